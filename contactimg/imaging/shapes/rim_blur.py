"""Width of the blur from the slope of the rims."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from contactimg.imaging.pixels.robust import median

MOST_SLOPES = 8000  # pixels at half height that give the blur
STRIP = 64  # pixels of a row looked at together


def estimate_blur(image: NDArray[np.float32], plateau: float) -> float:
    """Width of the blur from the gradient where rims cross half height, pixel included, px.

    Notes
    -----
    At half height a straight edge has the gradient ``plateau/(s sqrt(2 pi))``; the smoothing that tames the
    noise here adds 2/3 px^2 (a 3 x 3 mean), central differences 1/3 px^2. Good to 10 %: a start for the fit.
    """
    slopes = _slopes(image, np.float32(0.4 * plateau), np.float32(0.6 * plateau), MOST_SLOPES)
    if len(slopes) < 20:
        return 1.5
    width = plateau / max(median(slopes), 1e-6 * plateau) / np.sqrt(2 * np.pi)
    return float(np.sqrt(max(width**2 - 1.0, 0.35)))


@njit(cache=True)
def _slopes(image, low, high, most):
    """Gradients of the pixels between two levels, every so many rows such that not too many come out."""
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
    """Whether a value of the row does, in vector instructions."""
    total = np.int32(0)
    for x in range(len(row)):
        total += np.int32(row[x] > level)
    return total > 0
