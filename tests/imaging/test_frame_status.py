"""What a frame says of itself where it is not what the method assumes."""

from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
import pytest
from camera_worlds import Layout, World, field_stop, in_stop, vignetting
from contact_frames import Optics, coverage, expose, match, render, scatter

from contactimg.forces import SHARED_SHIFTS
from contactimg.imaging.measure import measure_image
from contactimg.tables import Flag, Reason, Status

OPTICS = Optics(shape=(360, 480), dust=4)


@pytest.fixture(scope="module")
def truth():
    return scatter(60, OPTICS, np.random.default_rng(11), radii=(2, 20), pairs=0.1, touching=0.0)


def sum_error(truth, disks):
    """Error of the sum of the areas, in its stated standard uncertainties."""
    a, slope = disks.radius_px.to_numpy(), 2 * np.pi * disks.radius_px.to_numpy()
    shared = disks[list(SHARED_SHIFTS)].to_numpy()
    own = np.maximum(disks.radius_std_px.to_numpy() ** 2 - (shared**2).sum(axis=1), 0)
    std = np.sqrt(slope**2 @ own + np.sum((slope @ shared) ** 2))
    return (np.pi * (a**2).sum() - np.pi * (truth.radius_px**2).sum()) / std


def pair(truth):
    """Frame and reference as the method assumes them."""
    return render(truth, OPTICS, np.random.default_rng(5))


def levels(light):
    return np.clip(np.rint(light), 0, 255).astype(np.uint8)


def dim_reference(frame, reference):
    return frame, levels(reference * np.linspace(0.76, 0.84, frame.shape[1]))


def row_noise(frame, reference):
    rows = 1.5 * np.random.default_rng(6).standard_normal((len(frame), 1))
    return levels(frame + rows), reference


def ghosts(frame, reference):
    """Fifteen contacts of another place in the reference."""
    other = scatter(15, OPTICS, np.random.default_rng(6), radii=(6, 25), pairs=0, touching=0)
    cover = coverage(other.x_px, other.y_px, other.radius_px, np.ones(len(other)), OPTICS)
    return frame, levels(reference * (1 + OPTICS.contrast * cover))


def other_surface(frame, _reference):
    blank = scatter(0, OPTICS, np.random.default_rng(6))
    return frame, render(blank, replace(OPTICS, texture=0.05), np.random.default_rng(6))[1]


@pytest.mark.parametrize("change", [None, dim_reference, row_noise])
def test_frames_as_assumed_are_ok_and_not_flagged(truth, change):
    images = pair(truth) if change is None else change(*pair(truth))
    result = measure_image(*images, polarity="bright")
    assert result.status == "ok"
    assert not (result.disks["flags"] & int(Flag.DISAGREES)).any()
    assert len(match(truth, result.disks)) == len(result.disks) == len(truth)
    assert abs(sum_error(truth, result.disks)) < 3


@pytest.mark.parametrize(
    ("change", "status"), [(ghosts, Status.WRONG_REFERENCE), (other_surface, Status.NOT_REGISTERED)]
)
def test_a_reference_of_another_place_is_named(truth, change, status):
    result = measure_image(*change(*pair(truth)), polarity="bright")
    assert result.status == status
    assert result.message


UNEVEN = {
    "vignetting": ({"light": vignetting}, 60),
    "a dark corner": ({"light": lambda u, v, _: 1.2 - 0.8 * np.exp(-5 * ((u - 1) ** 2 + (v - 1) ** 2))}, 60),
    "a field stop": ({"light": field_stop, "layout": Layout(region=in_stop)}, 12),
}


@pytest.mark.parametrize("name", UNEVEN)
def test_uneven_light_on_a_smooth_surface_is_no_texture(name):
    """It is in frame and reference, and nothing in it would move with the sample."""
    kind, count = UNEVEN[name]
    world = World(texture=0.0, dusty=False, electrons=5 if "corner" in name else 80, moves=0.0, **kind)
    scene = world(count, np.random.default_rng([5, count, 0]))
    assert measure_image(scene.frame, scene.reference).status == "ok"


