"""Which disks share pixels: pairs whose rims come close (compiled)."""

import numpy as np

from contactimg.compiled import njit


@njit(cache=True)
def find_pairs(disks, space):
    """Pairs of disks whose rims come closer than ``2 space``, by a sweep along x."""
    n = len(disks)
    left = disks[:, 0] - disks[:, 2] - space
    order = np.argsort(left)
    capacity = 4 * n + 16
    pairs = np.empty((capacity, 2), np.int64)
    count = 0
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
            if count == capacity:
                grown = np.empty((2 * capacity, 2), np.int64)
                grown[:capacity] = pairs
                pairs, capacity = grown, 2 * capacity
            pairs[count, 0], pairs[count, 1] = min(i, j), max(i, j)
            count += 1
    return pairs[:count]


@njit(cache=True)
def select_close(pairs, disks, space):
    """The pairs whose rims come closer than ``2 space``."""
    near = np.zeros(len(pairs), np.bool_)
    for p in range(len(pairs)):
        one, two = disks[pairs[p, 0]], disks[pairs[p, 1]]
        limit = one[2] + two[2] + 2 * space
        near[p] = (one[0] - two[0]) ** 2 + (one[1] - two[1]) ** 2 <= limit * limit
    return pairs[near]


@njit(cache=True)
def list_neighbours(n, pairs):
    """Neighbours of each disk: start of its list, and rows of (pair, side in the pair, the other disk)."""
    start = np.zeros(n + 1, np.int64)
    for p in range(len(pairs)):
        start[pairs[p, 0] + 1] += 1
        start[pairs[p, 1] + 1] += 1
    start = np.cumsum(start)
    fill = start[:-1].copy()
    link = np.empty((2 * len(pairs), 3), np.int64)
    for p in range(len(pairs)):
        for side in range(2):
            i = pairs[p, side]
            link[fill[i]] = p, side, pairs[p, 1 - side]
            fill[i] += 1
    return start, link
