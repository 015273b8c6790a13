"""The blurred overlap of two disks (compiled).

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
from scipy import special

from contactimg.compiled import njit

EDGE_REACH_BLUR_WIDTHS = 5.0  # theory: beyond, an edge is 0 or 1 to 3e-7
EDGE_STEPS_PER_BLUR_WIDTH = 64  # theory: linear interpolation errs by (1/64)^2/8 x 0.24 = 7e-6
EDGE_HALF = EDGE_REACH_BLUR_WIDTHS * EDGE_STEPS_PER_BLUR_WIDTH
EDGE = special.ndtr(np.arange(-EDGE_HALF, EDGE_HALF + 2) / EDGE_STEPS_PER_BLUR_WIDTH)  # a straight edge
NODE_SPACING_BLUR_WIDTHS = 0.8  # of the integral; theory: exact to 1e-8, see above
LEAST_NODES = 8  # theory: midpoint rule on the parabola of a thin lens, area right to 1/(2 x 8^2) = 0.8 %
THINNEST_OVERLAP_PX = 0.02  # depth of overlaps that are ignored; theory: area 4/3 sqrt(a) 0.02^1.5


@njit(cache=True)
def overlaps(one, two):
    """Whether two disks overlap visibly."""
    dx, dy = two[0] - one[0], two[1] - one[1]
    limit = one[2] + two[2] - THINNEST_OVERLAP_PX
    return limit > 0.0 and dx * dx + dy * dy < limit * limit


@njit(cache=True)
def add_lens(model, one, two, s, sign):
    """Add ``sign`` times the lens that two overlapping disks share, at the mean of their contrasts."""
    dx, dy = two[0] - one[0], two[1] - one[1]
    d = math.sqrt(dx * dx + dy * dy)
    ex, ey = (dx / d, dy / d) if d > 0.0 else (1.0, 0.0)
    a, b = one[2], two[2]
    tall, count = lens_nodes(a, b, d, s)
    step = 2.0 * tall / count
    low, high = np.empty(count), np.empty(count)
    for k in range(count):
        t = -tall + (k + 0.5) * step
        u, v = math.sqrt(max(a * a - t * t, 0.0)), math.sqrt(max(b * b - t * t, 0.0))
        low[k], high[k] = max(-u, d - v), max(min(u, d + v), -u, d - v)
    _draw_lens(model, (one[0], one[1], ex, ey), (a, b, d), low, high, tall, s, sign * 0.5 * (one[3] + two[3]))


@njit(cache=True)
def lens_nodes(a, b, d, s):
    """Half the height of the lens of two disks at a distance d, and the nodes of the integral over it."""
    foot = 0.5 * (d + (a * a - b * b) / d) if d > 0.0 else -1.0
    tall = math.sqrt(max(a * a - foot * foot, 0.0)) if 0.0 <= foot <= d else min(a, b)
    return tall, max(math.ceil(2.0 * tall / (NODE_SPACING_BLUR_WIDTHS * s)), LEAST_NODES)


@njit(cache=True)
def _draw_lens(model, frame, circles, low, high, tall, s, level):
    """Add the lens, given in the coordinates of its pair (origin and axis in ``frame``), to the image.

    Only pixels near one of the two ``circles`` (radii, distance of the centres) need the integral.
    """
    x, y, ex, ey = frame
    a, b, d = circles
    reach = EDGE_REACH_BLUR_WIDTHS * s
    p0, p1, q1 = low.min() - reach, high.max() + reach, tall + reach
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
    t = min(max((z + EDGE_REACH_BLUR_WIDTHS) * EDGE_STEPS_PER_BLUR_WIDTH, 0.0), 2.0 * EDGE_HALF)
    k = int(t)
    return EDGE[k] + (t - k) * (EDGE[k + 1] - EDGE[k])
