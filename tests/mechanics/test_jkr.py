"""JKR's closed forms: inverses, stability, pull-off, the limit of Hertz, change of units, energy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from contactimg import InputError, ModelRangeError, hertz, jkr

LENS = {"sphere_radius": 0.1288, "contact_modulus": 4e6, "work_of_adhesion": 0.05}
ROUNDING = 1e-12  # square roots of sums of cubes


def test_radius_by_hand():
    # P = 0: a^3 = 6 pi w R^2/K = 6 pi 0.05 0.1288^2/(5.3333e6) = 2.93163e-9
    assert float(jkr.radius(0.0, **LENS)) ** 3 == pytest.approx(2.93163e-9, rel=1e-5)


def test_radius_is_the_formula_of_the_calibration():
    R, K, w, P = 0.1288, 4 / 3 * 4e6, 0.05, 0.2
    formula = R / K * (P + 3 * np.pi * w * R + np.sqrt(6 * np.pi * w * R * P + (3 * np.pi * w * R) ** 2))
    assert float(jkr.radius(P, **LENS)) ** 3 == pytest.approx(formula, rel=ROUNDING)


@given(st.floats(-0.999, 1e6), st.floats(1e-6, 1), st.floats(1e3, 1e9), st.floats(1e-4, 1))
def test_load_and_radius_are_inverse(factor, radius, modulus, work):
    where = {"sphere_radius": radius, "contact_modulus": modulus, "work_of_adhesion": work}
    pull = -jkr.pull_off_load(sphere_radius=radius, work_of_adhesion=work)
    load = factor * pull
    # at pull-off dP/da = 0, so the rounding of the radius leaves the load alone
    assert jkr.load(jkr.radius(load, **where), **where) == pytest.approx(
        load, abs=1e-13 * (abs(load) + pull) * 4
    )


@given(st.floats(-2.9999, 1e6))
def test_radius_from_indentation_inverts(factor):
    fold = jkr.pull_off_radius(**LENS, imposed="indentation")
    delta = factor * fold**2 / LENS["sphere_radius"]
    a = jkr.radius_from_indentation(delta, **LENS)
    assert a >= fold
    back = jkr.indentation_from_radius(a, **LENS)
    assert back == pytest.approx(delta, abs=1e-13 * (abs(delta) + 4 * fold**2 / LENS["sphere_radius"]))


def test_pull_off_is_where_the_branch_ends():
    a = jkr.pull_off_radius(**LENS)
    h = 1e-5 * a
    low, mid, high = jkr.load([a - h, a, a + h], **LENS)
    pull = jkr.pull_off_load(sphere_radius=0.1288, work_of_adhesion=0.05)
    assert mid == pytest.approx(pull, rel=ROUNDING)
    assert low > mid
    assert high > mid
    fold = jkr.pull_off_radius(**LENS, imposed="indentation")
    deltas = jkr.indentation_from_radius(fold * np.array([0.999, 1, 1.001]), **LENS)
    assert deltas[1] == deltas.min()
    assert deltas[1] == pytest.approx(jkr.pull_off_indentation(**LENS), rel=ROUNDING)
    with pytest.raises(ModelRangeError, match="below pull-off"):
        jkr.radius(1.001 * pull, **LENS)
    with pytest.raises(ModelRangeError, match="below pull-off"):
        jkr.radius_from_indentation(1.001 * deltas[1], **LENS)


def test_hertz_as_the_adhesion_vanishes():
    # to first order da/a = sqrt(6 pi w R P)/(3 P): halves when w falls by four
    ratios = [
        float(jkr.radius(0.2, sphere_radius=0.1288, contact_modulus=4e6, work_of_adhesion=w))
        / float(hertz.radius(0.2, sphere_radius=0.1288, contact_modulus=4e6))
        - 1
        for w in (4e-8, 1e-8, 0.0)
    ]
    assert ratios[0] / ratios[1] == pytest.approx(2, rel=1e-3)
    assert ratios[1] == pytest.approx(np.sqrt(6 * np.pi * 1e-8 * 0.1288 * 0.2) / 0.6, rel=1e-3)
    assert ratios[2] == pytest.approx(0, abs=ROUNDING)
    hertzian = jkr.radius_from_indentation(
        1e-6, sphere_radius=1e-4, contact_modulus=1.0, work_of_adhesion=0.0
    )
    assert hertzian == pytest.approx(1e-5, rel=ROUNDING)


def test_load_is_work_conjugate_to_the_indentation():
    # along equilibria the work of the load is the rise of elastic energy less the surface energy gained
    R, K, w = LENS["sphere_radius"], 4 / 3 * LENS["contact_modulus"], LENS["work_of_adhesion"]

    def elastic(a):
        # Hertz to a, then unload at constant a by P1 - P: stiffness 3 K a/2
        P = float(jkr.load(a, **LENS))
        hertzian = K * a**3 / R
        return 0.4 * hertzian * a**2 / R - (hertzian**2 - P**2) / (2 * 1.5 * K * a)

    low, high = 0.9e-3, 1.6e-3
    slope = lambda a: 2 * a / R - 0.5 * np.sqrt(8 * np.pi * w / (3 * K * a))  # noqa: E731
    work = quad(lambda a: float(jkr.load(a, **LENS)) * slope(a), low, high, epsrel=1e-12)[0]
    surface = w * np.pi * (high**2 - low**2)
    assert work == pytest.approx(elastic(high) - elastic(low) - surface, rel=1e-9)


@given(st.floats(1e-3, 1e3), st.floats(1e-3, 1e3))
def test_change_of_units(length, pressure):
    scaled = {
        "sphere_radius": 0.1288 * length,
        "contact_modulus": 4e6 * pressure,
        "work_of_adhesion": 0.05 * pressure * length,
    }
    assert jkr.radius(0.2 * pressure * length**2, **scaled) == pytest.approx(
        length * float(jkr.radius(0.2, **LENS)), rel=ROUNDING
    )
    assert jkr.indentation(0.2 * pressure * length**2, **scaled) == pytest.approx(
        length * float(jkr.indentation(0.2, **LENS)), rel=1e-10
    )


@pytest.mark.parametrize("closed_form", [jkr.radius, jkr.radius_from_indentation])
def test_of_several_spheres_the_pull_off_of_the_one_that_breaks_is_named(closed_form):
    radii = np.array([1e-3, 1e-4])
    where = {"contact_modulus": 4e6, "work_of_adhesion": 0.05}
    limit = jkr.pull_off_load(sphere_radius=1e-4, work_of_adhesion=0.05)
    if closed_form is jkr.radius_from_indentation:
        limit = jkr.pull_off_indentation(sphere_radius=1e-4, **where)
    with pytest.raises(ModelRangeError, match=rf"below pull-off, {limit:.6g} .*, got {1.5 * limit!r}"):
        closed_form([0.0, 1.5 * limit], sphere_radius=radii, **where)


def test_refusals():
    with pytest.raises(InputError, match="work_of_adhesion must not be negative"):
        jkr.radius(1.0, sphere_radius=1.0, contact_modulus=1.0, work_of_adhesion=-1.0)
    with pytest.raises(InputError, match="imposed must be"):
        jkr.pull_off_radius(**LENS, imposed="both")
