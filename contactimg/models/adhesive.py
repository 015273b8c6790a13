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
from typing import TypedDict, Unpack

import numpy as np
import pandas as pd

from contactimg.errors import ConvergenceError, InputError
from contactimg.models.adhesive_asperity_law import AdhesiveLaw
from contactimg.models.adhesive_path import AdhesivePath
from contactimg.models.adhesive_proof import AdhesiveProof
from contactimg.models.asperity_laws import LAWS
from contactimg.models.coupling import Kernel
from contactimg.models.interacting import check_layer, solve_interacting
from contactimg.models.load_spring import ContactConditions, LoadSpring, prescribed
from contactimg.models.proof import ADHESION_RANGE_J_M2, check_range, refuse_beyond_floats
from contactimg.models.scaled_problem import check_choice, scale_problem
from contactimg.models.solution import InteractingSolution

COUPLINGS = ("none", "asymptotic", "full")

FIRST_SUBSTEPS, MOST_SUBSTEPS = 8, 128
"""Steps between two loads of a path, at first and at most. Chosen: in one step from 20 to 1 mN a pattern lost
two of its twelve contacts, in eight none."""


class AdhesiveOptions(TypedDict, total=False):
    """Keywords of `solve_adhesive` that hold for every load of a series."""

    apex: tuple[float, float]
    coupling: str
    law: str
    thickness: float
    poisson_ratio: float
    tolerance: float
    max_iterations: int


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
    return AdhesiveProof(path, state, law_in_si, conditions, start).judge(solution)


def solve_adhesive_path(
    asperities: pd.DataFrame,
    *,
    loads: Iterable[float | LoadSpring],
    indenter_radius: float,
    contact_modulus: float,
    work_of_adhesion: float,
    **options: Unpack[AdhesiveOptions],
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
    **options: Unpack[AdhesiveOptions],
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
    """From one load to the next, in steps so small that half of them lead to the same contacts."""
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
