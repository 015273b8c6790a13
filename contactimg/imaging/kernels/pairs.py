"""Which disks share pixels: pairs whose rims come close."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from contactimg.compiled import lengthened, njit
from contactimg.imaging.profile.limits import EDGE_BLUR_WIDTHS, LEAST_VISIBLE

DEEPEST = 0.35
"""Overlap over the diameter of the smaller disk above which two disks are one contact. Chosen by hand."""


def find_pairs(disks: NDArray[np.float64], space: float) -> NDArray[np.int64]:
    """Pairs of disks whose rims come closer than ``2 space``, by a sweep along x."""
    disks = np.ascontiguousarray(disks)
    left = disks[:, 0] - disks[:, 2] - space
    return np.asarray(_sweep(disks, left, np.argsort(left), float(space)), np.int64)


@njit(cache=True)
def _sweep(disks, left, order, space):
    """The pairs, each disk compared with those that begin before it ends."""
    n = len(disks)
    pairs, count = np.empty((4 * n + 16, 2), np.int64), 0
    for u in range(n):
        i = order[u]
        right = disks[i, 0] + disks[i, 2] + space
        for v in range(u + 1, n):
            j = order[v]
            if left[j] > right:
                break
            limit = disks[i, 2] + disks[j, 2] + 2 * space
            dx, dy = disks[i, 0] - disks[j, 0], disks[i, 1] - disks[j, 1]
            if abs(dy) > limit or dx * dx + dy * dy > limit * limit:
                continue
            if count == len(pairs):
                pairs = lengthened(pairs)
            pairs[count, 0], pairs[count, 1] = min(i, j), max(i, j)
            count += 1
    return pairs[:count]


@njit(cache=True)
def select_close(pairs, disks, space):
    """The pairs whose rims come closer than ``2 space``."""
    out, count = np.empty(pairs.shape, np.int64), 0
    for i, j in pairs:
        dx, dy = disks[i, 0] - disks[j, 0], disks[i, 1] - disks[j, 1]
        if dx * dx + dy * dy <= (disks[i, 2] + disks[j, 2] + 2.0 * space) ** 2:
            out[count, 0], out[count, 1] = i, j
            count += 1
    return out[:count]


@njit(cache=True)
def largest_move(disks, before):
    """Largest distance that a rim has moved."""
    largest = 0.0
    for i in range(len(disks)):
        moved = np.hypot(disks[i, 0] - before[i, 0], disks[i, 1] - before[i, 1])
        largest = max(largest, moved + disks[i, 2] - before[i, 2])
    return largest


def are_entangled(disks: NDArray[np.float64], pairs: NDArray[np.int64], blur: float, pixels: int) -> bool:
    """Whether pairs of disks share so many pixels, of those of the image, that the disks are no contacts."""
    smaller = np.minimum(*disks[pairs.T, 2]) + EDGE_BLUR_WIDTHS * blur
    # By hand: a close packing of small ones shares seven times the image; the work of a fit grows with it.
    return bool(np.minimum(np.pi * smaller**2, pixels).sum() > 10.0 * pixels)


def overlapping(disks: NDArray, deepest: float) -> NDArray[np.bool_]:
    """Whether each disk lies in a larger one by more than ``deepest`` of its own diameter."""
    out = np.zeros(len(disks), np.bool_)
    i, j = _deep_pairs(disks, deepest).T
    out[np.where(disks[i, 2] <= disks[j, 2], i, j)] = True
    return out


def hidden(disks: NDArray) -> NDArray[np.bool_]:
    """Whether each disk overlaps an earlier one, itself not hidden, by more than `DEEPEST`."""
    out = np.zeros(len(disks), np.bool_)
    pairs = _deep_pairs(disks, DEEPEST)
    for earlier, later in pairs[np.argsort(pairs[:, 1])]:
        out[later] |= not out[earlier]
    return out


def _deep_pairs(disks: NDArray, deepest: float) -> NDArray[np.int64]:
    """Pairs of disks that overlap by more than ``deepest`` of the diameter of the smaller one."""
    pairs = find_pairs(disks, 0.0)
    (x, y, a), (u, v, b) = disks[pairs[:, 0], :3].T, disks[pairs[:, 1], :3].T
    return pairs[a + b - np.hypot(x - u, y - v) > 2.0 * deepest * np.minimum(a, b)]


def count_touching(disks: NDArray, space: float) -> NDArray[np.int64]:
    """Number of other disks whose rim comes closer than ``space`` to that of each disk."""
    return np.bincount(find_pairs(disks, 0.5 * space).ravel(), minlength=len(disks))


def label_groups(disks: NDArray, gap: float) -> NDArray[np.int64]:
    """Number of the group of each disk: disks with gaps below ``gap``, directly or through others."""
    pairs, n = find_pairs(disks, 0.5 * gap), len(disks)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)


def visible_share(disks: NDArray) -> NDArray[np.float64]:
    """Fraction of each disk's rim that lies in no other disk."""
    share, (i, half) = np.ones(len(disks)), _arcs(disks)
    np.subtract.at(share, i, half / np.pi)
    return np.maximum(share, LEAST_VISIBLE)


def areas_beyond_chords(disks: NDArray) -> NDArray[np.float64]:
    """Area of each disk (x, y, radius, ...) beyond the chords it has in common with others.

    Without it the areas of two disks that overlap add up to that of their union. A segment of half angle h of
    a disk of radius a has the area ``a^2 (h - sin h cos h)``.

    Examples
    --------
    >>> areas_beyond_chords(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 2.0], [9.0, 0.0, 3.0]])).round(3).tolist()
    [3.142, 0.0, 0.0]
    """
    area, (i, half) = np.zeros(len(disks)), _arcs(disks)
    np.add.at(area, i, disks[i, 2] ** 2 * (half - np.sin(half) * np.cos(half)))
    return area


def _arcs(disks: NDArray) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The disks that overlap, once for each other one, and half the angle of their arc that lies in it.

    A disk of radius b at distance d hides the arc of half angle ``acos((d^2 + a^2 - b^2)/(2 d a))`` of one of
    radius a.
    """
    pairs = find_pairs(disks, 0.0)
    i, j = np.concatenate([pairs, pairs[:, ::-1]]).T
    (x, y, a), (u, v, b) = disks[i, :3].T, disks[j, :3].T
    d = np.hypot(x - u, y - v)
    cosine = (d * d + a * a - b * b) / np.maximum(2.0 * d * a, 1e-12)
    return i, np.arccos(np.clip(cosine, -1.0, 1.0))
