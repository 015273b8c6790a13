"""A load cell: P = k (d - D), between prescribed load and prescribed indentation."""

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import brentq

from contactimg import LoadSpring, generate_asperities, hertz, jkr, solve_adhesive, solve_adhesive_path
from contactimg import solve_interacting as solve
from contactimg.errors import InputError

LENS = {"indenter_radius": 0.1288, "contact_modulus": 4e6, "apex": (1e-3, 1e-3)}
FLAT = {"indenter_radius": np.inf, "contact_modulus": 4e6}
ONE = pd.DataFrame({"x_m": [0.0], "y_m": [0.0], "height_m": [4e-5], "radius_m": [1e-4]})
BALL = {"sphere_radius": 1e-4, "contact_modulus": 4e6}
STICKY = {**BALL, "work_of_adhesion": 0.05}


@pytest.fixture(scope="module")
def patch():
    return generate_asperities("SA", side=2e-3, rng=np.random.default_rng(4))


def test_one_asperity_on_a_spring():
    # (4/3) E* sqrt(R) D^(3/2) = k (d - D)
    cell = LoadSpring(stiffness=300.0, displacement=2e-5)
    depth = brentq(
        lambda D: float(hertz.load_from_indentation(D, **BALL)) - cell.load_at(D), 0, 2e-5, xtol=1e-20
    )
    solution = solve(ONE, load=cell, **FLAT)
    assert solution.indentation == pytest.approx(depth, rel=1e-10)
    assert solution.load == pytest.approx(cell.load_at(depth), rel=1e-10)


@pytest.mark.parametrize("coupling", ["none", "asymptotic", "full"])
@pytest.mark.parametrize("method", ["dense", "fast"])
def test_the_spring_agrees_with_its_load_and_its_indentation(patch, coupling, method):
    if method == "fast" and coupling != "asymptotic":
        return
    by_load = solve(patch, load=0.05, coupling=coupling, **LENS)
    for stiffness in (10.0, 1e4, 1e9):
        cell = LoadSpring(stiffness, by_load.indentation + 0.05 / stiffness)
        sprung = solve(patch, load=cell, coupling=coupling, method=method, **LENS)
        # a stiff cell rounds its load by 1e-16 k d
        allowed = 1e-9 * 0.05 + 1e-15 * stiffness * cell.displacement
        np.testing.assert_allclose(sprung.force, by_load.force, atol=allowed)


def test_limits_of_the_stiffness(patch):
    # k -> infinity: D = d to first order in P/(k d); k -> 0 with k d = P: the load P to first order in k D/P
    rigid = solve(patch, indentation=1e-5, **LENS)
    loaded = solve(patch, load=0.05, **LENS)
    for factor in (1e3, 1e4):
        stiff = solve(patch, load=LoadSpring(factor * rigid.load / 1e-5, 1e-5), **LENS)
        assert 0 < 1 - stiff.indentation / 1e-5 < 1.01 / factor
        softness = 0.05 / loaded.indentation / factor
        soft = solve(patch, load=LoadSpring(softness, 0.05 / softness), **LENS)
        assert 0 < 1 - soft.load / 0.05 < 1.01 / factor


def test_change_of_units(patch):
    base = solve(patch, load=LoadSpring(2e3, 3e-5), coupling="full", **LENS)
    length, pressure = 7.3, 0.02
    scaled = solve(
        patch * length,
        load=LoadSpring(2e3 * length * pressure, 3e-5 * length),
        coupling="full",
        indenter_radius=0.1288 * length,
        contact_modulus=4e6 * pressure,
        apex=(1e-3 * length, 1e-3 * length),
    )
    np.testing.assert_allclose(scaled.force, base.force * pressure * length**2, rtol=1e-9)


def test_nothing_touches_before_the_first_touch(patch):
    apart = solve(patch, load=LoadSpring(100.0, -1e-6), **LENS)
    assert apart.load == 0
    assert apart.indentation == pytest.approx(-1e-6)
    with pytest.raises(InputError, match="stiffness of a load spring must be positive"):
        LoadSpring(0.0, 1e-6)


@pytest.mark.parametrize("stiffness", [1.0, 50.0, 1e5])
def test_jump_in_and_pull_off_of_an_adhesive_asperity(stiffness):
    # at first touch (d = 0) the asperity jumps to the JKR state on the line P = -k D; it parts where the
    # slope of the JKR branch is -k, at d = D + P/k
    def state(a):
        return np.array([float(jkr.load(a, **STICKY)), float(jkr.indentation_from_radius(a, **STICKY))])

    touched = solve_adhesive(ONE, load=LoadSpring(stiffness, 0.0), work_of_adhesion=0.05, **FLAT)
    load, depth = touched.load, touched.indentation
    assert load == pytest.approx(-stiffness * depth, rel=1e-8)
    np.testing.assert_allclose(state(touched.radius[0]), [load, depth], rtol=1e-8, atol=1e-13)
    assert load < 0 < depth
    radii = np.linspace(0.2, 1, 200_001) * float(touched.radius[0])
    along = np.array(jkr_curve(radii))
    displacement = along[1] + along[0] / stiffness
    parting = float(displacement.min())
    path = [LoadSpring(stiffness, d) for d in (0.0, 0.999 * parting, 1.001 * parting)]
    _, held, parted = solve_adhesive_path(ONE, loads=path, work_of_adhesion=0.05, **FLAT)
    assert held.radius[0] > 0
    assert parted.radius[0] == 0
    assert parted.indentation == pytest.approx(1.001 * parting)


def jkr_curve(a):
    """Load and indentation: p = 4E*a^3/3R - sqrt(8 pi w E* a^3), d = a^2/R - sqrt(2 pi w a/E*)."""
    E, R, w = 4e6, 1e-4, 0.05
    return 4 * E * a**3 / (3 * R) - np.sqrt(8 * np.pi * w * E * a**3), a**2 / R - np.sqrt(
        2 * np.pi * w * a / E
    )


@pytest.mark.parametrize("side", [0.004, 0.01])
def test_stiff_cells_lead_to_the_prescribed_indentation(side):
    table = generate_asperities("RA-", side=side, rng=np.random.default_rng(2))
    where = {"indenter_radius": 0.013, "contact_modulus": 4e6, "apex": (side / 2, side / 2)}
    rigid = solve(table, indentation=2e-5, **where)
    for stiffness in (1e4, 1e6, 1e8, 1e12):
        solution = solve(table, load=LoadSpring(stiffness, 2e-5), **where)
        assert solution.status == "converged"
        assert solution.load == pytest.approx(stiffness * (2e-5 - solution.indentation), abs=1e-9 * stiffness)
        # dP/dD < 1e4 N/m, so that the cell gives way by less than P/k and loses less than 1e4 P/k
        assert 0 <= rigid.load - solution.load < 1e4 * rigid.load / stiffness + 1e-9
