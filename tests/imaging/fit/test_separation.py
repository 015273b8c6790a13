"""Contacts that touch, overlap or form groups are told apart; one contact, however ragged, stays one."""

import cv2
import numpy as np
import pandas as pd
import pytest
from camera_worlds import make_scene
from contact_frames import Optics, expose, match, render

from contactimg.imaging.count.split_touching import split_components
from contactimg.imaging.detect.components import label_components
from contactimg.imaging.fit.disks import FitControl, fit_disks, render_disks
from contactimg.imaging.fit.problem import ContrastPrior, FitProblem
from contactimg.imaging.kernels.model_image import add_lens
from contactimg.imaging.kernels.pairs import DEEPEST, hidden, visible_share
from contactimg.imaging.measure import measure_image
from contactimg.imaging.pixels.noise import Noise
from contactimg.tables import Flag, Status

OTHERS = [(190, 30, 10), (230, 40, 6), (200, 90, 8), (240, 95, 12), (190, 125, 6)]  # show contrast and blur


def lens_area(a, b, d):
    """Closed form of what two circles share."""
    u = np.arccos((d * d + a * a - b * b) / (2 * d * a))
    v = np.arccos((d * d + b * b - a * a) / (2 * d * b))
    return a * a * (u - np.sin(2 * u) / 2) + b * b * (v - np.sin(2 * v) / 2)


def frame_of(rows, seed=4, **options):
    truth = pd.DataFrame([*rows, *OTHERS], columns=["x_px", "y_px", "radius_px"], dtype=float).assign(kind=0)
    return truth, *render(truth, Optics(shape=(150, 270), dust=0, **options), np.random.default_rng(seed))


