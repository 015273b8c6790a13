"""Interacting asperities with adhesion: JKR's law for each contact, along loading and unloading.

The problem is not convex: at one load several sets of contacts can be in equilibrium, and the history of
loading selects one. A contact forms where the surfaces touch (``delta = 0``) and breaks where its equilibrium
becomes unstable. The set of contacts is therefore passed on from load to load; for a given set, Newton's
method finds radii and indentation.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.linalg import lapack

from contactimg.errors import ConvergenceError, InputError
from contactimg.models.adhesive_path import AdhesivePath, AdhesiveState
from contactimg.models.asperity_laws import LAWS, AdhesiveLaw, Caps
from contactimg.models.coupling import DenseCoupling, Kernel
from contactimg.models.interacting import check_layer, solve_interacting
from contactimg.models.load_spring import ContactConditions, LoadSpring, prescribed
from contactimg.models.proof import (
    ADHESION_RANGE_J_M2,
    MAX_RELATIVE_ERROR,
    check_finite,
    check_range,
    judge,
    refuse_beyond_floats,
)
from contactimg.models.scaled_problem import check_choice, scale_problem
from contactimg.models.solution import InteractingSolution

Values = NDArray[np.float64]

COUPLINGS = ("none", "asymptotic", "full")

FIRST_SUBSTEPS, MOST_SUBSTEPS = 8, 128
"""Steps between two loads of a path, at first and at most. Chosen: in one step from 20 to 1 mN a pattern lost
two of its twelve contacts, in eight none."""

ROUNDING_FRACTION = 1e-11
"""Error of the sum of adhesive forces, relative to the sum of their magnitudes, that counts as rounding.
Theory: the Hertz part and the punch part of a force cancel, and the iteration stops at relative errors of
1e-11."""


@refuse_beyond_floats
def solve_adhesive(
    asperities: pd.DataFrame,
    *,
    indenter_radius: float,
    contact_modulus: float,
    work_of_adhesion: float,
    load: float | LoadSpring | None = None,
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
        Exactly one of the two. The load may be a pull and the indentation negative while contacts hold. A
        `LoadSpring` as the load prescribes the displacement of a stage that presses through a spring.
    apex : (float, float), m
    coupling : {"none", "asymptotic", "full"}
        As in `solve_interacting`.
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
    check_range("work_of_adhesion", w, ADHESION_RANGE_J_M2, "J/m^2")
    check_choice("coupling", coupling, COUPLINGS)
    check_choice("law", law, LAWS)
    wanted = prescribed(load, indentation)
    conditions = ContactConditions(
        indenter_radius, float(contact_modulus), apex, float(thickness), *wanted, poisson_ratio
    )
    conditions.check()
    problem = scale_problem(asperities, conditions, depth=_depth_unit(asperities, conditions, w))
    if problem.shapes is not None:
        raise InputError(
            f"the caps are {problem.shapes.words}; adhesion is defined for spherical caps of one modulus"
        )
    held = start is not None and bool(start.radius.any())  # without contacts nothing is remembered
    previous = start if start is not None and held else None
    previous = previous or _without_adhesion(asperities, conditions, coupling, law)
    aspect = 1.0 if law == "sphere" else 0.0
    layer = float(thickness), poisson_ratio
    if coupling == "none":  # independent contacts, of which none has neighbours to share the support with
        layer = np.inf, poisson_ratio
    path = AdhesivePath(
        problem,
        AdhesiveLaw(
            w * problem.length / (contact_modulus * problem.depth**2),
            aspect * problem.depth / problem.length,
            layer[0] / problem.length,
            poisson_ratio,
        ),
        None
        if coupling == "none"
        else Kernel.of_thickness(thickness / problem.length, poisson_ratio, between=True),
        tolerance,
        max_iterations,
    )
    state, steps = path.follow(previous, first=not held)
    if coupling == "full":
        path, state, steps = path.refined(state, steps)
    solution = problem.record(
        *state.scattered(problem.order.size),
        indentation=state.indentation,
        coupling=coupling,
        iterations=steps,
        residual=state.residual,
    )
    check_layer(solution.radius, float(thickness))
    law_in_si = AdhesiveLaw(w / conditions.contact_modulus, aspect, *layer)
    return replace(
        solution,
        status=_status(solution, path, state, law_in_si),
        branch=_branch(solution, start),
        stability_check=_stability_check(path, state),
    )


def solve_adhesive_path(
    asperities: pd.DataFrame,
    *,
    loads: Iterable[float | LoadSpring],
    indenter_radius: float,
    contact_modulus: float,
    work_of_adhesion: float,
    **options: Any,
) -> Iterator[InteractingSolution]:
    """Load and unload: one solution per load, in order, with contacts persisting from load to load.

    Parameters
    ----------
    asperities : DataFrame
    loads : iterable of float, N, or of LoadSpring
        Up and down; a pull is negative.
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
            load=load if isinstance(load, LoadSpring) else float(load),
            start=previous,
            **options,
        )
        yield previous


