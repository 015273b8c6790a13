"""Interacting asperities with adhesion: JKR's law for each contact, along loading and unloading.

The problem is not convex: at one load several sets of contacts can be in equilibrium, and the history of
loading selects one. A contact forms where the surfaces touch (``delta = 0``) and breaks where its equilibrium
becomes unstable. The set of contacts is therefore passed on from load to load; for a given set, Newton's
method finds radii and indentation.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TypedDict, Unpack

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import ConvergenceError, InputError, ModelRangeError
from contactimg.models.adhesive_asperity_law import AdhesiveLaw
from contactimg.models.adhesive_full_coupling import correct_for_field
from contactimg.models.asperity_laws import LAWS
from contactimg.models.coupling import DenseCoupling, Kernel
from contactimg.models.interacting import solve_interacting
from contactimg.models.scaled_problem import ContactConditions, ScaledProblem, check_choice, scale_problem
from contactimg.models.solution import InteractingSolution

Values = NDArray[np.float64]
Rows = NDArray[np.intp]

COUPLINGS = ("none", "asymptotic", "full")

_MIN_STEP_FRACTION = 2.0**-30
"""Shortest fraction of a Newton step in the line search. Chosen by hand; sensitivity not measured."""

MAX_FIELD_UPDATES = 30
"""Most updates of the field corrections of full coupling. Chosen by hand; sensitivity not measured."""

FIELD_UPDATE_CHANGE = 1e-10
"""Change of the contact radii, relative to the largest, at which the field corrections have converged. Chosen
by hand, close to the tolerance of the radii."""


class AdhesiveOptions(TypedDict, total=False):
    """Keywords of `solve_adhesive` that hold for every load of a series."""

    apex: tuple[float, float]
    coupling: str
    law: str
    thickness: float
    tolerance: float
    max_iterations: int


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
    coupling : {"none", "asymptotic", "full"}
        As in `solve_interacting`.
    law : {"hertz", "sphere"}
        Profile of an asperity: the paraboloid of JKR's law, or the exact sphere.
    thickness : float, m
        Of a layer bonded to a rigid support (Poisson's ratio 1/2); infinite for a half-space.
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
        If the field corrections of full coupling do not converge.

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
    check_choice("coupling", coupling, COUPLINGS)
    check_choice("law", law, LAWS)
    setting = ContactConditions(
        indenter_radius, float(contact_modulus), apex, float(thickness), load, indentation
    )
    setting.check()
    problem = scale_problem(asperities, setting, depth=_depth_unit(asperities, setting, w))
    previous = start if start is not None else _without_adhesion(asperities, setting, coupling, law)
    path = _Path(
        problem,
        AdhesiveLaw(
            w * problem.length / (contact_modulus * problem.depth**2),
            aspect=problem.depth / problem.length if law == "sphere" else 0.0,
        ),
        None if coupling == "none" else Kernel.of_thickness(thickness / problem.length),
        tolerance,
        max_iterations,
    )
    state, steps = path.follow(previous, first=start is None)
    if coupling == "full":
        state, steps = path.refined(state, steps)
    return problem.record(
        *state.scattered(problem.order.size),
        indentation=state.indentation * problem.depth,
        coupling=coupling,
        thickness=float(thickness),
        status="converged",
        iterations=steps,
        residual=state.residual,
    )


def solve_adhesive_path(
    asperities: pd.DataFrame,
    *,
    loads: Iterable[float],
    indenter_radius: float,
    contact_modulus: float,
    work_of_adhesion: float,
    **options: Unpack[AdhesiveOptions],
) -> Iterator[InteractingSolution]:
    """Load and unload: one solution per load, in order, with contacts persisting from load to load.

    Parameters
    ----------
    asperities : DataFrame
    loads : iterable of float, N
        Up and down; a pull is negative.
    indenter_radius : float, m
    contact_modulus : float, Pa
    work_of_adhesion : float, J/m^2
    **options
        Further keywords of `solve_adhesive`: those of `AdhesiveOptions`.

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


def _depth_unit(asperities: pd.DataFrame, setting: ContactConditions, work_of_adhesion: float) -> float:
    """Unit of height, m: the larger of the indentations by load and by adhesion of the median asperity."""
    if not len(asperities):
        raise InputError("the asperity table is empty: no asperity can adhere")
    radius, E = float(np.median(asperities["radius_m"])), setting.contact_modulus
    hertz = (0.75 * abs(setting.load or 0.0) / E / np.sqrt(radius)) ** (2 / 3)
    return float(max(hertz, abs(setting.indentation or 0.0), np.cbrt(radius * (work_of_adhesion / E) ** 2)))


