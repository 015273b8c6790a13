"""Conjugate gradients for the Newton system of contacts: with a stored matrix, or with a function for it.

The system is ``A z = b + s rho``, ``A = I + S C S``, with the rise ``rho`` of the indentation as an unknown
where the load is prescribed: ``s . z + k rho = m``. All iterates meet that condition (constraint
preconditioning), so that a prescribed load takes no second right-hand side; and the displacement that all
contacts share, which belongs to the largest eigenvalue of ``A``, is out of the iteration.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit

Values = NDArray[np.float64]

MAX_CONJUGATE_GRADIENT_STEPS = 200
"""Most steps of one conjugate-gradient solution. Chosen by hand: the matrix is close to the identity."""


class NotPositiveDefinite(ArithmeticError):  # noqa: N818 - a state of the iteration, not a user error
    """The Newton matrix is indefinite because contacts overlap too far."""


@dataclass(frozen=True, eq=False)
class NewtonSystem:
    """The right-hand sides of the Newton system of some contacts, and its border.

    Parameters
    ----------
    scale : ndarray, shape (n,)
        ``s = sqrt(2 a)``.
    side : ndarray, shape (n,)
        ``b``.
    missing : float
        ``m``: by how much the sum of the forces is to rise; 0 at prescribed indentation.
    stiffness : float
        ``k`` of the load cell: 0 at prescribed load, infinite at prescribed indentation.
    """

    scale: Values
    side: Values
    missing: float = 0.0
    stiffness: float = np.inf

    def eliminate(self, from_side: Values, from_scale: Values) -> tuple[Values, float]:
        """The solution from those of ``A z = b`` and of ``A z = s``."""
        if np.isinf(self.stiffness):
            return from_side, 0.0
        rise = self.missing - float(self.scale @ from_side)
        rise /= float(self.scale @ from_scale) + self.stiffness
        return from_side + rise * from_scale, rise


def conjugate_gradients(
    apply: Callable[[Values], Values],
    system: NewtonSystem,
    tolerance: float,
    precondition: Callable[[Values], Values],
) -> tuple[Values, float]:
    """Solve a Newton system with a positive definite matrix: ``z`` and the rise.

    ``tolerance`` is that of the residual, relative to ``b`` and to what the rise adds to it.
    """
    scale, shared = system.scale, precondition(system.scale)
    share = 1 / (system.stiffness + float(scale @ shared))

    def conditioned(residual: Values) -> tuple[Values, float]:
        change = precondition(residual)
        rise = -share * float(scale @ change)
        return change + rise * shared, rise

    rise = system.missing * share
    solution = rise * shared
    residual = system.side + rise * scale - (apply(solution) if rise else 0.0)
    goal = tolerance**2 * float(system.side @ system.side + (rise * scale) @ (rise * scale))
    direction, direction_rise = change, change_rise = conditioned(residual)
    square = float(residual @ change)
    for _ in range(MAX_CONJUGATE_GRADIENT_STEPS):
        remaining = residual + change_rise * scale
        if float(remaining @ remaining) <= goal:
            break
        image = apply(direction) - direction_rise * scale
        curvature = float(direction @ image)
        if curvature <= 0:
            raise NotPositiveDefinite
        step = square / curvature
        solution += step * direction
        rise += step * direction_rise
        residual -= step * image
        change, change_rise = conditioned(residual)
        before, square = square, float(residual @ change)
        direction = change + square / before * direction
        direction_rise = change_rise + square / before * direction_rise
    return solution, rise + change_rise


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def dense_conjugate_gradients(matrix, scale, side, missing, stiffness, tolerance, most_steps):  # type: ignore[no-untyped-def]  # noqa: PLR0917  # pragma: no cover
    """The same with a stored matrix: ``z``, the rise, and whether it has succeeded.

    It has not if a direction of negative curvature is met. Compiled.
    """
    n = side.size
    share = 1.0 / (stiffness + np.sum(scale * scale))
    rise = missing * share
    solution, residual, image = rise * scale, side + rise * scale, np.empty(n)
    goal = tolerance**2 * (np.sum(side * side) + rise * rise * np.sum(scale * scale))
    if rise != 0.0:
        _apply(matrix, solution, image)
        residual -= image
    change_rise = -share * np.sum(scale * residual)
    change = residual + change_rise * scale
    direction, direction_rise = change.copy(), change_rise
    square = np.sum(residual * change)
    for _ in range(most_steps):
        if np.sum(change * change) <= goal:
            return solution, rise + change_rise, True
        _apply(matrix, direction, image)
        image -= direction_rise * scale
        curvature = np.sum(direction * image)
        if curvature <= 0.0:
            return solution, rise, False
        step = square / curvature
        solution += step * direction
        rise += step * direction_rise
        residual -= step * image
        change_rise = -share * np.sum(scale * residual)
        change = residual + change_rise * scale
        before, square = square, np.sum(residual * change)
        direction = change + square / before * direction
        direction_rise = change_rise + square / before * direction_rise
    return solution, rise, False


@njit(cache=True, fastmath={"reassoc", "contract"})
def _apply(matrix, vector, image):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """The image of a vector under the matrix."""
    for i in range(matrix.shape[0]):
        row = matrix[i]
        total = 0.0
        for j in range(row.size):
            total += row[j] * vector[j]
        image[i] = total
