"""Adhesive asperities: JKR for one, Hertz without adhesion, hysteresis, pull-off."""

import numpy as np
import pandas as pd
import pytest

from contactimg import (
    InputError,
    ModelRangeError,
    generate_asperities,
    jkr,
    solve_adhesive,
    solve_adhesive_path,
    solve_interacting,
    sphere,
)
from contactimg.models.asperity_laws import AdhesiveLaw, Caps

ONE = pd.DataFrame({"x_m": [0.0], "y_m": [0.0], "height_m": [4e-5], "radius_m": [1e-4]})
FLAT = {"indenter_radius": np.inf, "contact_modulus": 4e6}
SPHERE = {"sphere_radius": 1e-4, "contact_modulus": 4e6, "work_of_adhesion": 0.05}
PULL = jkr.pull_off_load(sphere_radius=1e-4, work_of_adhesion=0.05)


@pytest.mark.parametrize("load", [1e-2, 1e-4, 0.0, 0.5 * PULL, 0.99 * PULL])
def test_one_asperity_is_jkr(load):
    solution = solve_adhesive(ONE, load=load, work_of_adhesion=0.05, **FLAT)
    assert solution.radius[0] == pytest.approx(float(jkr.radius(load, **SPHERE)), rel=1e-9)
    assert solution.indentation == pytest.approx(float(jkr.indentation(load, **SPHERE)), rel=1e-9, abs=1e-16)
    assert solution.load == pytest.approx(load, rel=1e-10, abs=1e-14)  # the solver's 1e-11


def test_pull_off_at_imposed_load_and_indentation():
    # at pull-off the radius answers to the residual r of the load as sqrt(r): 1e-11 -> 3e-6
    edge = solve_adhesive(ONE, load=PULL, work_of_adhesion=0.05, **FLAT)
    assert edge.radius[0] == pytest.approx(jkr.pull_off_radius(**SPHERE), rel=2e-5)
    with pytest.raises(ModelRangeError, match="load must not be below pull-off"):
        solve_adhesive(ONE, load=1.001 * PULL, work_of_adhesion=0.05, **FLAT)
    fold = jkr.pull_off_indentation(**SPHERE)
    pressed = solve_adhesive(ONE, indentation=1e-6, work_of_adhesion=0.05, **FLAT)
    held = solve_adhesive(ONE, indentation=0.99 * fold, start=pressed, work_of_adhesion=0.05, **FLAT)
    assert held.radius[0] == pytest.approx(
        float(jkr.radius_from_indentation(0.99 * fold, **SPHERE)), rel=1e-8
    )
    parted = solve_adhesive(ONE, indentation=1.01 * fold, start=held, work_of_adhesion=0.05, **FLAT)
    assert parted.radius[0] == 0
    approaching = solve_adhesive(ONE, indentation=0.5 * fold, work_of_adhesion=0.05, **FLAT)
    assert approaching.radius[0] == 0


@pytest.fixture(scope="module")
def patch():
    return generate_asperities("SA", side=3e-3, rng=np.random.default_rng(6))


LENS = {"indenter_radius": 0.1288, "contact_modulus": 4e6, "apex": (1.5e-3, 1.5e-3)}


@pytest.mark.parametrize("coupling", ["none", "asymptotic"])
def test_hertz_as_the_adhesion_vanishes(patch, coupling):
    without = solve_interacting(patch, load=0.05, coupling=coupling, **LENS)
    change = []
    for work in (4e-9, 1e-9):
        sticky = solve_adhesive(patch, load=0.05, coupling=coupling, work_of_adhesion=work, **LENS)
        change.append(sticky.area / without.area - 1)
    # the radii grow as sqrt(w): halved by a quarter of it
    assert change[0] / change[1] == pytest.approx(2, rel=0.05)
    assert 0 < change[1] < 1e-4


@pytest.mark.parametrize("coupling", ["none", "asymptotic"])
def test_equations_hold_and_contacts_remember(patch, coupling):
    loads = [0.02, 0.1, 0.02]
    up, top, down = solve_adhesive_path(patch, loads=loads, work_of_adhesion=0.05, coupling=coupling, **LENS)
    for solution, load in zip((up, top, down), loads, strict=True):
        rows = solution.touching
        r = np.hypot(*(c[rows, None] - c[rows] for c in (solution.x, solution.y)))
        np.fill_diagonal(r, np.inf)
        R = solution.composite_radius[rows]
        where = {"sphere_radius": R, "contact_modulus": 4e6, "work_of_adhesion": 0.05}
        a = solution.radius[rows]
        np.testing.assert_allclose(solution.force[rows], jkr.load(a, **where), rtol=1e-9, atol=1e-14)
        lens = 0.1288
        apex = np.asarray(patch["height_m"]) - (
            (patch["x_m"] - 1.5e-3) ** 2 + (patch["y_m"] - 1.5e-3) ** 2
        ) / (2 * (lens + patch["radius_m"]))
        gap = (apex.max() - apex).to_numpy()[rows]
        sag = solution.force[rows] @ (1 / (np.pi * 4e6 * r)) if coupling != "none" else 0.0
        delta = jkr.indentation_from_radius(a, **where)
        np.testing.assert_allclose(delta, solution.indentation - gap - sag, atol=1e-9 * solution.indentation)
        assert solution.load == pytest.approx(load, rel=1e-9)
    assert top.force.min() < 0
    if (
        coupling == "none"
    ):  # coupled, neighbours sinking under a load can tear off a contact that the load made
        assert down.touching.size >= up.touching.size
        assert down.area >= up.area * (1 - 1e-9)


