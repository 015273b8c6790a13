"""What the pixels about each disk show, all other disks subtracted: plateau, surroundings, area at half height.

One compiled pass over the windows of all disks. A pixel at the distance r from the centre of a disk of radius a
behind a blur s lies at ``u = (r - a)/s``.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from contactimg.imaging.fit.disks import FittedDisks
from contactimg.imaging.fit.problem import CONTRAST, RADIUS, FitProblem
from contactimg.imaging.pixels.masks import for_kernel
from contactimg.imaging.profile.blurred_disk import INNER_BLUR_WIDTHS, STEPS_PER_BLUR_WIDTH, EdgeTable

CORE_BLUR_WIDTHS = 2.0  # inside the rim, where a contact shows its plateau; theory: 98 % of it
RIM_BLUR_WIDTHS = 3.0  # about the rim; theory: 0.1 % of the edge is left
RING_BLUR_WIDTHS = (3.0, 6.0)  # outside the rim: the surroundings
OTHER_SHARE = 0.05  # light of other disks, of the contrast, up to which a pixel is surroundings; by hand
COUNT_BLUR_WIDTHS = 3.0  # beyond the rim, up to which pixels above half height are counted

COLUMNS = (
    "core_n", "core_mean", "core_square", "ring_n", "ring_mean", "ring_square", "rim_n", "rim_chi", "light",
    "count", "x", "y", "xx", "xy", "yy", "expected", "inside_seen", "core_chi", "border",
)  # fmt: skip
_COLUMN = {name: k for k, name in enumerate(COLUMNS)}


@dataclass(frozen=True, eq=False)
class ContactPixels:
    """One array for each quantity, shape (n,); lengths in px of the fit, grey levels of the fit.

    Parameters
    ----------
    plateau, plateau_std : ndarray
        Mean of the pixels well inside the rim, and its standard uncertainty; NaN for contacts too small.
    ring, ring_std : ndarray
        Mean of the surroundings, and the scatter of their pixels; NaN where none is seen.
    rim_chi_square, core_chi_square : ndarray
        Mean squared residual over its variance, about the rim and inside it.
    light : ndarray
        Sum of the light above the surroundings, out to `COUNT_BLUR_WIDTHS`.
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
    plateau_std: NDArray[np.float64]
    ring: NDArray[np.float64]
    ring_std: NDArray[np.float64]
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


def look_at_pixels(
    problem: FitProblem, fit: FittedDisks, *, half: NDArray[np.float64] | None = None
) -> ContactPixels:
    """Look at the pixels about the disks of a fit.

    Parameters
    ----------
    problem : FitProblem
    fit : FittedDisks
        With all its disks in the model image.
    half : ndarray or None, shape (n,)
        Level above which pixels are counted; None: half of each contrast.
    """
    disks = np.ascontiguousarray(fit.disks)
    n = len(disks)
    level = 0.5 * disks[:, CONTRAST] if half is None else half
    variance = problem.noise.variance / fit.brightness
    slope = problem.noise.slope / problem.contrast
    out = np.zeros((n, len(COLUMNS)))
    _look(
        problem.image, fit.model, for_kernel(problem.valid), disks, fit.blur, variance, slope,
        np.ascontiguousarray(level, float), _values(problem.profile), problem.profile.outer, out,
    )  # fmt: skip
    with np.errstate(invalid="ignore", divide="ignore"):
        return _summarise(out, disks, problem)


def _values(profile: EdgeTable) -> NDArray[np.float32]:
    """The heights of an edge table."""
    return np.ascontiguousarray(profile.values[:, :, 0])


