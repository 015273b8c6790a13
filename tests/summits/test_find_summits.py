"""Summits of maps whose spheres are known: heights and radii within their stated uncertainties."""

import re
import time
from contextlib import contextmanager

import numpy as np
import pandas as pd
import pytest
from scipy.ndimage import gaussian_filter

from contactimg.engine.progress import shown_by
from contactimg.errors import InputError
from contactimg.summits import HeightMap, find_summits
from contactimg.summits.base import pixel_noise
from contactimg.summits.find import SphereFit, _without_twins

PIXEL = 1e-6


def caps_map(rng, *, side=420, count=45, gap=2e-6):
    """Heights of caps on a flat base, and x, y, height, radius and base radius of each."""
    x = (np.arange(side) - (side - 1) / 2) * PIXEL
    heights, rows = np.zeros((side, side)), []
    for _ in range(5000):
        radius = rng.uniform(20e-6, 100e-6)
        height = radius * rng.uniform(0.03, 0.2)
        base = np.sqrt(2 * radius * height - height**2)
        cx, cy = rng.uniform(x[0] + base, x[-1] - base, 2)
        if all(np.hypot(cx - row[0], cy - row[1]) > base + row[4] + gap for row in rows):
            rows.append((cx, cy, height, radius, base))
            heights = np.maximum(heights, cap(x, cx, cy, height, radius))
        if len(rows) == count:
            break
    return x, heights, np.array(rows)


def cap(x, cx, cy, height, radius, *, y=None):
    squared = (x[None, :] - cx) ** 2 + ((x if y is None else y)[:, None] - cy) ** 2
    return np.maximum(np.sqrt(np.maximum(radius**2 - squared, 0)) - radius + height, 0)


def spoilt(rng, x, heights, *, noise=60e-9, correlation=0.0):
    """With tilt, noise, missing pixels, holes and spikes."""
    white = rng.normal(size=heights.shape)
    if correlation:
        white = gaussian_filter(white, correlation)
        white /= white.std()
    out = heights + noise * white + 0.005 * x[None, :] - 0.003 * x[:, None] + 7e-6
    rows, columns = rng.integers(0, len(x), (2, 20))
    out[rows, columns] += rng.choice([-1, 1], 20) * rng.uniform(2e-6, 2e-5, 20)
    out[rng.random(out.shape) < 0.02] = np.nan
    for row, column in rng.integers(5, len(x) - 5, (10, 2)):
        out[row - 3 : row + 4, column - 3 : column + 4] = np.nan
    return HeightMap(out, (PIXEL, PIXEL))


def pairs(found, truth):
    """Rows of the table and the caps that they mean; every cap has its row, and no other rows are there."""
    table = found.table
    assert len(table) == len(truth), found.left_out
    distances = np.hypot(table["x_m"].to_numpy() - truth[:, [0]], table["y_m"].to_numpy() - truth[:, [1]])
    assert distances.min(axis=1).max() < 1e-6
    return table.iloc[distances.argmin(axis=1)].reset_index(drop=True)


@pytest.mark.parametrize("correlation", [0.0, 1.0])
def test_heights_and_radii_are_within_their_uncertainties(rng, correlation):
    x, heights, truth = caps_map(rng)
    table = pairs(find_summits(spoilt(rng, x, heights, correlation=correlation)), truth)
    for name, column in (("height", 2), ("radius", 3)):
        pulls = (table[f"{name}_m"] - truth[:, column]) / table[f"{name}_std_m"]
        # mean of squares of n normal numbers: 1 +- sqrt(2/n), four of these, and 20 % for the uncertainty
        assert abs((pulls**2).mean() - 1) < 4 * np.sqrt(2 / len(truth)) + 0.2, name
    assert (table["radius_std_m"] / truth[:, 3]).median() < 0.03  # tight enough to be of use


def test_the_fits_of_a_map_are_counted(rng):
    shown = []

    @contextmanager
    def bar(text, count):
        shown.append((text, count))
        yield lambda: shown.append(text)

    _, heights, truth = caps_map(rng, side=200, count=8)
    with shown_by(bar):
        find_summits(HeightMap(heights, (PIXEL, PIXEL)))
    assert shown == [("fitting summits", len(truth)), *["fitting summits"] * len(truth)]


def test_the_noise_is_that_of_the_map(rng):
    x, heights, _ = caps_map(rng, side=200, count=8)
    surface = spoilt(rng, x, heights, noise=60e-9)
    assert find_summits(surface).noise == pytest.approx(60e-9, rel=0.03)
    assert pixel_noise(surface.heights) == pytest.approx(60e-9, rel=0.05)


def test_a_map_without_noise_gives_the_spheres_exactly(rng):
    x, heights, truth = caps_map(rng, side=200, count=8)
    table = pairs(find_summits(HeightMap(heights + 0.002 * x, (PIXEL, PIXEL))), truth)
    np.testing.assert_allclose(table["height_m"], truth[:, 2], rtol=1e-4)  # taking off 0.002: 1.5 t^2 = 6e-6
    np.testing.assert_allclose(table["radius_m"], truth[:, 3], rtol=1e-4)


