"""What the pixels about each disk show, all others subtracted: plateau, surroundings, counted area.

One compiled pass over the windows of all disks. A pixel at the distance r from the centre of a disk of
radius a behind a blur s lies at ``u = (r - a)/s``.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.imaging.fit.disks import FittedDisks
from contactimg.imaging.fit.problem import CONTRAST, RADIUS, FitProblem
from contactimg.imaging.pixels.masks import for_kernel
from contactimg.imaging.profile.blurred_disk import INNER_BLUR_WIDTHS, STEPS_PER_BLUR_WIDTH, EdgeTable
from contactimg.imaging.profile.limits import (
    EDGE_BLUR_WIDTHS,
    FAINT_FRACTION,
    FIT_BLUR_WIDTHS,
    NEAR_BLUR_WIDTHS,
)

RING_BLUR_WIDTHS = (3.0, 6.0)  # outside the rim: the surroundings

COLUMNS = (
    "core_n", "core_mean", "ring_n", "ring_mean", "rim_n", "rim_chi", "light",
    "count", "x", "y", "xx", "xy", "yy", "expected", "inside_seen", "core_chi", "border",
)  # fmt: skip
_COLUMN = {name: k for k, name in enumerate(COLUMNS)}


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
        Pixels above half of the plateau, and those at which the fitted disk is above it.
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
    problem: FitProblem,
    fit: FittedDisks,
    *,
    half: NDArray[np.float64] | None = None,
    rows: NDArray[np.intp] | None = None,
) -> ContactPixels:
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
    n = len(disks)
    level = 0.5 * disks[:, CONTRAST] if half is None else half[chosen]
    variance = problem.noise.variance / fit.brightness[chosen]
    noise = np.array([problem.noise.slope, 4.0 * problem.noise.rim, 1.0 / problem.contrast], np.float32)
    out = np.zeros((n, len(COLUMNS)))
    _look(
        problem.image, fit.model, for_kernel(problem.valid), disks, fit.blur, variance, noise,
        np.ascontiguousarray(level, float), _values(problem.profile), out,
    )  # fmt: skip
    with np.errstate(invalid="ignore", divide="ignore"):
        return _summarise(out, disks)


def _values(profile: EdgeTable) -> NDArray[np.float32]:
    """The heights of an edge table."""
    return np.ascontiguousarray(profile.values[:, :, 0])


def _summarise(out: NDArray, disks: NDArray) -> ContactPixels:
    """Means from sums."""
    q = {name: out[:, k] for name, k in _COLUMN.items()}
    plateau = q["core_mean"] / q["core_n"]
    ring = q["ring_mean"] / q["ring_n"]
    x, y = q["x"] / q["count"], q["y"] / q["count"]
    # a pixel is a square: its own moment is 1/12
    xx, yy, xy = q["xx"] / q["count"] - x**2, q["yy"] / q["count"] - y**2, q["xy"] / q["count"] - x * y
    half_trace, root = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    elongation = np.sqrt((half_trace + root + 1 / 12) / np.maximum(half_trace - root + 1 / 12, 1 / 12))
    few = q["core_n"] < 5
    return ContactPixels(
        plateau=np.where(few, np.nan, plateau),
        ring=np.where(q["ring_n"] < 5, np.nan, ring),
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


@njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"}, forceinline=True)
def _look(  # noqa: C901, PLR0912, PLR0915 -- one pass over the pixels, for time
    image, model, valid, disks, s, variance, noise, half, heights, out
):
    """Sums over the pixels about each disk; see `COLUMNS`."""
    rows, columns = image.shape
    masked = valid.shape == image.shape
    last = heights.shape[1] - 2
    profile = np.empty(heights.shape[1], np.float32)
    for i in range(len(disks)):
        x, y, a, c = disks[i]
        q = out[i]
        reach = a + RING_BLUR_WIDTHS[1] * s
        line = s / (s + a) * (heights.shape[0] - 1)
        k = min(int(line), heights.shape[0] - 2)
        f = np.float32(line - k)
        for j in range(len(profile)):
            profile[j] = heights[k, j] + f * (heights[k + 1, j] - heights[k, j])
        height, level, plain = np.float32(c), np.float32(half[i]), np.float32(1.0 / variance[i])
        growth, rim, unit = noise[0] * noise[2], noise[1], noise[2]
        ring_low, ring_high = a + RING_BLUR_WIDTHS[0] * s, reach
        core, low, high = a - NEAR_BLUR_WIDTHS * s, a - EDGE_BLUR_WIDTHS * s, a + EDGE_BLUR_WIDTHS * s
        counted = a + EDGE_BLUR_WIDTHS * s
        scale, start = STEPS_PER_BLUR_WIDTH / s, (INNER_BLUR_WIDTHS - a / s) * STEPS_PER_BLUR_WIDTH
        other_most, other_half = np.float32(FAINT_FRACTION * c), np.float32(0.5 * c)
        inner = a - FIT_BLUR_WIDTHS * s
        for row in range(max(int(np.ceil(y - reach)), 0), min(int(y + reach), rows - 1) + 1):
            dy = row - y
            wide = np.sqrt(max(reach * reach - dy * dy, 0.0))
            first, end = max(int(np.ceil(x - wide)), 0), min(int(x + wide), columns - 1) + 1
            left = right = end
            if not masked and inner > abs(dy) and 0 < row < rows - 1:
                chord = np.sqrt(inner * inner - dy * dy)
                left, right = max(int(np.ceil(x - chord)), 1), min(int(x + chord) + 1, columns - 1)
                if right - left < 16:
                    left = right = end
                else:
                    _add_inside(
                        image[row, left:right], model[row, left:right], height, level, plain, growth, q
                    )
                    n = right - left
                    middle = 0.5 * (left + right - 1) - x
                    q[8] += n * middle
                    q[9] += n * dy
                    q[10] += n * middle * middle + n * (n * n - 1.0) / 12.0
                    q[11] += n * middle * dy
                    q[12] += n * dy * dy
            edge_row = row == 0 or row == rows - 1
            for column in range(first, end):
                if left <= column < right or (masked and valid[row, column] == 0):
                    continue
                dx = column - x
                r = np.sqrt(dx * dx + dy * dy)
                place = r * scale + start
                if place <= 0.0:
                    own = height
                elif place >= last:
                    own = np.float32(0.0)
                else:
                    j = int(place)
                    own = height * (profile[j] + np.float32(place - j) * (profile[j + 1] - profile[j]))
                modelled = model[row, column]
                rest, others = image[row, column] - modelled, modelled - own
                value = rest + own
                if r < high:
                    p = min(max(modelled * unit, np.float32(0.0)), np.float32(1.0))
                    increase = growth * max(modelled, np.float32(0.0)) + rim * p * (np.float32(1.0) - p)
                    z = min(rest * rest * plain / (np.float32(1.0) + increase), 100.0)
                    if r < a:
                        q[14] += 1.0
                    if r < core:
                        q[0] += 1.0
                        q[1] += value
                        q[15] += z
                    if r > low:
                        q[4] += 1.0
                        q[5] += z
                if ring_low < r < ring_high and others < other_most:
                    q[2] += 1.0
                    q[3] += value
                if r < counted and others < other_half:
                    q[6] += value
                    if own > level:
                        q[13] += 1.0
                    if value > level:
                        q[7] += 1.0
                        q[8] += dx
                        q[9] += dy
                        q[10] += dx * dx
                        q[11] += dx * dy
                        q[12] += dy * dy
                        if edge_row or column == 0 or column == columns - 1:
                            q[16] += 1.0


@njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"}, forceinline=True)
def _add_inside(line, modelled, height, level, plain, growth, q):
    """Add a row of pixels well inside a disk, all of which count as lying above the level in the moments."""
    one, zero, most = np.float32(1.0), np.float32(0.0), np.float32(100.0)
    total = chi = above = expected = zero
    for i in range(len(line)):
        rest = line[i] - modelled[i]
        value = rest + height
        total += value
        chi += min(rest * rest * plain / (one + growth * max(modelled[i], zero)), most)
        above += one if value > level else zero
        expected += one
    n = float(len(line))
    q[0] += n
    q[1] += total
    q[6] += total
    q[7] += above
    q[13] += expected if height > level else zero
    q[14] += n
    q[15] += chi


@njit(cache=True, error_model="numpy")
def measure_rise(image, disks, s):
    """Mean of the pixels inside each disk minus that of the ring around it; NaN where one is not seen.

    ``disks`` holds x, y, radius; ``s`` is the blur, px.
    """
    rows, columns = image.shape
    rise = np.empty(len(disks))
    for i in range(len(disks)):
        x, y, a = disks[i, 0], disks[i, 1], disks[i, 2]
        inner, low, high = max(a - 0.5 * s, 0.7), a + RING_BLUR_WIDTHS[0] * s, a + RING_BLUR_WIDTHS[1] * s
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
