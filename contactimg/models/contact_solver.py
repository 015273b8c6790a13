"""Solve one contact problem: select the candidates, choose their coupling, iterate to convergence.

Candidates are the asperities with ``g < D``, which the indenter would reach if the others did not lower the
surface. At prescribed load ``D`` is unknown: an upper estimate selects the candidates, and if the solution
exceeds it, a larger selection is solved. Most candidates of a large set stay out of contact. A rough
solution, with sums of low accuracy, therefore selects those near contact; the accurate solution is found for
them and then checked on the others.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.errors import ConvergenceError, ModelRangeError
from contactimg.models.asperity_laws import AsperityLaw
from contactimg.models.coupling import Coupling, DenseCoupling, Kernel, NotPositiveDefinite
from contactimg.models.fast_coupling import FastCoupling
from contactimg.models.full_coupling import FieldCorrection
from contactimg.models.newton_iteration import (
    EXACT,
    START_ACCURACY,
    ContactSystem,
    Iterate,
    evaluate_iterate,
    initial_iterate,
    solve_uncoupled,
    take_step,
)
from contactimg.models.scaled_problem import ScaledProblem
from contactimg.models.validity import close_pairs, nearest_neighbours, overlapping, unstable_pair

Values = NDArray[np.float64]

METHODS = ("auto", "dense", "fast")

MAX_DENSE_CANDIDATES = 4000
"""Most candidates for a stored matrix (128 MB). Measured: up to about here Cholesky is faster than fast
sums."""

FEWEST_SUMMED = 3
"""Fewest candidates that fast sums take."""

FIELD_GAIN = 1e-2
"""Residual with point forces below which the field corrections are computed, and the factor by which a Newton
step between two updates of them lowers the residual at least. Chosen by time: the updates leave about as
much; neither affects the converged solution."""

MAX_SELECTIONS = 100
"""Most selections of candidates for one problem. Chosen by hand: each enlarges the previous one."""


SCREENING_RESIDUAL, SCREENING_SUM_ACCURACY = 0.1, 1e-4
"""Residual of a rough solution with point forces, and relative accuracy of its fast sums, which take most of
the time. Chosen by hand; sensitivity not measured."""

SCREENING_GAP_FRACTION = 0.2
"""Asperities with a gap below this fraction of the deepest penetration in the rough solution are kept. The
accurate solution counts an asperity as missed at half of this gap, so that the field corrections, 1e-2 of a
penetration or less, do not matter."""


MAX_OVERLAPPING = 0.5
"""Share of the contacts that may overlap a neighbour in the start of a screened solution. Chosen by time:
beyond, the Newton matrix is close to indefinite, and 12 000 to 50 000 contacts take thousands of sums."""

FIELD_COUPLINGS = ("hertz", "full")
"""Couplings with field corrections, computed for all pairs of a candidate and a contact."""

MIN_SCREENED_CANDIDATES = 100
"""Fewest candidates of a stored matrix that are screened before the field corrections. Chosen by hand: it
affects the time only; below, all terms together take less than a millisecond."""

CLOSE_DIAMETERS = 1.5
"""Candidates within this many diameters of a contact of the rough solution are kept. Chosen: solutions can be
ambiguous only within one diameter, and the radii of the rough solution are good to a tenth."""


@dataclass(frozen=True, eq=False)
class ContactSolver:
    """Selects the candidates of one problem, chooses their coupling and iterates to convergence.

    Parameters
    ----------
    problem : ScaledProblem
    law : AsperityLaw
    kernel : Kernel
    coupling : {"none", "asymptotic", "hertz", "full"}
    method : {"auto", "dense", "fast"}
    tolerance : float
    max_iterations : int
        Newton steps before giving up.
    """

    problem: ScaledProblem
    law: AsperityLaw
    kernel: Kernel
    coupling: str
    method: str
    tolerance: float
    max_iterations: int

    def solve(self, seed: Values | None) -> tuple[ScaledProblem, ContactSystem, Iterate, int]:
        """The candidates, their converged system and iterate, and the number of Newton steps.

        ``seed`` are forces to start from, in the order of the problem.
        """
        separate, alone = self._uncoupled()
        if self.coupling == "none":
            return self.problem, separate, alone, 0
        force, reach, taken = alone.force if seed is None else seed, alone.indentation, 0
        if self.problem.load is not None:
            reach += displacement_under_largest_force(self.problem, alone.force)
        for _ in range(MAX_SELECTIONS):
            count = int(np.searchsorted(self.problem.gap, reach, side="right"))
            candidates = self.problem.part(slice(count))
            candidates.refuse_duplicates()
            found, system, iterate, steps = self._solve_candidates(
                candidates, force[:count], alone.indentation
            )
            taken += steps
            if iterate.indentation <= reach or count == self.problem.gap.size:
                raised = self._reached_by_bulge(count, found, iterate)
                if raised is None:
                    _refuse_ambiguous(found, system, iterate)
                    return found, system, iterate, taken
                reach = raised
            else:
                reach = 1.1 * iterate.indentation
            force = found.scattered(iterate.force)[self.problem.order]
        raise ConvergenceError(
            f"the contacts were not selected in {MAX_SELECTIONS} rounds: the indentation grows from round to "
            "round; lower the load"
        )

    def _reached_by_bulge(self, count: int, found: ScaledProblem, iterate: Iterate) -> float | None:
        """Gap up to which the bulge of a layer reaches asperities beyond the first ``count``; None if none.

        An incompressible layer rises around a contact, so that an asperity with ``g > D`` may touch.
        """
        beyond = self.problem.part(slice(count, None))
        loaded = np.flatnonzero(iterate.force)
        rise = self.kernel.largest_rise() * float(iterate.force.sum()) / np.pi
        near = np.flatnonzero(beyond.gap < iterate.indentation + rise)
        if not rise or not near.size:
            return None
        sources = np.stack([found.x[loaded], found.y[loaded]])
        displacement = self.kernel.displacement(
            beyond.x[near], beyond.y[near], sources, iterate.force[loaded]
        )
        touched = near[iterate.indentation - beyond.gap[near] > displacement]
        return float(beyond.gap[touched].max()) if touched.size else None

    def _solve_candidates(
        self, candidates: ScaledProblem, force: Values, indentation: float
    ) -> tuple[ScaledProblem, ContactSystem, Iterate, int]:
        """Solve with a stored matrix or with fast sums, these and field corrections near contact only."""
        dense, x, y = self._dense(candidates), candidates.x, candidates.y
        rough = DenseCoupling(x, y, self.kernel) if dense else None
        system = self._system(candidates, rough or FastCoupling(x, y, self.kernel, SCREENING_SUM_ACCURACY))
        iterate = initial_iterate(system, force, indentation)
        if not dense:
            _refuse_crowd(candidates, iterate)
        elif self.coupling not in FIELD_COUPLINGS or candidates.gap.size < MIN_SCREENED_CANDIDATES:
            return candidates, *self._converge(candidates, system, iterate, 0)
        system, iterate, steps = self._converge(candidates, system, iterate, 0, rough=True)
        rough_sums, force, penetration = system.coupling, iterate.force, iterate.penetration(system)
        margin = SCREENING_GAP_FRACTION * float(penetration.max())
        margin += 4 * SCREENING_SUM_ACCURACY * float(iterate.displacement.max())
        near = penetration > -margin
        close = close_pairs(candidates.x, candidates.y, CLOSE_DIAMETERS * 2 * iterate.contact_radius)
        near[close[0]] = near[close[1]] = True  # a contact may keep a close neighbour out of contact
        for _ in range(MAX_SELECTIONS):
            part = candidates.part(near)
            kind = DenseCoupling if self._dense(part) else FastCoupling
            system = self._system(part, kind(part.x, part.y, self.kernel))
            displacement = system.coupling.displacement(force[near])
            iterate = evaluate_iterate(system, force[near], iterate.indentation, displacement)
            system, iterate, steps = self._converge(part, system, iterate, steps)
            force = np.zeros_like(force)
            force[near] = iterate.force
            penetration = iterate.indentation - candidates.gap - rough_sums.displacement(force)
            if not np.any(penetration[~near] > -0.5 * margin):
                return part, system, iterate, steps
            near |= penetration > -margin
        raise ConvergenceError(
            f"the contacts were not selected in {MAX_SELECTIONS} rounds: the screening misses contacts every "
            'time; lower the load, or use method "dense"'
        )

    def _uncoupled(self) -> tuple[ContactSystem, Iterate]:
        problem, still = self.problem, np.zeros_like(self.problem.gap)
        system = self._system(problem, Coupling(problem.x, problem.y, self.kernel))
        indentation = self.problem.indentation
        if system.load is not None:
            accuracy = EXACT if self.coupling == "none" else START_ACCURACY
            indentation = solve_uncoupled(system, still, system.load, accuracy=accuracy)
        force = system.response(indentation - system.gap)[0]
        return system, evaluate_iterate(system, force, indentation, still)

    def _system(self, candidates: ScaledProblem, operator: Coupling) -> ContactSystem:
        """The equations of the candidates with their coupling."""
        return ContactSystem(candidates.gap, candidates.caps, self.law, operator, candidates.load)

    def _dense(self, candidates: ScaledProblem) -> bool:
        """Whether to store the coupling matrix of these candidates."""
        count = candidates.gap.size
        return (
            count < FEWEST_SUMMED
            or self.method == "dense"
            or (self.method == "auto" and count <= MAX_DENSE_CANDIDATES)
        )

    def _converge(
        self, problem: ScaledProblem, system: ContactSystem, at: Iterate, taken: int, *, rough: bool = False
    ) -> tuple[ContactSystem, Iterate, int]:
        """Iterate to the tolerance, updating the field corrections between Newton steps where they apply.

        A rough solution has point forces only and the residual `SCREENING_RESIDUAL`.
        """
        refinement, tolerance = None, max(self.tolerance, SCREENING_RESIDUAL if rough else 0.0)
        if self.coupling in FIELD_COUPLINGS and not rough:
            refinement = FieldCorrection(system, problem.x, problem.y, full=self.coupling == "full")
        refined = False
        for steps in range(taken, self.max_iterations + 1):
            if refinement is not None and (refined or at.residual < FIELD_GAIN):
                if not refined:
                    _refuse_ambiguous(problem, system, at)
                system, at = refinement.apply(system, at)
                refined = True
            if at.residual <= tolerance and refined == (refinement is not None):
                return system, at, steps
            wanted = max(tolerance, FIELD_GAIN * at.residual) if refined else tolerance
            following = take_step(system, at, wanted) if steps < self.max_iterations else None
            if following is None:
                break
            at = following
        _refuse_ambiguous(problem, system, at)
        merged = int(np.sum(overlapping(self.problem.x, self.problem.y, self._uncoupled()[1].contact_radius)))
        raise ConvergenceError(
            f"the contact forces did not converge: residual {at.residual:.3g} after {steps} "
            f"Newton steps, tolerance {tolerance:.3g}; "
            + (
                f"{merged} contacts would overlap without coupling, so that the load may lie beyond the model"
                if merged
                else "start from the solution at a smaller load, or allow a larger tolerance"
            )
        )


def displacement_under_largest_force(problem: ScaledProblem, force: Values) -> float:
    """Displacement of a half-space under the largest of several point forces, by the others."""
    top, others = int(np.argmax(force)), np.flatnonzero(force)
    distance = np.hypot(problem.x[others] - problem.x[top], problem.y[others] - problem.y[top])
    apart = distance > 0
    return float(np.sum(force[others[apart]] / distance[apart]) / np.pi)


def _refuse_crowd(problem: ScaledProblem, iterate: Iterate) -> None:
    """Raise `ModelRangeError` if most contacts of a first estimate overlap a neighbour."""
    # Hertz's radii of the forces, which sum to the load; those at the penetrations are not consistent yet
    contact_radius = np.cbrt(0.75 * problem.radius * np.maximum(iterate.force, 0.0))
    rows = np.flatnonzero(contact_radius)
    if rows.size < 2:
        return
    distance, other = nearest_neighbours(problem.x[rows], problem.y[rows])
    spacing = distance / (contact_radius[rows] + contact_radius[rows[other]])
    share = float(np.mean(spacing < 1))
    if share <= MAX_OVERLAPPING:
        return
    # the force goes as the cube of the contact radius
    bearable = float(iterate.force.sum()) * problem.force_unit * float(np.median(spacing)) ** 3
    raise ModelRangeError(
        f"{share:.0%} of {rows.size} contacts would overlap a neighbour (at "
        f"most {MAX_OVERLAPPING:.0%} may): beyond any model of single contacts; lower the load to some "
        f"{bearable:.2g} N or less, or the indentation, and check their units"
    )


def _refuse_ambiguous(problem: ScaledProblem, system: ContactSystem, iterate: Iterate) -> None:
    """Raise `ModelRangeError` if contacts are so close that the equilibrium is unstable or not unique."""
    x, y = problem.x, problem.y
    pairs = close_pairs(x, y, 2 * iterate.contact_radius)
    pair = unstable_pair(pairs, iterate.contact_radius, iterate.penetration(system), iterate.force)
    (i, j, distance), a = pairs, iterate.contact_radius
    closeness = np.where(a[j] > 0, distance / (a[i] + a[j]), np.inf)
    if pair is None and np.any(closeness < 1):
        active = np.flatnonzero(a)
        try:
            system.coupling.check_definite(active, np.sqrt(2 * a[active]))
        except NotPositiveDefinite:
            closest = int(np.argmin(closeness))
            pair = int(i[closest]), int(j[closest])
    if pair is not None:
        first, second = sorted(int(problem.order[row]) for row in pair)
        a = a * problem.length * 1e6
        apart = float(np.hypot(x[pair[0]] - x[pair[1]], y[pair[0]] - y[pair[1]])) * problem.length
        raise ModelRangeError(
            f"asperities: rows {first} and {second}, {apart * 1e6:.4g} um apart, would overlap (contact "
            f"radii {a[pair[0]]:.4g} and {a[pair[1]]:.4g} um) so far that several solutions exist; "
            "lower the load or merge them"
        )
