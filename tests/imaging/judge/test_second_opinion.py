"""Areas without a model of the edge: right for any shape, with the uncertainties that they state."""

import cv2
import numpy as np
import pytest
from contactimg.imaging.judge.agreement import compare
from contactimg.imaging.judge.second_opinion import Scenery, is_outshone, measure_again, measure_rise
from contactimg.imaging.kernels.contact_light import sum_light

RNG_SEED, NOISE, CONTRAST, FINE = 3, 2.0, 80.0, 4
EVERYTHING = np.ones((50, 75), np.bool_)


def places():
    """A grid of 20 places for contacts of some 10 px."""
    y, x = np.mgrid[50:400:90, 50:600:110]
    return np.column_stack([x.ravel(), y.ravel()]).astype(float) + 0.3


def scene(inside, *, blur=1.4, noise=NOISE):
    """An image of one shape at all places, and its area in px^2."""
    y, x = (np.mgrid[0 : 400 * FINE, 0 : 600 * FINE] + 0.5) / FINE - 0.5
    fine = np.zeros(x.shape, np.float32)
    for cx, cy in places():
        box = (
            slice(int((cy - 30) * FINE), int((cy + 30) * FINE)),
            slice(int((cx - 30) * FINE), int((cx + 30) * FINE)),
        )
        fine[box] += inside(x[box] - cx, y[box] - cy)
    area = float(fine.sum()) / FINE**2 / len(places())
    fine = cv2.GaussianBlur(fine, (0, 0), blur * FINE)
    image = CONTRAST * fine.reshape(400, FINE, 600, FINE).mean(axis=(1, 3))
    image += np.random.default_rng(RNG_SEED).normal(0, noise, image.shape)
    return image.astype(np.float32), area


SHAPES = {
    "disk": lambda x, y: np.hypot(x, y) < 10,
    "ellipse": lambda x, y: np.hypot(x / 1.15, y * 1.15) < 10,
    "square": lambda x, y: np.maximum(np.abs(x), np.abs(y)) < 9,
    "bitten disk": lambda x, y: (np.hypot(x, y) < 11) & (np.hypot(x - 11, y) > 4),
}


@pytest.mark.parametrize("name", SHAPES)
def test_areas_of_any_shape(name):
    image, area = scene(SHAPES[name])
    disks = np.column_stack([places(), np.full(len(places()), np.sqrt(area / np.pi))])
    background = np.ones((50, 75), np.bool_)
    for x, y, a in disks:
        background[int(y - a - 8) // 8 : int(y + a + 16) // 8, int(x - a - 8) // 8 : int(x + a + 16) // 8] = (
            False
        )
    opinion = measure_again(
        Scenery.of(image, valid=None, background=background, level=0.0),
        disks,
        blur_px=np.hypot(1.4, 12**-0.5),
    )
    for found, std in (
        (opinion.light_area, opinion.light_area_std),
        (opinion.half_area, opinion.half_area_std),
    ):
        pulls = (found - area) / std
        assert np.isfinite(pulls).all()
        # the stated std is an upper limit; 20 normal deviates lie within 3.5 in 99 % of such tests
        assert np.abs(pulls).max() < 3.5
        assert np.abs(found.mean() / area - 1) < 4e-3


def test_a_radius_that_is_wrong_is_found():
    image, area = scene(SHAPES["disk"])
    disks = np.column_stack([places(), np.full(len(places()), 10.0)])
    scenery = Scenery.of(image, valid=None, background=EVERYTHING, level=0.0)
    opinion = measure_again(scenery, disks, blur_px=1.43)
    right = compare(opinion, np.full(len(disks), np.sqrt(area / np.pi)), blur_px=1.43)
    assert not right.disagrees.any()
    assert not right.is_shared
    assert not right.remark(disks[:, 2])
    wrong = compare(opinion, np.full(len(disks), 9.6), blur_px=1.43)
    assert wrong.disagrees.all()
    assert wrong.is_shared
    assert np.median(wrong.shared_px) == pytest.approx(0.4, abs=0.05)
    assert "in all contacts alike" in wrong.remark(np.full(len(disks), 9.6))


def test_no_opinion_on_what_is_cut():
    image, _ = scene(SHAPES["disk"])
    disks = np.column_stack([places(), np.full(len(places()), 10.0)])
    valid = np.ones(image.shape, np.uint8)
    valid[:, :55] = 0
    image[:, :55] = 0.0
    scenery = Scenery.of(image, valid=valid, background=EVERYTHING, level=0.0)
    opinion = measure_again(scenery, disks, blur_px=1.43)
    cut = disks[:, 0] < 66
    assert np.isnan(opinion.light_area[cut]).all()
    assert np.isfinite(opinion.light_area[~cut]).all()


