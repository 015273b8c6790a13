"""Interacting asperities: every contact of a pattern under a sphere, at prescribed load or indentation.

The convex problem ``delta_i = D - g_i - sum_j C_ij p_j``, ``p_i = (4/3) E* sqrt(R_i) delta_i^{3/2}`` where
``delta_i > 0``, solved without dimensions by Newton's method (`contactimg.models.newton`).
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import ConvergenceError, InputError
from contactimg.models.coupling import Coupling, DenseCoupling, NoCoupling
from contactimg.models.local_laws import HertzLaw, LocalLaw
from contactimg.models.newton import Iterate, System, initial_iterate, measure, solve_uncoupled, take_step
from contactimg.models.solution import InteractingSolution
from contactimg.surfaces import composite_apexes

__all__ = ["solve_interacting", "solve_loads"]

Values = NDArray[np.float64]

COUPLINGS = ("none", "asymptotic")


@dataclass(frozen=True)
class _Scaled:
    """A contact problem without dimensions, asperities from the highest down.

    Lengths along the surface are in ``length``, heights in ``depth``, forces in ``E* length depth``;
    ``order`` holds the asperities' rows in the table.
    """

    x: Values
    y: Values
    gap: Values
    radius: Values
    order: NDArray[np.intp]
    load: float | None
    indentation: float
    length: float
    depth: float
    force_unit: float


def solve_interacting(
    asperities: pd.DataFrame,
    *,
    indenter_radius: float,
    contact_modulus: float,
    load: float | None = None,
    indentation: float | None = None,
    apex: tuple[float, float] = (0.0, 0.0),
    coupling: str = "asymptotic",
    tolerance: float = 1e-12,
    max_iterations: int = 30,
    start: InteractingSolution | None = None,
) -> InteractingSolution:
    """Forces and radii of all contacts of a pattern, elastically coupled.

    Parameters
    ----------
    asperities : DataFrame
        Columns ``x_m, y_m, height_m, radius_m``.
    indenter_radius : float, m
        Radius of the lens; infinite for a flat.
    contact_modulus : float, Pa
        ``E* = E/(1 - nu^2)``.
    load, indentation : float, N or m
        Exactly one of the two; the indentation counts from first touch.
    apex : (float, float), m
        Where the lens's apex stands.
    coupling : {"none", "asymptotic"}
        ``"none"``: independent contacts; ``"asymptotic"``: a contact lowers its neighbours by ``p/(pi E* r)``.
    tolerance : float
        On the sum of ``|p - q|`` over the load.
    max_iterations : int
        Newton steps before giving up.
    start : InteractingSolution, optional
        A neighbouring solution of the same table to start from.

    Returns
    -------
    InteractingSolution

    Raises
    ------
    InputError
        If an argument breaks its rule.
    ConvergenceError
        If the residual stays above the tolerance.

    References
    ----------
    Yashima et al., Soft Matter 11 (2015) 871, doi:10.1039/C4SM02346C, eqs. (3) and (4).

    Examples
    --------
    One asperity under a flat follows Hertz:

    >>> import pandas as pd
    >>> cap = pd.DataFrame({"x_m": [0.0], "y_m": [0.0], "height_m": [4e-5], "radius_m": [1e-4]})
    >>> solution = solve_interacting(cap, indenter_radius=float("inf"), contact_modulus=4e6, load=1.44e-3)
    >>> round(float(solution.radius[0]) * 1e6, 9)
    30.0
    """
    _check(contact_modulus, load, indentation, coupling)
    apexes = composite_apexes(asperities, indenter_radius=indenter_radius, apex=apex)
    scaled = _scale(apexes, float(contact_modulus), load, indentation)
    if scaled is None:
        return _untouched(asperities, apexes, coupling)
    seed = None if start is None else start.force[scaled.order] / scaled.force_unit
    system, iterate, steps = _solve(scaled, coupling, seed, tolerance, max_iterations)
    return _record(asperities, apexes, scaled, system, iterate, coupling=coupling, steps=steps)


def solve_loads(
    asperities: pd.DataFrame,
    *,
    loads: Iterable[float],
    indenter_radius: float,
    contact_modulus: float,
    **options: object,
) -> Iterator[InteractingSolution]:
    """One solution a load, each started from the one before.

    Parameters
    ----------
    asperities : DataFrame
    loads : iterable of float, N
    indenter_radius : float, m
    contact_modulus : float, Pa
    **options
        Further keywords of `solve_interacting`.

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
    previous = None
    for load in loads:
        previous = solve_interacting(
            asperities,
            indenter_radius=indenter_radius,
            contact_modulus=contact_modulus,
            load=load,
            start=previous,
            **options,  # type: ignore[arg-type]
        )
        yield previous


def _check(contact_modulus: float, load: float | None, indentation: float | None, coupling: str) -> None:
    """Refuse arguments that make no problem."""
    if not (np.isfinite(contact_modulus) and contact_modulus > 0):
        raise InputError(f"contact_modulus must be a positive modulus, got {contact_modulus!r} Pa")
    if (load is None) == (indentation is None):
        raise InputError("give exactly one of load and indentation")
    for name, value in (("load", load), ("indentation", indentation)):
        if value is not None and not np.isfinite(value):
            raise InputError(f"{name} must be finite, got {value!r}")
    if load is not None and load < 0:
        raise InputError(f"load must not be negative, got {load!r} N; only adhesive contacts can be pulled")
    if coupling not in COUPLINGS:
        raise InputError(f"coupling must be one of {', '.join(map(repr, COUPLINGS))}, got {coupling!r}")