def test_touching_caps_are_two_and_a_summit_beyond_the_edge_is_none(rng):
    x = (np.arange(121) - 60) * PIXEL
    two = np.maximum(cap(x, -9e-6, 0, 5e-6, 30e-6), cap(x, 9e-6, 1e-6, 4e-6, 25e-6))
    beyond = np.maximum(cap(x, -65e-6, 40e-6, 5e-6, 30e-6), cap(x, 40e-6, 58e-6, 5e-6, 30e-6))
    found = find_summits(HeightMap(np.maximum(two, beyond) + rng.normal(0, 2e-8, two.shape), (PIXEL, PIXEL)))
    assert found.left_out == {"summits beyond the edge of the map": 1}
    table = found.table.sort_values("x_m", ignore_index=True)
    truth = np.array([[5e-6, 30e-6], [4e-6, 25e-6], [5e-6, 30e-6]])  # the last is cut by the edge
    for name, column in (("height", 0), ("radius", 1)):
        pulls = (table[f"{name}_m"] - truth[:, column]) / table[f"{name}_std_m"]
        assert pulls.abs().max() < 4
    stds = table["radius_std_m"] / table["radius_m"]
    assert stds[2] > 1.2 * stds[0]  # half a cap says less


def test_second_fits_of_an_asperity_are_dropped_in_little_time():
    """20,000 fits: pair by pair their comparison would take minutes."""
    pixels = [np.ones(20, bool), np.ones(10, bool)]
    fits = []
    for k, place in enumerate(1e-4 * np.stack(np.divmod(np.arange(20_000), 200), axis=1)):
        sphere = np.array([*place, 4e-6, 1e4])
        # half the radius of its patch is sqrt(2 x 0.5 x 4e-6/1e4)/2 = 10 um
        twin = sphere + np.array([(9.9e-6, 10.1e-6)[k % 2], 0, 0, 0])
        for n, one in enumerate((sphere, twin) if k < 2 else (sphere,)):
            fits.append((SphereFit(one, np.eye(4), pixels[n], np.zeros(20), 1.0), None))
    began = time.perf_counter()
    kept = _without_twins(fits[::-1], depth=0.5)
    assert time.perf_counter() - began < 20
    places = {round(whole.sphere[0] * 1e7) for whole, _ in kept if whole.sphere[1] < 2e-4}
    assert len(kept) == 20_001
    assert 99 not in places
    assert 101 in places


def test_the_form_of_a_lens_is_taken_off(rng):
    x, heights, truth = caps_map(rng, side=300, count=20)
    lens = -(x[None, :] ** 2 + x[:, None] ** 2) / (2 * 5e-3)  # 4.5 um from the middle to the corner
    surface = HeightMap(heights + lens + rng.normal(0, 3e-8, heights.shape), (PIXEL, PIXEL))
    table = pairs(find_summits(surface, form="sphere"), truth)
    pulls = (table["radius_m"] - truth[:, 3]) / table["radius_std_m"]
    assert (pulls**2).mean() < 1 + 4 * np.sqrt(2 / len(truth)) + 0.2


def test_a_summit_that_is_no_sphere_says_so_and_its_uncertainty_covers_it(rng):
    x = (np.arange(101) - 50) * PIXEL
    squared = x[None, :] ** 2 + x[:, None] ** 2
    radius, height = 40e-6, 5e-6
    quartic = height - squared / (2 * radius) - squared**2 / (2 * (30e-6) ** 3)
    found = find_summits(
        HeightMap(np.maximum(quartic, 0) + rng.normal(0, 1e-8, squared.shape), (PIXEL, PIXEL))
    )
    row = found.table.iloc[0]
    # a height h - r^2/(2 R) - r^4/(2 d^3) is steeper farther down: a sphere through all is too high there
    told = r"no sphere: radius and height of the upper half differ by \+[1-9][.\d]* and -"
    assert re.match(told, row["message"])
    assert abs(row["radius_m"] - radius) < 2 * row["radius_std_m"]
    assert found.warnings == ["no sphere: 1 of 1 summits; their uncertainties allow for it"]


def test_pixels_need_not_be_square(rng):
    columns, rows = (np.arange(161) - 80) * 0.5e-6, (np.arange(81) - 40) * 1e-6
    heights = cap(columns, 3e-6, -5e-6, 4e-6, 50e-6, y=rows) + rng.normal(0, 1e-8, (81, 161))
    row = find_summits(HeightMap(heights, (0.5e-6, 1e-6))).table.iloc[0]
    assert row["x_m"] == pytest.approx(3e-6, abs=5 * row["x_std_m"])
    assert row["y_m"] == pytest.approx(-5e-6, abs=5 * row["y_std_m"])
    assert row["radius_m"] == pytest.approx(50e-6, abs=5 * row["radius_std_m"])