def painted(mask, *, sigma=1.4, fine=4, noise=True):
    """Frame and reference of a shape given on a grid ``fine`` times finer than the pixels."""
    cover = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), sigma * fine)
    rows, columns = mask.shape
    light = 80 + 100 * cover.reshape(rows // fine, fine, columns // fine, fine).mean(axis=(1, 3))
    if not noise:
        return np.rint(light).astype(np.uint8), np.full(light.shape, 80, np.uint8)
    rng = np.random.default_rng(3)
    return expose(light, Optics(), rng), expose(np.full(light.shape, 80.0), Optics(), rng)


def grid(shape=(150, 270), fine=4):
    y, x = np.mgrid[0 : shape[0] * fine, 0 : shape[1] * fine]
    return (x + 0.5) / fine - 0.5, (y + 0.5) / fine - 0.5


@pytest.mark.parametrize("two", [(33.0, 24.0, 7.0), (31.0, 20.0, 4.0), (20.0, 35.4, 9.0)])
def test_lens_is_what_two_blurred_disks_share(two):
    one, other, s, k = np.array([20.3, 20.1, 8.0, 100.0]), np.array([*two, 100.0]), 1.4, 16
    model = np.zeros((56, 56), np.float32)
    add_lens(model, one, other, s, 1.0)
    x, y = grid((56, 56), k)
    both = (np.hypot(x - one[0], y - one[1]) < one[2]) & (np.hypot(x - two[0], y - two[1]) < two[2])
    blurred = cv2.GaussianBlur(both.astype(np.float32), (0, 0), s * k)
    centre = blurred.reshape(56, k, 56, k)[:, k // 2 - 1 : k // 2 + 1][..., k // 2 - 1 : k // 2 + 1]
    # the midpoint rule errs by 0.8 % of the lens, 1 % where its ends are blunt
    assert np.abs(model / 100 - centre.mean(axis=(1, 3))).max() < 0.01 * model.max() / 100 + 1e-3
    d = np.hypot(one[0] - two[0], one[1] - two[1])
    assert model.sum() / 100 == pytest.approx(lens_area(8.0, two[2], d), rel=0.015)


def test_lens_of_a_disk_in_a_disk_is_the_smaller_one():
    model = np.zeros((60, 60), np.float32)
    add_lens(model, np.array([30.0, 30.0, 12.0, 80.0]), np.array([33.0, 29.0, 5.0, 100.0]), 1.4, 1.0)
    assert model.sum() / 90 == pytest.approx(np.pi * 25, rel=0.015)  # at the mean of the contrasts


def test_light_of_overlapping_disks_is_that_of_their_union():
    disks = np.array([[20.0, 20.0, 9.0, 1.0], [34.0, 21.0, 8.0, 1.0]])
    union = np.pi * (81 + 64) - lens_area(9.0, 8.0, np.hypot(14, 1))
    assert render_disks(disks, 1.4, (44, 56)).sum() == pytest.approx(union, rel=2e-3)
    alone = sum(render_disks(disk[None], 1.4, (44, 56)) for disk in disks)
    assert alone.sum() > 1.02 * union


def test_overlapping_disks_are_fitted_without_bias():
    truth = np.array([[30.0, 30.0, 9.0, 100.0], [44.5, 31.0, 7.0, 100.0]])
    image = render_disks(truth, 1.5, (62, 74))
    start = truth + np.array([[0.4, -0.3, -0.5, 0], [0.3, 0.4, 0.4, 0]])
    problem = FitProblem(image, Noise(0.01), ContrastPrior(100.0, 1e-3))
    found = fit_disks(
        problem, start, blur=1.5, control=FitControl(free_blur=False, robust=False, iterations=30)
    )
    # the same lens is in the image and in the model; taken as a sum, it would shift the radii by 0.2 px
    assert np.abs(found.disks - truth)[:, :3].max() < 5e-3


def test_visible_share_is_the_arc_outside_the_neighbour():
    # equal circles at the distance of their radius hide 2 x 60 degrees of each other; touching ones nothing
    disks = np.array([[0, 0, 5, 1], [5, 0, 5, 1], [100, 0, 5, 1], [110, 0, 5, 1]], float)
    assert np.allclose(visible_share(disks), [2 / 3, 2 / 3, 1, 1])
    inside = np.array([[0, 0, 5, 1], [1, 0, 2, 1]], float)
    assert 0 < visible_share(inside)[1] < 0.5 < visible_share(inside)[0]


@pytest.mark.parametrize("share", [0.1, 0.2, 0.3])
def test_visible_areas_of_overlapping_contacts_add_up_to_their_union(share):
    far = (10.0 + 14.0) * (1.0 - share)
    truth, frame, reference = frame_of([(50.0, 60.0, 10.0), (50.0 + far, 62.0, 14.0)])
    found = measure_image(frame, reference).disks
    pair = found[found.x_px < 120]
    assert len(found) == len(truth)
    assert len(pair) == 2
    lens = lens_area(10.0, 14.0, np.hypot(far, 2.0))
    union = np.pi * (10.0**2 + 14.0**2) - lens
    assert pair.visible_area_px2.sum() == pytest.approx(union, abs=max(0.2 * lens, 0.01 * union))
    assert pair.area_px2.sum() - pair.visible_area_px2.sum() == pytest.approx(lens, rel=0.2)


def test_hidden_disks_overlap_one_before_them():
    step = 2 * 5 * (1 - DEEPEST)  # distance of equal disks of radius 5 at the limit
    disks = np.array([[0, 0, 5], [step - 0.1, 0, 5], [2 * step - 0.1, 0, 5], [30, 0, 5]], float)
    assert list(hidden(disks)) == [False, True, False, False]


GROUPS = {
    "overlapping by a fifth of the smaller": [(50, 60, 12), (66.4, 60, 6.5)],
    "compact three": [(60, 50, 7), (53, 60.5, 6), (66.5, 60.5, 6.5)],
    "three small ones": [(60, 60, 3.8), (57.4, 65.2, 3.0), (54.0, 58.6, 3.4)],
    "four": [(50, 50, 6), (63, 53, 8.5), (38.5, 53, 5.7), (48.5, 40.5, 4.5)],
    "five": [(26, 70, 5.6), (36.3, 71, 5.2), (15.8, 71, 5.1), (48.5, 75.5, 9), (31, 78.3, 4.8)],
}


@pytest.mark.parametrize("name", list(GROUPS))
def test_groups_are_resolved(name):
    rows = GROUPS[name]
    truth, frame, reference = frame_of(rows)
    found = measure_image(frame, reference).disks
    pairs = match(truth, found)
    assert len(pairs) == len(truth) == len(found)
    error = np.full(len(truth), np.nan)
    error[pairs[:, 0]] = found.radius_px.to_numpy()[pairs[:, 1]] - truth.radius_px.to_numpy()[pairs[:, 0]]
    # uncertainties are 0.02-0.1 px; taken as a sum of disks, the members would come out 0.2-0.5 px small
    assert np.abs(error).max() < 0.3
    assert (found["flags"].to_numpy()[pairs[:, 1]][pairs[:, 0] < len(rows)] & int(Flag.MERGED)).all()


@pytest.mark.parametrize("angle", [0.2, 1.0, 2.1])
@pytest.mark.parametrize(("wide", "small", "gap"), [(5.3, 1.85, 0.0), (3.3, 1.6, 1.5)])
def test_a_small_contact_beside_a_wider_one_is_no_bump_of_an_ellipse(wide, small, gap, angle):
    """Behind a blur as wide as the small one, the two look like an ellipse that fits badly."""
    away = wide + small + gap
    pair = [(60, 70, wide), (60 + away * np.cos(angle), 70 + away * np.sin(angle), small)]
    truth, frame, reference = frame_of(pair, sigma=1.9, camera="high")
    disks = measure_image(frame, reference).disks
    assert len(match(truth, disks)) == len(truth) == len(disks)
    assert set(disks["shape"]) == {"disk"}


@pytest.mark.parametrize(("wide", "small", "k"), [(9.27, 2.43, 1), (8.0, 2.2, 7)])
def test_two_contacts_that_fit_imperfectly_in_bright_light_stay_two(wide, small, k):
    """In bright light even the right two disks leave three times the noise; one region leaves far more."""
    angle, away, x, y = 0.1 + 0.6 * k, wide + small, 60 + 0.17 * k, 70 - 0.23 * k
    pair = [(x, y, wide), (x + away * np.cos(angle), y + away * np.sin(angle), small)]
    truth, frame, reference = frame_of(pair, seed=k, sigma=1.9, camera="high")
    disks = measure_image(frame, reference).disks
    assert len(match(truth, disks)) == len(truth) == len(disks)


@pytest.mark.parametrize("sigma", [1.4, 2.0])
def test_small_close_contacts_are_two(sigma):
    # at gaps below the blur the two have one maximum
    rows = [(40, 40, 1.8), (40 + 1.8 + 1.6 + 0.7, 40, 1.6), (90, 60, 5.8), (90 - 5.3, 60 - 6.2, 1.6)]
    truth, frame, reference = frame_of(rows, sigma=sigma)
    found = measure_image(frame, reference).disks
    assert len(match(truth, found)) == len(truth) == len(found)


def shapes():
    x, y = grid()
    r, angle = np.hypot(x - 60, y - 70), np.arctan2(y - 70, x - 60)
    yield "ellipse", ((x - 60) / 18.4) ** 2 + ((y - 70) / 12.3) ** 2 < 1
    yield "lobes", r < 18 * (1 + 0.1 * np.cos(4 * angle + 1) + 0.06 * np.cos(7 * angle))
    yield "large ellipse", ((x - 60) / 34) ** 2 + ((y - 70) / 26) ** 2 < 1
    yield "square", np.maximum(abs(x - 60), abs(y - 70)) < 13


@pytest.mark.parametrize(
    ("name", "mask"), list(shapes()), ids=lambda value: value if isinstance(value, str) else ""
)
@pytest.mark.parametrize("noise", [True, False])
def test_one_contact_of_any_shape_is_one(name, mask, noise):
    x, y = grid()
    for cx, cy, a in OTHERS:
        mask = mask | (np.hypot(x - cx, y - cy) < a)
    for method in ("disk", "threshold"):
        found = measure_image(*painted(mask, noise=noise), method=method).disks
        assert len(found) == 1 + len(OTHERS)
        if method == "disk":
            odd = found.loc[np.hypot(found.x_px - 60, found.y_px - 70).idxmin()]
            assert odd["shape"] in ("ellipse", "free")


@pytest.mark.parametrize("radius", [2.5, 4.0, 10.0, 30.0])
@pytest.mark.parametrize("offset", [0.0, 0.3])
def test_a_disk_of_whole_pixels_is_one(radius, offset):
    y, x = np.mgrid[0:150, 0:270]
    mask = np.zeros(x.shape, bool)
    for cx, cy, a in [(60, 70, radius), *OTHERS]:
        mask |= np.hypot(x - cx - offset, y - cy - offset) < a
    frame = np.where(mask, 180, 80).astype(np.uint8)
    found = measure_image(frame, np.full(frame.shape, 80, np.uint8)).disks
    assert len(found) == 1 + len(OTHERS)
    one = found.loc[np.hypot(found.x_px - 60, found.y_px - 70).idxmin()]
    # N pixels in a circle scatter about pi a^2 by the rim's, sqrt(2 pi a/12) or so: 0.1-0.3 px of the radius
    assert one.radius_px == pytest.approx(radius, abs=0.35)


@pytest.mark.parametrize("gap", [-2.0, 0.0, 0.5, 1.5])
def test_threshold_parts_what_touches(gap):
    rows = [(50, 60, 9), (50 + 9 + 6 + gap, 60, 6)]
    truth, frame, reference = frame_of(rows)
    found = measure_image(frame, reference, method="threshold").disks
    pairs = match(truth, found)
    assert len(pairs) == len(truth) == len(found)
    flags = found["flags"].to_numpy()[pairs[:, 1]][np.argsort(pairs[:, 0])]
    assert [bool(flag & Flag.MERGED) for flag in flags] == [True] * 2 + [False] * len(OTHERS)
    error = found.radius_px.to_numpy()[pairs[:, 1]] - truth.radius_px.to_numpy()[pairs[:, 0]]
    # light in the neck between two counts for both, light of a lens for one: some px^2 of 2 pi a px
    assert np.abs(error).max() < 0.6


def test_parting_loses_no_pixel():
    y, x = np.mgrid[0:60, 0:120]
    image = np.zeros(x.shape, np.float32)
    for cx, cy, a in [(30, 30, 12), (48, 30, 7), (58, 38, 6), (100, 20, 9)]:
        image[np.hypot(x - cx, y - cy) < a] = 2.0
    found = label_components(image, 1.0)
    parts, split = split_components(image, 1.0)
    assert len(found) == 2
    assert sorted(split) == [False, True, True, True]
    for name in ("area", "flux"):
        assert parts[name].sum() == found[name].sum()
    for name in ("x", "y"):
        assert parts["area"] @ parts[name] == pytest.approx(found["area"] @ found[name], rel=1e-12)
    assert parts["left"].min() == found["left"].min()
    assert parts["bottom"].max() == found["bottom"].max()


def test_noise_parts_nothing():
    # contrast over noise of 5: rims are notched by the noise
    rng = np.random.default_rng(1)
    y, x = np.mgrid[0:150, 0:270]
    image = np.zeros(x.shape, np.float32)
    for cx, cy, a in [(60, 70, 20), *OTHERS]:
        image += np.clip(0.5 + (a - np.hypot(x - cx, y - cy)) / 3.5, 0, 1)
    image = (80 + 14 * image + rng.normal(0, 2.8, image.shape)).astype(np.float32)
    reference = (80 + rng.normal(0, 0.1, image.shape)).astype(np.float32)
    found = measure_image(image, reference, method="threshold").disks
    assert len(found) == 1 + len(OTHERS)


def test_three_contacts_in_a_convex_region_stay_three():
    rows = [(64.5, 50.2, 27.6), (29.5, 47.9, 5.8), (26.6, 67.0, 12.5)]
    truth, frame, reference = frame_of(rows)
    found = measure_image(frame, reference)
    assert len(match(truth, found.disks)) == len(found.disks) == len(truth)
    assert found.status == Status.OK


@pytest.mark.parametrize("count", [140, 450])
def test_two_small_contacts_beside_wide_ones_are_told_apart(count):
    """The wide ones, which fit well, do not outweigh what the small ones leave unexplained."""
    scene = make_scene("crowd", count, 70007)
    found = measure_image(scene.frame, scene.reference, polarity=scene.polarity)
    assert len(match(scene.truth, found.disks)) == len(found.disks) == count
