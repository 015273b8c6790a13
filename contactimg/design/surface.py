"""A designed surface: from a wanted law to a table of asperities, with the laws that it follows."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.design.independent import HeightDensity, find_density
from contactimg.design.laws import WantedLaw
from contactimg.design.refine import evaluate, refine
from contactimg.errors import InputError
from contactimg.models.interacting import solve_interacting
from contactimg.models.solution import InteractingSolution
from contactimg.surfaces import base_radius
from contactimg.tables import ASPERITIES, DESIGNED

Values = NDArray[np.float64]

LOADS = 33
"""Loads at which the law is compared. Chosen: 7 % apart over a decade; areas between follow smoothly."""

DRAWS = 400
"""Random sets of errors of the heights. Theory: the scatter is uncertain by 1/sqrt(2 x 400), 3.5 %."""

AIM = 3
"""The heights are refined to the tolerance over this. Chosen: loads between those compared meet it too."""

MOST_CAPS, UNLIMITED = 10_000, 10**9
"""Most caps of a design (chosen: it takes minutes), and as many as any law may need in a message."""

LEAST_RADIUS = 1e-9
"""Radius (m) below which a smaller cap is no advice. Chosen: atoms."""


@dataclass(frozen=True, eq=False)
class DesignedSurface:
    """A surface and its laws.

    Parameters
    ----------
    asperities : DataFrame
        Columns ``x_m, y_m, height_m, radius_m``.
    law : DataFrame
        Columns of `contactimg.tables.DESIGNED`, one row a load.
    status : str
        ``"ok"``, or a sentence on what the surface does not do.
    residual, independent_residual : float
        Largest relative difference between area and wanted area: of the surface, and of the one designed as
        if its contacts were independent, both with contacts that displace each other.
    iterations : int
        Steps that the coupled solver took.
    independent_asperities : DataFrame
        The design for independent contacts.
    """

    asperities: pd.DataFrame
    law: pd.DataFrame
    status: str
    residual: float
    independent_residual: float
    iterations: int
    independent_asperities: pd.DataFrame


def design_heights(
    law: WantedLaw,
    *,
    count: int,
    cap_radius: float,
    spacing: float,
    contact_modulus: float,
    lowest: float | None = None,
    height_std: float = 1e-6,
    coupling: Literal["asymptotic", "hertz", "full"] = "asymptotic",
    profile: Literal["hertz", "sphere"] = "sphere",
    tolerance: float = 0.01,
    nearest: bool = False,
    max_iterations: int = 40,
    rng: np.random.Generator,
) -> DesignedSurface:
    """Heights of equal caps on a square grid whose contacts with a flat follow a law of area against load.

    Parameters
    ----------
    law : WantedLaw
    count : int
        Number of caps.
    cap_radius, spacing : float, m
        Radius of curvature of the caps, and distance of neighbours.
    contact_modulus : float, Pa
        ``E* = E/(1 - nu^2)`` of the elastic body; the partner is rigid.
    lowest : float, m, optional
        Height of the lowest cap above the base plane; by default a tenth of the radius (chosen: the plane
        between the caps stays free).
    height_std : float, m
        Standard deviation of the errors with which the heights are made.
    coupling, profile : str
        Of the contacts for which the heights are refined, as in `solve_interacting`.
    tolerance : float
        Largest relative difference of the area from the wanted one that is accepted.
    nearest : bool
        Whether the nearest possible law is designed where the wanted one is not possible.
    max_iterations : int
        Most steps of either refinement.
    rng : Generator
        Decides which cap has which height.

    Returns
    -------
    DesignedSurface

    Raises
    ------
    InputError
        If an argument breaks its rule or the law is not possible; the sentence says from which load on.
    ConvergenceError
        If the contacts cannot be solved.

    Notes
    -----
    The heights of independent contacts (`find_density`) are corrected first as such, because caps are whole,
    then with the coupled solver. The scatter is that of random errors of the heights at constant load and
    constant displacement by the neighbours (`scatter`).
    That friction is strength times area under pure compression is an empirical premise.

    References
    ----------
    Aymard et al., Science 383 (2024) 200, doi:10.1126/science.adk4234.
    """
    sizes = {"cap_radius": cap_radius, "spacing": spacing, "contact_modulus": contact_modulus}
    for name, value in sizes.items():
        if not 0 < value < np.inf:
            raise InputError(f"{name} must be positive and finite, got {value!r}")
    if not 1 <= count <= MOST_CAPS or not 0 < tolerance < 1 or not 0 <= height_std < np.inf:
        raise InputError(
            f"a design needs 1 to {MOST_CAPS} caps, a tolerance between 0 and 1 and an error of the heights "
            f"that is not negative, got {count}, {tolerance} and {height_std}"
        )
    up = cap_radius * 0.1 if lowest is None else lowest
    if not (0 < up < cap_radius and 2 * base_radius(up, cap_radius) <= spacing):
        raise InputError(
            f"caps of radius {cap_radius * 1e6:.4g} um that are {up * 1e6:.4g} um high cannot stand "
            f"{spacing * 1e6:.4g} um apart; their discs are {2e6 * base_radius(up, cap_radius):.4g} um wide"
        )
    caps = {"cap_radius": cap_radius, "contact_modulus": contact_modulus}
    density = find_density(law, count=count, **caps)
    reason = why_impossible(density, law, count=count, tolerance=tolerance, **caps)
    if reason and not nearest:
        raise InputError(f"the law is not possible: {reason}")
    loads = law.loads(LOADS)
    wanted = law.at(loads)
    goal = np.interp(loads, density.load, density.area) if reason else wanted
    heights = -rng.permutation(density.heights(count))
    start = square_grid(count, spacing).assign(height_m=heights, radius_m=cap_radius)
    steps: dict[str, Any] = {"tolerance": tolerance / AIM, "max_iterations": max_iterations}
    coupled: dict[str, Any] = {"contact_modulus": contact_modulus, "coupling": coupling, "law": profile}
    alone = refine(start, loads, goal, contact_modulus=contact_modulus, coupling="none", **steps)
    before = evaluate(alone.table, loads, goal, coupled)
    found = refine(alone.table, loads, goal, **steps, **coupled)
    table = _raised(found.table, up)
    last = solve_interacting(table, load=float(loads[-1]), indenter_radius=np.inf, **coupled)
    remarks = [f"the wanted law is not possible: {reason}"] if reason else []
    if found.residual > tolerance:
        remarks.append(
            f"the area differs from the {'nearest possible' if reason else 'wanted'} law by up to "
            f"{100 * found.residual:.2g} % after {found.iterations} steps; "
            "take more caps, or a narrower range"
        )
    width = 2 * float(base_radius(table["height_m"].max(), cap_radius))
    if width > spacing:
        remarks.append(f"the highest cap covers a disc {width * 1e6:.4g} um wide, more than the spacing")
    errors = height_std * rng.standard_normal((DRAWS, count))
    columns = {
        "load_N": loads,
        "wanted_area_m2": wanted,
        "independent_area_m2": alone.areas,
        "uncorrected_area_m2": before.areas,
        "coupled_area_m2": found.areas,
        "coupled_std_m2": [scatter(one, errors) for one in found.solutions],
        "n_contacts": [one.touching.size for one in found.solutions],
    }
    return DesignedSurface(
        table,
        DESIGNED.conform(pd.DataFrame(columns)),
        "; ".join([*remarks, *last.validity.messages()]) or "ok",
        found.residual,
        before.residual,
        found.iterations,
        _raised(alone.table, up),
    )


def why_impossible(
    density: HeightDensity,
    law: WantedLaw,
    *,
    count: int,
    cap_radius: float,
    contact_modulus: float,
    tolerance: float,
) -> str:
    """Why the nearest law of independent caps differs by more than the tolerance; empty if it does not."""
    excess = density.excess
    wrong = np.flatnonzero(np.abs(excess) > tolerance)
    if wrong.size == 0:
        return ""
    first, worst = int(wrong[0]), int(np.abs(excess).argmax())
    load, off = density.load[first], f"{100 * abs(excess[worst]):.3g} %"
    if first == 0 and excess[0] > 0:
        fit = cap_radius * (law.at(load) / density.area[0]) ** 1.5
        smaller = f"take caps of a radius below {fit * 1e6:.3g} um, or " if fit > LEAST_RADIUS else "take "
        return (
            f"one cap alone has {density.area[0]:.3g} m2 at {load:.3g} N and {law.at(load):.3g} m2 are "
            f"wanted; {smaller}a larger first load"
        )
    if excess[first] < 0:
        caps = find_density(law, count=UNLIMITED, cap_radius=cap_radius, contact_modulus=contact_modulus).caps
        needed = f"{np.ceil(caps.sum()):.0f}" if caps.sum() < 0.99 * UNLIMITED else f"over {UNLIMITED:.0g}"
        return (
            f"the law needs {needed} caps, and there are {count}; from {load:.3g} N on the area is too "
            f"small, by up to {off} (at {density.load[worst]:.3g} N)"
        )
    return (
        f"from {load:.3g} N on the area would have to grow more slowly than that of the caps which touch "
        f"already (it is not convex in the indentation); the nearest possible law has up to {off} "
        f"more area (at {density.load[worst]:.3g} N); --nearest designs it"
    )


def scatter(solution: InteractingSolution, errors: Values) -> float:
    """Root mean square change of the area (m^2) at constant load by errors of the heights, one set a row (m).

    The displacement of each cap by its neighbours stays as it is; caps come into contact and leave it.
    """
    before = np.maximum(solution.penetration, 0.0)
    changed, load = solution.penetration + errors, np.sum(before**1.5)
    # Newton from where the highest cap alone bears the load: convex, so that no step goes too far
    shift = load ** (2 / 3) - changed.max(axis=1, keepdims=True)
    for _ in range(20):  # from any start the last steps change nothing
        inside = np.maximum(changed + shift, 0.0)
        slope = 1.5 * np.sum(np.sqrt(inside), axis=1, keepdims=True)
        shift -= (np.sum(inside**1.5, axis=1, keepdims=True) - load) / slope
    change = np.maximum(changed + shift, 0.0).sum(axis=1) - before.sum()
    share = float(np.sqrt(np.mean(change**2)) / before.sum())
    return share * solution.area


def square_grid(count: int, spacing: float) -> pd.DataFrame:
    """Places of caps on a square grid about (0, 0), row by row; the last row may be shorter.

    Examples
    --------
    >>> square_grid(4, 2.0)["x_m"].tolist()
    [-1.0, 1.0, -1.0, 1.0]
    """
    side = int(np.ceil(np.sqrt(count)))
    rows, columns = np.divmod(np.arange(count), side)
    x, y = columns - (side - 1) / 2, rows - rows.max() / 2
    return pd.DataFrame({"x_m": spacing * x, "y_m": spacing * y})


def _raised(table: pd.DataFrame, lowest: float) -> pd.DataFrame:
    """Shift all heights so that the lowest one is ``lowest`` (m)."""
    heights = table["height_m"] - table["height_m"].min() + lowest
    return table.assign(height_m=heights)[list(ASPERITIES.first)]
