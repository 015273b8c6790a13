"""The solver of one contact problem: which asperities are candidates, how they are coupled, Newton on them.

Candidates are the asperities that the indenter would reach if the others did not lower the surface,
``g < D``. At prescribed load ``D`` is not known beforehand: an upper estimate selects them, and if the
solution exceeds it, the next larger selection is solved.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.errors import ConvergenceError, ModelRangeError
from contactimg.models.coupling import Coupling, DenseCoupling, Kernel, NoCoupling, NotPositiveDefinite
from contactimg.models.fast_sum import FastCoupling
from contactimg.models.local_laws import LocalLaw
from contactimg.models.newton import Iterate, System, initial_iterate, measure, solve_uncoupled, take_step
from contactimg.models.problem import Problem
from contactimg.models.refinement import Refinement
from contactimg.models.validity import Pairs, close_pairs, overlapping, unstable_pair

__all__ = ["METHODS", "CandidateSolver"]

Values = NDArray[np.float64]

METHODS = ("auto", "dense", "fast")

DENSE_LIMIT = 4000
"""Candidates up to which a stored matrix (128 MB) and Cholesky are faster than the fast sum."""

REFINE_BELOW = 1e-2
"""Residual with point forces from which on the refined fields are worth computing."""


@dataclass(frozen=True, eq=False)
class CandidateSolver:
    """Solves one problem.

    Parameters
    ----------
    problem : Problem
    law : LocalLaw
    kernel : Kernel
    coupling : {"none", "asymptotic", "hertz", "full"}
    method : {"auto", "dense", "fast"}
    """

    problem: Problem
    law: LocalLaw
    kernel: Kernel
    coupling: str
    method: str

    def solve(
        self, seed: Values | None, *, tolerance: float, max_iterations: int
    ) -> tuple[System, Iterate, int]:
        """The converged system and state, and the Newton steps it took; ``seed`` are forces to start from."""
        alone = self._uncoupled()
        if self.coupling == "none":
            return self._system(self.problem.gap.size, NoCoupling()), alone, 0
        force, reach, taken = alone.force if seed is None else seed, self._reach(alone), 0
        while True:
            count = int(np.searchsorted(self.problem.gap, reach, side="right"))
            system = self._system(count, self._operator(count))
            iterate = initial_iterate(system, force[:count], alone.indentation)
            system, iterate, steps = self._converge(system, iterate, tolerance, max_iterations)
            taken += steps
            if iterate.indentation <= reach or count == self.problem.gap.size:
                self._refuse_ambiguous(system, iterate)
                return system, iterate, taken
            force, reach = self.problem.padded(iterate.force), 1.1 * iterate.indentation

    def _uncoupled(self) -> Iterate:
        """Independent contacts."""
        still = np.zeros_like(self.problem.gap)
        system = self._system(still.size, NoCoupling())
        indentation = self.problem.indentation
        if system.load is not None:
            indentation = solve_uncoupled(system, still, system.load)
        return measure(system, system.response(indentation - system.gap)[0], indentation, still)

    def _system(self, count: int, operator: Coupling) -> System:
        """The first candidates and their coupling."""
        p = self.problem
        return System(p.gap[:count], p.radius[:count], self.law, operator, p.load)

    def _reach(self, alone: Iterate) -> float:
        """Upper estimate of the indentation: the uncoupled forces lower the surface under the largest one."""
        if self.problem.load is None:
            return alone.indentation
        top = int(np.argmax(alone.force))
        others = np.flatnonzero(alone.force)
        others = others[others != top]
        x, y = self.problem.x, self.problem.y
        distance = np.hypot(x[others] - x[top], y[others] - y[top])
        apart = distance > 0
        return alone.indentation + float(np.sum(alone.force[others[apart]] / distance[apart]) / np.pi)

    def _operator(self, count: int) -> Coupling:
        """Dense or fast coupling of the first candidates, once no two stand in the same place."""
        duplicates = self.problem.duplicates(count)
        if duplicates is not None:
            raise ModelRangeError(
                f"asperities: rows {duplicates[0]} and {duplicates[1]} stand in the same place: coupled, "
                "either of them could bear the force; remove one"
            )
        dense = self.method == "dense" or (self.method == "auto" and count <= DENSE_LIMIT)
        kind = DenseCoupling if dense or count < 3 else FastCoupling
        return kind(self.problem.x[:count], self.problem.y[:count], self.kernel)

    def _converge(
        self, system: System, iterate: Iterate, tolerance: float, max_iterations: int
    ) -> tuple[System, Iterate, int]:
        """Newton steps, refining the fields between them where the level of coupling asks for it."""
        refinement, count = None, system.gap.size
        x, y = self.problem.x[:count], self.problem.y[:count]
        if self.coupling in ("hertz", "full"):
            refinement = Refinement(system, x, y, full=self.coupling == "full")
        refined = False
        for steps in range(max_iterations + 1):
            if refinement is not None and (refined or iterate.residual < REFINE_BELOW):
                if not refined:
                    self._refuse_ambiguous(system, iterate)
                system, iterate = refinement.apply(system, iterate)
                refined = True
            if iterate.residual <= tolerance and refined == (refinement is not None):
                return system, iterate, steps
            following = take_step(system, iterate) if steps < max_iterations else None
            if following is None:
                break
            iterate = following
        self._refuse_ambiguous(system, iterate)
        merged = int(np.sum(overlapping(x, y, self._uncoupled().contact_radius[:count])))
        raise ConvergenceError(
            f"the contact forces did not converge: residual {iterate.residual:.3g} after {steps} "
            f"Newton steps, tolerance {tolerance:.3g}; "
            + (
                f"{merged} contacts would overlap without coupling, so that the load may lie beyond the model"
                if merged
                else "start from the solution at a smaller load, or allow a larger tolerance"
            )
        )

    def _refuse_ambiguous(self, system: System, iterate: Iterate) -> None:
        """`ModelRangeError` if contacts are so close that the equilibrium is unstable or not the only one."""
        x, y = self.problem.x[: system.gap.size], self.problem.y[: system.gap.size]
        pairs = close_pairs(x, y, 2 * iterate.contact_radius)
        pair = unstable_pair(pairs, iterate.contact_radius, iterate.penetration(system), iterate.force)
        if pair is None:
            pair = _indefinite_pair(system, iterate, pairs)
        if pair is not None:
            first, second = sorted(int(self.problem.order[row]) for row in pair)
            a = iterate.contact_radius * self.problem.length * 1e6
            apart = float(np.hypot(x[pair[0]] - x[pair[1]], y[pair[0]] - y[pair[1]])) * self.problem.length
            raise ModelRangeError(
                f"asperities: rows {first} and {second}, {apart * 1e6:.4g} um apart, would overlap (contact "
                f"radii {a[pair[0]]:.4g} and {a[pair[1]]:.4g} um) so far that several solutions exist; "
                "lower the load or merge them"
            )


def _indefinite_pair(system: System, iterate: Iterate, pairs: Pairs) -> tuple[int, int] | None:
    """The closest overlapping pair if contacts overlap and their joint Newton matrix is indefinite."""
    i, j, distance = pairs
    a = iterate.contact_radius
    closeness = np.where(a[j] > 0, distance / (a[i] + a[j]), np.inf)
    if not np.any(closeness < 1):
        return None
    active = np.flatnonzero(a)
    scale = np.sqrt(2 * a[active])
    try:
        system.coupling.newton(active, scale, np.column_stack([scale, scale]), 1e-3)
    except NotPositiveDefinite:
        closest = int(np.argmin(closeness))
        return int(i[closest]), int(j[closest])
    return None
