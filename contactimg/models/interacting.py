"""Interacting asperities: every contact of a pattern under a sphere, at prescribed load or indentation.

``delta_i = D - g_i - sum_j C_ij p_j`` with ``p_i = (4/3) E* sqrt(R_i) delta_i^{3/2}`` where ``delta_i > 0``.
Solved without dimensions (`contactimg.models.scaled_problem`) by Newton's method
(`contactimg.models.newton_iteration`) on the candidates: the asperities that the indenter would reach if the
others did not lower the surface.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import ConvergenceError, InputError, ModelRangeError, finite_number
from contactimg.mechanics.layer import LARGEST_RATIO
from contactimg.models.asperity_laws import LAWS, AdhesiveLaw, AsperityLaw, LayerLaw, asperity_law
from contactimg.models.composite_summits import CompositeSummits
from contactimg.models.conditions import ContactConditions
from contactimg.models.contact_solver import METHODS, ContactSolver
from contactimg.models.convergence import check_finite, judge, refuse_beyond_floats, relative_error
from contactimg.models.coupling import Kernel
from contactimg.models.newton_iteration import ContactSystem
from contactimg.models.scaled_problem import ScaledProblem, check_choice, scale_problem
from contactimg.models.solution import InteractingSolution

Values = NDArray[np.float64]

COUPLINGS = ("none", "asymptotic", "hertz", "full")


@refuse_beyond_floats
def solve_interacting(
    asperities: pd.DataFrame | CompositeSummits,
    *,
    indenter_radius: float,
    contact_modulus: float,
    load: float | None = None,
    indentation: float | None = None,
    apex: tuple[float, float] = (0.0, 0.0),
    coupling: str = "asymptotic",
    law: str = "hertz",
    thickness: float = np.inf,
    poisson_ratio: float = 0.5,
    start: InteractingSolution | None = None,
    method: str = "auto",
    tolerance: float = 1e-12,
    max_iterations: int = 30,
) -> InteractingSolution:
    """Forces and radii of all contacts of a pattern, elastically coupled.

    Parameters
    ----------
    asperities : DataFrame or CompositeSummits
        Columns ``x_m, y_m, height_m, radius_m``.
    indenter_radius : float, m
        Radius of the lens; infinite for a flat.
    contact_modulus : float, Pa
        ``E* = E/(1 - nu^2)``.
    load, indentation : float, N or m
        Exactly one of the two; the indentation counts from first touch.
    apex : (float, float), m
        Where the lens's apex stands.
    coupling : {"none", "asymptotic", "hertz", "full"}
        Displacement of a contact by its neighbours. ``"none"``: zero, independent contacts.
        ``"asymptotic"``: that of a point force, ``p/(pi E* r)``. ``"full"``, the accurate level: that of
        Hertz's pressure over the width of a contact, to the sixth power of ``a/r``
        (`contactimg.models.full_coupling`). ``"hertz"``: that of Hertz's pressure at the summit alone, the
        original form of the model.
    law : {"hertz", "sphere"}
        Profile of one asperity: a paraboloid, or the exact sphere (Sneddon).
    thickness : float, m
        Of a layer bonded to a rigid support; infinite for a half-space. Each cap follows the exact law of a
        layer, up to contact radii of two thicknesses.
    poisson_ratio : float
        Of the layer.
    start : InteractingSolution, optional
        A solution of the same table at a similar load, to start from.
    method : {"auto", "dense", "fast"}
        A stored matrix, or sums by non-uniform FFT; ``"auto"`` takes the faster one.
    tolerance : float
        Largest accepted residual, the sum of ``|p - q|`` over the load.
    max_iterations : int
        Most Newton steps.

    Returns
    -------
    InteractingSolution

    Raises
    ------
    InputError
        If an argument breaks its rule.
    ModelRangeError
        If two asperities are so close that the solution is not unique (it names both rows), or the numbers
        are outside the range of the model.
    ConvergenceError
        If the residual stays above the tolerance, or the final forces fail a check.

    Notes
    -----
    The error of the forces, sum of ``|dF|`` over the load, against solutions of the whole contact problem on
    the patterns SA+ (0.5 N) and RA+ (0.6 N), spheres: 46 and 55 % (none), 0.056 and 0.24 % (asymptotic),
    0.00013 and 0.0036 % (full). Memory: 8 bytes a pair of candidates up to 4000 of them, about 3 kB a
    candidate beyond.

    References
    ----------
    Yashima et al., Soft Matter 11 (2015) 871, doi:10.1039/C4SM02346C, eqs. (2) and (3); Ciavarella,
    Delfine, Demelio, J. Mech. Phys. Solids 54 (2006) 2569, doi:10.1016/j.jmps.2006.05.006.

    Examples
    --------
    One asperity under a flat follows Hertz:

    >>> import pandas as pd
    >>> cap = pd.DataFrame({"x_m": [0.0], "y_m": [0.0], "height_m": [4e-5], "radius_m": [1e-4]})
    >>> solution = solve_interacting(cap, indenter_radius=float("inf"), contact_modulus=4e6, load=1.44e-3)
    >>> round(float(solution.radius[0]) * 1e6, 9)
    30.0
    """
    check_choice("coupling", coupling, COUPLINGS)
    check_choice("law", law, LAWS)
    check_choice("method", method, METHODS)
    if load is not None and (load := finite_number(load, "load", "N")) < 0:
        raise InputError(f"load must not be negative, got {load!r} N; only adhesive contacts bear a pull")
    conditions = ContactConditions(
        indenter_radius, float(contact_modulus), apex, float(thickness), load, indentation, poisson_ratio
    )
    problem = scale_problem(asperities, conditions)
    if not problem.touches:
        return problem.untouched(coupling=coupling)
    check_start(start, len(asperities))
    seed = None if start is None or not start.force.any() else start.force[problem.order] / problem.force_unit
    layered = coupling != "none" and np.isfinite(thickness)
    kernel = Kernel.of_thickness(thickness / problem.length, poisson_ratio, between=layered)
    aspect = problem.depth / problem.length
    profile: AsperityLaw = asperity_law(law, aspect=aspect)
    if layered:
        flatness = aspect if law == "sphere" else 0.0
        profile = LayerLaw(AdhesiveLaw(0.0, flatness, thickness / problem.length, poisson_ratio))
    solver = ContactSolver(problem, profile, kernel, coupling, method, tolerance, max_iterations)
    problem, system, iterate, steps = solver.solve(seed)
    radius, penetration = iterate.contact_radius, iterate.penetration(system)
    if isinstance(profile, LayerLaw):
        radius = profile.contact_radius(penetration, system.caps)
        check_layer(radius * problem.length, thickness)
    how = {"coupling": coupling, "iterations": steps, "residual": iterate.residual}
    solution = problem.record(iterate.carried, radius, penetration, iterate.indentation, **how)
    return replace(solution, status=_prove(solution, problem, system, tolerance))


def check_start(start: InteractingSolution | None, count: int) -> None:
    """Refuse to start from the solution of a table of another length."""
    if start is not None and start.force.size != count:
        raise InputError(
            f"start must be a solution of the same table of {count} asperities, got one of {start.force.size}"
        )


def check_layer(contact_radius: Values, thickness: float) -> None:
    """Refuse contacts of more than `LARGEST_RATIO` thicknesses of the layer, m."""
    widest = float(contact_radius.max(initial=0.0))
    if widest > (1 - 1e-9) * LARGEST_RATIO * thickness:
        raise ModelRangeError(
            f"a contact would have a radius of {widest * 1e6:.4g} um or more on a layer of "
            f"{thickness * 1e6:.4g} um: the law of a layer holds up to {LARGEST_RATIO:g} thicknesses; lower "
            "the load"
        )


def _prove(
    solution: InteractingSolution, problem: ScaledProblem, system: ContactSystem, tolerance: float
) -> str:
    """Status of a solution: its forces pull nowhere, bear the load and follow from its indentation.

    ``system`` holds the equations of the asperities of ``problem``, with the corrections of full coupling.
    """
    force, radius = solution.force, solution.radius
    check_finite({"force": force, "contact radius": radius, "indentation": solution.indentation})
    if np.any(force < 0) or np.any((force > 0) != (radius > 0)):
        raise ConvergenceError(
            "a contact of the solution pulls, or has a force without a radius: loads, lengths and moduli may "
            "be too many orders of magnitude apart; check their units"
        )
    carried = force[problem.order] / problem.force_unit
    total = float(carried.sum())
    depth = solution.indentation / problem.depth - system.gap
    expected, _ = system.response(depth - system.coupling.displacement(carried))
    size = problem.load or total or 1.0
    errors = {
        "sum of the forces": relative_error(total, size),
        "forces at the indentation": float(np.abs(expected - carried).sum()) / size,
    }
    return judge(errors, tolerance)


SIMILAR_LOADS = 1.3
"""Ratio of two loads up to which a solution at one is a start for the other.

