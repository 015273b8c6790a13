"""Find the circles of a group of disks from its outline, by voting.

Each disk of a group leaves an arc in the outline of the group. Two points p and q of one circle, with inward
normals m and n, obey ``p + r m = q + r n``. Each pair of points proposes the circle that solves this in least
squares, and the points that lie on it vote. The circle with most votes is kept, its points are removed, and
the search is repeated.
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.imaging.kernels.rim_pixels import FAST

SMOOTHING_PX = 0.8
"""Gaussian filter against noise in the normals; narrow against any arc that can be recognised. By hand."""
MOST_PAIRS = 3000
"""Pairs of points that propose a circle. In a group of five equal disks one pair in five lies on one
circle."""
LEAST_NORMAL_DIFFERENCE2 = 0.15
"""Least ``|m - n|^2`` of two normals that determine a radius: 22 degrees apart. Chosen by hand."""
TOLERANCE_PX = 0.5
"""Distance from a circle up to which a point lies on it. Chosen by hand."""
LEAST_COSINE = 0.9
"""Least cosine between the normal of a point and the direction of the centre. Chosen by hand."""
LEAST_POINTS, LEAST_ARC_FRACTION = 5, 0.2
"""Least number of points of an arc, and least fraction of the circumference. Chosen by hand."""
CROSSINGS_PER_PX = 4.0 / math.pi
"""Crossings of the rows and columns of pixels by a curve per px of its length. Theory: mean of |cos| +
|sin|."""
LEAST_BRIGHT_FRACTION = 0.9
"""Of the points inside a circle that must be above the level. Chosen by hand."""
SPOKES = 16
"""Directions in which these points lie."""
MOST_CIRCLES = 12
"""Circles looked for in a group."""


def cover_outline(image: NDArray[np.float32], level: float, *, smallest: float) -> NDArray[np.float64]:
    """Circles that follow the outline of the regions above a level, those with most points first.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Bright inside.
    level : float
    smallest : float, px
        Radius of the smallest circle.

    Returns
    -------
    ndarray, shape (n, 4)
        x, y, radius (px), and the fraction of the circumference that follows the outline.

    Examples
    --------
    >>> y, x = np.mgrid[0:40, 0:60]
    >>> two = np.minimum(np.hypot(x - 20, y - 20) - 9, np.hypot(x - 36, y - 20) - 8)
    >>> circles = cover_outline(np.clip(0.5 - two, 0, 1).astype(np.float32), 0.5, smallest=2.0)
    >>> np.abs(circles[circles[:, 0].argsort(), :3] - [[20, 20, 9], [36, 20, 8]]).max() < 0.5
    np.True_
    """
    blurred = cv2.GaussianBlur(image, (0, 0), SMOOTHING_PX, borderType=cv2.BORDER_REPLICATE)
    smooth = np.asarray(blurred, np.float32)
    points = _crossings(smooth, level)
    circles: list[NDArray] = []
    while len(circles) < MOST_CIRCLES and points.shape[1] >= LEAST_POINTS:
        circle, on = _best_circle(points, smooth, np.float32(level), smallest)
        if not on.any():
            break
        length = 2.0 * np.pi * circle[2] * CROSSINGS_PER_PX
        circles.append(np.append(circle, np.count_nonzero(on) / length))
        points = np.ascontiguousarray(points[:, ~on])
    return np.array(circles).reshape(-1, 4)


def _crossings(image: NDArray[np.float32], level: float) -> NDArray[np.float32]:
    """Points where rows and columns of pixels cross the level: rows of x, y and the inward normal."""
    if min(image.shape) < 2:
        return np.empty((4, 0), np.float32)
    gradient = np.array([np.gradient(image, axis=axis) for axis in (1, 0)])
    above = image > level
    parts = []
    for axis in (0, 1):
        j, i = np.nonzero(np.diff(above, axis=axis))
        ahead = (j + 1, i) if axis == 0 else (j, i + 1)
        f = (level - image[j, i]) / (image[ahead] - image[j, i])
        x, y = (i, j + f) if axis == 0 else (i + f, j)
        normal = gradient[:, j, i] * (1 - f) + gradient[(slice(None), *ahead)] * f
        length = np.maximum(np.hypot(*normal), 1e-12)
        parts.append(np.stack([x, y, *(normal / length)]))
    return np.asarray(np.hstack(parts), np.float32)


@njit(cache=True)
def _best_circle(points, image, level, smallest):
    """The circle with most points, and which of them lie on it."""
    n = points.shape[1]
    every = max(n * (n - 1) // 2 // MOST_PAIRS, 1)
    most, best, number = 0.0, (0.0, 0.0, 0.0), 0
    votes = np.zeros(n, np.float32)
    for i in range(n):
        for j in range(i + 1, n):
            number += 1
            if number % every:
                continue
            circle = _through(points[:, i], points[:, j])
            if not smallest < circle[2] < max(image.shape):
                continue
            count = _vote(points, circle, votes)
            if count > most and _is_arc(count, circle[2]) and _bright(image, level, circle):
                most, best = count, circle
    votes[:] = 0.0
    if most:
        _vote(points, best, votes)
    return best, votes > 0


@njit(cache=True)
def _through(p, q):
    """Circle (x, y, r) of two points with normals, in least squares."""
    mx, my = q[2] - p[2], q[3] - p[3]
    square = mx * mx + my * my
    if square < LEAST_NORMAL_DIFFERENCE2:
        return 0.0, 0.0, -1.0
    r = ((p[0] - q[0]) * mx + (p[1] - q[1]) * my) / square
    return 0.5 * (p[0] + q[0] + r * (p[2] + q[2])), 0.5 * (p[1] + q[1] + r * (p[3] + q[3])), r


@njit(cache=True, fastmath=FAST, forceinline=True)
def _vote(points, circle, votes):
    """1 for the points that lie on a circle and face its centre, else 0; and how many these are."""
    x, y, along, across = points[0], points[1], points[2], points[3]
    middle_x, middle_y, r = np.float32(circle[0]), np.float32(circle[1]), np.float32(circle[2])
    off, facing = np.float32(TOLERANCE_PX), np.float32(LEAST_COSINE)
    one, none = np.float32(1.0), np.float32(0.0)
    low, high = max(r - off, none) ** 2, (r + off) ** 2
    count = none
    for k in range(len(votes)):
        dx, dy = middle_x - x[k], middle_y - y[k]
        square = dx * dx + dy * dy
        near = (low < square) & (square < high)
        votes[k] = one if near & (dx * along[k] + dy * across[k] > facing * np.sqrt(square)) else none
        count += votes[k]
    return count


@njit(cache=True)
def _is_arc(count, r):
    """Whether so many points are enough of a circle."""
    return count >= max(LEAST_POINTS, LEAST_ARC_FRACTION * CROSSINGS_PER_PX * 2.0 * math.pi * r)


@njit(cache=True)
def _bright(image, level, circle):
    """Whether a circle is bright inside, as far as it lies in the image."""
    inside = total = 0
    for share in (0.0, 0.5, 0.8):
        for k in range(SPOKES if share else 1):
            angle = 2.0 * math.pi * k / SPOKES
            i = round(circle[0] + share * circle[2] * math.cos(angle))
            j = round(circle[1] + share * circle[2] * math.sin(angle))
            if 0 <= i < image.shape[1] and 0 <= j < image.shape[0]:
                total += 1
                inside += image[j, i] > level
    return inside >= LEAST_BRIGHT_FRACTION * total > 0