def _without_adhesion(
    asperities: pd.DataFrame, setting: ContactConditions, coupling: str, law: str
) -> InteractingSolution:
    """The solution without adhesion, whose contacts are the least that first loading brings about."""
    return solve_interacting(
        asperities,
        indenter_radius=setting.indenter_radius,
        contact_modulus=setting.contact_modulus,
        load=None if setting.load is None else max(setting.load, 0.0),
        indentation=setting.indentation,
        apex=setting.apex,
        coupling="none" if coupling == "none" else "asymptotic",
        law=law,
        thickness=setting.thickness,
    )


@dataclass(frozen=True, eq=False)
class _State:
    """Contacts (rows from the highest down), their radii, the penetrations of all, and ``D``."""

    rows: Rows
    contact_radius: Values
    force: Values
    penetration: Values
    indentation: float
    residual: float

    def scattered(self, size: int) -> tuple[Values, Values, Values]:
        """Force, contact radius and penetration of all asperities."""
        force, contact_radius = np.zeros(size), np.zeros(size)
        force[self.rows], contact_radius[self.rows] = self.force, self.contact_radius
        return force, contact_radius, self.penetration


@dataclass(frozen=True, eq=False)
class _Path:
    """One problem of a path; without a kernel the contacts are independent."""

    problem: ScaledProblem
    law: AdhesiveLaw
    kernel: Kernel | None
    tolerance: float
    max_iterations: int

    def follow(self, previous: InteractingSolution, *, first: bool) -> tuple[_State, int]:
        """Let contacts break and form until the set is in equilibrium.

        First loading starts with the highest asperity in contact at prescribed load, and with the asperities
        that the indenter reaches at prescribed indentation.
        """
        p = self.problem
        radius = previous.radius[p.order] / p.length
        if first and not radius.any() and (p.load is not None or p.indentation >= 0):
            radius[0] = self.law.touch_radius(p.radius[:1])[0]
        return self._settle(radius, previous.indentation / p.depth, first=first)

    def refined(self, state: _State, steps: int) -> tuple[_State, int]:
        """Full coupling from the state with point forces: alternate field corrections and contacts."""
        path, difference = self, np.inf
        for _ in range(MAX_FIELD_UPDATES):
            if not state.rows.size:
                return state, steps
            guess = np.zeros(self.problem.order.size)
            guess[state.rows] = state.contact_radius
            path = replace(self, problem=self._refine(path.problem, state, guess))
            following, taken = path._settle(guess.copy(), state.indentation, first=False)
            steps += taken
            _, radius, _ = following.scattered(guess.size)
            difference, state = float(np.abs(radius - guess).max() / guess.max()), following
            if difference <= FIELD_UPDATE_CHANGE:
                return state, steps
        raise ConvergenceError(
            f"full coupling of the adhesive contacts did not converge: the radii still change by "
            f"{difference:.3g} of the largest after {MAX_FIELD_UPDATES} updates, tolerance "
            f'{FIELD_UPDATE_CHANGE:.3g}; use coupling "asymptotic"'
        )

    def _refine(self, at: ScaledProblem, state: _State, contact_radius: Values) -> ScaledProblem:
        """The problem with the field corrections of a state; ``at`` holds the shifted summits."""
        force, _, _ = state.scattered(contact_radius.size)
        near = np.flatnonzero((contact_radius > 0) | (state.indentation > self.problem.gap))
        a = contact_radius[near]
        pull = np.sqrt(8 * np.pi * self.law.adhesion * a**3)
        kernel = self.kernel if self.kernel is not None else Kernel.of_thickness(np.inf)
        return correct_for_field(
            self.problem, at, kernel, near=near, force=force[near], pull=pull, contact_radius=a
        )

    def _settle(self, guess: Values, depth: float, *, first: bool) -> tuple[_State, int]:
        """Newton for one set of contacts after the other, from guessed radii and indentation."""
        p, rows, steps = self.problem, np.flatnonzero(guess), 0
        broken = np.zeros(guess.size, dtype=bool)
        while rows.size:
            if first:
                guess[rows] = np.maximum(guess[rows], self.law.touch_radius(p.radius[rows]))
            state, taken, weakest = self._equilibrium(rows, guess[rows], depth)
            steps += taken
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
            guess[forming] = self.law.touch_radius(p.radius[forming])
            rows = np.flatnonzero(guess)
        return self._parted(), steps

    def _parted(self) -> _State:
        """The state without contacts, after the last one has broken."""
        p = self.problem
        if p.load is not None and p.load < 0:
            raise ModelRangeError(
                "load must not be below pull-off: the contacts cannot bear a pull of "
                f"{-p.load * p.force_unit:.6g} N"
            )
        none, depth = np.zeros(0), 0.0 if p.load is not None else p.indentation
        return _State(np.zeros(0, dtype=np.intp), none, none, depth - p.gap, depth, 0.0)

    def _equilibrium(self, rows: Rows, a: Values, depth: float) -> tuple[_State | None, int, int]:
        """Solve for one set of contacts; if it has no equilibrium, name the contact closest to its fold."""
        contacts = _Contacts.of(self, rows)
        D = self.problem.indentation if self.problem.load is None else depth
        error, missing = contacts.errors(a, D)
        for steps in range(self.max_iterations + 1):
            residual = contacts.residual(error, missing, D)
            if residual <= self.tolerance:
                return contacts.state(a, D, residual), steps, -1
            change, rise = contacts.direction(a, error, missing)
            step, merit = 1.0, float(error @ error + missing**2)
            while step > _MIN_STEP_FRACTION:
                trial = np.clip(a + step * change, contacts.fold, contacts.widest)
                error, missing = contacts.errors(trial, D + step * rise)
                if float(error @ error + missing**2) < (1 - 1e-4 * step) * merit:
                    break
                step /= 2
            else:
                break
            a, D = trial, D + step * rise
        return None, steps, int(rows[np.argmin(a / contacts.fold)])


