"""The model image: disks drawn and erased, each pixel as bright as in their union (compiled).

Where two disks overlap, a pixel is as bright as in one of them. The image of their union is the sum of the
two minus the image of the lens that they share,

    L(p, q) = int dt g(q - t) [Phi((hi(t) - p)/s) - Phi((lo(t) - p)/s)]

with p along the line of centres, q across, ``lo`` and ``hi`` the ends of the lens at height t, g and Phi the
Gaussian of width s and its integral. Sampled every 0.8 s the integral over t is exact to 1e-8 but for the
ends of the lens. The common part of three disks is subtracted once too often; contacts overlap too little for
that to matter.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import special

from contactimg.compiled import njit
from contactimg.imaging.kernels.pairs import select_close
from contactimg.imaging.kernels.rim_pixels import (
    BY_C,
    EACH,
    FAST,
    NONE,
    PLACE,
    add_block,
    allocate_pixels,
    block_between,
    evaluate_profile,
    interpolate_row,
    next_blocks,
    pad_pixels,
    reach_of_profile,
    row_of_block,
)
from contactimg.imaging.profile.blurred_disk import END_BLUR_WIDTHS, EdgeTable
from contactimg.imaging.profile.limits import REACH_BLUR_WIDTHS

EDGE_STEPS_PER_BLUR_WIDTH = 64  # theory: linear interpolation errs by (1/64)^2/8 x 0.24 = 7e-6
EDGE_HALF = REACH_BLUR_WIDTHS * EDGE_STEPS_PER_BLUR_WIDTH
EDGE = special.ndtr(np.arange(-EDGE_HALF, EDGE_HALF + 2) / EDGE_STEPS_PER_BLUR_WIDTH)  # a straight edge
NODE_SPACING_BLUR_WIDTHS = 0.8  # of the integral; theory: exact to 1e-8, see above


def draw_disks(
    model: NDArray[np.float32], disks: NDArray[np.float64], s: float, drawn: NDArray[np.bool_],
    wanted: NDArray[np.bool_],
    near_pairs: NDArray[np.int64], table: EdgeTable, *, shared: bool = False,
) -> None:  # fmt: skip
    """Add disks to the model image, or subtract them, until it contains those wanted, each with its overlaps.

    ``near_pairs`` contains all pairs that overlap; ``shared``: the image contains other disks as well.
    """
    kept, erased = np.count_nonzero(drawn & wanted), np.count_nonzero(drawn & ~wanted)
    # 6000 pixels are cleared in the time in which a disk is erased
    if not shared and (erased - kept) * 6000 > model.size:  # those that stay are sooner drawn anew
        model.fill(0.0)
        drawn[:] = False
    change = np.flatnonzero(drawn != wanted)
    if not len(change):
        return
    disks, touching = np.ascontiguousarray(disks), select_close(near_pairs, disks, 0.0)
    _draw(model, disks, s, drawn, wanted, table, change, touching)
    drawn[change] = wanted[change]


@njit(cache=True, error_model="numpy")
def _draw(model, disks, s, drawn, wanted, table, change, pairs):
    """Add or subtract the disks that ``change``, and what the pairs drawn after, or before, share."""
    for i in change:
        add_disk(model, disks[i], s, table, 1.0 if wanted[i] else -1.0)
    for p in range(len(pairs)):
        i, j = pairs[p]
        before, after = drawn[i] and drawn[j], wanted[i] and wanted[j]
        dx, dy = disks[j, 0] - disks[i, 0], disks[j, 1] - disks[i, 1]
        # Thinner overlaps are ignored. Theory: their area is 4/3 sqrt(a) 0.02^1.5.
        limit = disks[i, 2] + disks[j, 2] - 0.02
        if before != after and limit > 0.0 and dx * dx + dy * dy < limit * limit:
            add_lens(model, disks[i], disks[j], s, -1.0 if after else 1.0)


@njit(cache=True, error_model="numpy", inline="always")
def add_disk(model, disk, s, table, sign):
    """Add ``sign`` times one disk to the model image."""
    x, y, a, c = disk
    rows, columns = model.shape
    reach = reach_of_profile(table, END_BLUR_WIDTHS)
    half, inner = a + reach * s, a - END_BLUR_WIDTHS * s
    row, pixels, height = interpolate_row(table, a, s), allocate_pixels(half), np.float32(sign * c)
    j, bottom = max(int(np.ceil(y - half)), 0), min(int(np.floor(y + half)), rows - 1)
    while j <= bottom:
        left, right = next_blocks(j, bottom, EACH, half, inner, x, y, columns)
        n = pad_pixels(pixels, add_block(pixels, add_block(pixels, NONE, left, x, y), right, x, y))
        evaluate_profile(pixels, n, a, s, row)
        _scale_profile(pixels[BY_C, :n], pixels[PLACE, :n], np.float32(reach / END_BLUR_WIDTHS), height)
        _add_levels(model, left, pixels[BY_C], NONE)
        _add_levels(model, right, pixels[BY_C], left[1] * left[4])
        _add_flat(model, block_between(left, right), height)
        j += left[1]


@njit(cache=True, fastmath=FAST, forceinline=True)
def _scale_profile(level, place, reach, height):
    """Multiply a profile by its height, and set it to 0 beyond its end."""
    for i in range(len(level)):
        level[i] = height * level[i] if place[i] <= reach else np.float32(0.0)


@njit(cache=True)
def _add_levels(model, block, levels, n):
    """Add the levels from ``n`` on to a block of the model image."""
    for k in range(block[1]):
        line, more = row_of_block(block, k, model, levels, n)
        for i in range(len(line)):
            line[i] += more[i]


@njit(cache=True)
def _add_flat(model, block, height):
    """Add one level to a block of the model image."""
    top, rows, _, first, width = block
    for j in range(top, top + rows):
        line = model[j, first : first + width]
        for i in range(len(line)):
            line[i] += height


@njit(cache=True)
def add_lens(model, one, two, s, sign):
    """Add ``sign`` times the lens that two overlapping disks share, at the mean of their contrasts."""
    dx, dy = two[0] - one[0], two[1] - one[1]
    d = math.sqrt(dx * dx + dy * dy)
    ex, ey = (dx / d, dy / d) if d > 0.0 else (1.0, 0.0)
    a, b = one[2], two[2]
    # half the height of the lens, and the nodes of the integral over it
    foot = 0.5 * (d + (a * a - b * b) / d) if d > 0.0 else -1.0
    tall = math.sqrt(max(a * a - foot * foot, 0.0)) if 0.0 <= foot <= d else min(a, b)
    # Theory: the midpoint rule on the parabola of a thin lens is right to 1/(2 x 8^2) = 0.8 % of the area.
    count = max(math.ceil(2.0 * tall / (NODE_SPACING_BLUR_WIDTHS * s)), 8)
    step = 2.0 * tall / count
    low, high = np.empty(count), np.empty(count)
    for k in range(count):
        t = -tall + (k + 0.5) * step
        u, v = math.sqrt(max(a * a - t * t, 0.0)), math.sqrt(max(b * b - t * t, 0.0))
        low[k], high[k] = max(-u, d - v), max(min(u, d + v), -u, d - v)
    _draw_lens(model, (one[0], one[1], ex, ey), (a, b, d), low, high, tall, s, sign * 0.5 * (one[3] + two[3]))


@njit(cache=True)
def _draw_lens(model, frame, circles, low, high, tall, s, level):
    """Add the lens, given in the coordinates of its pair (origin and axis in ``frame``), to the image.

    Only pixels near one of the two ``circles`` (radii, distance of the centres) need the integral.
    """
    x, y, ex, ey = frame
    a, b, d = circles
    reach = REACH_BLUR_WIDTHS * s
    widest = len(low) // 2
    p0, p1, q1 = low[widest] - reach, high[widest] + reach, tall + reach
    half_x, half_y = 0.5 * (p1 - p0) * abs(ex) + q1 * abs(ey), 0.5 * (p1 - p0) * abs(ey) + q1 * abs(ex)
    cx, cy = x + 0.5 * (p0 + p1) * ex, y + 0.5 * (p0 + p1) * ey
    step = 2.0 * tall / len(low)
    height = level * step / (s * math.sqrt(2.0 * math.pi))
    spacing = step / s
    narrower = math.exp(-spacing * spacing)
    for j in range(max(math.ceil(cy - half_y), 0), min(math.floor(cy + half_y), model.shape[0] - 1) + 1):
        for i in range(max(math.ceil(cx - half_x), 0), min(math.floor(cx + half_x), model.shape[1] - 1) + 1):
            p, q = (i - x) * ex + (j - y) * ey, (j - y) * ex - (i - x) * ey
            if p < p0 or p > p1 or abs(q) > q1:
                continue
            depth = min(a - math.sqrt(p * p + q * q), b - math.sqrt((p - d) ** 2 + q * q))
            if abs(depth) > reach:
                model[j, i] += level if depth > 0.0 else 0.0
                continue
            first = max(int((q - reach + tall) / step), 0)
            last = min(int((q + reach + tall) / step) + 1, len(low))
            # Gaussians at equal steps: the ratio of two of them changes by a constant factor
            z, total = (q + tall - (first + 0.5) * step) / s, 0.0
            gaussian, ratio = math.exp(-0.5 * z * z), math.exp((z - 0.5 * spacing) * spacing)
            for k in range(first, last):
                total += gaussian * (_edge((high[k] - p) / s) - _edge((low[k] - p) / s))
                gaussian *= ratio
                ratio *= narrower
            model[j, i] += height * total


@njit(cache=True)
def _edge(z):
    """Integral of the normal distribution."""
    t = min(max((z + REACH_BLUR_WIDTHS) * EDGE_STEPS_PER_BLUR_WIDTH, 0.0), 2.0 * EDGE_HALF)
    k = int(t)
    return EDGE[k] + (t - k) * (EDGE[k + 1] - EDGE[k])