def test_light_is_shared_between_contacts_that_touch():
    x, y = np.meshgrid(np.arange(200.0), np.arange(100.0))
    fine = np.zeros((100, 200), np.float32)
    disks = np.array([[60.0, 50.0, 14.0], [80.5, 50.0, 6.0], [130.0, 50.0, 14.0], [165.0, 50.0, 14.0]])
    for cx, cy, a in disks:
        fine = np.maximum(fine, np.clip(a - np.hypot(x - cx, y - cy) + 0.5, 0, 1)).astype(np.float32)
    image = cv2.GaussianBlur(100 * fine, (0, 0), 1.4)
    scenery = Scenery.of(image, valid=None, background=np.ones((13, 25), np.bool_), level=0.0)
    found = measure_again(scenery, disks, blur_px=1.4).light_area
    # what a small contact loses to a large one across the line between their rims: 2 % of its light
    assert found == pytest.approx(np.pi * disks[:, 2] ** 2, rel=0.02)
    assert found[:2].sum() == pytest.approx(np.pi * (14**2 + 6**2), rel=3e-3)


@pytest.mark.parametrize(
    ("around", "spare_crowds", "rejected"),
    [
        (0.0, False, False),  # alone
        (120.0, False, True),  # brighter light all around it, beyond its rim
        (120.0, True, True),  # which no contact explains
        (80.0, False, False),  # darker light
    ],
)
def test_a_contact_outshines_what_lies_around_it(around, spare_crowds, rejected):
    y, x = np.mgrid[0:64, 0:64]
    r = np.hypot(x - 31.0, y - 32.0)
    image = np.where(r < 6, 100.0, np.where((r > 8) & (r < 18), around, 0.0)).astype(np.float32)
    found = is_outshone(image, np.array([[31.0, 32.0, 6.0]]), contrast=100.0, spare_crowds=spare_crowds)
    assert found.tolist() == [rejected]


def test_a_contact_among_brighter_contacts_may_be_spared():
    y, x = np.mgrid[0:64, 0:64]
    corners = [(31.0 + 11.5 * np.cos(t), 32.0 + 11.5 * np.sin(t), 5.5) for t in np.arange(6) * np.pi / 3]
    disks = np.array([(31.0, 32.0, 5.0), *corners])
    image = np.zeros(x.shape, np.float32)
    for (cx, cy, a), level in zip(disks, [90.0, *[100.0] * 6], strict=True):
        image[np.hypot(x - cx, y - cy) < a] = level
    assert is_outshone(image, disks, contrast=100.0, spare_crowds=False)[0]
    assert not is_outshone(image, disks, contrast=100.0, spare_crowds=True)[0]


@pytest.mark.parametrize("prominence", [0.5, 1.5, 5.0])
def test_bounds_of_the_rise_decide_as_the_rise_itself(prominence):
    image, area = scene(SHAPES["disk"])
    rng = np.random.default_rng(8)
    nothing = np.column_stack([rng.uniform(20, 580, 60), rng.uniform(20, 380, 60), rng.uniform(1, 8, 60)])
    disks = np.vstack([np.column_stack([places(), np.full(len(places()), np.sqrt(area / np.pi))]), nothing])
    rise, scatter = measure_rise(image, None, disks, blur_px=1.4)
    least, most = measure_rise(image, None, disks, blur_px=1.4, prominence=prominence)
    known = np.isfinite(rise)
    np.testing.assert_array_equal(np.isfinite(least), known)
    assert (least <= rise)[known].all()
    assert (most >= scatter)[known].all()
    assert (least != rise)[known].sum() >= len(places())  # that of a contact is not computed
    np.testing.assert_array_equal(least > prominence * most, rise > prominence * scatter)


def test_light_is_summed_alike_in_whole_rows_and_pixel_by_pixel():
    image, area = scene(SHAPES["disk"])
    disks = np.column_stack([places(), np.full(len(places()), np.sqrt(area / np.pi))])
    core, limits = np.maximum(disks[:, 2] - 4.0, 0.0), np.array([5.0, 9.0])
    sums, masked = np.zeros((2, len(disks), 7))
    sum_light(image, np.zeros((0, 0), np.uint8), disks, core, limits, sums)
    sum_light(image, np.ones(image.shape, np.uint8), disks, core, limits, masked)  # nothing is masked
    # single precision within a row of 40 pixels of 80 levels: 40 x 80 x 6e-8 = 2e-4 a row, 40 rows
    np.testing.assert_allclose(sums, masked, atol=8e-3)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    outside = np.hypot(x - disks[0, 0], y - disks[0, 1]) - disks[0, 2]
    assert sums[0, 0] == np.count_nonzero(outside < 5.0)
    assert sums[0, 2] == pytest.approx(image[outside < 5.0].sum(dtype=float), abs=8e-3)
    assert sums[0, 5] == np.count_nonzero((outside >= 5.0) & (outside < 9.0))
