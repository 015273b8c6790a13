"""Newton's method for contacts that a stored matrix couples, in one variable each and the depth they share.

The variable of a contact is its radius (adhesion) or its depth (a ring of many asperities), from which its
penetration ``delta`` and its force ``p`` follow. The equations are

    delta(x) + C p(x) + g - D = 0    and, at prescribed load,    v p(x) = P,

with ``v`` what a force counts in the load. The matrix of Newton's system is dense and unsymmetric.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contactimg.models.convergence import MAX_RELATIVE_ERROR
from contactimg.models.newton_iteration import STEP_FRACTIONS

Values = NDArray[np.float64]


class ContactLaw(Protocol):
    """The quantities of each contact that the equations need."""

    def response(self, variable: Values) -> tuple[Values, Values]:
        """Penetrations and forces."""

    def slopes(self, variable: Values) -> tuple[Values, Values]:
        """Their derivatives."""


@dataclass(frozen=True, eq=False)
class Balance:
    """A state of the iteration, with the errors of its equations.

    Parameters
    ----------
    variable : ndarray
    indentation : float
        ``D``.
    force, error : ndarray
    missing : float
        Load that the forces lack.
    residual : float
        Largest relative error.
    """

    variable: Values
    indentation: float
    force: Values
    error: Values
    missing: float
    residual: float

    @property
    def merit(self) -> float:
        """Sum of the squares of all errors."""
        return float(self.error @ self.error + self.missing**2)


@dataclass(frozen=True, eq=False)
class BalanceEquations:
    """The equations of some contacts.

    Parameters
    ----------
    law : ContactLaw
    matrix : ndarray, shape (n, n)
        ``C``.
    gap : ndarray, shape (n,)
    weights : ndarray, shape (n,)
        ``v``.
    load : float or None
        None at prescribed indentation.
    limits : (ndarray, ndarray) or None
        Least and largest variables.
    """

    law: ContactLaw
    matrix: Values
    gap: Values
    weights: Values
    load: float | None
    limits: tuple[Values, Values] | None = None

    def at(self, variable: Values, indentation: float) -> Balance:
        """The state with its errors."""
        if self.limits is not None:
            variable = np.clip(variable, *self.limits)
        penetration, force = self.law.response(variable)
        error = penetration + self.matrix @ force + self.gap - indentation
        missing = 0.0 if self.load is None else self.load - float(self.weights @ force)
        size = max(1.0, float(np.abs(indentation - self.gap).max()))
        residual = max(float(np.abs(error).max()) / size, abs(missing) / max(1.0, abs(self.load or 0.0)))
        return Balance(variable, indentation, force, error, missing, residual)

    def solve(self, state: Balance, *, tolerance: float, most_steps: int) -> tuple[Balance, int]:
        """Newton steps until the errors are small or do not fall any more, and how many were taken."""
        for steps in range(most_steps + 1):
            rounding = 8 * np.finfo(float).eps * float(self.weights @ np.abs(state.force))
            allowed = np.inf if not self.load else max(0.01 * MAX_RELATIVE_ERROR * abs(self.load), rounding)
            if steps == most_steps or (state.residual <= tolerance and abs(state.missing) <= allowed):
                break
            change, rise = self.direction(state)
            for step in STEP_FRACTIONS:
                trial = self.at(state.variable + step * change, state.indentation + step * rise)
                if trial.merit < (1 - 1e-4 * step) * state.merit:
                    break
            else:
                break
            state = trial
        return state, steps

    def direction(self, state: Balance) -> tuple[Values, float]:
        """Newton's change of the variables and of the indentation."""
        softness, stiffness = self.law.slopes(state.variable)
        jacobian = self.matrix * stiffness
        jacobian[np.diag_indices_from(jacobian)] += softness
        sides = np.column_stack([state.error, np.ones(state.error.size)])
        back, sink = np.linalg.solve(jacobian, sides).T
        if self.load is None:
            return -back, 0.0
        loading = self.weights * stiffness
        rise = float((state.missing + loading @ back) / (loading @ sink))
        return rise * sink - back, rise