def test_heights_that_the_instrument_cut_off_are_holes(rng):
    """Caps cut off at 2.5 um in steps of 1 nm: with the flat tops the radii are 62 um, not 50."""
    x = (np.arange(161) - 80) * 1e-6
    squared = x[None, :] ** 2 + x[:, None] ** 2
    whole = np.maximum(np.sqrt(np.maximum((50e-6) ** 2 - squared, 0)) - 47e-6, 0)
    whole += rng.normal(0, 5e-9, whole.shape)
    steps = np.round(whole / 1e-9) * 1e-9
    assert find_summits(HeightMap(steps, (1e-6, 1e-6))).warnings == []
    found = find_summits(HeightMap(np.minimum(steps, 2.5e-6), (1e-6, 1e-6)))
    row = found.table.iloc[0]
    assert abs(row["radius_m"] - 50e-6) < 3 * row["radius_std_m"] < 1e-6
    assert row["height_m"] == pytest.approx(3e-6, abs=3 * row["height_std_m"])
    assert "pixels have the largest height, 2.5 um: the instrument cut off" in found.warnings[0]
    noiseless = np.maximum(np.sqrt(np.maximum((50e-6) ** 2 - squared, 0)) - 47e-6, 0)
    pit = find_summits(HeightMap(-noiseless, (1e-6, 1e-6)))
    assert pit.table.empty
    assert not any("cut off" in warning for warning in pit.warnings)


def test_noise_alone_has_no_summit(rng):
    assert find_summits(HeightMap(rng.normal(0, 1e-8, (200, 200)), (PIXEL, PIXEL))).table.empty
    assert find_summits(HeightMap(np.zeros((50, 50)), (PIXEL, PIXEL))).table.empty


def test_a_rough_surface_without_base_and_a_steep_one_say_so(rng):
    rough = gaussian_filter(rng.normal(size=(150, 150)), 4)
    found = find_summits(HeightMap(rough / rough.std() * 1e-6, (PIXEL, PIXEL)))
    assert any("no base is seen" in warning for warning in found.warnings)
    x, heights, _ = caps_map(rng, side=150, count=4)
    steep = find_summits(HeightMap(heights + 0.1 * x + rng.normal(0, 1e-8, heights.shape), (PIXEL, PIXEL)))
    assert any("inclined by 5.7 degrees" in warning for warning in steep.warnings)


def test_lengths_may_be_in_any_unit(rng):
    _, heights, _ = caps_map(rng, side=150, count=5)
    heights += rng.normal(0, 3e-8, heights.shape)
    one = find_summits(HeightMap(heights, (PIXEL, PIXEL))).table
    other = find_summits(HeightMap(heights * 1e3, (PIXEL * 1e3, PIXEL * 1e3))).table
    for name in ("x_m", "height_m", "radius_m", "height_std_m", "radius_std_m"):
        np.testing.assert_allclose(other[name], one[name] * 1e3, rtol=1e-6)


def test_an_unknown_form_is_refused():
    with pytest.raises(InputError, match="form must be one of 'none', 'plane', 'sphere', got 'flat'"):
        find_summits(HeightMap(np.zeros((20, 20)), (PIXEL, PIXEL)), form="flat")


@pytest.mark.parametrize(
    ("heights", "size", "sentence"),
    [
        (np.zeros(5), 1e-6, "must be a matrix"),
        (np.full((20, 20), np.nan), 1e-6, "no finite height"),
        (np.zeros((20, 20)), 0.0, "pixel size must be two positive lengths"),
        (np.zeros((20, 20)), np.inf, "pixel size must be two positive lengths"),
    ],
)
def test_what_is_no_map_is_refused(heights, size, sentence):
    with pytest.raises(InputError, match=sentence):
        HeightMap(heights, (size, size))
    with pytest.raises(InputError, match="two positive lengths"):
        HeightMap(np.zeros((20, 20)), 1e-6)


def test_a_map_of_integers_is_that_of_their_values(rng):
    # in unsigned integers the differences that tell the noise would wrap around
    _, heights, _ = caps_map(rng, side=150, count=5)
    counts = np.rint((heights + rng.normal(0, 3e-8, heights.shape)).clip(0) * 1e10)
    whole, real = (
        find_summits(HeightMap(counts.astype(kind), (1e4, 1e4))).table for kind in ("uint16", "float64")
    )
    assert len(real) == 5
    pd.testing.assert_frame_equal(whole, real)


def test_a_computed_map_of_spheres_has_no_summit_that_is_none(rng):
    # pixels of 1 by 2: differences of 1e-16 are those of rounding
    columns, rows = (np.arange(200) - 99.5) * 1e-6, (np.arange(160) - 79.5) * 2e-6
    places = [(-60e-6, -90e-6), (11e-6, 3e-6), (-70.5e-6, 101.3e-6), (55e-6, 77e-6)]
    heights = np.max([cap(columns, x, y, 3e-6, 50e-6, y=rows) for x, y in places], axis=0)
    found = find_summits(HeightMap(heights, (1e-6, 2e-6)))
    assert found.table["message"].tolist() == [""] * 4
    assert found.table["radius_m"].to_numpy() == pytest.approx(50e-6, rel=1e-9)
