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
)

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
