"""Every hard case of the contact models: those of `contactimg selftest` and more of each kind."""

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.integrate import quad

from contactimg.mechanics import hertz, jkr
from contactimg.models.adhesive import solve_adhesive, solve_adhesive_path
from contactimg.models.greenwood_tripp import solve_greenwood_tripp
from contactimg.models.greenwood_williamson import solve_greenwood_williamson
from contactimg.models.hard_cases import (
    ADHESION,
    CASES,
    FLAT,
    MODULUS,
    RADIUS,
    STICKY,
    Outcome,
    caps,
    close_caps,
    compared,
    equations,
    hertz_load,
    jump_in,
    layer,
    overlapping_pair,
    pattern,
    pulled,
    refused,
    rough_lens,
    soft_pattern,
    uniform_heights,
)
from contactimg.models.interacting import solve_interacting
from contactimg.prediction import find_touching_load, predict_contacts
from contactimg.scene import scene_from_dict

LENS = 0.013
ROUGH = FLAT | {"indenter_radius": LENS, "apex": (1e-3, 1e-3)}
"""Under the rough lens, radius 13 mm, above the middle of a pattern of 2 mm."""

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

ALL_CASES = dict(CASES)


def hard_case(name, *values):
    """Declare a case for each value, or one without any."""

    def declare(check):
        for value in values:
            arguments = value if isinstance(value, tuple) else (value,)
            ALL_CASES[name.format(*arguments)] = partial(check, *arguments)
        if not values:
            ALL_CASES[name] = check
        return check

    return declare


hard_case("one cap, Hertz, {:g} N", 1e-9, 1e2)(hertz_load)
hard_case("JKR, {:.7g} of the pull-off force", 0.0, 0.999)(pulled)
more_forces = [(*key, force) for key, force in LAYER_FORCES.items()]
hard_case("cap on a layer of {:g} m, nu {:g}, {:g} m deep", *more_forces)(layer)
hard_case("{} paraboloids {:g} radii apart", *((*key, area) for key, area in GROUPS.items()))(close_caps)
hard_case("SA+ of 10 mm under a lens, {:g} N", 1e-15, 1e-6, 1e-2)(soft_pattern)
hard_case("Greenwood-Williamson, {:g} N", 1e-15)(uniform_heights)
hard_case("JKR, jump into contact at an indentation of {:g} m", 1e-15)(jump_in)
hard_case("two caps {:g} radii apart, which overlap", 0.645)(overlapping_pair)


@hard_case("one sphere, {:g} N: a/R = 1 to rounding", 1e2)
def _beyond_the_equator(load):
    solution = solve_interacting(caps([0.0]), load=load, law="sphere", **FLAT)
    true = (load / MODULUS + RADIUS**2) / (2 * RADIUS)
    return compared(solution, solution.indentation, true, 1e-9, "limit a/R = 1 of Sneddon's law")


@hard_case("one cap, no load")
def _no_load():
    solution = solve_interacting(caps([0.0]), load=0.0, **FLAT)
    return compared(solution, solution.area, 0.0, 0.0, "no contact")


@hard_case("JKR, stage at {:g} of the last indentation", 0.9999, 1.0001)
def _withdrawn(share):
    last = jkr.pull_off_indentation(contact_modulus=MODULUS, **STICKY)
    solution = None
    for part in (0.0, 0.5, share):
        where = FLAT | {"indentation": part * last, "start": solution}
        solution = solve_adhesive(caps([0.0]), work_of_adhesion=ADHESION, **where)
    held = share < 1
    true = jkr.radius_from_indentation(share * last, contact_modulus=MODULUS, **STICKY) if held else 0.0
    return compared(solution, solution.radius, true, 1e-6, "closed form (JKR)")


@hard_case("adhesion of {:g} J/m2, RA-, 0.1 N", 1e-15)
def _vanishing_adhesion(adhesion):
    where = ROUGH | {"load": 0.1}
    table = pattern("RA-", 2e-3)
    solution = solve_adhesive(table, work_of_adhesion=adhesion, **where)
    true = solve_interacting(table, **where).force
    return compared(solution, solution.force, true, 1e-6, "limit: the same without adhesion")


@hard_case("adhesive RA+, unloaded to {:g} N", 0.0, -2e-5)
def _unloaded(load):
    where = ROUGH | {"work_of_adhesion": ADHESION, "loads": [0.05, 0.01, load]}
    *_, solution = solve_adhesive_path(pattern("RA+", 2e-3), **where)
    return Outcome(solution.status, np.nan, 0.0, "", solution.residual)


@hard_case("two caps at the same place, uncoupled")
def _coincident_uncoupled():
    solution = solve_interacting(caps([0.0, 0.0]), load=1e-3, coupling="none", **FLAT)
    return compared(solution, solution.force, 5e-4, 1e-9, "symmetry")


@hard_case("radii over six decades")
def _radii_over_decades():
    rng = np.random.default_rng(8)
    radius = 10 ** rng.uniform(-7, -1, 200)
    x, y = rng.random((2, 200)) * 0.1
    table = caps(x, y, height=rng.random(200) * 1e-6).assign(radius_m=radius)
    return equations(solve_interacting(table, load=1e-2, **FLAT), table, np.inf)


@hard_case("E* of {:g} Pa, RA-", 1.0, 1e4, 1e12)
def _any_modulus(modulus):
    solution, usual = (
        solve_interacting(
            pattern("RA-", 2e-3), load=0.1 * E / MODULUS, **ROUGH | {"contact_modulus": E, "coupling": "full"}
        )
        for E in (modulus, MODULUS)
    )
    return compared(solution, solution.radius, usual.radius, 1e-9, "the same problem in other units")


