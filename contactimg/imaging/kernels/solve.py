"""The coupled normal equations of disks that share pixels (compiled)."""

import numpy as np

from contactimg.compiled import njit
from contactimg.imaging.kernels.pairs import list_neighbours

LARGEST_INFLATION = 25.0  # of a variance by free neighbours; by hand: beyond, the two are not resolved
DIVERGENCE_RATIO = 100.0  # change over that of the first sweep at which the sweeps diverge; by hand


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
def solve_coupled(inverse, gradient, moving, pairs, blocks, steps, sweeps):
    """Solve the coupled normal equations by block Gauss-Seidel; ``steps`` starts at the uncoupled solution.

    The sweeps converge for a positive definite matrix. It may not be positive definite where many disks
    describe something that is not a disk; if the sweeps diverge, the uncoupled solution is kept.
    """
    start, link = list_neighbours(len(gradient), pairs)
    limit = np.inf
    for sweep in range(sweeps):
        largest = 0.0
        for i in range(len(gradient)):
            if moving[i] and start[i] < start[i + 1]:
                change = _solve_one(i, inverse, gradient, link[start[i] : start[i + 1]], blocks, steps)
                largest = max(largest, change)
        if sweep == 0:
            limit = DIVERGENCE_RATIO * largest
        if not largest <= limit:
            for i in range(len(gradient)):
                if moving[i]:
                    steps[i] = inverse[i] @ gradient[i]
            break
        if largest < 1e-4:
            break


@njit(cache=True)
def _solve_one(i, inverse, gradient, linked, blocks, steps):
    """Solve for the step of one disk, given those of its neighbours; the largest change of a length."""
    rest = gradient[i].copy()
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
def marginal_variances(normals, inverse, pairs, blocks, moved):
    """Variances of each disk's parameters, marginalised over its direct neighbours.

    From the Schur complement over the neighbours that moved, each taken as independent of the others.
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
        for u in range(
            4
        ):  # without information from pixels, only the damping of the inverse keeps the matrix regular
            reduced[i, u, u] += 1e-9 / inverse[i, u, u]
        full = np.linalg.inv(reduced[i])
        for u in range(4):
            if full[u, u] <= 0:
                out[i, u] *= LARGEST_INFLATION
            else:
                out[i, u] = min(max(full[u, u], out[i, u]), LARGEST_INFLATION * out[i, u])
    return out