def test_a_texture_below_the_noise_tells_the_shift_to_a_pixel():
    clear, faint = (
        World(texture=rms, dusty=False, electrons=electrons, moves=14.0, level=100.0, contrast=50.0)
        for rms, electrons in ((0.02, 20), (0.007, 3))
    )
    shifts = []
    for world in (clear, faint):
        scene = world(140, np.random.default_rng([6, 1]))
        found = measure_image(scene.frame, scene.reference)
        shifts.append((found.shift_x_px, found.shift_y_px))
    np.testing.assert_allclose(*shifts, atol=1.5)
    assert np.hypot(*shifts[0]) > 10


@pytest.mark.parametrize(("size", "share"), [(1, 0.5), (3, 0.35), (6, 0.3)])
def test_scattered_holes_do_not_hide_the_shift(size, share):
    world = World(texture=0.03, moves=14.0, dusty=False)
    scene = world(60, np.random.default_rng([6, 1]))
    whole = measure_image(scene.frame, scene.reference)
    frame, rng = scene.frame.astype(np.float32), np.random.default_rng(2)
    for _ in range(int(share * frame.size / size**2)):
        y, x = (rng.integers(0, n - size) for n in frame.shape)
        frame[y : y + size, x : x + size] = np.nan
    found = measure_image(frame, scene.reference.astype(np.float32))
    shifts = [(one.shift_x_px, one.shift_y_px) for one in (whole, found)]
    assert np.hypot(*shifts[0]) > 10
    np.testing.assert_allclose(*shifts, atol=1.5)


def test_a_reference_that_leaves_a_margin_bare_is_said(truth):
    frame, reference = pair(truth)
    near, far = (measure_image(frame, np.roll(reference, by, axis=0)) for by in (2, 16))
    assert near.status == Status.OK
    assert far.status == Status.UNRESOLVED
    assert "leaves 4.4 % of the frame bare" in far.message


@pytest.mark.parametrize("method", ["disk", "threshold"])
def test_contacts_that_only_the_reference_shows_are_not_ok(truth, method):
    """Bright contacts in a reference are dust, or dark contacts of an empty frame."""
    frame, reference = pair(truth)
    result = measure_image(reference, frame, method=method, polarity="dark")
    assert result.status != Status.OK
    assert not result.measurable or not len(result.disks)
    assert len(result.rejected) >= 3


def bright_patch(seed):
    """Frame and reference of three contacts, and of a wider rectangle of half of their height."""
    rng, (y, x) = np.random.default_rng(seed), np.mgrid[:221, :310]
    light = np.zeros((221, 310))
    for cx, cy, a in ((60, 60, 14), (250, 60, 10), (240, 170, 17)):
        light[np.hypot(x - cx, y - cy) < a] = 25.0
    light[90:190, 80:170] = 13.0
    light = cv2.GaussianBlur(light, (0, 0), 1.4)
    return [levels(80 + image + rng.normal(0, 2, light.shape)) for image in (light, 0.0 * light)]


@pytest.mark.parametrize("seed", [2, 3, 9])
def test_a_frame_is_not_ok_where_most_of_the_area_is_no_disk(seed):
    found = measure_image(*bright_patch(seed))
    assert len(found.disks) == 4
    assert found.status == Status.POOR_FIT
    assert "% of the area, are not described" in found.message


@pytest.mark.parametrize("rows", [1, 4])
def test_a_frame_of_a_few_rows_is_not_ok(truth, rows):
    frame, reference = pair(truth)
    row = int(truth.loc[truth.radius_px.idxmax(), "y_px"])
    strip = slice(row, row + rows)
    result = measure_image(frame[strip], reference[strip], method="threshold", polarity="bright")
    assert result.status != "ok"
    assert result.message


