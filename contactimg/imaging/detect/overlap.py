"""Which disks touch, which lie inside one another, and how much of each rim is visible."""

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.kernels.pairs import find_pairs

DEEPEST = 0.35
"""Overlap over the diameter of the smaller disk above which two disks are one contact. Chosen by hand."""

LEAST_VISIBLE_RIM = 0.2
"""Visible fraction of a rim below which a disk is treated as if it showed this much. Chosen by hand."""


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


def visible_share(disks: NDArray) -> NDArray[np.float64]:
    """Fraction of each disk's rim that lies in no other disk.

    A disk of radius b at distance d hides the arc of half angle ``acos((d^2 + a^2 - b^2)/(2 d a))`` of one of
    radius a.
    """
    share = np.ones(len(disks))
    pairs = find_pairs(disks, 0.0)
    i, j = np.concatenate([pairs, pairs[:, ::-1]]).T
    (x, y, a), (u, v, b) = disks[i, :3].T, disks[j, :3].T
    d = np.hypot(x - u, y - v)
    cosine = (d * d + a * a - b * b) / np.maximum(2.0 * d * a, 1e-12)
    np.subtract.at(share, i, np.arccos(np.clip(cosine, -1.0, 1.0)) / np.pi)
    return np.maximum(share, LEAST_VISIBLE_RIM)
