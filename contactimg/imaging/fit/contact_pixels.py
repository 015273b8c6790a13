"""What the pixels about each disk show, all others subtracted: plateau, surroundings, counted area.

One compiled pass over the windows of all disks. A pixel at the distance r from the centre of a disk of
radius a behind a blur s lies at ``u = (r - a)/s``. The surroundings are the pixels between `EDGE_BLUR_WIDTHS`
and `INNER_BLUR_WIDTHS`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.imaging.fit.disks import FittedDisks
from contactimg.imaging.fit.problem import CONTRAST, RADIUS, FitProblem
from contactimg.imaging.kernels.rim_pixels import FAST
from contactimg.imaging.pixels.masks import for_kernel
from contactimg.imaging.profile.blurred_disk import INNER_BLUR_WIDTHS, STEPS_PER_BLUR_WIDTH
from contactimg.imaging.profile.limits import EDGE_BLUR_WIDTHS, FAINT_FRACTION, NEAR_BLUR_WIDTHS

COLUMNS = (
    "core_n", "core_mean", "ring_n", "ring_mean", "rim_n", "rim_chi", "light",
    "count", "x", "y", "xx", "xy", "yy", "expected", "inside_seen", "core_chi", "border",
)  # fmt: skip
BATCH, ROOM = 512, 7  # pixels that are added at once, besides those of a row, and numbers for each; accuracy


@dataclass(frozen=True, eq=False)
class ContactPixels:
    """One array for each quantity, shape (n,); lengths in px of the fit, grey levels of the fit.

    Parameters
    ----------
    plateau : ndarray
        Mean of the pixels well inside the rim; NaN for contacts too small.
    ring : ndarray
        Mean of the surroundings; NaN where none is seen.
    rim_chi_square, core_chi_square : ndarray
        Mean squared residual over its variance, about the rim and inside it.
    light : ndarray
        Sum of the light above the surroundings, out to `EDGE_BLUR_WIDTHS`.
    area, expected : ndarray, px^2
        Pixels above half of the plateau, and as many as the fitted disk and the noise let one expect.
    border : ndarray
        Share of those that touch a pixel that is not seen.
    x, y : ndarray, px
        Centroid of them.
    elongation : ndarray
        Ratio of the axes of their second moments.
    visible : ndarray
        Share of the disk that is seen: inside the image, not masked.
    """

    plateau: NDArray[np.float64]
    ring: NDArray[np.float64]
    rim_chi_square: NDArray[np.float64]
    core_chi_square: NDArray[np.float64]
    light: NDArray[np.float64]
    area: NDArray[np.float64]
    expected: NDArray[np.float64]
    border: NDArray[np.float64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    elongation: NDArray[np.float64]
    visible: NDArray[np.float64]

    def updated(self, rows: NDArray[np.intp], other: "ContactPixels") -> "ContactPixels":
        """The sums with the values of some rows replaced by those of another look at them."""
        values = {name: value.copy() for name, value in vars(self).items()}
        for name, value in vars(other).items():
            values[name][rows] = value
        return ContactPixels(**values)


def look_at_pixels(
    problem: FitProblem, fit: FittedDisks, *, half: NDArray[np.float64] | None = None,
    rows: NDArray[np.intp] | None = None,
) -> ContactPixels:  # fmt: skip
    """Look at the pixels about the disks of a fit.

    Parameters
    ----------
    problem : FitProblem
    fit : FittedDisks
        With all its disks in the model image.
    half : ndarray or None, shape (n,)
        Level above which pixels are counted; None: half of each contrast.
    rows : ndarray of int or None
        Disks that are looked at; None: all.
    """
    chosen = np.arange(len(fit.disks)) if rows is None else rows
    disks = np.ascontiguousarray(fit.disks[chosen])
    level = 0.5 * disks[:, CONTRAST] if half is None else half[chosen]
    variance = problem.noise.variance / fit.brightness[chosen]
    noise = np.array([problem.noise.slope, 4.0 * problem.noise.rim, 1.0 / problem.contrast], np.float32)
    out = np.zeros((len(disks), len(COLUMNS)))
    _look(
        problem.image, fit.model, for_kernel(problem.valid), disks, fit.blur, variance, noise,
        np.ascontiguousarray(level, float), np.ascontiguousarray(problem.profile.values[:, :, 0]), out,
    )  # fmt: skip
    return _summarise(out, disks)


@np.errstate(invalid="ignore", divide="ignore")
def _summarise(out: NDArray, disks: NDArray) -> ContactPixels:
    """Means from sums."""
    q = dict(zip(COLUMNS, out.T, strict=True))
    x, y = q["x"] / q["count"], q["y"] / q["count"]
    # a pixel is a square: its own moment is 1/12
    xx, yy, xy = q["xx"] / q["count"] - x**2, q["yy"] / q["count"] - y**2, q["xy"] / q["count"] - x * y
    half_trace, root = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    elongation = np.sqrt((half_trace + root + 1 / 12) / np.maximum(half_trace - root + 1 / 12, 1 / 12))
    few = q["core_n"] < 5
    return ContactPixels(
        plateau=np.where(few, np.nan, q["core_mean"] / q["core_n"]),
        ring=np.where(q["ring_n"] < 5, np.nan, q["ring_mean"] / q["ring_n"]),
        rim_chi_square=q["rim_chi"] / np.maximum(q["rim_n"] - 3.0, 1.0),
        core_chi_square=np.where(few, np.nan, q["core_chi"] / np.maximum(q["core_n"], 1)),
        light=q["light"],
        area=q["count"],
        expected=q["expected"],
        border=q["border"] / np.maximum(q["count"], 1.0),
        x=disks[:, 0] + x,
        y=disks[:, 1] + y,
        elongation=np.where(q["count"] < 4, 1.0, elongation),
        visible=np.minimum(q["inside_seen"] / np.maximum(np.pi * disks[:, RADIUS] ** 2, 1e-9), 1.0),
    )


@njit(cache=True, error_model="numpy")
def _look(image, model, valid, disks, s, variance, noise, half, heights, out):
    """Sums over the pixels about each disk; see `COLUMNS`."""
    rows, columns = image.shape
    masked = valid.shape == image.shape
    profile = np.empty(heights.shape[1], np.float32)
    # level, model, place from the centre of the disk, whether at the border, and two for `_add_pixels`
    pixels = np.empty((ROOM, columns + BATCH), np.float32)
    for i in range(len(disks)):
        x, y, a, c = disks[i]
        line = s / (s + a) * (heights.shape[0] - 1)
        k = min(int(line), heights.shape[0] - 2)
        for j in range(len(profile)):
            profile[j] = heights[k, j] + np.float32(line - k) * (heights[k + 1, j] - heights[k, j])
        reach = a + INNER_BLUR_WIDTHS * s
        radii = (
            np.float32(a), np.float32(a - NEAR_BLUR_WIDTHS * s), np.float32(a - EDGE_BLUR_WIDTHS * s),
            np.float32(a + EDGE_BLUR_WIDTHS * s),
        )  # fmt: skip
        scale = np.float32(STEPS_PER_BLUR_WIDTH / s)
        start = np.float32((INNER_BLUR_WIDTHS - a / s) * STEPS_PER_BLUR_WIDTH)
        light = (
            np.float32(c), np.float32(half[i]), np.float32(FAINT_FRACTION * c), np.float32(0.5 * c),
            np.float32(1.0 / variance[i]), noise[0] * noise[2], noise[1], noise[2],
            np.float32(1.0 / np.sqrt(12.0 * variance[i])),
        )  # fmt: skip
        n = 0
        bottom = min(int(y + reach), rows - 1)
        for row in range(max(int(np.ceil(y - reach)), 0), bottom + 1):
            wide = np.sqrt(max(reach * reach - (row - y) ** 2, 0.0))
            first, end = max(int(np.ceil(x - wide)), 0), min(int(x + wide), columns - 1) + 1
            border = row == 0 or row == rows - 1
            if masked or border or first == 0 or end == columns:
                for column in range(first, end):
                    if not masked or valid[row, column] > 0:
                        outside = border or column == 0 or column == columns - 1
                        pixels[0, n], pixels[1, n] = image[row, column], model[row, column]
                        pixels[2, n], pixels[3, n], pixels[4, n] = column - x, row - y, outside
                        n += 1
            else:
                _append(pixels, n, image[row][first:end], model[row][first:end], first - x, row - y)
                n += end - first
            if n > BATCH or row == bottom:
                _add_pixels(pixels, n, radii, scale, start, light, profile, out[i])
                n = 0


@njit(cache=True, forceinline=True)
def _append(pixels, n, line, modelled, x, y):
    """Append the pixels of a row inside the image, the first at ``x`` and ``y`` from the centre of a disk."""
    levels, models, across = pixels[0][n:], pixels[1][n:], pixels[2][n:]
    down, border, first = pixels[3][n:], pixels[4][n:], np.float32(x)
    for j in range(len(line)):
        levels[j], models[j], across[j] = line[j], modelled[j], first + np.float32(j)
        down[j], border[j] = np.float32(y), np.float32(0.0)


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def _add_pixels(pixels, n, radii, scale, start, light, profile, q):
    """Add pixels to the sums of a disk.

    There is no branch in the loops, so that all but the one that reads the profile compile to vector
    instructions.
    """
    a, core, low, high = radii
    height, level, faint, half, plain, growth, rim, unit, steepness = light
    line, modelled, x, y = pixels[0, :n], pixels[1, :n], pixels[2, :n], pixels[3, :n]
    border, place, own = pixels[4, :n], pixels[5, :n], pixels[6, :n]
    one, zero, most, last = np.float32(1.0), np.float32(0.0), np.float32(100.0), np.float32(len(profile) - 2)
    core_n = core_sum = core_chi = ring_n = ring_sum = rim_n = rim_chi = inside = zero
    total = expected = count = sx = sy = sxx = sxy = syy = at_border = zero
    for k in range(len(line)):
        place[k] = np.sqrt(x[k] * x[k] + y[k] * y[k]) * scale + start
    for k in range(len(line)):
        where = min(max(place[k], zero), last)
        j = np.int32(where)
        own[k] = height * (profile[j] + (where - np.float32(j)) * (profile[j + 1] - profile[j]))
    for k in range(len(line)):
        r = (place[k] - start) / scale
        mine = height if place[k] <= zero else (zero if place[k] >= last else own[k])
        rest, others = line[k] - modelled[k], modelled[k] - mine
        value = rest + mine
        near = one if r < high else zero
        p = min(max(modelled[k] * unit, zero), one)
        increase = growth * max(modelled[k], zero) + rim * p * (one - p)
        chi = min(rest * rest * plain / (one + increase), most)
        inside += one if r < a else zero
        deep, edge = one if r < core else zero, near if r > low else zero
        core_n += deep
        core_sum += deep * value
        core_chi += deep * chi
        rim_n += edge
        rim_chi += edge * chi
        around = one - near if others < faint else zero
        ring_n += around
        ring_sum += around * value
        counted = near if others < half else zero
        total += counted * value
        # noise lifts more pixels about a disk above the level than it lowers in it
        expected += counted * min(max(np.float32(0.5) + (mine - level) * steepness, zero), one)
        above = counted if value > level else zero
        count += above
        sx += above * x[k]
        sy += above * y[k]
        sxx += above * x[k] * x[k]
        sxy += above * x[k] * y[k]
        syy += above * y[k] * y[k]
        at_border += above * border[k]
    sums = (
        core_n, core_sum, ring_n, ring_sum, rim_n, rim_chi, total,
        count, sx, sy, sxx, sxy, syy, expected, inside, core_chi, at_border,
    )  # fmt: skip
    for k in range(len(sums)):
        q[k] += sums[k]


@njit(cache=True, error_model="numpy")
def measure_rise(image, disks, s):
    """Mean of the pixels inside each disk minus that of the ring around it; NaN where one is not seen.

    ``disks`` holds x, y, radius; ``s`` is the blur, px.
    """
    rows, columns = image.shape
    rise = np.empty(len(disks))
    for i in range(len(disks)):
        x, y, a = disks[i, 0], disks[i, 1], disks[i, 2]
        inner, low, high = max(a - 0.5 * s, 0.7), a + EDGE_BLUR_WIDTHS * s, a + INNER_BLUR_WIDTHS * s
        sums = np.zeros(4)
        for row in range(max(int(np.ceil(y - high)), 0), min(int(y + high), rows - 1) + 1):
            for column in range(max(int(np.ceil(x - high)), 0), min(int(x + high), columns - 1) + 1):
                r = np.hypot(column - x, row - y)
                if r < inner:
                    sums[0] += image[row, column]
                    sums[1] += 1.0
                elif low < r < high:
                    sums[2] += image[row, column]
                    sums[3] += 1.0
        rise[i] = sums[0] / sums[1] - sums[2] / sums[3] if sums[1] > 0 and sums[3] > 0 else np.nan
    return rise
