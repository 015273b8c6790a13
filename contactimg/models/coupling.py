"""What contacts do to each other: displacement of the surface at every candidate by the forces on all.

Dimensionless throughout (``E* = 1``): a force ``q_j`` lowers the surface at a distance ``r`` by
``q_j/(pi r)``. An operator offers the product with a vector of forces and the solution of the Newton system
``(I + S C S) z = b`` on the active rows, ``S`` the diagonal of ``s = sqrt(2 a)``.
"""

from typing import Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import lapack

__all__ = ["Coupling", "DenseCoupling", "NoCoupling", "NotPositiveDefinite"]

Values = NDArray[np.float64]
Rows = NDArray[np.intp]


class NotPositiveDefinite(ArithmeticError):  # noqa: N818 - a state of the iteration, not an error of the user
    """The Newton matrix is indefinite: some contacts overlap too far."""


class Coupling(Protocol):
    """Displacement of the surface at the candidates by the forces on the candidates."""

    def displacement(self, force: Values) -> Values:
        """``C q``: displacement into the body at every candidate."""

    def newton(self, active: Rows, scale: Values, sides: Values) -> Values:
        """Solve ``(I + S C S) z = b`` on the active rows for the columns of ``sides``."""


class NoCoupling:
    """Independent contacts."""

    def displacement(self, force: Values) -> Values:
        """Nothing moves."""
        return np.zeros_like(force)

    def newton(self, active: Rows, scale: Values, sides: Values) -> Values:
        """The identity."""
        return sides


class DenseCoupling:
    """A stored matrix and its Cholesky factor: up to some thousand candidates.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        Candidates; no two may coincide.
    self_displacement : float
        What a unit force on a candidate adds to the displacement there beyond its own contact law (layer).
    """

    def __init__(self, x: Values, y: Values, self_displacement: float = 0.0) -> None:
        self.matrix = point_kernel(x, y, self_displacement)

    def displacement(self, force: Values) -> Values:
        """``C q``, over the candidates that carry a force."""
        loaded = np.flatnonzero(force)
        if 2 * loaded.size < force.size:
            return self.matrix[loaded].T @ force[loaded]
        return self.matrix @ force

    def newton(self, active: Rows, scale: Values, sides: Values) -> Values:
        """By Cholesky; `NotPositiveDefinite` if the matrix is not."""
        system = newton_matrix(self.matrix, active, scale)
        # the kernel fills the lower triangle in C order, which is the upper one for LAPACK
        factor, failed = lapack.dpotrf(system.T, lower=0, clean=0, overwrite_a=1)
        if failed:
            raise NotPositiveDefinite
        solution, _ = lapack.dpotrs(factor, sides, lower=0)
        return solution


@njit(cache=True)
def point_kernel(x, y, self_displacement):  # pragma: no cover - compiled
    """``C_ij = 1/(pi r_ij)``."""
    n = x.size
    matrix = np.empty((n, n))
    for i in range(n):
        for j in range(i):
            dx, dy = x[i] - x[j], y[i] - y[j]
            value = 1.0 / (np.pi * np.sqrt(dx * dx + dy * dy))
            matrix[i, j] = value
            matrix[j, i] = value
        matrix[i, i] = self_displacement
    return matrix


@njit(cache=True)
def newton_matrix(matrix, active, scale):  # pragma: no cover - compiled
    """Lower triangle of ``I + S C S`` on the active rows."""
    n = active.size
    system = np.empty((n, n))
    for i in range(n):
        row = active[i]
        for j in range(i):
            system[i, j] = scale[i] * matrix[row, active[j]] * scale[j]
        system[i, i] = 1.0 + scale[i] * scale[i] * matrix[row, row]
    return system