def solve_adhesive_after(
    history: Iterable[float | LoadSpring],
    asperities: pd.DataFrame,
    *,
    load: float | LoadSpring,
    indenter_radius: float,
    contact_modulus: float,
    work_of_adhesion: float,
    **options: Any,
) -> InteractingSolution:
    """The solution at a load that is reached slowly after other loads.

    Between two loads the contacts are followed in steps so small that half of them lead to the same contacts.

    Parameters
    ----------
    history : iterable of float, N, or of LoadSpring
        The loads before, in order.
    asperities, load, indenter_radius, contact_modulus, work_of_adhesion
        As in `solve_adhesive`.
    **options
        Further keywords of `solve_adhesive`.
    """
    solve = partial(
        solve_adhesive,
        asperities,
        indenter_radius=indenter_radius,
        contact_modulus=contact_modulus,
        work_of_adhesion=work_of_adhesion,
        **options,
    )
    levels = [*history, load]
    solution = solve(load=levels[0])
    for before, after in pairwise(levels):
        solution = _continuous(solve, solution, before, after)
    return solution


def _continuous(
    solve: Callable[..., InteractingSolution],
    start: InteractingSolution,
    first: float | LoadSpring,
    last: float | LoadSpring,
) -> InteractingSolution:
    """Follow the contacts between two loads in steps so small that half of them lead to the same set."""
    coarse: InteractingSolution | None = None
    steps = FIRST_SUBSTEPS
    while steps <= MOST_SUBSTEPS:
        fine: InteractingSolution | None = start
        try:
            for level in _levels(first, last, steps):
                fine = solve(load=level, start=fine)
        except ConvergenceError:
            fine = None
        if fine is not None and coarse is not None and np.array_equal(fine.touching, coarse.touching):
            return fine
        coarse, steps = fine, 2 * steps
    raise ConvergenceError(
        "the adhesive contacts on the loading path still depend on its steps: "
        f"{MOST_SUBSTEPS} from one load to the next hold other contacts than half as many; state more loads"
    )


def _levels(first: float | LoadSpring, last: float | LoadSpring, steps: int) -> Sequence[float | LoadSpring]:
    """Loads or displacements on the way; loads of one sign in equal ratios."""
    if isinstance(first, LoadSpring) and isinstance(last, LoadSpring):
        ways = np.linspace(first.displacement, last.displacement, steps + 1)[1:]
        return [replace(last, displacement=float(way)) for way in ways]
    if isinstance(first, LoadSpring) or isinstance(last, LoadSpring):
        raise InputError("a loading path is of loads or of displacements of the stage, not of both")
    space = np.geomspace if first * last > 0 else np.linspace
    return [float(way) for way in space(first, last, steps + 1)[1:]]


def _depth_unit(asperities: pd.DataFrame, conditions: ContactConditions, work_of_adhesion: float) -> float:
    """Unit of height, m: the larger of the indentations by load and by adhesion of the median asperity."""
    if not len(asperities):
        raise InputError("the asperity table is empty: no asperity can adhere")
    radius, E = float(np.median(asperities["radius_m"])), conditions.contact_modulus
    hertz = (0.75 * abs(conditions.force or 0.0) / E / np.sqrt(radius)) ** (2 / 3)
    depth = abs(conditions.depth or 0.0)
    pressed = min(hertz, depth) if conditions.spring is not None else max(hertz, depth)
    return float(max(pressed, np.cbrt(radius * (work_of_adhesion / E) ** 2)))


def _without_adhesion(
    asperities: pd.DataFrame, conditions: ContactConditions, coupling: str, law: str
) -> InteractingSolution:
    """The solution without adhesion, whose contacts are the least that first loading brings about."""
    load = conditions.load
    return solve_interacting(
        asperities,
        indenter_radius=conditions.indenter_radius,
        contact_modulus=conditions.contact_modulus,
        load=load if load is None or isinstance(load, LoadSpring) else max(load, 0.0),
        indentation=conditions.indentation,
        apex=conditions.apex,
        coupling="none" if coupling == "none" else "asymptotic",
        law=law,
        thickness=conditions.thickness,
        poisson_ratio=conditions.poisson_ratio,
    )


