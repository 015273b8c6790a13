"""Interacting asperities with adhesion: JKR's law for each contact, along loading and unloading.

The problem is not convex: at one load several sets of contacts can be in equilibrium, and the history of
loading selects one. A contact forms where the surfaces touch (``delta = 0``) and breaks where its equilibrium
becomes unstable. The set of contacts is therefore passed on from load to load; for a given set, Newton's
method finds radii and indentation, with a dense, unsymmetric system.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import ConvergenceError, InputError, ModelRangeError
from contactimg.models.asperity_laws import LAWS, AdhesiveLaw
from contactimg.models.conditions import ContactConditions
from contactimg.models.coupling import DenseCoupling, Kernel
from contactimg.models.interacting import check_layer, solve_interacting
from contactimg.models.proof import (
    ADHESION_RANGE_J_M2,
    MAX_RELATIVE_ERROR,
    check_finite,
    check_range,
    judge,
    refuse_beyond_floats,
)
from contactimg.models.scaled_problem import ScaledProblem, check_choice, scale_problem
from contactimg.models.solution import InteractingSolution

Values = NDArray[np.float64]
Rows = NDArray[np.intp]

COUPLINGS = ("none", "asymptotic")

ROUNDING_FRACTION = 1e-11
"""Error of the sum of adhesive forces, relative to the sum of their magnitudes, that counts as rounding.
Theory: the Hertz part and the punch part of a force cancel, and the iteration stops at relative errors of
1e-11."""

MAX_CONTACTS = 10_000
"""Most adhesive contacts. Chosen by memory: their matrices take some 2 GB."""

MAX_TOTAL_STEPS = 5000
"""Most Newton steps for all sets of contacts of one solution. Chosen by time: 300 contacts take about 20
s."""

LOAD_TOLERANCE = 1e-8
"""Relative error of the load to which the iteration continues after the tolerance is met. Chosen: a hundredth
of the error up to which a solution counts as converged."""

MIN_STEP_FRACTION = 2.0**-30
"""Shortest fraction of a Newton step in the line search. Chosen by hand; sensitivity not measured."""


@refuse_beyond_floats
def solve_adhesive(
    asperities: pd.DataFrame,
    *,
    indenter_radius: float,
    contact_modulus: float,
    work_of_adhesion: float,
    load: float | None = None,
    indentation: float | None = None,
    apex: tuple[float, float] = (0.0, 0.0),
    coupling: str = "asymptotic",
    law: str = "hertz",
    thickness: float = np.inf,
    poisson_ratio: float = 0.5,
    start: InteractingSolution | None = None,
    tolerance: float = 1e-11,
    max_iterations: int = 30,
) -> InteractingSolution:
    """Forces and radii of adhesive contacts, from a previous solution or at first loading.

    Parameters
    ----------
    asperities : DataFrame
        Columns ``x_m, y_m, height_m, radius_m``.
    indenter_radius : float, m
    contact_modulus : float, Pa
    work_of_adhesion : float, J/m^2
    load, indentation : float, N or m
        Exactly one of the two. The load may be a pull and the indentation negative while contacts hold.
    apex : (float, float), m
    coupling : {"none", "asymptotic"}
        As in `solve_interacting`; full coupling is that of Hertz's pressure, not of JKR's.
    law : {"hertz", "sphere"}
        Profile of an asperity: the paraboloid of JKR's law, or the exact sphere.
    thickness : float, m
        Of a layer bonded to a rigid support; infinite for a half-space.
    poisson_ratio : float
        Of the layer.
    start : InteractingSolution, optional
        The previous solution: its contacts persist until they break. Without it the surfaces come into
        contact for the first time.
    tolerance : float
        Largest accepted error of a penetration, relative to the largest penetration.
    max_iterations : int
        Most Newton steps for one set of contacts.

    Returns
    -------
    InteractingSolution
        Forces of contacts under tension are negative.

    Raises
    ------
    InputError
        If an argument breaks its rule.
    ModelRangeError
        If the load is a stronger pull than the contacts bear.
    ConvergenceError
        If no set of contacts is found in equilibrium.

    Notes
    -----
    Contacts that have formed persist, so the solution depends on the history: approach a load in the same
    steps as the experiment (`solve_adhesive_path`). Each asperity follows JKR's stable branch under an
    imposed displacement. The equations include the compliance of its neighbours, with which a contact breaks
    earlier. Suitable for some thousand contacts: the Newton system is a dense, unsymmetric matrix.

    References
    ----------
    Johnson, Kendall, Roberts, Proc. R. Soc. A 324 (1971) 301, doi:10.1098/rspa.1971.0141.

    Examples
    --------
    >>> import pandas as pd
    >>> cap = pd.DataFrame({"x_m": [0.0], "y_m": [0.0], "height_m": [4e-5], "radius_m": [1e-4]})
    >>> where = dict(indenter_radius=float("inf"), contact_modulus=4e6, work_of_adhesion=0.05)
    >>> solution = solve_adhesive(cap, load=0.0, **where)
    >>> from contactimg import jkr
    >>> closed = jkr.zero_load_radius(sphere_radius=1e-4, contact_modulus=4e6, work_of_adhesion=0.05)
    >>> round(float(solution.radius[0]) / closed, 9)
    1.0
    """
    w = float(work_of_adhesion)
    if not (np.isfinite(w) and w > 0):
        raise InputError(
            f"work_of_adhesion must be positive, got {work_of_adhesion!r} J/m^2; "
            "use solve_interacting without adhesion"
        )
    check_range("work_of_adhesion", w, ADHESION_RANGE_J_M2, "J/m^2")
    check_choice("coupling", coupling, COUPLINGS)
    check_choice("law", law, LAWS)
    conditions = ContactConditions(
        indenter_radius, float(contact_modulus), apex, float(thickness), load, indentation, poisson_ratio
    )
    conditions.check()
    problem = scale_problem(asperities, conditions, depth=_depth_unit(asperities, conditions, w))
    held = start is not None and bool(start.radius.any())  # without contacts nothing is remembered
    previous = start if start is not None and held else None
    if previous is None:  # the contacts without adhesion are the least that first loading brings about
        previous = solve_interacting(
            asperities,
            indenter_radius=indenter_radius,
            contact_modulus=conditions.contact_modulus,
            load=None if load is None else max(load, 0.0),
            indentation=indentation,
            apex=apex,
            coupling="none" if coupling == "none" else "asymptotic",
            law=law,
            thickness=conditions.thickness,
            poisson_ratio=poisson_ratio,
        )
    aspect = 1.0 if law == "sphere" else 0.0
    # independent contacts have no neighbours to share the support with
    layer = np.inf if coupling == "none" else conditions.thickness
    path = AdhesivePath(
        problem,
        AdhesiveLaw(
            w * problem.length / (contact_modulus * problem.depth**2),
            aspect * problem.depth / problem.length,
            layer / problem.length,
            poisson_ratio,
        ),
        None
        if coupling == "none"
        else Kernel.of_thickness(thickness / problem.length, poisson_ratio, between=True),
        tolerance,
        max_iterations,
    )
    state, steps = path.follow(previous, first=not held)
    solution = problem.record(
        *state.scattered(problem.order.size),
        indentation=state.indentation,
        coupling=coupling,
        iterations=steps,
        residual=state.residual,
    )
    check_layer(solution.radius, float(thickness))
    law_in_si = AdhesiveLaw(w / conditions.contact_modulus, aspect, layer, poisson_ratio)
    status = _status(solution, path, state, law_in_si)
    return replace(solution, status=status)


def solve_adhesive_path(
    asperities: pd.DataFrame,
    *,
    loads: Iterable[float],
    indenter_radius: float,
    contact_modulus: float,
    work_of_adhesion: float,
    **options: Any,
) -> Iterator[InteractingSolution]:
    """Load and unload: one solution per load, in order, with contacts persisting from load to load.

    Parameters
    ----------
    asperities : DataFrame
    loads : iterable of float, N
        Up and down, in steps so small that half of them lead to the same contacts; a pull is negative.
    indenter_radius : float, m
    contact_modulus : float, Pa
    work_of_adhesion : float, J/m^2
    **options
        Further keywords of `solve_adhesive` that hold for every load.

    Yields
    ------
    InteractingSolution

    Examples
    --------
    >>> import pandas as pd
    >>> cap = pd.DataFrame({"x_m": [0.0], "y_m": [0.0], "height_m": [4e-5], "radius_m": [1e-4]})
    >>> where = dict(indenter_radius=float("inf"), contact_modulus=4e6, work_of_adhesion=0.05)
    >>> [round(float(s.radius[0]) * 1e6, 1) for s in solve_adhesive_path(cap, loads=[0, 1e-4, 0], **where)]
    [12.1, 16.8, 12.1]
    """
    previous = None
    for load in loads:
        previous = solve_adhesive(
            asperities,
            indenter_radius=indenter_radius,
            contact_modulus=contact_modulus,
            work_of_adhesion=work_of_adhesion,
            load=float(load),
            start=previous,
            **options,
        )
        yield previous


def _depth_unit(asperities: pd.DataFrame, conditions: ContactConditions, work_of_adhesion: float) -> float:
    """Unit of height, m: the larger of the indentations by load and by adhesion of the median asperity."""
    if not len(asperities):
        raise InputError("the asperity table is empty: no asperity can adhere")
    radius, E = float(np.median(asperities["radius_m"])), conditions.contact_modulus
    hertz = (0.75 * abs(conditions.load or 0.0) / E / np.sqrt(radius)) ** (2 / 3)
    depth = abs(conditions.indentation or 0.0)
    return float(max(hertz, depth, np.cbrt(radius * (work_of_adhesion / E) ** 2)))


def _status(
    solution: InteractingSolution, path: "AdhesivePath", state: "AdhesiveState", law: AdhesiveLaw
) -> str:
    """Status of a solution whose numbers follow from each other, recomputed in SI units; an error if not.

    ``law`` has ``w/E*`` in m and forces over ``E*`` in m^2.
    """
    check_finite(
        {"force": solution.force, "contact radius": solution.radius, "indentation": solution.indentation}
    )
    p, rows, conditions = path.problem, state.rows, solution.conditions
    radius, force = solution.radius[p.order[rows]], solution.force[p.order[rows]]
    depth = solution.indentation - p.depths[rows]
    size = max(float(np.abs(depth).max(initial=0.0)), p.depth)
    punch = np.sqrt(8 * np.pi * law.adhesion * radius**3) * conditions.contact_modulus
    total, borne = float(np.sum(np.abs(force) + punch)), float(force.sum())
    load = conditions.load
    away = abs(borne - (load or 0.0))
    errors = {"sum of the forces": 0.0 if load is None else away / (abs(load) or total or 1.0)}
    if rows.size:
        state.contacts.refuse_engulfed(state.contact_radius)
        caps = p.caps_in_metres(p.caps[rows])
        law_force = law.force(radius, caps) * conditions.contact_modulus
        errors["forces at the contact radii"] = float(np.abs(law_force - force).sum()) / total
        lowered = state.contacts.matrix @ (force / p.force_unit) * p.depth
        errors["penetrations"] = float(np.abs(law.penetration(radius, caps) - depth + lowered).max()) / size
    below = load and errors["sum of the forces"] > MAX_RELATIVE_ERROR and away <= ROUNDING_FRACTION * total
    if below:
        errors["sum of the forces"] = 0.0
    status = judge(errors, path.tolerance)
    if below:
        return (
            f"the load of {load:.6g} N is below the accuracy of the adhesive forces, {total:.3g} N: "
            f"they sum to the load within {away:.3g} N"
        )
    overlap = path.penetration(state.contacts, state.force, state.indentation, np.arange(p.gap.size))
    overlap[rows] = -np.inf
    overlap = overlap[overlap > 0] * p.depth
    if overlap.size and float(overlap.max()) > MAX_RELATIVE_ERROR * size:
        return (
            f"{overlap.size} asperities without contact overlap the indenter, by up to "
            f"{float(overlap.max()) * 1e6:.3g} um: their contacts broke on the way to this solution; "
            "approach it in smaller steps"
        )
    return status


@dataclass(frozen=True, eq=False)
class AdhesiveState:
    """A set of contacts with radii, forces and ``D``, and the penetrations of all asperities."""

    contacts: "AdhesiveContacts"
    contact_radius: Values
    force: Values
    penetration: Values
    indentation: float
    residual: float

    @property
    def rows(self) -> Rows:
        """Rows of the contacts, from the highest down."""
        return self.contacts.rows

    def scattered(self, size: int) -> tuple[Values, Values, Values]:
        """Force, contact radius and penetration of all asperities."""
        force, contact_radius = np.zeros(size), np.zeros(size)
        force[self.rows], contact_radius[self.rows] = self.force, self.contact_radius
        return force, contact_radius, self.penetration


@dataclass(frozen=True, eq=False)
class AdhesivePath:
    """One problem of a path; without a kernel the contacts are independent."""

    problem: ScaledProblem
    law: AdhesiveLaw
    kernel: Kernel | None
    tolerance: float
    max_iterations: int

    def penetration(self, contacts: "AdhesiveContacts", force: Values, depth: float, rows: Rows) -> Values:
        """Overlaps of some asperities with the indenter as the contacts displace the surface."""
        p = self.problem
        overlap = depth - p.gap[rows]
        if self.kernel is not None and contacts.rows.size:
            sources = np.stack([p.x, p.y])[:, contacts.rows]
            overlap -= self.kernel.displacement(p.x[rows], p.y[rows], sources, force)
        return overlap

    def follow(self, previous: InteractingSolution, *, first: bool) -> tuple[AdhesiveState, int]:
        """Let contacts break and form until the set is in equilibrium.

        First loading starts with the highest asperity in contact at prescribed load, and with the asperities
        that the indenter reaches at prescribed indentation.
        """
        p = self.problem
        radius = previous.radius[p.order] / p.length
        reached = p.load is not None or p.indentation >= 0
        if first and not radius.any() and reached:
            radius[0] = self.law.touch_radius(p.caps[:1])[0]
        return self._settle(radius, previous.indentation / p.depth, first=first)

    def _settle(self, guess: Values, depth: float, *, first: bool) -> tuple[AdhesiveState, int]:
        """Newton for one set of contacts after the other, from guessed radii and indentation."""
        p, rows, steps = self.problem, np.flatnonzero(guess), 0
        broken = np.zeros(guess.size, dtype=bool)
        while rows.size:
            if first:
                guess[rows] = np.maximum(guess[rows], self.law.touch_radius(p.caps[rows]))
            state, taken, weakest = self._equilibrium(rows, guess[rows], depth)
            steps += taken
            if steps > MAX_TOTAL_STEPS:
                raise ConvergenceError(
                    f"no contacts were found in equilibrium in {MAX_TOTAL_STEPS} Newton steps; approach "
                    "the load in smaller steps"
                )
            if state is None:
                broken[weakest] = True
                rows = rows[rows != weakest]
                continue
            forming = (state.penetration > 0) & ~broken
            forming[rows] = False
            if not forming.any():
                return state, steps
            guess, depth, first = np.zeros(guess.size), state.indentation, False
            guess[rows] = state.contact_radius
            guess[forming] = self.law.touch_radius(p.caps[forming])
            rows = np.flatnonzero(guess)
        return self._parted(), steps

    def _parted(self) -> AdhesiveState:
        """The state without contacts, after the last one has broken."""
        p = self.problem
        if p.load is not None and p.load > 0:
            raise ConvergenceError(
                f"no contacts were found in equilibrium under the load of {p.load * p.force_unit:.6g} N; "
                "approach it in smaller steps, or start at a higher load"
            )
        if p.load is not None and p.load < 0:
            raise ModelRangeError(
                "load must not be below pull-off: the contacts cannot bear a pull of "
                f"{-p.load * p.force_unit:.6g} N"
            )
        none, depth = np.zeros(0), p.indentation
        contacts = AdhesiveContacts(self, np.zeros(0, dtype=np.intp))
        return AdhesiveState(contacts, none, none, depth - p.gap, depth, 0.0)

    def _equilibrium(self, rows: Rows, a: Values, depth: float) -> tuple[AdhesiveState | None, int, int]:
        """Solve for one set of contacts; if it has no equilibrium, name the contact closest to its fold."""
        if rows.size > MAX_CONTACTS:
            raise ModelRangeError(
                f"{rows.size} adhesive contacts are too many for a dense matrix, at most {MAX_CONTACTS}; "
                "lower the load or take a part of the pattern"
            )
        contacts = AdhesiveContacts(self, rows)
        D = self.problem.indentation if self.problem.load is None else depth
        error, missing = contacts.errors(a, D)
        for steps in range(self.max_iterations + 1):
            residual = contacts.residual(error, missing, D)
            if residual <= self.tolerance and contacts.balanced(a, missing):
                return contacts.state(a, D, residual), steps, -1
            change, rise = contacts.direction(a, error, missing)
            step, merit = 1.0, float(error @ error + missing**2)
            while step > MIN_STEP_FRACTION:
                trial = np.clip(a + step * change, contacts.fold, contacts.widest)
                trial_error, trial_missing = contacts.errors(trial, D + step * rise)
                if float(trial_error @ trial_error + trial_missing**2) < (1 - 1e-4 * step) * merit:
                    break
                step /= 2
            else:
                break
            error, missing = trial_error, trial_missing
            a, D = trial, D + step * rise
        if residual <= self.tolerance:
            return contacts.state(a, D, residual), steps, -1
        contacts.refuse_engulfed(a)
        return None, steps, int(rows[np.argmin(a / contacts.fold)])


class AdhesiveContacts:
    """Equations of a set of contacts in their radii: ``delta(a) + C p(a) + g - D = 0``, ``sum p = P``.

    ``fold`` are the radii at which an isolated contact breaks.
    """

    def __init__(self, path: AdhesivePath, rows: Rows) -> None:
        p = path.problem
        self.path, self.rows, self.caps, self.gap = path, rows, p.caps[rows], p.gap[rows]
        self.fold, self.widest = path.law.fold(self.caps), path.law.widest(self.caps)
        self.matrix = np.zeros((rows.size, rows.size))
        if path.kernel is not None and rows.size:
            p.part(rows).refuse_duplicates()
            self.matrix = DenseCoupling(p.x[rows], p.y[rows], path.kernel).matrix

    def errors(self, a: Values, depth: float) -> tuple[Values, float]:
        """Errors of the penetrations and of the load."""
        penetration = self.path.law.penetration(a, self.caps)
        force, load = self.path.law.force(a, self.caps), self.path.problem.load
        missing = 0.0 if load is None else load - float(force.sum())
        return penetration + self.matrix @ force + self.gap - depth, missing

    def residual(self, error: Values, missing: float, depth: float) -> float:
        """Largest relative error."""
        load = self.path.problem.load
        size = max(1.0, float(np.abs(depth - self.gap).max()))
        return max(float(np.abs(error).max()) / size, abs(missing) / max(1.0, abs(load or 0.0)))

    def refuse_engulfed(self, a: Values) -> None:
        """Refuse contacts that reach the centre of another one."""
        if not a.size or np.pi * float(self.matrix.max()) * float(a.max()) < 1:
            return
        reach = np.pi * self.matrix * np.maximum(a, a[:, None])
        i, j = np.unravel_index(int(np.argmax(reach)), reach.shape)
        if reach[i, j] >= 1:
            p = self.path.problem
            first, second = sorted(int(p.order[self.rows[k]]) for k in (i, j))
            apart = p.length / (np.pi * self.matrix[i, j])
            raise ModelRangeError(
                f"asperities: rows {first} and {second}, {apart * 1e6:.4g} um apart, are closer than the "
                f"contact radius of {max(a[i], a[j]) * p.length * 1e6:.4g} um; lower the load or merge them"
            )

    def balanced(self, a: Values, missing: float) -> bool:
        """Whether the forces sum to the load within `LOAD_TOLERANCE`, or within their rounding errors."""
        load = self.path.problem.load
        if not load or abs(missing) <= LOAD_TOLERANCE * abs(load):
            return True
        rounding = 8 * np.finfo(float).eps * float(np.sum(np.abs(self.path.law.force(a, self.caps))))
        return bool(abs(missing) <= rounding)

    def direction(self, a: Values, error: Values, missing: float) -> tuple[Values, float]:
        """Newton's change of radii and of the indentation."""
        stiffness, softness = self.path.law.slopes(a, self.caps)
        jacobian = self.matrix * stiffness
        # at the fold the softness vanishes; a lower bound keeps the matrix of an uncoupled row regular
        jacobian[np.diag_indices_from(jacobian)] += np.maximum(softness, 1e-9 * a / self.caps.radius)
        back, sink = np.linalg.solve(jacobian, np.column_stack([error, np.ones(a.size)])).T
        if self.path.problem.load is None:
            return -back, 0.0
        rise = float((missing + stiffness @ back) / (stiffness @ sink))
        return rise * sink - back, rise

    def state(self, a: Values, depth: float, residual: float) -> AdhesiveState:
        """The state with all penetrations: JKR's in contact, the overlap of the surfaces elsewhere."""
        path, force = self.path, self.path.law.force(a, self.caps)
        penetration = depth - path.problem.gap
        penetration[self.rows] = 0.0
        near = np.flatnonzero(penetration > 0)
        if path.kernel is not None:
            path.problem.part(np.union1d(near, self.rows)).refuse_duplicates()
        penetration[near] = path.penetration(self, force, depth, near)
        penetration[self.rows] = path.law.penetration(a, self.caps)
        return AdhesiveState(self, a, force, penetration, depth, residual)
