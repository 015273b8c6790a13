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
from contactimg.models import convergence
from contactimg.models.asperity_laws import LAWS, AdhesiveLaw, Caps
from contactimg.models.conditions import ContactConditions
from contactimg.models.coupling import DenseCoupling, Kernel
from contactimg.models.dense_balance import Balance, BalanceEquations
from contactimg.models.interacting import check_layer, check_start, solve_interacting
from contactimg.models.scaled_problem import ScaledProblem, check_choice, scale_problem
from contactimg.models.solution import InteractingSolution
from contactimg.surfaces import check_asperities

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


@convergence.refuse_beyond_floats
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
    >>> closed = jkr.radius(0.0, sphere_radius=1e-4, contact_modulus=4e6, work_of_adhesion=0.05)
    >>> round(float(solution.radius[0] / closed), 9)
    1.0
    """
    w = float(work_of_adhesion)
    if not (np.isfinite(w) and w > 0):
        raise InputError(
            f"work_of_adhesion must be positive, got {work_of_adhesion!r} J/m^2; "
            "use solve_interacting without adhesion"
        )
    convergence.check_range("work_of_adhesion", w, convergence.ADHESION_RANGE_J_M2, "J/m^2")
    check_choice("coupling", coupling, COUPLINGS)
    check_choice("law", law, LAWS)
    conditions = ContactConditions(
        indenter_radius, float(contact_modulus), apex, float(thickness), load, indentation, poisson_ratio
    )
    conditions.check()
    asperities = check_asperities(asperities)
    if not len(asperities):
        raise InputError("the asperity table is empty: no asperity can adhere")
    check_start(start, len(asperities))
    # the unit of height: the depth under the load without adhesion, that prescribed, or that of adhesion
    radius, E = float(np.median(asperities["radius_m"])), conditions.contact_modulus
    hertz = (0.75 * abs(load or 0.0) / E / np.sqrt(radius)) ** (2 / 3)
    unit = float(max(hertz, abs(indentation or 0.0), np.cbrt(radius * (w / E) ** 2)))
    problem = scale_problem(asperities, conditions, depth=unit)
    first = start is None or not start.radius.any()  # without contacts nothing is held
    if start is None or first:  # contacts without adhesion are the least that first loading brings about
        start = solve_interacting(
            asperities,
            indenter_radius=indenter_radius,
            contact_modulus=conditions.contact_modulus,
            load=None if load is None else max(load, 0.0),
            indentation=indentation,
            apex=apex,
            coupling=coupling,
            law=law,
            thickness=conditions.thickness,
            poisson_ratio=poisson_ratio,
        )
    coupled, layer = coupling != "none", conditions.thickness / problem.length
    aspect = problem.depth / problem.length if law == "sphere" else 0.0
    support = layer if coupled else np.inf  # independent contacts have no neighbours to share it with
    adhesion = w * problem.length / (contact_modulus * problem.depth**2)
    contact = AdhesiveLaw(adhesion, aspect, support, poisson_ratio)
    kernel = Kernel.of_thickness(layer, poisson_ratio, between=True) if coupled else None
    path = AdhesivePath(problem, contact, kernel, tolerance, max_iterations)
    state, steps = path.follow(start, first=first)
    how: dict[str, Any] = {"coupling": coupling, "iterations": steps, "residual": state.balance.residual}
    force, contact_radius = np.zeros((2, problem.order.size))
    force[state.rows], contact_radius[state.rows] = state.balance.force, state.balance.variable
    solution = problem.record(force, contact_radius, state.penetration, state.balance.indentation, **how)
    check_layer(solution.radius, conditions.thickness)
    return replace(solution, status=path.prove(solution, state))


def solve_adhesive_path(
    asperities: pd.DataFrame, *, loads: Iterable[float], **options: Any
) -> Iterator[InteractingSolution]:
    """Load and unload: one solution per load, in order, with contacts persisting from load to load.

    Parameters
    ----------
    asperities : DataFrame
    loads : iterable of float, N
        Up and down, in steps so small that half of them lead to the same contacts; a pull is negative.
    **options
        Keywords of `solve_adhesive` that hold for every load: ``indenter_radius``, ``contact_modulus``,
        ``work_of_adhesion`` and any other.

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
        previous = solve_adhesive(asperities, load=float(load), start=previous, **options)
        yield previous