def _summarise(out: NDArray, disks: NDArray, problem: FitProblem) -> ContactPixels:
    """Means from sums."""
    q = {name: out[:, k] for name, k in _COLUMN.items()}
    plateau = q["core_mean"] / q["core_n"]
    scatter = np.sqrt(np.maximum(q["core_square"] / q["core_n"] - plateau**2, problem.noise.variance))
    ring = q["ring_mean"] / q["ring_n"]
    ring_std = np.sqrt(np.maximum(q["ring_square"] / q["ring_n"] - ring**2, 0.0))
    x, y = q["x"] / q["count"], q["y"] / q["count"]
    # a pixel is a square: its own moment is 1/12
    xx, yy, xy = q["xx"] / q["count"] - x**2, q["yy"] / q["count"] - y**2, q["xy"] / q["count"] - x * y
    half_trace, root = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    elongation = np.sqrt((half_trace + root + 1 / 12) / np.maximum(half_trace - root + 1 / 12, 1 / 12))
    few = q["core_n"] < 5
    return ContactPixels(
        plateau=np.where(few, np.nan, plateau),
        plateau_std=np.where(few, np.nan, scatter / np.sqrt(np.maximum(q["core_n"], 1))),
        ring=np.where(q["ring_n"] < 5, np.nan, ring),
        ring_std=np.where(q["ring_n"] < 5, np.nan, ring_std),
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
def _look(image, model, valid, disks, s, variance, slope, half, heights, outer, out):
    """Sums over the pixels about each disk; see `COLUMNS`."""
    rows, columns = image.shape
    masked = valid.shape == image.shape
    last = heights.shape[1] - 1
    for i in range(len(disks)):
        x, y, a, c = disks[i]
        q = out[i]
        reach = a + RING_BLUR_WIDTHS[1] * s
        line = s / (s + a) * (heights.shape[0] - 1)
        k = min(int(line), heights.shape[0] - 2)
        f = line - k
        for row in range(max(int(np.ceil(y - reach)), 0), min(int(y + reach), rows - 1) + 1):
            dy = row - y
            wide = np.sqrt(max(reach * reach - dy * dy, 0.0))
            for column in range(max(int(np.ceil(x - wide)), 0), min(int(x + wide), columns - 1) + 1):
                if masked and valid[row, column] == 0:
                    continue
                dx = column - x
                r = np.sqrt(dx * dx + dy * dy)
                u = (r - a) / s
                place = (u + INNER_BLUR_WIDTHS) * STEPS_PER_BLUR_WIDTH
                if place <= 0.0:
                    p = 1.0
                elif place >= last:
                    p = 0.0
                else:
                    j = int(place)
                    g = place - j
                    p = (1 - f) * (heights[k, j] + g * (heights[k, j + 1] - heights[k, j])) + f * (
                        heights[k + 1, j] + g * (heights[k + 1, j + 1] - heights[k + 1, j])
                    )
                rest = image[row, column] - model[row, column]
                others = model[row, column] - c * p
                value = rest + c * p
                if u < 0.0:
                    q[16] += 1.0
                z = rest * rest / (variance[i] * (1.0 + slope * max(model[row, column], 0.0)))
                if u < -CORE_BLUR_WIDTHS:
                    q[0] += 1.0
                    q[1] += value
                    q[2] += value * value
                    q[17] += min(z, 100.0)
                if abs(u) < RIM_BLUR_WIDTHS:
                    q[6] += 1.0
                    q[7] += min(z, 100.0)
                alone = others < OTHER_SHARE * c
                if RING_BLUR_WIDTHS[0] < u < RING_BLUR_WIDTHS[1] and alone:
                    q[3] += 1.0
                    q[4] += value
                    q[5] += value * value
                if u < COUNT_BLUR_WIDTHS and others < 0.5 * c:
                    q[8] += value
                    q[15] += c * p > half[i]
                    if value > half[i]:
                        q[9] += 1.0
                        q[10] += column
                        q[11] += row
                        q[12] += column * column
                        q[13] += column * row
                        q[14] += row * row
                        edge = row == 0 or column == 0 or row == rows - 1 or column == columns - 1
                        q[18] += edge
        # second moments about the centre lose fewer digits
        if q[9] > 0.0:
            q[12] -= 2.0 * x * q[10] - x * x * q[9]
            q[14] -= 2.0 * y * q[11] - y * y * q[9]
            q[13] -= x * q[11] + y * q[10] - x * y * q[9]
            q[10] -= x * q[9]
            q[11] -= y * q[9]


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
