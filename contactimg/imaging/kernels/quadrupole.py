"""How elongated the rims of isolated disks look: a cheap screen before any ellipse is fitted (compiled)."""

import numpy as np

from contactimg.compiled import njit
from contactimg.imaging.kernels.pairs import find_pairs

HALF_WIDTH_BLUR_WIDTHS = 2.0
"""Half the width of the band about the rim. Theory: it holds 95 % of the information of a displaced rim."""
GAP_BLUR_WIDTHS = 6.0
"""Gap to a neighbour from which on a disk counts as isolated. Theory: its rim is 0.1 % three widths away."""
INSIDE_BLUR_WIDTHS = 3.0
"""Distance of the inside from the rim. Theory: 0.13 % of the edge's height is missing there."""


@njit(cache=True)
def screen_quadrupoles(image, disks, s, noise, out, inside):
    """Score of each isolated disk for an elongated outline; NaN for disks with neighbours or at the border.

    Into ``inside`` the mean squared deviation of the pixels `INSIDE_BLUR_WIDTHS` inside the rim from
    the disk's contrast, over their variance; NaN without such pixels.

    The pixels of the band about the rim are weighted with ``(1 - u^2/w^2) exp(2 i f)``, f the angle and u the
    distance from the rim. A disk adds nothing to that sum. Over the variance of the sum, its square is
    distributed as chi-square of two degrees of freedom. ``noise``: variance of a background pixel and its
    growth over a contact.
    """
    isolated = np.ones(len(disks), np.bool_)
    pairs = find_pairs(disks, 0.5 * GAP_BLUR_WIDTHS * s)
    for p in range(len(pairs)):
        isolated[pairs[p, 0]] = isolated[pairs[p, 1]] = False
    rows, columns = image.shape
    for k in range(len(disks)):
        x, y, a = disks[k, 0], disks[k, 1], disks[k, 2]
        width = HALF_WIDTH_BLUR_WIDTHS * s
        reach, inner = a + width, max(a - width, 0.0)
        out[k] = inside[k] = np.nan
        if not isolated[k] or x < reach or y < reach or x + reach >= columns or y + reach >= rows:
            continue
        sums = np.zeros(3)
        for j in range(int(np.ceil(y - reach)), int(np.floor(y + reach)) + 1):
            dy = j - y
            half = np.sqrt(max(reach * reach - dy * dy, 0.0))
            hole = np.sqrt(max(inner * inner - dy * dy, 0.0))
            narrow = 1.0 / (width * width)
            _add_run(image[j], x - half, x - hole if hole > 0.0 else x + half, x, dy, a, narrow, sums)
            if hole > 0.0:
                _add_run(image[j], x + hole, x + half, x, dy, a, narrow, sums)
        inside[k] = _deviation_inside(image, disks[k], s) / (noise[0] * (1.0 + noise[1]))
        variance = noise[0] * (1.0 + 0.5 * noise[1]) * 0.5 * sums[2]
        out[k] = (sums[0] ** 2 + sums[1] ** 2) / max(variance, 1e-30)


@njit(cache=True, fastmath=True, forceinline=True)
def _add_run(row, start, end, x, dy, a, narrow, sums):
    """Add the pixels of a row from ``start`` to ``end``."""
    first, last = int(np.ceil(start)), int(np.floor(end)) + 1
    cosine = sine = squares = zero = np.float32(0.0)
    one, two, tiny = np.float32(1.0), np.float32(2.0), np.float32(1e-9)
    start_x, down, radius, sharp = np.float32(first - x), np.float32(dy), np.float32(a), np.float32(narrow)
    levels = row[first:last]
    for i in range(len(levels)):
        dx = start_x + np.float32(i)
        square = dx * dx + down * down
        u = np.sqrt(square) - radius
        weight = max(one - u * u * sharp, zero)
        light = levels[i] * weight / max(square, tiny)
        cosine += light * (dx * dx - down * down)
        sine += light * two * dx * down
        squares += weight * weight
    sums[0] += cosine
    sums[1] += sine
    sums[2] += squares


@njit(cache=True)
def _deviation_inside(image, disk, s):
    """Mean squared deviation of the pixels well inside a disk from its contrast; NaN without any."""
    x, y, a, c = disk
    reach = a - INSIDE_BLUR_WIDTHS * s
    total, count = 0.0, 0
    if reach > 0.0:
        for j in range(int(np.ceil(y - reach)), int(np.floor(y + reach)) + 1):
            half = np.sqrt(reach * reach - (j - y) ** 2)
            first, last = int(np.ceil(x - half)), int(np.floor(x + half)) + 1
            total += _squares(image[j, first:last], np.float32(c))
            count += max(last - first, 0)
    return total / count if count else np.nan


@njit(cache=True, fastmath=True, forceinline=True)
def _squares(levels, c):
    """Sum of the squared deviations of some pixels."""
    total = np.float32(0.0)
    for i in range(len(levels)):
        total += (levels[i] - c) ** 2
    return total