def test_refusals(patch):
    with pytest.raises(InputError, match="work_of_adhesion must be positive"):
        solve_adhesive(patch, load=0.1, work_of_adhesion=0.0, **LENS)
    with pytest.raises(InputError, match="coupling must be one of"):
        solve_adhesive(patch, load=0.1, work_of_adhesion=0.1, coupling="hertz", **LENS)


# adhesion together with the sphere's profile, a layer and full coupling


@pytest.mark.parametrize(
    "options",
    [
        {"law": "sphere"},
        {"thickness": 2e-3},
        {"coupling": "full"},
        {"law": "sphere", "thickness": 2e-3, "coupling": "full"},
    ],
    ids=["sphere", "layer", "full", "all"],
)
def test_every_combination_becomes_the_one_without_adhesion(patch, options):
    without = solve_interacting(patch, load=0.05, **options, **LENS)
    for w in (1e-6, 1e-10):
        solution = solve_adhesive(patch, load=0.05, work_of_adhesion=w, **options, **LENS)
        change = np.abs(solution.force - without.force).sum() / 0.05
        # light contacts count: sqrt(6 pi w R p)/p <= 2e-2 for w = 1e-6 down to a thousandth of the mean force
        # of 1 mN, and a hundredth of that for w = 1e-10; the forces hardly redistribute
        assert change < 2e-2 * np.sqrt(w / 1e-6)
        assert solution.residual <= 1e-11


def test_adhesive_sphere():
    """JKR on an exact sphere: load and indentation less those of the flat punch."""
    a, R, w, E = 4e-5, 1e-4, 0.05, 4e6
    load = float(sphere.load(a, sphere_radius=R, contact_modulus=E)) - np.sqrt(8 * np.pi * w * E * a**3)
    depth = float(sphere.indentation_from_radius(a, sphere_radius=R)) - np.sqrt(2 * np.pi * w * a / E)
    solution = solve_adhesive(ONE, load=load, work_of_adhesion=w, law="sphere", **FLAT)
    assert solution.radius[0] == pytest.approx(a, rel=1e-9)
    assert solution.indentation == pytest.approx(depth, rel=1e-9)


@pytest.mark.parametrize("aspect", [0.0, 0.01, 0.5])
@pytest.mark.parametrize("w", [1e-4, 1.0])
@pytest.mark.parametrize("bends", [None, np.array([[0.1, 0.05], [-0.2, 0.0], [0.3, 0.2]])])
def test_adhesive_law_is_consistent(bends, w, aspect):
    law, caps = AdhesiveLaw(w, aspect), Caps(np.array([0.5, 1.0, 2.0]), bends=bends)
    touch, fold = law.touch_radius(caps), law.fold(caps)
    np.testing.assert_allclose(law.penetration(touch, caps), 0, atol=1e-13)
    np.testing.assert_allclose(law.slopes(fold, caps)[1], 0, atol=1e-10)
    np.testing.assert_array_less(fold, touch)
    depth = np.array([0.1, 0.4, 0.2])
    a = law.contact_radius(depth, caps)
    np.testing.assert_allclose(law.penetration(a, caps), depth, rtol=1e-12)
    step = 1e-5 * a
    for function, slope in zip((law.force, law.penetration), law.slopes(a, caps), strict=True):
        rise = (function(a + step, caps) - function(a - step, caps)) / (2 * step)
        # central differences: third derivatives times step^2/6, and rounding over the step
        np.testing.assert_allclose(rise, slope, rtol=1e-6)


def test_far_neighbours_of_an_adhesive_contact():
    """Full coupling over point forces at imposed indentation, to third order in a/r.

    A neighbour with Hertz's part p and the punch's part t lowers the surface by
    (p a^2/10 - t a^2/6)/(pi E* r^3) more than a point force; its field's curvature T = (p - t)/(2 pi E* r^3)
    makes 1/R larger by T.
    """
    w, R, E, depth, r = 0.05, 1e-4, 4e6, 6e-6, 6e-4
    pair = pd.DataFrame({"x_m": [0.0, r], "y_m": 0.0, "height_m": 4e-5, "radius_m": R})
    where = {"indentation": depth, "work_of_adhesion": w, **FLAT}
    point, full = (solve_adhesive(pair, coupling=c, **where) for c in ("asymptotic", "full"))
    a = point.radius[0]
    t = np.sqrt(8 * np.pi * w * E * a**3)
    p = point.force[0] + t
    lowering = (p * a**2 / 10 - t * a**2 / 6) / (np.pi * E * r**3) + a**2 * (p - t) / (2 * np.pi * E * r**3)
    softness = 2 * a / R - np.sqrt(np.pi * w / (2 * a * E))
    # the forces change too, and with them what point forces lower, by a/r of the effect itself; the shifts
    # count to fourth order in a/r
    assert full.radius[0] - point.radius[0] == pytest.approx(-lowering / softness, rel=3 * a / r)
    assert full.radius[0] == pytest.approx(full.radius[1], rel=1e-12)


def test_full_coupling_that_does_not_settle_is_approximate():
    """A soft, sticky pattern: the closest iteration, with what its radii still change by."""
    rng = np.random.default_rng(130)
    rng.choice(3), rng.choice(2)
    table = generate_asperities("RA+", side=1e-3, coverage=float(rng.uniform(0.2, 0.5)), rng=rng)
    load = 10 ** rng.uniform(-7, -1.5)
    work, modulus = 10 ** rng.uniform(-2.5, 0), 10 ** rng.uniform(4.5, 7)
    solution = solve_adhesive(
        table,
        load=load,
        indenter_radius=0.013,
        contact_modulus=modulus,
        work_of_adhesion=work,
        coupling="full",
        apex=(5e-4, 5e-4),
    )
    assert "did not settle" in solution.status
    assert solution.load == pytest.approx(load, rel=1e-6)
