"""Compiled pass over the rows of a frame: move and filter the reference, weight its bands, divide by it.

Whatever a row needs stays in the processor's cache, and every loop over a row compiles to vector
instructions: that takes contiguous rows, single precision, a number of filter coefficients that the compiler
knows, and no check for a division by zero (which numba inserts by default).
"""

import numpy as np

from contactimg.compiled import njit
from contactimg.imaging.background.illumination import cubic

TAPS = 9
"""Number of coefficients of each filter; odd."""

NO_DIRT = 1e30
"""Scatter of a band in which nothing counts as dirt."""

DIRT_SIGMA, FULL_DIRT_SIGMA = 4.0, 6.0
"""Robust standard deviations of a band from which its detail is partly, and from which it is wholly taken as
dirt. Chosen by hand on rendered frames; sensitivity not measured."""


@njit(cache=True)
def divide_rows(out, frame, reference, half, quarter, along, across, filters, sharp, numbers):
    """Divide a frame by the weighted bands of its reference.

    Parameters
    ----------
    out : ndarray of float32, shape (rows, columns)
        Receives the relative excess of the frame over the background, times the level.
    frame, reference : ndarray, shape (rows, columns)
    half, quarter : ndarray of float32
        The reference at half and quarter of the resolution, moved and blurred.
    along, across : ndarray of float32
        Illumination ratio, see `contactimg.imaging.background.illumination.Illumination.row_polynomials`.
    filters : ndarray of float32, shape (1 or 2, 2, TAPS)
        Filters along rows and columns that move the reference (left out if its finest band has no weight) and
        that move it and blur it by the narrowest Gaussian.
    sharp : ndarray of float32, shape (2, TAPS)
        Filter that moves the reference.
    numbers : ndarray of float32
        Gains of the three finer bands, finest first; the inverse scatters of the coarser two of them; the
        level; the smallest background that is divided by.
    """
    rows, columns = reference.shape
    reach, kinds = TAPS // 2, len(filters)
    ring = np.empty((kinds, TAPS, columns), np.float32)
    bands = np.empty((kinds + 2, columns), np.float32)
    line, turned = np.empty(columns + 2 * reach, np.float32), np.empty(TAPS, np.float32)
    halves = np.empty((2, 2 * half.shape[1]), np.float32)
    twice = np.empty(2 * quarter.shape[1], np.float32)
    quarters = np.empty((2, 2 * len(twice)), np.float32)
    halves_done = quarters_done = 0
    for ahead in range(-reach, rows + reach):
        _pad_row(line, reference[min(max(ahead, 0), rows - 1)])
        for i in range(kinds):
            _filter_row(ring[i, (ahead + reach) % TAPS], line, filters[i, 0])
        y = ahead - reach
        if y < 0:
            continue
        for i in range(kinds):
            _turn_taps(turned, filters[i, 1], y)
            _sum_rows(bands[i], ring[i], turned)
        above, below, fraction = _neighbours(y, 2, len(half))
        for row in range(halves_done, below + 1):
            _double_row(halves[row % 2], half[row])
        halves_done = below + 1
        _mix_rows(bands[-2], halves[above % 2], halves[below % 2], fraction)
        above, below, fraction = _neighbours(y, 4, len(quarter))
        for row in range(quarters_done, below + 1):
            _double_row(twice, quarter[row])
            _double_row(quarters[row % 2], twice)
        quarters_done = below + 1
        _mix_rows(bands[-1], quarters[above % 2], quarters[below % 2], fraction)
        dirty = _weight_bands(out[y], bands[0], bands[-3], bands[-2], bands[-1], numbers)
        if dirty:
            _restore_dirt(out[y], dirty, y, reference, sharp, bands[-3], bands[-2], bands[-1], numbers)
        _divide_row(out[y], frame[y], along[y], across, numbers)


@njit(cache=True)
def _neighbours(y, side, rows):
    """Binned rows above and below row y, and its position between them (0 to 1)."""
    place = min(max((y + 0.5) / side - 0.5, 0.0), rows - 1.0)
    above = int(place)
    return above, min(above + 1, rows - 1), np.float32(place - above)


