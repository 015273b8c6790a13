"""Sneddon's exact sphere: inverses, its own differential identity, the limit of Hertz."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contactimg import ModelRangeError, hertz, sphere

WHERE = {"sphere_radius": 1e-4, "contact_modulus": 4e6}


@settings(deadline=None)  # the first call compiles the law
@given(st.floats(1e-6, 0.999))
def test_inverses(ratio):
    a = ratio * 1e-4
    delta = sphere.indentation_from_radius(a, sphere_radius=1e-4)
    # towards the equator a/R = tanh(t) loses digits as 1/(1 - ratio^2)
    loss = 4e-16 / (1 - ratio**2)
    assert sphere.radius_from_indentation(delta, sphere_radius=1e-4) == pytest.approx(
        a, rel=1e-13 + 10 * loss
    )
    assert sphere.radius(sphere.load(a, **WHERE), **WHERE) == pytest.approx(a, rel=1e-13 + 10 * loss)


@pytest.mark.parametrize("ratio", [0.05, 0.0999, 0.1001, 0.3, 0.8])
def test_stiffness_is_twice_modulus_times_radius(ratio):
    # any axisymmetric punch: dP/d delta = 2 E* a; central differences of step h err by about h^2 = 1e-8
    a, h = ratio * 1e-4, 1e-4
    up, down = a * (1 + h), a * (1 - h)
    rise = sphere.load(up, **WHERE) - sphere.load(down, **WHERE)
    run = sphere.indentation_from_radius(up, sphere_radius=1e-4) - sphere.indentation_from_radius(
        down, sphere_radius=1e-4
    )
    assert float(rise / run) == pytest.approx(2 * 4e6 * a, rel=1e-6)


def test_hertz_for_small_contacts():
    for ratio in (1e-2, 1e-3):
        a = ratio * 1e-4
        excess = float(sphere.load(a, **WHERE) / hertz.load(a, **WHERE)) - 1
        # series: 1 + (2/5) s^2 + (9/35) s^4; rounding 1e-15
        assert excess == pytest.approx(0.4 * ratio**2, rel=ratio**2, abs=1e-14)


def test_equator_is_refused():
    with pytest.raises(ModelRangeError, match="below the sphere's radius"):
        sphere.load(1e-4, **WHERE)


@pytest.mark.parametrize("exponent", [0, 1, 2, 5, 20, 100])
def test_any_load_has_a_radius_within_the_sphere(exponent):
    found = float(sphere.radius(10.0**exponent, sphere_radius=1.0, contact_modulus=1.0))
    assert 0.7 < found <= 1.0
