"""Which disks touch, which lie inside one another, and how much of each rim is visible."""

import numpy as np

from contactimg.compiled import njit
from contactimg.imaging.kernels.pairs import find_pairs, list_neighbours

DEEPEST = 0.35
"""Overlap over the diameter of the smaller disk above which two disks are one contact. Chosen by hand."""

LEAST_VISIBLE_RIM = 0.2
"""Visible fraction of a rim below which a disk is treated as if it showed this much. Chosen by hand."""


@njit(cache=True)
def overlapping(disks, deepest):
    """Whether each disk lies in a larger one by more than ``deepest`` of its own diameter."""
    n = len(disks)
    out = np.zeros(n, np.bool_)
    order = np.argsort(disks[:, 0] - disks[:, 2])
    for u in range(n):
        i = order[u]
        for v in range(u + 1, n):
            j = order[v]
            if disks[j, 0] - disks[j, 2] > disks[i, 0] + disks[i, 2]:
                break
            distance = np.hypot(disks[i, 0] - disks[j, 0], disks[i, 1] - disks[j, 1])
            small = min(disks[i, 2], disks[j, 2])
            if disks[i, 2] + disks[j, 2] - distance > 2.0 * deepest * small:
                out[i if disks[i, 2] <= disks[j, 2] else j] = True
    return out


@njit(cache=True)
def hidden(disks):
    """Whether each disk overlaps an earlier one, itself not hidden, by more than `DEEPEST`."""
    out = np.zeros(len(disks), np.bool_)
    start, link = list_neighbours(len(disks), find_pairs(disks, 0.0))
    for i in range(len(disks)):
        for q in range(start[i], start[i + 1]):
            j = link[q, 2]
            if j >= i:
                continue
            distance = np.hypot(disks[i, 0] - disks[j, 0], disks[i, 1] - disks[j, 1])
            deep = disks[i, 2] + disks[j, 2] - distance
            if not out[j] and deep > 2.0 * DEEPEST * min(disks[i, 2], disks[j, 2]):
                out[i] = True
    return out


@njit(cache=True)
def count_touching(disks, space):
    """Number of other disks whose rim comes closer than ``space`` to that of each disk."""
    out = np.zeros(len(disks), np.int64)
    pairs = find_pairs(disks, 0.5 * space)
    for p in range(len(pairs)):
        out[pairs[p, 0]] += 1
        out[pairs[p, 1]] += 1
    return out


@njit(cache=True)
def visible_share(disks):
    """Fraction of each disk's rim that lies in no other disk.

    A disk of radius b at distance d hides the arc of half angle ``acos((d^2 + a^2 - b^2)/(2 d a))`` of one of
    radius a.
    """
    share = np.ones(len(disks))
    pairs = find_pairs(disks, 0.0)
    for p in range(len(pairs)):
        for side in range(2):
            i, j = pairs[p, side], pairs[p, 1 - side]
            a, b = disks[i, 2], disks[j, 2]
            d = np.hypot(disks[i, 0] - disks[j, 0], disks[i, 1] - disks[j, 1])
            cosine = (d * d + a * a - b * b) / max(2.0 * d * a, 1e-12)
            share[i] -= np.arccos(min(max(cosine, -1.0), 1.0)) / np.pi
    return np.maximum(share, LEAST_VISIBLE_RIM)
