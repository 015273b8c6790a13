"""Disks that share pixels: which pairs they form, and their coupled normal equations (compiled)."""

import numpy as np
from numba import njit

from contactimg.imaging.kernels.pairs import links

INFLATION = (
    25.0  # largest factor that neighbours put on a variance; more means the separation is not determined
)
DIVERGED = 100.0  # times the first change of a sweep


@njit(cache=True)
def invert(matrix, out):
    """Inverse of a symmetric positive definite 4 x 4 matrix (a general library takes ten times as long)."""
    low = np.zeros((4, 4))
    for u in range(4):
        for v in range(u + 1):
            rest = matrix[u, v]
            for k in range(v):
                rest -= low[u, k] * low[v, k]
            low[u, v] = np.sqrt(max(rest, 1e-12 * matrix[u, u])) if u == v else rest / low[v, v]
    inverse = np.zeros((4, 4))
    for v in range(4):
        inverse[v, v] = 1.0 / low[v, v]
        for u in range(v + 1, 4):
            rest = 0.0
            for k in range(v, u):
                rest -= low[u, k] * inverse[k, v]
            inverse[u, v] = rest / low[u, u]
    for u in range(4):
        for v in range(4):
            total = 0.0
            for k in range(max(u, v), 4):
                total += inverse[k, u] * inverse[k, v]
            out[u, v] = total


@njit(cache=True)
def relax(inverse, right, moving, pairs, blocks, steps, sweeps):
    """Solve the coupled normal equations by block Gauss-Seidel; ``steps`` starts at the uncoupled solution.

    The matrix is symmetric positive definite, so every sweep comes closer; where many disks describe what is
    none it may not be, and if the sweeps run away the uncoupled solution stays.
    """
    start, link = links(len(right), pairs)
    limit = np.inf
    for sweep in range(sweeps):
        largest = 0.0
        for i in range(len(right)):
            if moving[i] and start[i] < start[i + 1]:
                change = _relax_one(i, inverse, right, link[start[i] : start[i + 1]], blocks, steps)
                largest = max(largest, change)
        if sweep == 0:
            limit = DIVERGED * largest
        if not largest <= limit:
            for i in range(len(right)):
                if moving[i]:
                    steps[i] = inverse[i] @ right[i]
            break
        if largest < 1e-4:
            break


@njit(cache=True)
def _relax_one(i, inverse, right, linked, blocks, steps):
    """Step of one disk given those of its neighbours; the largest change of a length."""
    rest = right[i].copy()
    for q in range(len(linked)):
        p, side, other = linked[q]
        for u in range(4):
            for v in range(4):
                b = blocks[p, u, v] if side == 0 else blocks[p, v, u]
                rest[u] -= b * steps[other, v]
    largest = 0.0
    for u in range(4):
        value = 0.0
        for v in range(4):
            value += inverse[i, u, v] * rest[v]
        if u < 3:
            largest = max(largest, abs(value - steps[i, u]))
        steps[i, u] = value
    return largest


@njit(cache=True)
def variances(normals, inverse, pairs, blocks, moved):
    """Variances of each disk's parameters with its direct neighbours free as well.

    Neighbours held fixed stay fixed. The Schur complement over the neighbours, each taken as independent of
    the others.
    """
    n = len(normals)
    out = np.empty((n, 4))
    reduced = normals.copy()
    coupled = np.zeros(n, np.bool_)
    for p in range(len(pairs)):
        i, j = pairs[p]
        if moved[i] and moved[j]:
            b = blocks[p]
            reduced[i] -= b @ inverse[j] @ b.T
            reduced[j] -= b.T @ inverse[i] @ b
            coupled[i] = coupled[j] = True
    for i in range(n):
        for u in range(4):
            out[i, u] = inverse[i, u, u]
        if not coupled[i]:
            continue
        for u in range(4):  # where no pixel tells, nothing but the damping of the inverse holds the matrix
            reduced[i, u, u] += 1e-9 / inverse[i, u, u]
        full = np.linalg.inv(reduced[i])
        for u in range(4):
            if full[u, u] <= 0:
                out[i, u] *= INFLATION
            else:
                out[i, u] = min(max(full[u, u], out[i, u]), INFLATION * out[i, u])
    return out