@hard_case("hexagons of 144 equal caps, {:g} N", 1e-9, 2.0)
def _lattice(load):
    column, row = np.meshgrid(np.arange(12), np.arange(12))
    x, y = 2e-4 * (column + 0.5 * (row % 2)), 2e-4 * row * np.sqrt(0.75)
    table = caps(x.ravel(), y.ravel())
    return equations(solve_interacting(table, load=load, **FLAT), table, np.inf)


@hard_case("pattern of {:.0e} caps", 1e5, 1e6)
def _many(count):
    side, lens = float(np.sqrt(count / 18.45e6)), 0.1288 * np.sqrt(count / 1845)
    table = pattern("SA", side)
    where = FLAT | {"indenter_radius": lens, "apex": (side / 2, side / 2)}
    # fast sums are good to 1e-9 of the displacement, some ten times what remains as indentation of a cap
    found = equations(solve_interacting(table, load=5e-4 * count, **where), table, lens)
    return replace(found, allowed=3e-8)


@hard_case("gap between base planes, RA-, {:g} N", 0.2, 0.05)
def _base_gap(load):
    table = pattern("RA-", 2e-3)
    solution = solve_interacting(table, load=load, **ROUGH)
    base, R = table[["x_m", "y_m"]].to_numpy(), table["radius_m"].to_numpy()
    b = np.sqrt(2 * R * table["height_m"] - table["height_m"] ** 2).to_numpy()
    centre, half, least = np.array([1e-3, 1e-3]), 8e-4, np.inf
    for _ in range(4):
        x, y = (c + half * np.linspace(-1, 1, 81) for c in centre)
        x, y = (v.ravel() for v in np.meshgrid(x, y))
        free = np.all([np.hypot(x - p[0], y - p[1]) > r for p, r in zip(base, b, strict=True)], axis=0)
        x, y = x[free], y[free]
        gap = solution.summits.apexes["height_m"].max() + np.hypot(x - 1e-3, y - 1e-3) ** 2 / (2 * LENS)
        for i in solution.touching:
            r = np.hypot(x - solution.x[i], y - solution.y[i])
            gap += hertz.surface_displacement(
                r, radius=solution.radius[i], sphere_radius=solution.composite_radius[i]
            )
        least = min(least, float(gap.min()) - solution.indentation)
        centre, half = np.array([x[gap.argmin()], y[gap.argmin()]]), half / 15
    found = solution.base_gap.least
    return compared(solution, found, least, 2e-8 / abs(least), "displacement on grids; 0.02 um allowed")


@hard_case("low caps far from the apex: planes first")
def _low_caps():
    turn = np.arange(12) * np.pi / 6
    table = caps(1e-3 * np.cos(turn), 1e-3 * np.sin(turn), height=3e-5)
    load = find_touching_load(_scene(LENS, (0.0, 0.0)), table)
    return Outcome(f"touching load {load:g} N", load, 0.0, "1 mm^2/(2 x 13 mm) = 38 um above 30 um")


@hard_case("SA+ of 3 mm flattened by {:g} N", 50.0)
def _flattened(load):
    scene, table = _scene(0.1288, (1.5e-3, 1.5e-3)), pattern("SA", 3e-3)
    return refused(
        lambda: predict_contacts(scene, table, load=load), "planes touch", "the base bears the load"
    )


def _scene(lens, apex):
    """A lens on silicone rubber."""
    indenter = {"radius_m": lens, "apex_m": list(apex)}
    return scene_from_dict({"indenter": indenter, "elastic": {"young_modulus_Pa": 0.75 * MODULUS}})


@hard_case("Greenwood-Tripp, {:g} N: dilute", 1e-9, 1e-12)
def _dilute(load):
    arguments = rough_lens(load, 3e-5, 0.1288)
    rings = solve_greenwood_tripp(**arguments)
    true = solve_greenwood_williamson(**arguments).area
    return compared(rings, rings.area, true, 2e-3, "limit: Greenwood-Williamson")


@hard_case("one sphere, a/R = {:g}", 0.9999, 0.5, 0.9, 0.99)
def wide_sphere(ratio):
    """One sphere pressed to a ratio a/R."""
    a = ratio * RADIUS
    load = 2 * MODULUS * a**2 * quad(lambda t: np.sin(t) ** 2 * _sphere_slope(a * np.sin(t)), 0, np.pi / 2)[0]
    solution = solve_interacting(caps([0.0]), load=load, law="sphere", **FLAT)
    return compared(solution, solution.radius, a, 1e-7, "quadrature of Sneddon's integral")


def _sphere_slope(r):
    """Slope of the profile of a sphere."""
    return r / float(np.sqrt(RADIUS**2 - r**2))


@hard_case("JKR, {:.7g} of the pull-off force", 1.000001)
def pulled_off(share):
    """One adhesive cap under more than its pull-off force."""
    load = -share * 1.5 * np.pi * ADHESION * RADIUS
    solve = partial(solve_adhesive, caps([0.0]), load=load, work_of_adhesion=ADHESION, **FLAT)
    return refused(solve, "pull", "pull-off force of JKR")


@hard_case("Greenwood-Tripp, heights of {:g} m", 1e-9, 1e-11)
def smooth_sphere(width):
    """Greenwood and Tripp's model with heights that scatter by next to nothing (m)."""
    rings = solve_greenwood_tripp(**(rough_lens(0.5, width, 0.1288) | {"density": 1e12 / width**0.5}))
    true = hertz.peak_pressure(0.5, sphere_radius=0.1288, contact_modulus=MODULUS)
    return compared(rings, rings.pressure[0], true, 2e-3, "limit: Hertz's pressure of the smooth lens")