@dataclass(frozen=True, eq=False)
class TouchingCaps:
    """The law of some contacts in their radii, as `contactimg.models.dense_balance.ContactLaw`."""

    law: AdhesiveLaw
    caps: Caps

    def response(self, contact_radius: Values) -> tuple[Values, Values]:
        """Penetrations and forces."""
        law = self.law
        return law.penetration(contact_radius, self.caps), law.force(contact_radius, self.caps)

    def slopes(self, contact_radius: Values) -> tuple[Values, Values]:
        """Their derivatives."""
        stiffness, softness = self.law.slopes(contact_radius, self.caps)
        # at the fold the softness vanishes; a lower bound keeps the matrix of an uncoupled row regular
        return np.maximum(softness, 1e-9 * contact_radius / self.caps.radius), stiffness


@dataclass(frozen=True, eq=False)
class AdhesiveState:
    """A set of contacts in equilibrium, and the penetrations of all asperities.

    Parameters
    ----------
    rows : ndarray of int
        Of the contacts, from the highest down.
    equations : BalanceEquations
    balance : Balance
        Its variables are the contact radii.
    penetration : ndarray
        JKR's in contact, the overlap of the surfaces elsewhere.
    """

    rows: Rows
    equations: BalanceEquations
    balance: Balance
    penetration: Values


