"""Separable filters with a fixed number of taps, compiled so that every row is a run of vector instructions.

That takes contiguous rows, single precision, a number of taps that the compiler knows, and no check for a
division by zero (which numba's default makes of every division).
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

TAPS = 9
"""Coefficients of each filter."""

NO_IMAGE = np.empty((0, 0), np.float32)


def kernel_of(taps: NDArray[np.float64]) -> NDArray[np.float32]:
    """Coefficients of an odd number filled up with zeros, or cut and summing to 1, to `TAPS`.

    Examples
    --------
    >>> kernel_of(np.ones(3) / 3).round(2).tolist()
    [0.0, 0.0, 0.0, 0.33000001311302185, 0.33000001311302185, 0.33000001311302185, 0.0, 0.0, 0.0]
    """
    kernel, spare = np.zeros(TAPS), (TAPS - len(taps)) // 2
    if spare < 0:
        kernel = taps[-spare:spare] / taps[-spare:spare].sum()
    else:
        kernel[spare : spare + len(taps)] = taps
    return kernel.astype(np.float32)


def filter_image(
    image: NDArray,
    along: NDArray[np.float32],
    across: NDArray[np.float32],
    minus: NDArray[np.float32] = NO_IMAGE,
) -> NDArray[np.float32]:
    """The image correlated with a filter along its rows and one across them; its border repeats.

    ``minus`` is an image that is subtracted before.
    """
    out = np.empty(image.shape, np.float32)
    _filter_image(out, np.ascontiguousarray(image), along, across, np.ascontiguousarray(minus))
    return out


@njit(cache=True)
def _filter_image(out, image, along, across, minus):
    """`filter_image`; a ring keeps the rows that were filtered."""
    rows, columns = image.shape
    half = TAPS // 2
    ring = np.empty((TAPS, columns), np.float32)
    line = np.empty(columns + 2 * half, np.float32)
    turned = np.empty(TAPS, np.float32)
    for ahead in range(-half, rows + half):
        source = min(max(ahead, 0), rows - 1)
        pad_row(line, image[source])
        if minus.shape == image.shape:
            _subtract_row(line, minus[source])
        filter_row(ring[(ahead + half) % TAPS], line, along)
        y = ahead - half
        if y >= 0:
            turn_taps(turned, across, y)
            sum_rows(out[y], ring, turned)


@njit(cache=True)
def turn_taps(turned, taps, y):
    """Coefficients in the order of a ring whose first row is number y modulo `TAPS`."""
    for k in range(TAPS):
        turned[(y + k) % TAPS] = taps[k]


@njit(cache=True, fastmath=True, forceinline=True)
def pad_row(line, row):
    """The row in single precision, its ends repeated."""
    half = TAPS // 2
    for x in range(len(row)):
        line[half + x] = np.float32(row[x])
    line[:half] = np.float32(row[0])
    line[half + len(row) :] = np.float32(row[-1])


@njit(cache=True, fastmath=True, forceinline=True)
def _subtract_row(line, row):
    """Subtract a row from a padded one."""
    half = TAPS // 2
    for x in range(len(row)):
        line[half + x] -= row[x]
    line[:half] = line[half]
    line[half + len(row) :] = line[half + len(row) - 1]


@njit(cache=True, fastmath=True, forceinline=True)
def filter_row(out, line, taps):
    """Filter a padded row."""
    for x in range(len(out)):
        total = np.float32(0.0)
        for k in range(TAPS):
            total += taps[k] * line[x + k]
        out[x] = total


@njit(cache=True, fastmath=True, forceinline=True)
def sum_rows(out, rows, taps):
    """Weighted sum of `TAPS` rows."""
    for x in range(len(out)):
        total = np.float32(0.0)
        for k in range(TAPS):
            total += taps[k] * rows[k, x]
        out[x] = total


@njit(cache=True, fastmath=True, forceinline=True)
def double_row(out, row):
    """A row of twice as many pixels, between those of the row."""
    near, far = np.float32(0.75), np.float32(0.25)
    out[0], out[2 * len(row) - 1] = row[0], row[-1]
    for i in range(len(row) - 1):
        out[2 * i + 1] = near * row[i] + far * row[i + 1]
        out[2 * i + 2] = far * row[i] + near * row[i + 1]


@njit(cache=True, fastmath=True, forceinline=True)
def mix_rows(out, one, other, share):
    """The row between two, at a share of the way."""
    for x in range(len(out)):
        out[x] = one[x] + share * (other[x] - one[x])
