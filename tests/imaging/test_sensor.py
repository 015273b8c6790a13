"""What a sensor and a field stop add to a frame: found where it is, left alone where it is not."""

import numpy as np
import pandas as pd
import pytest
from camera_worlds import BAYER, Layout, World, black_border, field_stop, in_border, make_scene
from contact_frames import Optics, match, render, scatter
from scipy.special import ndtr

from contactimg.imaging.measure import measure_image
from contactimg.imaging.pixels.field_of_view import find_unlit
from contactimg.imaging.pixels.sensor_defects import divide_by_mosaic, mosaic_gains, repair_defects
from contactimg.tables import Flag, Status

SHAPE = (240, 320)
Y, X = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]].astype(float)


def noisy(light, rng, noise=2.0):
    return np.clip(np.rint(light + rng.normal(0, noise, np.shape(light))), 0, 255).astype(np.uint8)


def dots(level, height, rng, *, radius=9.0, pitch=40):
    """Disks on a lattice, those of the first row and column cut by the border."""
    light = np.full(SHAPE, float(level))
    for x in range(0, SHAPE[1], pitch):
        for y in range(0, SHAPE[0], pitch):
            light += height * np.clip(radius - np.hypot(X - x, Y - y) + 0.5, 0, 1)
    return noisy(light, rng)


UNLIT = {
    "border": np.minimum.reduce([X, Y, SHAPE[1] - 1 - X, SHAPE[0] - 1 - Y]) < 24,
    "round stop": np.hypot(X - 160, Y - 120) > 112,
    "band": Y < 40,
}


@pytest.mark.parametrize("name", UNLIT)
def test_regions_without_light_are_found_and_nothing_else(name, rng):
    dark = UNLIT[name]
    frame = noisy(np.where(dark, 1.0, 90.0), rng)
    found = find_unlit(frame, None)
    assert found is not None
    assert found[dark].all()
    # beside the margin for the blurred edge, lit pixels are kept
    assert np.mean(found[~dark]) < 0.1


LIT = {
    "bright dots on black": lambda rng: dots(2, 180, rng),
    "dark contacts at the border": lambda rng: dots(120, -112, rng),
    "a large dark contact at the border": lambda rng: noisy(
        120 - 115.0 * (np.hypot(X - 160, Y - 8) < 12), rng
    ),
    "light that falls off": lambda rng: noisy(
        150 - 120 * np.hypot(X - 160, Y - 120) / np.hypot(160, 120), rng
    ),
    "dim and even": lambda rng: noisy(np.full(SHAPE, 12.0), rng),
    "black": lambda rng: np.zeros(SHAPE, np.uint8),
}


@pytest.mark.parametrize("name", LIT)
def test_frames_without_a_stop_keep_all_pixels(name, rng):
    assert find_unlit(LIT[name](rng), None) is None