@dataclass(frozen=True, eq=False)
class AdhesivePath:
    """One problem of a path; without a kernel the contacts are independent."""

    problem: ScaledProblem
    law: AdhesiveLaw
    kernel: Kernel | None
    tolerance: float
    max_iterations: int

    def follow(self, previous: InteractingSolution, *, first: bool) -> tuple[AdhesiveState, int]:
        """Let contacts break and form until the set is in equilibrium.

        First loading starts with the highest asperity in contact at prescribed load, and with the asperities
        that the indenter reaches at prescribed indentation. Newton's method solves for one set of contacts
        after the other.
        """
        p = self.problem
        guess, depth = previous.radius[p.order] / p.length, previous.indentation / p.depth
        if first and not guess.any() and (p.load is not None or p.indentation >= 0):
            guess[0] = self.law.touch_radius(p.caps[:1])[0]
        rows, steps, broken = np.flatnonzero(guess), 0, np.zeros(guess.size, dtype=bool)
        while rows.size:
            if first:
                guess[rows] = np.maximum(guess[rows], self.law.touch_radius(p.caps[rows]))
            equations = self._equations(rows)
            at = equations.at(guess[rows], p.indentation if p.load is None else depth)
            most = self.max_iterations
            balance, taken = equations.solve(at, tolerance=self.tolerance, most_steps=most)
            steps += taken
            if steps > MAX_TOTAL_STEPS:
                raise ConvergenceError(
                    f"no contacts were found in equilibrium in {MAX_TOTAL_STEPS} Newton steps; approach "
                    "the load in smaller steps"
                )
            if balance.residual > self.tolerance:  # no equilibrium: the contact closest to its fold breaks
                self._refuse_engulfed(rows, equations, balance)
                weakest = rows[np.argmin(balance.variable / self.law.fold(p.caps[rows]))]
                broken[weakest] = True
                rows = rows[rows != weakest]
                continue
            penetration = balance.indentation - p.gap
            near = np.flatnonzero(penetration > 0)
            if self.kernel is not None:
                p.part(np.union1d(near, rows)).refuse_duplicates()
            penetration[near] = self._overlaps(near, rows, balance)
            penetration[rows] = self.law.penetration(balance.variable, p.caps[rows])
            state = AdhesiveState(rows, equations, balance, penetration)
            forming = (state.penetration > 0) & ~broken
            forming[rows] = False
            if not forming.any():
                return state, steps
            guess, depth, first = np.zeros(guess.size), balance.indentation, False
            guess[rows] = balance.variable
            guess[forming] = self.law.touch_radius(p.caps[forming])
            rows = np.flatnonzero(guess)
        return self._parted(), steps

    def _equations(self, rows: Rows) -> BalanceEquations:
        """The equations of a set of contacts, each not smaller than at its fold."""
        if rows.size > MAX_CONTACTS:
            raise ModelRangeError(
                f"{rows.size} adhesive contacts are too many for a dense matrix, at most {MAX_CONTACTS}; "
                "lower the load or take a part of the pattern"
            )
        p, matrix = self.problem, np.zeros((rows.size, rows.size))
        caps = p.caps[rows]
        if self.kernel is not None and rows.size:
            p.part(rows).refuse_duplicates()
            matrix = DenseCoupling(p.x[rows], p.y[rows], self.kernel).matrix
        limits, every = (self.law.fold(caps), self.law.widest(caps)), np.ones(rows.size)
        return BalanceEquations(TouchingCaps(self.law, caps), matrix, p.gap[rows], every, p.load, limits)

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
        none, rows = np.zeros(0), np.zeros(0, dtype=np.intp)
        balance = Balance(none, p.indentation, none, none, 0.0, 0.0)
        return AdhesiveState(rows, self._equations(rows), balance, p.indentation - p.gap)

    def _overlaps(self, places: Rows | slice, rows: Rows, balance: Balance) -> Values:
        """Overlaps of some asperities with the lens as the contacts displace the surface."""
        p = self.problem
        overlap = balance.indentation - p.gap[places]
        if self.kernel is not None and rows.size:
            sources = np.stack([p.x, p.y])[:, rows]
            overlap -= self.kernel.displacement(p.x[places], p.y[places], sources, balance.force)
        return overlap

    def _refuse_engulfed(self, rows: Rows, equations: BalanceEquations, balance: Balance) -> None:
        """Refuse contacts that reach the centre of another one."""
        a, p = balance.variable, self.problem
        reach = np.pi * equations.matrix * np.maximum(a, a[:, None])
        i, j = np.unravel_index(int(np.argmax(reach)), reach.shape)
        if reach[i, j] >= 1:
            first, second = sorted(int(p.order[rows[k]]) for k in (i, j))
            apart = p.length / (np.pi * equations.matrix[i, j])
            raise ModelRangeError(
                f"asperities: rows {first} and {second}, {apart * 1e6:.4g} um apart, are closer than the "
                f"contact radius of {max(a[i], a[j]) * p.length * 1e6:.4g} um; lower the load or merge them"
            )

    def prove(self, solution: InteractingSolution, state: AdhesiveState) -> str:
        """Status of a solution, from what follows of its numbers; an error if they contradict each other."""
        p, rows, load = self.problem, state.rows, self.problem.load or 0.0
        convergence.check_finite(
            {"force": solution.force, "contact radius": solution.radius, "indentation": solution.indentation}
        )
        force = solution.force[p.order[rows]] / p.force_unit
        radius = solution.radius[p.order[rows]] / p.length
        depth = solution.indentation / p.depth - p.gap[rows]
        size = max(float(np.abs(depth).max(initial=0.0)), 1.0)
        total = float(np.sum(np.abs(force) + np.sqrt(8 * np.pi * self.law.adhesion * radius**3)))
        away = 0.0 if p.load is None else abs(float(force.sum()) - load)
        errors = {"sum of the forces": away / (abs(load) or total or 1.0)}
        if rows.size:
            self._refuse_engulfed(rows, state.equations, state.balance)
            penetration, law_force = state.equations.law.response(radius)
            errors["forces at the contact radii"] = float(np.abs(law_force - force).sum()) / total
            error = penetration - depth + state.equations.matrix @ force
            errors["penetrations"] = float(np.abs(error).max()) / size
        unbalanced = errors["sum of the forces"] > convergence.MAX_RELATIVE_ERROR
        below = load != 0 and unbalanced and away <= ROUNDING_FRACTION * total
        if below:
            errors["sum of the forces"] = 0.0
        status = convergence.judge(errors, self.tolerance)
        if below:
            return (
                f"the load of {load * p.force_unit:.6g} N is below the accuracy of the adhesive forces, "
                f"{total * p.force_unit:.3g} N: they sum to the load within {away * p.force_unit:.3g} N"
            )
        overlap = np.delete(self._overlaps(slice(None), rows, state.balance), rows)
        overlap = overlap[overlap > 0] * p.depth
        if overlap.size and float(overlap.max()) > convergence.MAX_RELATIVE_ERROR * size * p.depth:
            return (
                f"{overlap.size} asperities without contact overlap the indenter, by up to "
                f"{float(overlap.max()) * 1e6:.3g} um: their contacts broke on the way to this solution; "
                "approach it in smaller steps"
            )
        return status
