"""Heights corrected until the contacts that displace each other follow the wanted law."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.models.interacting import solve_loads
from contactimg.models.solution import InteractingSolution

logger = logging.getLogger(__name__)

Values = NDArray[np.float64]

LARGEST_STEP = 0.5
"""Largest change of a height in an iteration over the mean indentation of the contacts. Chosen by hand."""

DAMPING, LESS, MORE = 1e-3, 0.5, 4.0
"""Damping of the first step, relative, and its factors after a step that helps and one that does not."""

MOST_STALLED, PROGRESS = 8, 0.9
"""Steps in turn after which it ends, each of which leaves more than this share of the squared residuals.
Chosen with the dampings among six sets, on eight designs: the largest residual is least."""


@dataclass(frozen=True, eq=False)
class Refined:
    """Heights, and how they follow the law.

    Parameters
    ----------
    table : DataFrame
        Asperities.
    solutions : sequence of InteractingSolution
        One a load.
    residual : float
        Largest relative difference of the area from the wanted one.
    iterations : int
    gradient : ndarray, shape (k, n), 1/m
        Relative change of the area at each load per height.
    """

    table: pd.DataFrame
    solutions: Sequence[InteractingSolution]
    residual: float
    iterations: int
    gradient: Values

    @property
    def areas(self) -> Values:
        """Area at each load, m^2."""
        return np.array([solution.area for solution in self.solutions])


def evaluate(table: pd.DataFrame, loads: Values, wanted: Values, how: dict[str, Any]) -> Refined:
    """The law of given heights beside the wanted one; ``how`` are keywords of `solve_loads`."""
    solutions = list(solve_loads(table, loads=loads, indenter_radius=np.inf, **how))
    areas = np.array([solution.area for solution in solutions])
    gradient = np.stack([area_gradient(solution) for solution in solutions])
    return Refined(table, solutions, float(np.abs(areas / wanted - 1).max()), 0, gradient)


def refine(
    table: pd.DataFrame, loads: Values, wanted: Values, *, tolerance: float, max_iterations: int, **how: Any
) -> Refined:
    """Correct the heights until the area at each load is the wanted one, or no step brings it nearer.

    Gauss-Newton steps of least norm, ``dh = -J' (J J' + mu)^-1 r`` with ``r = ln(A/A_wanted)``, damped where
    they fail (Levenberg and Marquardt), since caps come into contact and leave it.
    """
    best, damping, stalled = evaluate(table, loads, wanted, how), DAMPING, 0
    iterations = 0
    while best.residual > tolerance and stalled < MOST_STALLED and iterations < max_iterations:
        iterations += 1
        J, r = best.gradient, np.log(best.areas / wanted)
        square = J @ J.T
        if not square.any():  # equal caps alike: no height changes the area
            break
        damped = square + damping * np.trace(square) / len(r) * np.eye(len(r))
        step = -J.T @ np.linalg.solve(damped, r)
        touching = np.concatenate([one.penetration[one.touching] for one in best.solutions])
        step *= min(1.0, LARGEST_STEP * float(touching.mean()) / float(np.abs(step).max(initial=1e-300)))
        tried = evaluate(table.assign(height_m=best.table["height_m"] + step), loads, wanted, how)
        left = np.sum(np.log(tried.areas / wanted) ** 2) / np.sum(r**2)
        best, damping = (tried, damping * LESS) if left < 1 else (best, damping * MORE)
        logger.info("step %d: the area is off by up to %.2g %%", iterations, 100 * best.residual)
        stalled = 0 if left < PROGRESS else stalled + 1
    return Refined(best.table, best.solutions, best.residual, iterations, best.gradient)


def area_gradient(solution: InteractingSolution) -> Values:
    """Relative change of the area at constant load per height of each cap, 1/m.

    With ``dp = s d delta`` (``s = 2 E* a``) and ``d delta = dD + dh - C dp`` off the diagonal, at constant
    ``sum p``; of Hertz's law and point forces, whatever law and coupling the solution has.

    Examples
    --------
    All caps raised alike change nothing; of two, the one raised bears more, and the area is less:

    >>> two = pd.DataFrame({"x_m": [0.0, 1e-3], "y_m": 0.0, "height_m": [4e-5, 3.9e-5], "radius_m": 1e-4})
    >>> how = {"loads": [1e-3], "indenter_radius": np.inf, "contact_modulus": 4e6}
    >>> gradient = area_gradient(next(solve_loads(two, **how)))
    >>> bool(abs(gradient.sum()) < 1e-9 * abs(gradient[0])), bool(gradient[0] < 0)
    (True, True)
    """
    gradient, rows = np.zeros(len(solution.radius)), solution.touching
    if rows.size == 0:
        return gradient
    E, a = solution.conditions.contact_modulus, solution.radius[rows]
    s, x, y = 2 * E * a, solution.x[rows], solution.y[rows]
    M = np.eye(rows.size)
    if solution.coupling != "none":
        r = np.hypot(x - x[:, None], y - y[:, None])
        np.fill_diagonal(r, np.inf)
        M += s / (np.pi * E * r)
    # d delta = M^-1 (dh + dD): sums over it, weighted for the area and for the load
    R = solution.composite_radius[rows]
    of_area, of_load = np.linalg.solve(M.T, np.stack([np.pi * R, s], axis=1)).T
    gradient[rows] = (of_area - of_load * (of_area.sum() / of_load.sum())) / solution.area
    return gradient