@pytest.mark.parametrize("method", ["disk", "threshold"])
def test_one_contact_that_fits_is_ok(method):
    rng, optics = np.random.default_rng(3), Optics(shape=(240, 320))
    truth = scatter(1, optics, rng, radii=(10.0, 14.0), pairs=0.0, touching=0.0)
    assert measure_image(*render(truth, optics, rng), method=method, polarity="bright").status == Status.OK


def test_counted_contacts_that_touch_are_ok():
    rng, optics = np.random.default_rng(17), Optics(shape=(360, 480))
    truth = scatter(60, optics, rng, radii=(5.0, 14.0), pairs=0.5, touching=0.3)
    result = measure_image(*render(truth, optics, rng), method="threshold", polarity="bright")
    assert result.status == Status.OK


def scratched(truth, *, fraction=0.42):
    """A frame with a scratch across it, at a fraction of the contrast."""
    rng = np.random.default_rng(8)
    line = np.zeros((OPTICS.shape[0] * 4, OPTICS.shape[1] * 4), np.float32)
    cv2.line(line, (60, 1100), (1800, 900), 1.0, 5)
    line = cv2.GaussianBlur(line, (0, 0), 5.6)
    line = line.reshape(OPTICS.shape[0], 4, OPTICS.shape[1], 4).mean(axis=(1, 3))
    far = np.abs(truth.y_px - (275 - 0.115 * (truth.x_px - 15))) > truth.radius_px + 10
    kept = truth[far].reset_index(drop=True)
    frame, reference = pair(kept)
    light = frame + 80 * fraction * OPTICS.contrast * line / line.max()
    return kept, expose(light, Optics(camera=(1e6, 0.0)), rng), reference


def test_a_scratch_is_no_chain_of_contacts(truth):
    kept, frame, reference = scratched(truth)
    result = measure_image(frame, reference, polarity="bright")
    pairs = match(kept, result.disks)
    assert len(pairs) == len(kept)
    assert len(result.disks) - len(pairs) <= 3 or result.status != "ok"


def test_a_row_of_small_contacts_is_no_scratch():
    y, x = np.mgrid[40:320:9, 60:420:60]
    rows = pd.DataFrame({"x_px": x.ravel() * 1.0, "y_px": y.ravel() * 1.0, "radius_px": 2.5})
    result = measure_image(*pair(rows), polarity="bright")
    assert len(match(rows, result.disks)) == len(rows)
    assert Reason.SCRATCH not in set(result.rejected.reason)


def sharpened(truth):
    """Frame and reference by a camera that adds four times what a pixel exceeds its surroundings by."""
    images = (image.astype(float) for image in pair(truth))
    return [levels(5.0 * image - 4.0 * cv2.GaussianBlur(image, (0, 0), 1.5)) for image in images]


def with_second_image(truth):
    """Frame and reference of contacts of which glass plates reflect a fifth, 24 px away."""
    cover = coverage(*truth[["x_px", "y_px", "radius_px"]].T.to_numpy(), np.ones(len(truth)), OPTICS)
    cover = cover + 0.2 * np.roll(cover, (16, 18), (0, 1))
    rng = np.random.default_rng(5)
    return [expose(80.0 * (1.0 + OPTICS.contrast * part), OPTICS, rng) for part in (cover, 0.0 * cover)]


def with_a_faint_fibre(truth):
    """Frame and reference with an arc of a sixth of the contrast across background."""
    y, x = np.mgrid[: OPTICS.shape[0], : OPTICS.shape[1]]
    arc = np.exp(-(((np.hypot(x - 240, y + 60) - 240) / 1.5) ** 2) / 2)
    frame, reference = pair(truth)
    return levels(frame + 0.17 * 80 * OPTICS.contrast * arc), reference


def with_one_dark_contact(truth):
    """Frame and reference in which one of the contacts is darker than the background."""
    frame, reference = pair(truth[1:])
    dark = coverage(*truth[:1][["x_px", "y_px", "radius_px"]].T.to_numpy(), [1.0], OPTICS)
    return levels(frame * (1.0 - 0.4 * dark)), reference


