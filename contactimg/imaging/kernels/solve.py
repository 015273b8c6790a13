"""The coupled normal equations of disks that share pixels."""

import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit


@njit(cache=True)
def invert_4x4(matrix, out):
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
def solve_coupled(inverse, gradient, moving, pairs, blocks):
    """Steps of the disks that move: the coupled normal equations, by block Gauss-Seidel.

    The sweeps start at the uncoupled steps and converge for a positive definite matrix. It may not be
    positive definite where many disks describe something that is not a disk: where the sweeps diverge, the
    uncoupled steps are returned.
    """
    n = len(gradient)
    alone = np.zeros((n, 4))
    for i in range(n):
        if moving[i]:
            for u in range(4):
                for v in range(4):
                    alone[i, u] += inverse[i, u, v] * gradient[i, v]
    start, link = _list_neighbours(n, pairs)
    steps, first, largest = alone.copy(), np.inf, 0.0
    for sweep in range(40):  # accuracy: it stops at 1e-4 px
        largest = 0.0
        for i in range(n):
            if moving[i] and start[i] < start[i + 1]:
                change = _solve_one(i, inverse, gradient, start[i], start[i + 1], link, blocks, steps)
                largest = max(largest, change)
        first = largest if sweep == 0 else first
        if not largest >= 1e-4:
            break
    return steps if largest <= first and np.isfinite(steps).all() else alone


@njit(cache=True)
def _list_neighbours(n, pairs):
    """Neighbours of each disk: start of its list, and rows of (pair, side in the pair, the other disk)."""
    start, link = np.zeros(n + 2, np.int64), np.empty((2 * len(pairs), 3), np.int64)
    for i, j in pairs:
        start[i + 2] += 1
        start[j + 2] += 1
    for i in range(n):
        start[i + 2] += start[i + 1]
    for p in range(len(pairs)):
        for side in range(2):
            at = start[pairs[p, side] + 1]
            link[at, 0], link[at, 1], link[at, 2] = p, side, pairs[p, 1 - side]
            start[pairs[p, side] + 1] += 1
    return start[: n + 1], link


@njit(cache=True)
def _solve_one(i, inverse, gradient, first, end, link, blocks, steps):
    """Solve for the step of one disk, given those of its neighbours; the largest change of a length."""
    largest = 0.0
    for u in range(4):
        value = 0.0
        for v in range(4):
            rest = gradient[i, v]
            for q in range(first, end):
                p, other = link[q, 0], link[q, 2]
                for w in range(4):
                    b = blocks[p, v, w] if link[q, 1] == 0 else blocks[p, w, v]
                    rest -= b * steps[other, w]
            value += inverse[i, u, v] * rest
        if u < 3:
            largest = max(largest, abs(value - steps[i, u]))
        steps[i, u] = value
    return largest


@njit(cache=True)
def take_steps(disks, steps, moving, s, prior, largest, least):
    """Move disks by a step within limits.

    ``prior`` holds the mean and the upper bound of each contrast, ``largest`` the upper bounds of the radii,
    ``least`` the smallest radius in blur widths and the smallest contrast over its mean.
    """
    for i in range(len(disks)):
        if moving[i]:
            a = disks[i, 2]
            limit, wider = 0.5 * max(a, s), max(0.4 * a, 0.5 * s)
            disks[i, 0] += min(max(steps[i, 0], -limit), limit)
            disks[i, 1] += min(max(steps[i, 1], -limit), limit)
            radius = a + min(max(steps[i, 2], -0.4 * a), wider)
            disks[i, 2] = min(max(radius, least[0] * s), largest[i])
            contrast = max(disks[i, 3] + steps[i, 3], least[1] * prior[0, i])
            disks[i, 3] = min(contrast, prior[2, i])


def marginal_variances(
    normals: NDArray[np.float64], inverse: NDArray[np.float64], pairs: NDArray[np.int64],
    blocks: NDArray[np.float64], moved: NDArray[np.bool_],
) -> NDArray[np.float64]:  # fmt: skip
    """Variances of each disk's parameters, marginalised over its direct neighbours.

    From the Schur complement over the neighbours that moved, each taken as independent of the others.
    """
    out = np.einsum("iuu->iu", inverse).copy()
    chosen = moved[pairs].all(axis=1)
    (i, j), b = pairs[chosen].T, blocks[chosen]
    coupled = np.unique(pairs[chosen])
    if not len(coupled):
        return out
    reduced, transposed = normals.copy(), b.transpose(0, 2, 1)
    np.subtract.at(reduced, i, b @ inverse[j] @ transposed)
    np.subtract.at(reduced, j, transposed @ inverse[i] @ b)
    alone = out[coupled]
    # without information from pixels, only the damping of the inverse keeps the matrix regular
    reduced = reduced[coupled] + 1e-9 / alone[:, None, :] * np.eye(4)
    full = np.einsum("iuu->iu", np.linalg.inv(reduced))
    most = 25.0 * alone  # by hand: beyond, the two are not resolved
    out[coupled] = np.where(full <= 0, most, np.clip(full, alone, most))
    return out