def _status(solution: InteractingSolution, path: AdhesivePath, state: AdhesiveState, law: AdhesiveLaw) -> str:
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
    load = conditions.force if conditions.spring is None else None
    away = abs(borne - (load or 0.0))
    errors = {"sum of the forces": 0.0 if load is None else away / (abs(load) or total or 1.0)}
    if conditions.spring is not None:
        errors["sum of the forces"] = conditions.spring.imbalance(borne, solution.indentation)
    if state.contacts is not None:
        state.contacts.refuse_engulfed(state.contact_radius)
        caps = p.caps_in_metres(p.caps[rows])
        law_force = law.force(radius, caps) * conditions.contact_modulus
        errors["forces at the contact radii"] = float(np.abs(law_force - force).sum()) / total
        lowered = (path.field_gap(rows) + state.contacts.matrix @ (force / p.force_unit)) * p.depth
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
    if state.unsettled > MAX_RELATIVE_ERROR:
        return (
            "full coupling of the adhesive contacts did not settle: with the fields of the neighbours "
            f"the contact radii still change by {state.unsettled:.2g} of the largest"
        )
    overlap = _overlap(path, state)
    if overlap.size and float(overlap.max()) > MAX_RELATIVE_ERROR * size:
        return (
            f"{overlap.size} asperities without contact overlap the indenter, by up to "
            f"{float(overlap.max()) * 1e6:.3g} um: their contacts broke on the way to this solution; "
            "approach it in smaller steps"
        )
    return status


def _overlap(path: AdhesivePath, state: AdhesiveState) -> Values:
    """Overlaps of the asperities without contact with the indenter, m: positive ones only."""
    p, kernel = path.problem, path.kernel
    penetration = state.indentation - p.gap
    if kernel is not None and state.rows.size:
        sources = np.stack([p.x, p.y])[:, state.rows]
        penetration -= kernel.displacement(p.x, p.y, sources, state.force)
    penetration[state.rows] = -np.inf
    return penetration[penetration > 0] * p.depth


def _branch(solution: InteractingSolution, previous: InteractingSolution | None) -> str:
    """How the solution was reached from the previous one."""
    if previous is None:
        return "first loading"
    conditions = solution.conditions
    now, then = solution.indentation, previous.indentation
    if conditions.spring is not None:
        now = conditions.spring.displacement
        then += previous.load / conditions.spring.stiffness
    elif conditions.force is not None:
        now, then = conditions.force, previous.load
    if abs(now - then) <= MAX_RELATIVE_ERROR * abs(now):
        return "held"
    return "loading" if now > then else "unloading"


def _stability_check(path: AdhesivePath, state: AdhesiveState) -> Callable[[], str] | None:
    """The check of the stability, for when it is asked for; None without coupling or contacts."""
    p, rows = path.problem, state.rows
    if path.kernel is None or not rows.size:
        return None
    stiffness = p.stiffness if p.load is not None else np.inf
    place = p.x[rows], p.y[rows], path.kernel
    check = partial(_stability, place, p.caps[rows], path.law)
    return partial(check, contact_radius=state.contact_radius, stiffness=stiffness)


def _stability(
    place: tuple[Values, Values, Kernel],
    caps: Caps,
    law: AdhesiveLaw,
    *,
    contact_radius: Values,
    stiffness: float,
) -> str:
    """``"stable"``, ``"stable only at fixed indentation"`` or ``"unstable"``: the energy's second variation.

    A contact alone is stable at fixed indentation where its penetration grows with its radius. Coupled
    contacts with the tangent stiffnesses ``k`` are stable while ``diag(1/k) + C`` has as many negative
    eigenvalues as ``diag(1/k)``. Under a prescribed load the sum of the forces must also grow with the
    indentation; with a load cell it may fall, more slowly than the force of the cell, whose ``stiffness`` is
    infinite at a prescribed indentation.
    """
    force_slope, penetration_slope = law.slopes(contact_radius, caps)
    if np.any(penetration_slope < 0):
        return "unstable"
    compliance = penetration_slope / np.where(force_slope == 0, np.finfo(float).tiny, force_slope)
    matrix = DenseCoupling(*place).matrix
    matrix[np.diag_indices_from(matrix)] += compliance
    factor, pivots, failed = lapack.dsytrf(matrix, lower=1)
    # eigenvalues by Sylvester's law of inertia: a pivot of order two has one of each sign
    single = pivots > 0
    negative = int(np.sum(np.diag(factor)[single] < 0)) + int(np.sum(~single)) // 2
    if failed or negative != int(np.sum(compliance < 0)):
        return "unstable"
    if np.isinf(stiffness):
        return "stable"
    rise, _ = lapack.dsytrs(factor, pivots, np.ones((contact_radius.size, 1)), lower=1)
    return "stable" if float(np.sum(rise)) + stiffness > 0 else "stable only at fixed indentation"