@pytest.mark.parametrize(
    ("change", "count", "seed", "status", "why"),
    [
        (sharpened, 60, 12, Status.NONLINEAR, "a camera that sharpens"),
        (with_second_image, 6, 13, Status.FALSE_CANDIDATES, "less than 0.25 of the brightness"),
        (with_a_faint_fibre, 20, 14, Status.FALSE_CANDIDATES, "hardly stand out of the noise"),
        (with_one_dark_contact, 6, 12, Status.UNRESOLVED, "1 spot is darker"),
    ],
)
def test_what_looks_like_contacts_is_said(change, count, seed, status, why):
    rng = np.random.default_rng(seed)
    truth = scatter(count, OPTICS, rng, radii=(3, 14), pairs=0.0, touching=0.0)
    result = measure_image(*change(truth), polarity="bright")
    assert why in result.message
    assert result.status == status


def test_light_that_is_measured_as_a_contact_is_said():
    """A lamp doubles the light of a part of the frame, up to the full scale."""
    optics, rng = Optics(shape=(226, 302), dust=0), np.random.default_rng(8)
    truth = scatter(5, optics, rng, radii=(2, 14), pairs=0.0, touching=0.0)
    frame, reference = render(truth, optics, rng)
    v, u = (np.linspace(-1, 1, n) for n in optics.shape)
    lamp = 1.0 + 1.2 * np.exp(-((u + 0.3) ** 2 + v[:, None] ** 2) / 0.1)
    result = measure_image(levels(frame * lamp), reference)
    assert result.status == Status.LIGHT_NOT_FOLLOWED
    assert "as light is" in result.message


def test_contacts_with_holes_that_are_counted_are_said():
    """Holes of 0.3 of the radii, most of whose area is counted but not all of it."""
    truth = scatter(6, OPTICS, np.random.default_rng(15), radii=(5, 16), pairs=0.0, touching=0.0)
    outer, inner = (
        coverage(truth.x_px, truth.y_px, share * truth.radius_px, np.ones(6), OPTICS) for share in (1.0, 0.3)
    )
    frame, reference = pair(truth[:0])
    result = measure_image(levels(frame * (1.0 + 0.75 * (outer - inner))), reference, polarity="bright")
    assert result.status == Status.DISAGREES
    assert "far from those of the fit" in result.message


def test_contacts_whose_optics_spread_half_of_their_light_keep_their_rims():
    """The rims fall by half of what they fall by behind the core of the point spread function alone."""
    optics = replace(OPTICS, halo=0.5, halo_sigma=16.0)
    truth = scatter(40, optics, np.random.default_rng(1), radii=(5, 16), pairs=0.0, touching=0.0)
    result = measure_image(*render(truth, optics, np.random.default_rng(1)))
    assert len(match(truth, result.disks)) == len(result.disks) == 40
    assert abs(sum_error(truth, result.disks)) < 3


def test_islands_behind_a_halo_are_counted_at_half_of_the_height_that_is_seen():
    """Fourteen regions of five disks that overlap, half of whose light is spread over 16 px."""
    optics, rng = replace(OPTICS, halo=0.5, halo_sigma=16.0), np.random.default_rng(1)
    islands = scatter(14, optics, rng, radii=(14, 20), pairs=0.0, touching=0.0, margin=12)
    x, y, a = np.repeat(islands[["x_px", "y_px", "radius_px"]].to_numpy(), 5, axis=0).T
    turn, way, part = rng.uniform([[0.0], [0.2], [0.35]], [[2 * np.pi], [0.65], [0.55]], (3, 70))
    x, y, a = x + way * a * np.cos(turn), y + way * a * np.sin(turn), part * a
    truth = pd.DataFrame({"x_px": x, "y_px": y, "radius_px": a})
    expected = coverage(x, y, a, np.ones(70), replace(optics, halo=0.0, sigma=0.3)).sum()
    result = measure_image(*render(truth, optics, np.random.default_rng(1)))
    assert len(result.disks) <= 18
    assert abs(result.disks.visible_area_px2.sum() / expected - 1.0) < 0.05