def _scale(
    apexes: pd.DataFrame, contact_modulus: float, load: float | None, indentation: float | None
) -> _Scaled | None:
    """The problem without dimensions, in units of the highest asperity alone; None if nothing touches."""
    if load == 0 or (indentation is not None and indentation <= 0) or (load is None and apexes.empty):
        return None
    if apexes.empty:
        raise InputError(f"the asperity table is empty: nothing can bear the load of {load!r} N")
    height, radius = apexes["height_m"].to_numpy(), apexes["radius_m"].to_numpy()
    order = np.argsort(-height, kind="stable")
    highest = float(radius[order[0]])
    if load is not None:
        depth = (0.75 * load / contact_modulus / np.sqrt(highest)) ** (2 / 3)
    else:
        depth = float(indentation)  # type: ignore[arg-type]
    length = np.sqrt(highest * depth)
    unit = contact_modulus * length * depth
    return _Scaled(
        x=apexes["x_m"].to_numpy()[order] / length,
        y=apexes["y_m"].to_numpy()[order] / length,
        gap=(height[order[0]] - height[order]) / depth,
        radius=radius[order] / highest,
        order=order,
        load=None if load is None else load / unit,
        indentation=1.0,
        length=length,
        depth=depth,
        force_unit=unit,
    )


def _solve(
    scaled: _Scaled, coupling: str, seed: Values | None, tolerance: float, max_iterations: int
) -> tuple[System, Iterate, int]:
    """Newton on the candidates, which are all asperities that the indenter's shape alone would reach."""
    law: LocalLaw = HertzLaw()
    free = System(scaled.gap, scaled.radius, law, NoCoupling(), scaled.load)
    indentation = scaled.indentation
    if scaled.load is not None:
        indentation = solve_uncoupled(free, np.zeros_like(scaled.gap), scaled.load)
    force, _ = free.response(indentation - scaled.gap)
    if coupling == "none":
        return free, measure(free, force, indentation, np.zeros_like(force)), 0
    reach = indentation if scaled.load is None else indentation + _sag(scaled, force)
    while True:
        count = int(np.searchsorted(scaled.gap, reach, side="right"))
        rows = slice(0, count)
        operator: Coupling = DenseCoupling(scaled.x[rows], scaled.y[rows])
        system = System(scaled.gap[rows], scaled.radius[rows], law, operator, scaled.load)
        iterate = initial_iterate(system, (force if seed is None else seed)[rows], indentation)
        iterate, steps = _iterate(system, iterate, take_step, tolerance, max_iterations)
        if iterate.indentation <= reach or count == scaled.gap.size:
            return system, iterate, steps
        reach = 1.1 * iterate.indentation


def _sag(scaled: _Scaled, force: Values) -> float:
    """How far the others lower the surface under the most loaded of independent contacts."""
    top = int(np.argmax(force))
    others = np.flatnonzero(force)
    others = others[others != top]
    distance = np.hypot(scaled.x[others] - scaled.x[top], scaled.y[others] - scaled.y[top])
    return float(np.sum(force[others] / distance) / np.pi)


def _iterate(
    system: System,
    iterate: Iterate,
    step: Callable[[System, Iterate], Iterate],
    tolerance: float,
    max_iterations: int,
) -> tuple[Iterate, int]:
    """Newton steps until the mismatch is within the tolerance."""
    for steps in range(max_iterations + 1):
        if iterate.mismatch <= tolerance:
            return iterate, steps
        following = step(system, iterate)
        if following is iterate:
            break
        iterate = following
    raise ConvergenceError(
        f"the contact forces did not converge: residual {iterate.mismatch:.3g} after {steps} steps, "
        f"tolerance {tolerance:.3g}; solve at smaller loads first and hand over the solution as start"
    )


def _untouched(asperities: pd.DataFrame, apexes: pd.DataFrame, coupling: str) -> InteractingSolution:
    """Nothing touches."""
    none = np.zeros(len(apexes))
    height = apexes["height_m"].to_numpy()
    return InteractingSolution(
        force=none,
        radius=none,
        x=apexes["x_m"].to_numpy(),
        y=apexes["y_m"].to_numpy(),
        composite_radius=apexes["radius_m"].to_numpy(),
        height=asperities["height_m"].to_numpy(dtype=np.float64),
        penetration=height - (height.max() if height.size else 0.0),
        indentation=0.0,
        load=0.0,
        coupling=coupling,
        thickness=np.inf,
        status="converged",
        iterations=0,
        residual=0.0,
    )


def _record(
    asperities: pd.DataFrame,
    apexes: pd.DataFrame,
    scaled: _Scaled,
    system: System,
    iterate: Iterate,
    *,
    coupling: str,
    steps: int,
) -> InteractingSolution:
    """The solution with dimensions, in the order of the table."""

    def full(values: Values, unit: float, fill: float = 0.0) -> Values:
        result = np.full(len(apexes), fill)
        result[scaled.order[: values.size]] = values * unit
        return result

    penetration = iterate.penetration(system)
    force, contact_radius = system.response(penetration)
    return InteractingSolution(
        force=full(force, scaled.force_unit),
        radius=full(contact_radius, scaled.length),
        x=apexes["x_m"].to_numpy(),
        y=apexes["y_m"].to_numpy(),
        composite_radius=apexes["radius_m"].to_numpy(),
        height=asperities["height_m"].to_numpy(dtype=np.float64),
        penetration=full(penetration, scaled.depth, -np.inf),
        indentation=iterate.indentation * scaled.depth,
        load=float(force.sum()) * scaled.force_unit,
        coupling=coupling,
        thickness=np.inf,
        status="converged",
        iterations=steps,
        residual=iterate.mismatch,
    )