@njit(cache=True, fastmath=True, forceinline=True)
def _weight_bands(out, sharp, narrow, middle, wide, numbers):
    """Sum the weighted bands of a row; return the number of pixels where a band shows dirt."""
    finest, finer, coarser, per_finer, per_coarser = numbers[:5]
    limit = np.float32(DIRT_SIGMA)
    dirty = np.int32(0)
    for x in range(len(out)):
        fine, coarse = narrow[x] - middle[x], middle[x] - wide[x]
        out[x] = wide[x] + coarser * coarse + finer * fine + finest * (sharp[x] - narrow[x])
        dirty += np.int32((abs(fine) * per_finer > limit) | (abs(coarse) * per_coarser > limit))
    return dirty


@njit(cache=True, fastmath=True, error_model="numpy", forceinline=True)
def _restore_dirt(out, dirty, y, reference, sharp, narrow, middle, wide, numbers):
    """Replace the sum by the unfiltered reference, merely moved, in the pixels where a band shows dirt."""
    per_finer, per_coarser = numbers[3:5]
    rows, columns = reference.shape
    reach = TAPS // 2
    start, width = np.float32(DIRT_SIGMA), np.float32(FULL_DIRT_SIGMA - DIRT_SIGMA)
    for x in range(columns):
        worst = max(abs(narrow[x] - middle[x]) * per_finer, abs(middle[x] - wide[x]) * per_coarser)
        if not worst > start:
            continue
        moved = np.float32(0.0)
        for j in range(TAPS):
            row = reference[min(max(y + j - reach, 0), rows - 1)]
            for i in range(TAPS):
                moved += sharp[1, j] * sharp[0, i] * np.float32(row[min(max(x + i - reach, 0), columns - 1)])
        out[x] += min((worst - start) / width, np.float32(1.0)) * (moved - out[x])
        dirty -= 1
        if dirty == 0:
            break


@njit(cache=True, fastmath=True, error_model="numpy", forceinline=True)
def _divide_row(out, frame, along, across, numbers):
    """Relative excess of the frame over the background, times the level."""
    c0, c1, c2, c3 = along
    level, lowest = numbers[5:]
    for x in range(len(out)):
        background = cubic(c0, c1, c2, c3, across[x]) * out[x]
        out[x] = level * (np.float32(frame[x]) - background) / max(background, lowest)


@njit(cache=True)
def _turn_taps(turned, taps, y):
    """Coefficients in the order of a ring buffer whose first row is number y modulo `TAPS`."""
    for k in range(TAPS):
        turned[(y + k) % TAPS] = taps[k]


@njit(cache=True, fastmath=True, forceinline=True)
def _pad_row(line, row):
    """The row in single precision, padded by its end values."""
    half = TAPS // 2
    for x in range(len(row)):
        line[half + x] = np.float32(row[x])
    line[:half] = np.float32(row[0])
    line[half + len(row) :] = np.float32(row[-1])


@njit(cache=True, fastmath=True, forceinline=True)
def _filter_row(out, line, taps):
    """Filter a padded row."""
    for x in range(len(out)):
        total = np.float32(0.0)
        for k in range(TAPS):
            total += taps[k] * line[x + k]
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
def _double_row(out, row):
    """The row interpolated to twice as many pixels."""
    near, far = np.float32(0.75), np.float32(0.25)
    out[0], out[2 * len(row) - 1] = row[0], row[-1]
    for i in range(len(row) - 1):
        out[2 * i + 1] = near * row[i] + far * row[i + 1]
        out[2 * i + 2] = far * row[i] + near * row[i + 1]


@njit(cache=True, fastmath=True, forceinline=True)
def _mix_rows(out, above, below, fraction):
    """The row interpolated linearly between two."""
    for x in range(len(out)):
        out[x] = above[x] + fraction * (below[x] - above[x])