Measured: on SA+ and RA+ it saves a Newton step up to there; from a ratio of 1.6 on it costs one.
"""


def solve_loads(
    asperities: pd.DataFrame | CompositeSummits,
    *,
    loads: Iterable[float],
    indenter_radius: float,
    contact_modulus: float,
    **options: Any,
) -> Iterator[InteractingSolution]:
    """Solve at several loads, each solution started from the previous one where that is close.

    Parameters
    ----------
    asperities : DataFrame or CompositeSummits
    loads : iterable of float, N
    indenter_radius : float, m
    contact_modulus : float, Pa
    **options
        Further keywords of `solve_interacting` that hold for every load.

    Yields
    ------
    InteractingSolution
        In the order of the loads.

    Examples
    --------
    >>> import pandas as pd
    >>> cap = pd.DataFrame({"x_m": [0.0], "y_m": [0.0], "height_m": [4e-5], "radius_m": [1e-4]})
    >>> where = dict(indenter_radius=float("inf"), contact_modulus=4e6)
    >>> [round(float(s.radius[0]) * 1e6, 6) for s in solve_loads(cap, loads=[0.18e-3, 1.44e-3], **where)]
    [15.0, 30.0]
    """
    previous, apex = None, options.get("apex", (0.0, 0.0))
    summits = CompositeSummits.of(asperities, indenter_radius=indenter_radius, apex=apex)
    options |= {"indenter_radius": indenter_radius, "contact_modulus": contact_modulus}
    for load in loads:
        before = 0.0 if previous is None else previous.load
        similar = before > 0 and before / SIMILAR_LOADS <= load <= before * SIMILAR_LOADS
        previous = solve_interacting(summits, load=load, start=previous if similar else None, **options)
        yield previous