@dataclass(frozen=True, eq=False)
class _Contacts:
    """Equations of a set of contacts in their radii: ``delta(a) + C p(a) + g - D = 0``, ``sum p = P``."""

    path: _Path
    rows: Rows
    radius: Values
    gap: Values
    fold: Values
    widest: Values
    matrix: Values

    @classmethod
    def of(cls, path: _Path, rows: Rows) -> "_Contacts":
        """The equations of given rows; ``fold`` are the radii at which an isolated contact breaks."""
        p = path.problem
        radius = p.radius[rows]
        matrix = np.zeros((rows.size, rows.size))
        if path.kernel is not None:
            matrix = DenseCoupling(p.x[rows], p.y[rows], path.kernel).matrix
        fold, widest = path.law.fold(radius), path.law.widest(radius)
        return cls(path, rows, radius, p.gap[rows], fold, widest, matrix)

    def errors(self, a: Values, depth: float) -> tuple[Values, float]:
        """Errors of the penetrations and of the load."""
        penetration = self.path.law.penetration(a, self.radius)
        force, load = self.path.law.force(a, self.radius), self.path.problem.load
        missing = 0.0 if load is None else load - float(force.sum())
        return penetration + self.matrix @ force + self.gap - depth, missing

    def residual(self, error: Values, missing: float, depth: float) -> float:
        """Largest relative error."""
        load = self.path.problem.load
        size = max(1.0, float(np.abs(depth - self.gap).max()))
        return max(float(np.abs(error).max()) / size, abs(missing) / max(1.0, abs(load or 0.0)))

    def direction(self, a: Values, error: Values, missing: float) -> tuple[Values, float]:
        """Newton's change of radii and of the indentation."""
        stiffness, softness = self.path.law.slopes(a, self.radius)
        jacobian = self.matrix * stiffness
        # at the fold the softness vanishes; a lower bound keeps the matrix of an uncoupled row regular
        jacobian[np.diag_indices_from(jacobian)] += np.maximum(softness, 1e-9 * a / self.radius)
        back, sink = np.linalg.solve(jacobian, np.column_stack([error, np.ones(a.size)])).T
        if self.path.problem.load is None:
            return -back, 0.0
        rise = float((missing + stiffness @ back) / (stiffness @ sink))
        return rise * sink - back, rise

    def state(self, a: Values, depth: float, residual: float) -> _State:
        """The state with all penetrations: JKR's in contact, the overlap of the surfaces elsewhere."""
        p, law, force = self.path.problem, self.path.law, self.path.law.force(a, self.radius)
        penetration = depth - p.gap
        penetration[self.rows] = 0.0
        near = np.flatnonzero(penetration > 0)
        if self.path.kernel is not None:
            r = np.hypot(p.x[near, None] - p.x[self.rows], p.y[near, None] - p.y[self.rows])
            penetration[near] -= (1 / r - self.path.kernel.deficit(r)) @ force / np.pi
        penetration[self.rows] = law.penetration(a, self.radius)
        return _State(self.rows, a, force, penetration, depth, residual)
