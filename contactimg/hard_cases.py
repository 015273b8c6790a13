"""Numerically hard cases of the contact models, each beside what is known of its answer from elsewhere.

`CASES` lists them, `run_cases` makes their table. A case solves a problem and compares one number with a
closed form, a limit, the equations summed one by one, or a stored solution of the whole contact problem; or
it is one that must be refused, with a sentence that says why.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import quad

from contactimg.errors import ContactimgError
from contactimg.mechanics import hertz, jkr
from contactimg.models.adhesive import solve_adhesive, solve_adhesive_path
from contactimg.models.greenwood_tripp import solve_greenwood_tripp
from contactimg.models.greenwood_williamson import solve_greenwood_williamson
from contactimg.models.height_distributions import UniformHeights
from contactimg.models.interacting import solve_interacting
from contactimg.models.load_spring import LoadSpring
from contactimg.models.proof import CONVERGED
from contactimg.models.solution import InteractingSolution
from contactimg.prediction import find_touching_load, predict_contacts
from contactimg.scene import Scene, scene_from_dict
from contactimg.surfaces import generate_asperities

Values = NDArray[np.float64]

MODULUS, RADIUS, ADHESION, LENS = 4e6, 1e-4, 0.05, 0.013
"""E* (Pa), radius of a cap (m), work of adhesion (J/m2), radius of the lens (m). Chosen: those of silicone
rubber, of the patterns SA and of the lens of RA."""

FLAT: dict[str, Any] = {"indenter_radius": np.inf, "contact_modulus": MODULUS}
ROUGH: dict[str, Any] = FLAT | {"indenter_radius": LENS, "apex": (1e-3, 1e-3)}
"""Conditions on a flat, and under the rough lens above the middle of a pattern of 2 mm."""
SUMMED = 300
"""Contacts for which equations are summed one by one. Chosen by time."""

STICKY: dict[str, Any] = {"sphere_radius": RADIUS, "work_of_adhesion": ADHESION}

LAYER_FORCES = {
    (2e-5, 0.5, 4e-6): 2.18256e-3,
    (1e-4, 0.5, 1.2e-5): 3.63853e-3,
    (5e-5, 0.3, 1.2e-5): 4.75096e-3,
    (2e-5, 0.3, 4e-6): 1.24574e-3,
    (1e-3, 0.5, 1.2e-5): 2.30766e-3,
}
"""Thickness (m), Poisson's ratio, indentation (m) -> force (N) on one cap: axisymmetric boundary elements of
800 rings with the layer's own response (`boundary_elements` in tests/models/test_layer_law.py, which computes
them again)."""

GROUPS = {(7, 2.3): 8.398758e-3, (7, 2.5): 8.478162e-3, (2, 2.1): 2.473768e-3, (2, 2.5): 2.488942e-3}
"""Number of equal paraboloids, distance over the radius a of one alone -> sum of their areas, m2, of a pair
or a hexagon with its centre; their radii of curvature are 1 m, a = 20 mm. Solutions of the whole contact
problem (tests/helpers/spectral_contacts.py, polynomials of degree 8; of degree 6 they differ by 6e-6)."""


@dataclass(frozen=True)
class Outcome:
    """What a case gave.

    Parameters
    ----------
    said : str
        Status, or the sentence of a refusal.
    error : float
        Relative difference from the truth; NaN where there is none.
    allowed : float
        The largest error that is one of arithmetic, or of the model where it is known to err.
    truth : str
        Where the truth comes from.
    residual : float
        Of the solver; NaN where it does not apply.
    """

    said: str
    error: float
    allowed: float
    truth: str
    residual: float = np.nan

    @property
    def passed(self) -> bool:
        """Whether the answer holds; without a truth, whether the solver vouches for it."""
        return self.said == CONVERGED if np.isnan(self.error) else self.error <= self.allowed


@dataclass(frozen=True)
class HardCase:
    """A case: its name, what runs it, and whether it is one of the quick selection."""

    name: str
    check: Callable[[], Outcome]
    quick: bool


CASES: list[HardCase] = []
"""All cases, in the order of the page."""


def hard_case(name: str, *values: Any, quick: bool = True) -> Callable[[Callable[..., Outcome]], None]:
    """Declare a case, one for each value; the first of them is in the quick selection."""

    def declare(check: Callable[..., Outcome]) -> None:
        if not values:
            CASES.append(HardCase(name, check, quick))
        for k, value in enumerate(values):
            words = name.format(*value) if isinstance(value, tuple) else name.format(value)
            CASES.append(HardCase(words, partial(check, value), quick and k == 0))

    return declare


def run_cases(*, every: bool, advance: Callable[[], None] = lambda: None) -> pd.DataFrame:
    """The table of the cases: one row each, with ``passed``.

    Parameters
    ----------
    every : bool
        All cases, not only the quick selection.
    advance : callable
        Called after each case.

    Examples
    --------
    >>> list(run_cases(every=False).columns)
    ['case', 'said', 'residual', 'error', 'allowed', 'truth', 'passed']
    """
    rows = []
    for case in chosen_cases(every=every):
        try:
            outcome = case.check()
        except ContactimgError as error:
            outcome = Outcome(str(error), np.inf, 0.0, "an answer")
        fields = ("said", "residual", "error", "allowed", "truth", "passed")
        rows.append({"case": case.name} | {name: getattr(outcome, name) for name in fields})
        advance()
    return pd.DataFrame(rows)


def chosen_cases(*, every: bool) -> list[HardCase]:
    """All cases, or the quick selection."""
    return [case for case in CASES if every or case.quick]


# --- how a case is judged


def compared(solution: Any, found: ArrayLike, true: ArrayLike, allowed: float, truth: str) -> Outcome:
    """The largest relative difference of numbers from the true ones, over the largest of these."""
    found, true = np.asarray(found, float), np.asarray(true, float)
    error = float(np.max(np.abs(found - true)) / (np.max(np.abs(true)) or 1.0))
    return Outcome(solution.status, error, allowed, truth, solution.residual)


def refused(solve: Callable[[], object], words: str, why: str) -> Outcome:
    """Whether a problem is refused with a sentence that holds some words."""
    try:
        solve()
    except ContactimgError as error:
        return Outcome(str(error), 0.0 if words in str(error) else np.inf, 0.0, why)
    return Outcome("not refused", np.inf, 0.0, why)


def caps(
    x: ArrayLike, y: ArrayLike = 0.0, *, height: ArrayLike = 4e-5, radius: float = RADIUS
) -> pd.DataFrame:
    """A table of spherical caps."""
    columns = np.broadcast_arrays(np.asarray(x, float), y, height, radius)
    return pd.DataFrame(dict(zip(("x_m", "y_m", "height_m", "radius_m"), columns, strict=True)))


def pattern(kind: str, side: float, seed: int = 2) -> pd.DataFrame:
    """A random pattern."""
    return generate_asperities(kind, side=side, rng=np.random.default_rng(seed))


def equations(
    solution: InteractingSolution, table: pd.DataFrame, lens: float, allowed: float = 1e-9
) -> Outcome:
    """Forces from the equations of point forces, summed one by one for some contacts.

    Each force is Hertz's at the indentation that lens, height and all other forces leave to its cap.
    """
    x0, y0 = solution.conditions.apex
    R, share = table["radius_m"].to_numpy(), 1.0 / (1.0 + table["radius_m"].to_numpy() / lens)
    x, y = x0 + share * (table["x_m"].to_numpy() - x0), y0 + share * (table["y_m"].to_numpy() - y0)
    rise = (x - x0) ** 2 / (2 * lens * share) + (y - y0) ** 2 / (2 * lens * share)
    gap = rise - table["height_m"].to_numpy()
    touching = np.flatnonzero(solution.force)
    rows = touching[:: -(-touching.size // SUMMED)]
    depth = solution.indentation - (gap[rows] - gap.min())
    for k, i in enumerate(rows):
        others = touching[touching != i]
        distance = np.hypot(x[others] - x[i], y[others] - y[i])
        depth[k] -= np.sum(solution.force[others] / distance) / (np.pi * MODULUS)
    force = 4 / 3 * MODULUS * np.sqrt(R[rows] * share[rows]) * np.maximum(depth, 0) ** 1.5
    error = float(np.abs(force - solution.force[rows]).sum() / force.sum())
    return Outcome(solution.status, error, allowed, "equations, summed one by one", solution.residual)


# --- one contact


@hard_case("one cap, Hertz, {:g} N", 1e-15, 1e-9, 1e-3, 1e2)
def _hertz_load(load: float) -> Outcome:
    solution = solve_interacting(caps([0.0]), load=load, **FLAT)
    true = hertz.radius(load, sphere_radius=RADIUS, contact_modulus=MODULUS)
    return compared(solution, solution.radius, true, 1e-9, "closed form (Hertz)")


@hard_case("one sphere, a/R = {:g}", 0.9999, 0.5, 0.9, 0.99)
def _wide_sphere(ratio: float) -> Outcome:
    a = ratio * RADIUS
    load = 2 * MODULUS * a**2 * quad(lambda t: np.sin(t) ** 2 * _sphere_slope(a * np.sin(t)), 0, np.pi / 2)[0]
    solution = solve_interacting(caps([0.0]), load=load, law="sphere", **FLAT)
    return compared(solution, solution.radius, a, 1e-7, "quadrature of Sneddon's integral")


def _sphere_slope(r: float) -> float:
    """Slope of the profile of a sphere."""
    return r / float(np.sqrt(RADIUS**2 - r**2))


@hard_case("one sphere, {:g} N: a/R = 1 to rounding", 1e2, quick=False)
def _beyond_the_equator(load: float) -> Outcome:
    solution = solve_interacting(caps([0.0]), load=load, law="sphere", **FLAT)
    true = (load / MODULUS + RADIUS**2) / (2 * RADIUS)
    return compared(solution, solution.indentation, true, 1e-9, "limit a/R = 1 of Sneddon's law")


@hard_case("one cap, no load")
def _no_load() -> Outcome:
    solution = solve_interacting(caps([0.0]), load=0.0, **FLAT)
    return compared(solution, solution.area, 0.0, 0.0, "no contact")


# --- adhesion


@hard_case("JKR, {:.7g} of the pull-off force", 0.999999, 0.0, 0.999)
def _pulled(share: float) -> Outcome:
    load = -share * 1.5 * np.pi * ADHESION * RADIUS
    solution = solve_adhesive(caps([0.0]), load=load, work_of_adhesion=ADHESION, **FLAT)
    true = jkr.radius(load, contact_modulus=MODULUS, **STICKY)
    # the radius goes with the square root of the distance from the end of the branch
    return compared(solution, solution.radius, true, 1e-6, "closed form (JKR)")


@hard_case("JKR, {:.7g} of the pull-off force", 1.000001)
def _pulled_off(share: float) -> Outcome:
    load = -share * 1.5 * np.pi * ADHESION * RADIUS
    solve = partial(solve_adhesive, caps([0.0]), load=load, work_of_adhesion=ADHESION, **FLAT)
    return refused(solve, "pull", "pull-off force of JKR")


@hard_case("JKR, jump into contact at an indentation of {:g} m", 0.0, 1e-15, quick=False)
def _jump_in(indentation: float) -> Outcome:
    solution = solve_adhesive(caps([0.0]), indentation=indentation, work_of_adhesion=ADHESION, **FLAT)
    true = jkr.radius_from_indentation(indentation, contact_modulus=MODULUS, **STICKY)
    return compared(solution, solution.radius, true, 1e-9, "closed form (JKR)")


@hard_case("JKR, stage at {:g} of the last indentation", 0.9999, 1.0001)
def _withdrawn(share: float) -> Outcome:
    last = jkr.pull_off_indentation(contact_modulus=MODULUS, **STICKY)
    stages = [LoadSpring(np.inf, part * last) for part in (0.0, 0.5, share)]
    *_, solution = solve_adhesive_path(caps([0.0]), loads=stages, work_of_adhesion=ADHESION, **FLAT)
    held = share < 1
    true = jkr.radius_from_indentation(share * last, contact_modulus=MODULUS, **STICKY) if held else 0.0
    return compared(solution, solution.radius, true, 1e-6, "closed form (JKR)")


@hard_case("adhesion of {:g} J/m2, RA-, 0.1 N", 1e-15, quick=False)
def _vanishing_adhesion(adhesion: float) -> Outcome:
    where = ROUGH | {"load": 0.1, "coupling": "full"}
    table = pattern("RA-", 2e-3)
    solution = solve_adhesive(table, work_of_adhesion=adhesion, **where)
    true = solve_interacting(table, **where).force
    return compared(solution, solution.force, true, 1e-6, "limit: the same without adhesion")


@hard_case("adhesive RA+, unloaded to {:g} N", 0.0, -2e-5)
def _unloaded(load: float) -> Outcome:
    where = ROUGH | {"work_of_adhesion": ADHESION, "loads": [0.05, 0.01, load]}
    *_, solution = solve_adhesive_path(pattern("RA+", 2e-3), **where)
    return Outcome(solution.status, np.nan, 0.0, "", solution.residual)


# --- layers


@hard_case("cap on a layer of {:g} m, nu {:g}, {:g} m deep", *LAYER_FORCES)
def _layer(key: tuple[float, float, float]) -> Outcome:
    thickness, ratio, depth = key
    solution = solve_interacting(
        caps([0.0]), indentation=depth, thickness=thickness, poisson_ratio=ratio, **FLAT
    )
    truth = f"boundary elements; a/t = {float(solution.radius[0]) / thickness:.2g}"
    return compared(solution, solution.load, LAYER_FORCES[key], 1e-5, truth)


@hard_case("cap on a layer of {:g} m, 5 mN", 5e-6)
def _layer_beyond(thickness: float) -> Outcome:
    solve = partial(solve_interacting, caps([0.0]), load=5e-3, thickness=thickness, **FLAT)
    return refused(solve, "2 thicknesses", "a/t beyond 2")


# --- neighbours


@hard_case("{} paraboloids {:g} radii apart", *GROUPS)
def _close_caps(key: tuple[int, float]) -> Outcome:
    count, distance = key
    a = 0.02
    turn = np.exp(1j * np.arange(6) * np.pi / 3) if count == 7 else np.ones(1)
    place = a * distance * np.concatenate([[0], turn])
    table = caps(place.real, place.imag, height=0.2, radius=1.0)
    load = count * 4 / 3 * MODULUS * a**3
    solution = solve_interacting(table, load=load, coupling="full", **FLAT)
    # the error that docs/models.md states for such contacts
    allowed = {2: 1e-3, 7: 4e-3}[count]
    return compared(solution, solution.area, GROUPS[key], allowed, "spectral solution of the whole problem")


@hard_case("two caps {:g} radii apart, which overlap", 0.645, 1.2)
def _overlapping_pair(distance: float) -> Outcome:
    a = 2e-5
    load = 2 * float(hertz.load(a, sphere_radius=RADIUS, contact_modulus=MODULUS))
    solution = solve_interacting(caps([0.0, distance * a]), load=load, **FLAT)
    true = a**2 / RADIUS + load / 2 / (np.pi * MODULUS * distance * a)
    return compared(solution, solution.indentation, true, 1e-9, "closed form")


@hard_case("two caps {:g} radii apart: several solutions", 0.63)
def _engulfed_pair(distance: float) -> Outcome:
    load = 2 * float(hertz.load(2e-5, sphere_radius=RADIUS, contact_modulus=MODULUS))
    solve = partial(solve_interacting, caps([0.0, distance * 2e-5]), load=load, **FLAT)
    return refused(solve, "rows 0 and 1", "stability ends at r/a = 2/pi")


@hard_case("two caps at the same place")
def _coincident() -> Outcome:
    solve = partial(solve_interacting, caps([0.0, 0.0]), load=1e-3, **FLAT)
    return refused(solve, "at the same place", "no solution is unique")


@hard_case("two caps at the same place, uncoupled")
def _coincident_uncoupled() -> Outcome:
    solution = solve_interacting(caps([0.0, 0.0]), load=1e-3, coupling="none", **FLAT)
    return compared(solution, solution.force, 5e-4, 1e-9, "symmetry")


# --- patterns


@hard_case("SA+ of 10 mm under a lens, {:g} N", 1.0, 1e-15, 1e-6, 1e-2)
def _soft_pattern(load: float) -> Outcome:
    table, lens = pattern("SA", 1e-2), 0.1288
    where = FLAT | {"indenter_radius": lens, "apex": (5e-3, 5e-3)}
    return equations(solve_interacting(table, load=load, **where), table, lens)


@hard_case("radii over six decades")
def _radii_over_decades() -> Outcome:
    rng = np.random.default_rng(8)
    radius = 10 ** rng.uniform(-7, -1, 200)
    x, y = rng.random((2, 200)) * 0.1
    table = caps(x, y, height=rng.random(200) * 1e-6).assign(radius_m=radius)
    return equations(solve_interacting(table, load=1e-2, **FLAT), table, np.inf)


@hard_case("E* of {:g} Pa, RA-", 1.0, 1e4, 1e12)
def _any_modulus(modulus: float) -> Outcome:
    solution, usual = (
        solve_interacting(
            pattern("RA-", 2e-3), load=0.1 * E / MODULUS, **ROUGH | {"contact_modulus": E, "coupling": "full"}
        )
        for E in (modulus, MODULUS)
    )
    return compared(solution, solution.radius, usual.radius, 1e-9, "the same problem in other units")


@hard_case("hexagons of 144 equal caps, {:g} N", 1e-9, 2.0, quick=False)
def _lattice(load: float) -> Outcome:
    column, row = np.meshgrid(np.arange(12), np.arange(12))
    x, y = 2e-4 * (column + 0.5 * (row % 2)), 2e-4 * row * np.sqrt(0.75)
    table = caps(x.ravel(), y.ravel())
    return equations(solve_interacting(table, load=load, **FLAT), table, np.inf)


@hard_case("pattern of {:.0e} caps", 1e5, 1e6, quick=False)
def _many(count: float) -> Outcome:
    side, lens = float(np.sqrt(count / 18.45e6)), 0.1288 * np.sqrt(count / 1845)
    table = pattern("SA", side)
    where = FLAT | {"indenter_radius": lens, "apex": (side / 2, side / 2)}
    # fast sums are good to 1e-9 of the displacement, some ten times what remains as indentation of a cap
    return equations(solve_interacting(table, load=5e-4 * count, **where), table, lens, 3e-8)


# --- load cell and base planes


@hard_case("RA- by a stage through {:g} N/m", 1e6, 1e12)
def _stiff_spring(stiffness: float) -> Outcome:
    table = pattern("RA-", 2e-3)
    solution = solve_interacting(table, load=LoadSpring(stiffness, 2e-5), **ROUGH)
    true = solve_interacting(table, indentation=2e-5 - solution.load / stiffness, **ROUGH).load
    return compared(solution, solution.load, true, 1e-8, "the indentation prescribed")


@hard_case("gap between base planes, RA-, {:g} N", 0.2, 0.05)
def _base_gap(load: float) -> Outcome:
    table = pattern("RA-", 2e-3)
    solution = solve_interacting(table, load=load, **ROUGH)
    base, R = table[["x_m", "y_m"]].to_numpy(), table["radius_m"].to_numpy()
    b = np.sqrt(2 * R * table["height_m"] - table["height_m"] ** 2).to_numpy()
    centre, half, least = np.array([1e-3, 1e-3]), 8e-4, np.inf
    for _ in range(4):
        x, y = (c + half * np.linspace(-1, 1, 121) for c in centre)
        x, y = (v.ravel() for v in np.meshgrid(x, y))
        free = np.all([np.hypot(x - p[0], y - p[1]) > r for p, r in zip(base, b, strict=True)], axis=0)
        x, y = x[free], y[free]
        gap = solution.summits.apexes["height_m"].max() + np.hypot(x - 1e-3, y - 1e-3) ** 2 / (2 * LENS)
        for i in solution.touching:
            r = np.hypot(x - solution.x[i], y - solution.y[i])
            gap += hertz.surface_displacement(
                r, radius=solution.radius[i], sphere_radius=solution.law_radius[i]
            )
        least = min(least, float(gap.min()) - solution.indentation)
        centre, half = np.array([x[gap.argmin()], y[gap.argmin()]]), half / 15
    found = solution.base_gap.least
    return compared(solution, found, least, 2e-8 / abs(least), "displacement on grids; 0.02 um allowed")


@hard_case("low caps far from the apex: planes first")
def _low_caps() -> Outcome:
    turn = np.arange(12) * np.pi / 6
    table = caps(1e-3 * np.cos(turn), 1e-3 * np.sin(turn), height=3e-5)
    load = find_touching_load(_scene(LENS, (0.0, 0.0)), table)
    return Outcome(f"touching load {load:g} N", load, 0.0, "1 mm^2/(2 x 13 mm) = 38 um above 30 um")


@hard_case("SA+ of 3 mm flattened by {:g} N", 50.0)
def _flattened(load: float) -> Outcome:
    scene, table = _scene(0.1288, (1.5e-3, 1.5e-3)), pattern("SA", 3e-3)
    return refused(
        lambda: predict_contacts(scene, table, load=load), "planes touch", "the base bears the load"
    )


def _scene(lens: float, apex: tuple[float, float]) -> Scene:
    """A lens on silicone rubber."""
    indenter = {"radius_m": lens, "apex_m": list(apex)}
    return scene_from_dict({"indenter": indenter, "elastic": {"young_modulus_Pa": 0.75 * MODULUS}})


# --- statistical models


def _rough(load: float, width: float, lens: float) -> dict[str, Any]:
    """Arguments of a statistical model with uniform heights."""
    shared = {"density": 18.45e6, "radius": RADIUS, "contact_modulus": MODULUS}
    return shared | {"heights": UniformHeights(0.0, width), "indenter_radius": lens, "load": load}


@hard_case("Greenwood-Tripp, heights of {:g} m", 1e-9, 1e-11)
def _smooth_sphere(width: float) -> Outcome:
    rings = solve_greenwood_tripp(**(_rough(0.5, width, 0.1288) | {"density": 1e12 / width**0.5}))
    true = hertz.peak_pressure(0.5, sphere_radius=0.1288, contact_modulus=MODULUS)
    return compared(rings, rings.pressure[0], true, 2e-3, "limit: Hertz's pressure of the smooth lens")


@hard_case("Greenwood-Tripp, {:g} N: dilute", 1e-9, 1e-12)
def _dilute(load: float) -> Outcome:
    arguments = _rough(load, 3e-5, 0.1288)
    rings = solve_greenwood_tripp(**arguments)
    true = solve_greenwood_williamson(**arguments).area
    return compared(rings, rings.area, true, 2e-3, "limit: Greenwood-Williamson")


@hard_case("Greenwood-Williamson, {:g} N", 0.3, 1e-15)
def _uniform_heights(load: float) -> Outcome:
    s, lens = 3e-5, 0.1288
    rings = solve_greenwood_williamson(**_rough(load, s, lens))
    # 2 pi Rl times the integral of (2/5) K sqrt(R) eta0 x^(5/2)/s over depth
    strength = 4 / 3 * MODULUS * np.sqrt(RADIUS) * 18.45e6 / s
    depth = (load * 35 / (8 * np.pi * lens * strength)) ** (2 / 7)
    return compared(rings, rings.depth.max(), depth, 1e-9, "closed form (Appendix B over the sphere)")
