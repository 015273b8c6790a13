"""Conjugate gradients for two right-hand sides at once: with a stored matrix, or with a function for it."""

from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray

Values = NDArray[np.float64]

MAX_CONJUGATE_GRADIENT_STEPS = 500
"""Most steps of one conjugate-gradient solution. Chosen by hand: the matrix is close to the identity."""


class NotPositiveDefinite(ArithmeticError):  # noqa: N818 - a state of the iteration, not a user error
    """The Newton matrix is indefinite because contacts overlap too far."""


def conjugate_gradients(
    apply: Callable[[Values], Values],
    sides: Values,
    tolerance: float,
    precondition: Callable[[Values], Values],
) -> Values:
    """Solve a symmetric positive definite system for several columns at once to a relative residual."""
    solution = np.zeros_like(sides)
    residual = sides.copy()
    goal = tolerance**2 * np.sum(residual**2, axis=0)
    going = goal > 0
    conditioned = precondition(residual)
    direction, square = conditioned.copy(), np.sum(residual * conditioned, axis=0)
    for _ in range(MAX_CONJUGATE_GRADIENT_STEPS):
        if not going.any():
            break
        image = apply(direction)
        curvature = np.sum(direction * image, axis=0)
        if np.any(curvature[going] <= 0):
            raise NotPositiveDefinite
        step = np.where(going, square / np.where(going, curvature, 1.0), 0.0)
        solution += step * direction
        residual -= step * image
        going = going & (np.sum(residual**2, axis=0) > goal)
        conditioned = precondition(residual)
        before, square = square, np.sum(residual * conditioned, axis=0)
        direction = np.where(going, conditioned + square / np.where(going, before, 1.0) * direction, 0.0)
    return solution


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def dense_conjugate_gradients(matrix, sides, tolerance, most_steps):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The same with a stored matrix, and whether it has succeeded: no direction of negative curvature met.

    Compiled: the matrix is read once a step for both columns.
    """
    n = matrix.shape[0]
    solution, residual = np.zeros((2, n)), np.ascontiguousarray(sides.T)
    direction, image = residual.copy(), np.empty((2, n))
    square = np.array([np.sum(residual[0] ** 2), np.sum(residual[1] ** 2)])
    goal = tolerance**2 * square
    for _ in range(most_steps):
        if square[0] <= goal[0] and square[1] <= goal[1]:
            return solution.T, True
        _apply(matrix, direction, image)
        for k in range(2):
            if square[k] <= goal[k]:
                continue
            curvature = np.sum(direction[k] * image[k])
            if curvature <= 0.0:
                return solution.T, False
            step = square[k] / curvature
            solution[k] += step * direction[k]
            residual[k] -= step * image[k]
            before, square[k] = square[k], np.sum(residual[k] ** 2)
            direction[k] = residual[k] + square[k] / before * direction[k]
    return solution.T, False


@njit(cache=True, fastmath={"reassoc", "contract"})
def _apply(matrix, vectors, image):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Both images under the matrix."""
    first, second = vectors[0], vectors[1]
    for i in range(matrix.shape[0]):
        row = matrix[i]
        a, b = 0.0, 0.0
        for j in range(row.size):
            a += row[j] * first[j]
            b += row[j] * second[j]
        image[0, i], image[1, i] = a, b