def test_gains_of_a_colour_mosaic_are_found_and_taken_out(rng):
    gains = np.tile(BAYER, (SHAPE[0] // 2, SHAPE[1] // 2))
    light = 90 + 60.0 * (np.hypot(X - 100, Y - 100) < 30)
    found = mosaic_gains(noisy(light * gains, rng))
    # 19,200 pixels a phase with noise of 2 levels in 75: 2e-4; the sampling takes a quarter of them
    np.testing.assert_allclose(found, BAYER / BAYER.mean(), atol=2e-3)
    even = divide_by_mosaic(noisy(light * gains, rng), found)
    assert np.ptp([even[i::2, j::2].mean() for i in (0, 1) for j in (0, 1)]) < 0.5


def test_a_mask_hides_nothing_of_a_colour_mosaic():
    """Holes are filled with one level, of which the gains of a mosaic are 1."""
    scene = make_scene("Bayer", 140, 3)
    hidden = int(0.6 * scene.frame.shape[1])
    frame = scene.frame.astype(np.float32)
    frame[:, :hidden] = np.nan
    found = measure_image(frame, scene.reference, full_scale=255.0)
    assert found.status == Status.HOLES
    truth, disks = scene.truth, found.disks
    whole, seen = (
        truth[truth.x_px - truth.radius_px > hidden + 4],
        disks[disks.x_px - disks.radius_px > hidden],
    )
    assert len(seen) == len(whole)
    std = np.sqrt(np.sum(seen["area_std_px2"] ** 2))
    assert abs(seen["area_px2"].sum() - whole["area_px2"].sum()) < 3.0 * std
    # the noise of the frame without the mask
    assert found.noise == pytest.approx(measure_image(scene.frame, scene.reference).noise, rel=0.05)


def test_a_colour_whose_pixels_are_black_tells_no_gain(rng):
    gains = np.tile(BAYER, (SHAPE[0] // 2, SHAPE[1] // 2))
    image = noisy(np.maximum(90 * gains - 62, 0), rng, noise=1.0)
    assert np.median(image[::2, ::2]) == 0
    assert mosaic_gains(image) is None
    assert len(measure_image(image, image).disks) == 0


@pytest.mark.parametrize("name", LIT)
def test_a_plain_sensor_has_no_mosaic(name, rng):
    assert mosaic_gains(LIT[name](rng)) is None


def test_a_steep_gradient_is_no_mosaic(rng):
    assert mosaic_gains(noisy(20 + 200 * X / SHAPE[1], rng)) is None


def spots(rng, *, radius=1.0, blur=0.75):
    """Points and small contacts behind a sharp lens: the narrowest that a contact can look."""
    light = np.full(SHAPE, 90.0)
    for x, y in rng.uniform(10, (SHAPE[1] - 10, SHAPE[0] - 10), (40, 2)):
        near = np.exp(-((X - x) ** 2 + (Y - y) ** 2) / (2 * (blur**2 + 0.25 * radius**2)))
        light = np.maximum(light, 90 + 120 * near)
    return noisy(light, rng)


NO_DEFECTS = LIT | {
    "points behind a sharp lens": lambda rng: spots(rng, radius=0.0),
    "small contacts": spots,
    "sharp disks without noise": lambda _: np.where(np.hypot(X % 40 - 20, Y % 40 - 20) < 7, 200, 50).astype(
        np.uint8
    ),
    "a checkerboard of pixels": lambda _: (60 + 100 * ((X + Y) % 2)).astype(np.uint8),
    "a few electrons": lambda rng: rng.poisson(np.full(SHAPE, 0.5)).astype(np.uint8),
}


@pytest.mark.parametrize("name", NO_DEFECTS)
def test_a_sound_sensor_is_left_as_it_is(name, rng):
    frame = NO_DEFECTS[name](rng)
    repaired, where = repair_defects(frame, None)
    assert where is None
    assert repaired is frame


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
def test_hot_and_dead_pixels_and_columns_are_repaired(kind, rng):
    frame = np.asarray(dots(60, 90, rng), float) * (1 if kind is np.uint8 else 100)
    bad = np.zeros(SHAPE, np.bool_)
    bad[rng.integers(2, SHAPE[0] - 2, 60), rng.integers(2, SHAPE[1] - 2, 60)] = True
    bad[:, 77] = True
    broken = np.where(bad, 0.0, frame).astype(kind)
    repaired, where = repair_defects(broken, None)
    assert (
        np.mean(where[bad]) > 0.8
    )  # others are at the rims of the dots, where their neighbours differ as well
    assert where[:, 77].all()  # also at the rims of the dots
    assert np.mean(where[~bad]) < 1e-4
    # nine pixels or fewer give a median to about half of the noise of one; at a rim it is off by its slope
    assert np.median(np.abs(repaired[bad] - frame[bad])) < 3.0 * (1 if kind is np.uint8 else 100)


@pytest.mark.parametrize("row", [117, 119, 121, 123])
def test_a_hot_pixel_at_the_rim_does_not_take_a_contact_out(row, rng):
    light = np.full(SHAPE, 80.0)
    for x, y, a in [(100, 120, 36.0), (143.5, 120, 7.2), (220, 60, 12), (240, 180, 15), (60, 40, 10)]:
        light += 45.0 * ndtr(a - np.hypot(X - x, Y - y))
    frame = noisy(light, rng)
    frame[row, 150] = frame[row - 7, 146] = 255
    disks = measure_image(frame).disks
    assert len(disks) == 5
    assert disks["radius_px"].min() == pytest.approx(7.2, abs=0.3)


@pytest.mark.parametrize("share", [0.02, 0.05])
def test_contacts_are_found_where_many_pixels_are_defective(share):
    scene = make_scene("plain", 140, 44)
    broken = []
    for seed, image in enumerate((scene.frame, scene.reference)):
        chance = np.random.default_rng(seed).random(image.shape)
        broken.append(np.where(chance < share / 2, 0, np.where(chance > 1 - share / 2, 255, image)))
    disks = measure_image(*(image.astype(np.uint8) for image in broken)).disks
    pairs = match(scene.truth, disks)
    assert len(pairs) > 0.95 * scene.truth["required"].sum()
    assert len(pairs) > 0.95 * len(disks)
    assert disks["visible_area_px2"].sum() == pytest.approx((scene.truth.area_px2).sum(), rel=0.02)


@pytest.mark.parametrize("seed", range(5, 7))
@pytest.mark.parametrize("light", [field_stop, black_border])
def test_light_without_contacts_shows_none_or_is_not_ok(light, seed):
    world = World(layout=Layout(region=in_border), light=light, reference=False)
    result = measure_image(world(0, np.random.default_rng(seed)).frame)
    assert not len(result.disks) or result.status != Status.OK


def test_contacts_at_full_scale_are_flagged():
    scene = make_scene("clipped", 25, 13)
    result = measure_image(scene.frame, scene.reference)
    wide = scene.truth[scene.truth.radius_px > 4].reset_index(drop=True)
    pairs = match(wide, result.disks)
    assert len(pairs) == len(wide)
    assert (result.disks["flags"].to_numpy()[pairs[:, 1]] & int(Flag.SATURATED) > 0).all()
    assert result.status == "saturated"


CUT = pd.DataFrame(
    {
        "x_px": [3.0, 150.0, 318.0, 160.0],
        "y_px": [100.0, 2.0, 180.0, 120.0],
        "radius_px": [9.0, 10.0, 12.0, 11.0],
    }
)


@pytest.mark.parametrize("polarity", ["bright", "dark"])
def test_contacts_cut_by_the_border_state_their_visible_area(polarity, rng):
    optics = Optics(shape=SHAPE, dust=0, texture=0.0, contrast=1.25 if polarity == "bright" else -0.5)
    disks = measure_image(*render(CUT, optics, rng), polarity=polarity).disks
    pairs = match(CUT, disks, reach=2.0)
    assert len(pairs) == len(disks) == len(CUT)
    fine = (np.arange(-200, 4 * 400) + 0.5) / 4 - 0.5
    for i, j in pairs:
        x, y, a = CUT.iloc[i]
        inside = (fine >= -0.5) & (fine < SHAPE[1] - 0.5)
        rows = (fine >= -0.5) & (fine < SHAPE[0] - 0.5)
        visible = np.count_nonzero(np.hypot(fine[inside] - x, fine[rows, None] - y) < a) / 16
        found = disks.iloc[j]
        assert found["visible_area_px2"] == pytest.approx(visible, rel=0.05)
        assert found["area_px2"] == pytest.approx(np.pi * a**2, abs=4 * found["area_std_px2"])
        assert bool(int(found["flags"]) & int(Flag.EDGE)) == (visible < 0.99 * np.pi * a**2)


def test_the_visible_area_of_a_contact_that_is_not_cut_is_its_area(rng):
    optics = Optics(shape=SHAPE)
    disks = measure_image(*render(scatter(20, optics, rng, radii=(2, 10)), optics, rng)).disks
    whole = disks["flags"].to_numpy() & int(Flag.EDGE) == 0
    assert whole.any()
    np.testing.assert_allclose(disks["visible_area_px2"][whole], disks["area_px2"][whole], rtol=1e-9)


@pytest.mark.parametrize("method", ["disk", "threshold"])
def test_contacts_above_the_stated_limit_are_found(method):
    """Radii down to a third of the blur: what is above the stated limit is found, what is lost lies below."""
    found, lost, limits = [], [], []
    for seed in range(4):
        scene = World(layout=Layout(radii=(0.4, 6.0), pairs=0), texture=0.01)(
            60, np.random.default_rng([41, seed])
        )
        result = measure_image(scene.frame, scene.reference, method=method)
        assert result.smallest_px > 0
        limits.append(result.smallest_px)
        hit = np.isin(np.arange(len(scene.truth)), match(scene.truth, result.disks, reach=1.5)[:, 0])
        ratio = scene.truth["radius_px"].to_numpy() / result.smallest_px
        found.append(ratio[hit])
        lost.append(ratio[~hit])
    found, lost = np.concatenate(found), np.concatenate(lost)
    assert len(lost) > 5
    # the limit is that of half completeness: of those a third larger nineteen in twenty are found
    above = np.count_nonzero(found > 1.33), np.count_nonzero(lost > 1.33)
    assert above[0] / sum(above) >= 0.95
    assert np.ptp(limits) < 0.5 * np.mean(limits)
