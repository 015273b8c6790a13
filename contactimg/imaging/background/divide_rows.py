"""Compiled pass over the rows of a frame: move and filter the reference, divide by it.

Whatever a row needs stays in the processor's cache, and every loop over a row compiles to vector
instructions: that takes contiguous rows, single precision, a number of filter coefficients that the compiler
knows, and no check for a division by zero (which numba inserts by default).
"""

import numpy as np
from numba import njit

from contactimg.imaging.background.illumination import cubic

REACH = 4  # pixels on either side of the one that is filtered
TAPS = 2 * REACH + 1
"""Number of coefficients of each filter, as of `contactimg.imaging.background.resample.shift_kernel`."""

NO_DIRT = 1e30
"""Scatter of the detail in which nothing counts as dirt."""

DIRT_SIGMA, FULL_DIRT_SIGMA = 4.0, 6.0
"""Robust standard deviations of the detail from which it is partly, and from which it is wholly taken as
dirt. Chosen by hand on rendered frames; sensitivity not measured."""


@njit(cache=True)
def divide_rows(out, frame, reference, wide, along, across, narrow_taps, sharp_taps, numbers):
    """Divide a frame by its filtered reference.

    Parameters
    ----------
    out : ndarray of float32, shape (rows, columns)
        Receives the relative excess of the frame over the background, times the level.
    frame, reference : ndarray, shape (rows, columns)
    wide : ndarray of float32, at least as large
        The reference moved and blurred by the wide Gaussian.
    along, across : ndarray of float32
        Illumination ratio, see `contactimg.imaging.background.illumination.Illumination.row_polynomials`.
    narrow_taps, sharp_taps : ndarray of float32, shape (2, TAPS)
        Filters along rows and columns that move the reference and blur it by the narrow Gaussian, and that
        move it only.
    numbers : ndarray of float32
        Gain of the detail; its inverse scatter; the level; the smallest background that is divided by.
    """
    rows, columns = reference.shape
    ring = np.empty((TAPS, columns), np.float32)
    narrow, padded = np.empty(columns, np.float32), np.empty(columns + 2 * REACH, np.float32)
    ring_taps = np.empty(TAPS, np.float32)
    for ahead in range(-REACH, rows + REACH):
        row = reference[min(max(ahead, 0), rows - 1)]
        _filter_row(ring[(ahead + REACH) % TAPS], row, padded, narrow_taps[0])
        y = ahead - REACH
        if y < 0:
            continue
        for k in range(TAPS):  # row y + k - REACH of the reference is row (y + k) % TAPS of the ring
            ring_taps[(y + k) % TAPS] = narrow_taps[1, k]
        _sum_rows(narrow, ring, ring_taps)
        if _weight_detail(out[y], narrow, wide[y], numbers):
            _restore_dirt(out[y], y, reference, sharp_taps, narrow, wide[y], numbers)
        _divide_row(out[y], frame[y], along[y], across, numbers)


@njit(cache=True, fastmath=True, forceinline=True)
def _filter_row(out, row, padded, taps):
    """Filter a row, which its end values continue; ``padded`` is working memory."""
    for x in range(len(row)):
        padded[REACH + x] = np.float32(row[x])
    padded[:REACH] = np.float32(row[0])
    padded[REACH + len(row) :] = np.float32(row[-1])
    for x in range(len(out)):
        total = np.float32(0.0)
        for k in range(TAPS):
            total += taps[k] * padded[x + k]
        out[x] = total


@njit(cache=True, fastmath=True, forceinline=True)
def _sum_rows(out, rows, taps):
    """Weighted sum of `TAPS` rows."""
    for x in range(len(out)):
        total = np.float32(0.0)
        for k in range(TAPS):
            total += taps[k] * rows[k, x]
        out[x] = total


@njit(cache=True, fastmath=True, forceinline=True)
def _weight_detail(out, narrow, wide, numbers):
    """Add the weighted detail of a row to the wide blur; return the number of pixels that show dirt."""
    gain, per_scatter = numbers[:2]
    limit = np.float32(DIRT_SIGMA)
    dirty = np.int32(0)
    for x in range(len(out)):
        detail = narrow[x] - wide[x]
        out[x] = wide[x] + gain * detail
        dirty += np.int32(abs(detail) * per_scatter > limit)
    return dirty


@njit(cache=True, fastmath=True, error_model="numpy", forceinline=True)
def _restore_dirt(out, y, reference, taps, narrow, wide, numbers):
    """Replace the sum by the unfiltered reference, merely moved, in the pixels that show dirt."""
    rows, columns = reference.shape
    start, width = np.float32(DIRT_SIGMA), np.float32(FULL_DIRT_SIGMA - DIRT_SIGMA)
    for x in range(columns):
        size = abs(narrow[x] - wide[x]) * numbers[1]
        if not size > start:
            continue
        moved = np.float32(0.0)
        for j in range(TAPS):
            row = reference[min(max(y + j - REACH, 0), rows - 1)]
            for i in range(TAPS):
                pixel = np.float32(row[min(max(x + i - REACH, 0), columns - 1)])
                moved += taps[1, j] * taps[0, i] * pixel
        out[x] += min((size - start) / width, np.float32(1.0)) * (moved - out[x])


@njit(cache=True, fastmath=True, error_model="numpy", forceinline=True)
def _divide_row(out, frame, along, across, numbers):
    """Relative excess of the frame over the background, times the level."""
    c0, c1, c2, c3 = along
    level, lowest = numbers[2:]
    for x in range(len(out)):
        background = cubic(c0, c1, c2, c3, across[x]) * out[x]
        out[x] = level * (np.float32(frame[x]) - background) / max(background, lowest)
