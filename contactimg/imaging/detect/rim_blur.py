"""Estimate the blur from the slope of the rims."""

import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.imaging.detect.components import label_components
from contactimg.imaging.pixels.robust import median, quantile
from contactimg.imaging.profile.limits import FEW

DEFAULT_BLUR_PX = 1.5
"""Blur where the rims do not show it, px: typical of the paper's frames."""
LEAST_VARIANCE_PX2 = 0.35
"""Least squared blur (0.59 px), pixel included. Chosen by hand."""
STRIP = 64
"""Pixels of a row that are checked together; it affects the time alone."""


def estimate_blur(image: NDArray[np.float32], plateau: float) -> float:
    """Standard deviation of the blur from the gradient of rims at half height, pixel included, px.

    Notes
    -----
    At half height a straight edge has the gradient ``plateau/(s sqrt(2 pi))``. Good to 10 %.
    """
    # Theory: the slope varies by 3 % there, exp(-z^2/2) with Phi(z) = 0.6.
    low, high = np.float32(0.4 * plateau), np.float32(0.6 * plateau)
    # The median of so many pixels at half height is good to 1.4 % of the scatter.
    slopes = _slopes(image, low, high, 8000)
    if len(slopes) < FEW:
        return DEFAULT_BLUR_PX
    # plateaus of fainter contacts have the level of half height as well, but no slope. By hand
    steep = slopes[slopes > 0.4 * quantile(slopes, 0.9)]
    width = plateau / max(median(steep), 1e-6 * plateau) / np.sqrt(2 * np.pi)
    # Slopes are read with the 3 x 3 mean, of variance 2/3 px^2, and central differences, of 1/3.
    return float(np.sqrt(max(width**2 - 1.0, LEAST_VARIANCE_PX2)))


def widest_spot_blur(image: NDArray[np.float32], plateau: float) -> float:
    """Blur of the median region above half of ``plateau`` if it were a point, pixel included, px.

    Notes
    -----
    At half of its height a Gaussian is ``sqrt(2 ln 2)`` times as wide as its standard deviation; a disk makes
    it wider.
    """
    area = label_components(image, 0.5 * plateau)["area"]
    return float(np.sqrt(median(area) / (2.0 * np.pi * np.log(2.0)))) if len(area) else np.inf


@njit(cache=True)
def _slopes(image, low, high, most):
    """Gradients of the pixels between two levels, from every eighth row or from more if these are few."""
    rows, columns = image.shape
    out = np.empty(most)
    column = np.empty(columns, np.float32)
    low, high = np.float32(9.0) * low, np.float32(9.0) * high  # of a sum over 3 x 3 pixels
    count = 0
    for first in range(8):
        for y in range(2 + first, rows - 2, 8):
            _add_rows(column, image[y - 1], image[y], image[y + 1])
            for left in range(2, columns - 2, STRIP):
                right = min(left + STRIP, columns - 2)
                if not _exceeds(column[left - 1 : right + 1], low / np.float32(3.0)):
                    continue
                for x in range(left, right):
                    if low < column[x - 1] + column[x] + column[x + 1] < high and count < most:
                        out[count] = _slope_at(image, x, y)
                        count += 1
        if count > most // 4:
            break
    return out[:count]


@njit(cache=True)
def _slope_at(image, x, y):
    """Gradient, from central differences of means of 3 x 3 pixels."""
    gx = gy = np.float32(0.0)
    for i in range(-1, 2):
        gx += image[y + i, x + 2] + image[y + i, x + 1] - image[y + i, x - 1] - image[y + i, x - 2]
        gy += image[y + 2, x + i] + image[y + 1, x + i] - image[y - 1, x + i] - image[y - 2, x + i]
    return np.sqrt(gx * gx + gy * gy) / np.float32(18.0)


@njit(cache=True, fastmath=True, forceinline=True)
def _add_rows(out, one, two, three):
    """Sum of three rows, in vector instructions."""
    for x in range(len(out)):
        out[x] = one[x] + two[x] + three[x]


@njit(cache=True, fastmath=True, forceinline=True)
def _exceeds(row, level):
    """Whether any value of the row exceeds the level, in vector instructions."""
    total = np.int32(0)
    for x in range(len(row)):
        total += np.int32(row[x] > level)
    return total > 0
