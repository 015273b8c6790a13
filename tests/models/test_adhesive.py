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
        solve_adhesive(patch, load=0.1, work_of_adhesion=0.1, coupling="full", **LENS)


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        (lambda patch: patch.drop(columns="radius_m"), "column 'radius_m' is missing"),
        (lambda patch: patch.assign(radius_m=-1e-4), "row 0, column 'radius_m' must be positive"),
        (lambda patch: patch.assign(radius_m="wide"), "row 0, column 'radius_m' must be a number"),
    ],
)
def test_a_table_that_breaks_a_rule_is_refused_with_its_row(patch, table, sentence):
    with pytest.raises(InputError, match=sentence):
        solve_adhesive(table(patch), load=0.1, work_of_adhesion=0.1, **LENS)


def test_a_start_from_another_table_is_refused(patch):
    how = {"load": 0.01, "work_of_adhesion": 0.05} | LENS
    start = solve_adhesive(patch, **how)
    with pytest.raises(InputError, match=f"the same table of {len(patch) - 1} asperities, got one of"):
        solve_adhesive(patch.iloc[1:], start=start, **how)


# adhesion together with the sphere's profile and a layer


@pytest.mark.parametrize(
    "options",
    [
        {"law": "sphere"},
        {"thickness": 2e-3},
        {"law": "sphere", "thickness": 2e-3},
    ],
    ids=["sphere", "layer", "both"],
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
