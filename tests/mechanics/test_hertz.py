"""Hertz's closed forms: arithmetic, inverses, change of units, quadrature of the pressure, the gap."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from contactimg import InputError, hertz, sphere
from contactimg.mechanics.hertz import displacement_factor

LENS = {"sphere_radius": 0.1288, "contact_modulus": 4e6}
ROUNDING = 1e-13  # a handful of operations of 1e-16 each, cubed or cube-rooted


def test_load_by_hand():
    # K = 4/3 * 4e6; K a^3/R = 5.3333e6 * 8e-15 / 1e-4 = 4.2667e-4
    assert hertz.load(20e-6, sphere_radius=1e-4, contact_modulus=4e6) == pytest.approx(
        4.2666666667e-4, rel=1e-10
    )


@given(st.floats(1e-15, 1e6), st.floats(1e-6, 10), st.floats(1, 1e12))
def test_inverses(load, radius, modulus):
    where = {"sphere_radius": radius, "contact_modulus": modulus}
    a = hertz.radius(load, **where)
    assert hertz.load(a, **where) == pytest.approx(load, rel=ROUNDING)
    delta = hertz.indentation(load, **where)
    assert hertz.load_from_indentation(delta, **where) == pytest.approx(load, rel=ROUNDING)
    assert hertz.radius_from_indentation(delta, sphere_radius=radius) == pytest.approx(float(a), rel=ROUNDING)


@given(st.floats(1e-3, 1e3), st.floats(1e-3, 1e3))
def test_change_of_units(length, pressure):
    scaled = {"sphere_radius": 0.1288 * length, "contact_modulus": 4e6 * pressure}
    a = hertz.radius(0.5, **LENS)
    assert hertz.radius(0.5 * pressure * length**2, **scaled) == pytest.approx(
        float(a) * length, rel=ROUNDING
    )
    assert hertz.peak_pressure(0.5 * pressure * length**2, **scaled) == pytest.approx(
        pressure * float(hertz.peak_pressure(0.5, **LENS)), rel=ROUNDING
    )
    delta = hertz.annulus(0.5 * pressure * length**2, roughness=3e-5 * length, **scaled)
    assert delta == pytest.approx(length * float(hertz.annulus(0.5, roughness=3e-5, **LENS)), rel=ROUNDING)


def test_pressure_sums_to_the_load():
    a = float(hertz.radius(0.5, **LENS))
    total = quad(lambda r: 2 * np.pi * r * float(hertz.pressure(r, radius=a, **LENS)), 0, a, epsrel=1e-10)[0]
    assert total == pytest.approx(0.5, rel=1e-8)


def test_work_is_the_integral_of_the_load():
    # int K sqrt(R) d^(3/2) = (2/5) K sqrt(R) d^(5/2) = (2/5) P d
    depth = 5e-6
    where = {"sphere_radius": 1e-4, "contact_modulus": 4e6}
    work = quad(lambda d: float(hertz.load_from_indentation(d, **where)), 0, depth, epsrel=1e-12)[0]
    assert work == pytest.approx(0.4 * depth * float(hertz.load_from_indentation(depth, **where)), rel=1e-10)


def test_displacement_is_that_of_the_pressure():
    # superpose point forces: u(r) = (1/(pi E)) int p(s) <1/|r - s|> dA over the disc, at r = 2a
    a, r = 1e-3, 2e-3
    field = lambda s, t: s * np.sqrt(1 - s**2) / np.sqrt((r / a) ** 2 + s**2 - 2 * r / a * s * np.cos(t))  # noqa: E731
    inner = [
        quad(field, 0, 1, args=(t,), epsrel=1e-10)[0] for t in np.linspace(0, 2 * np.pi, 64, endpoint=False)
    ]
    peak = float(hertz.pressure(0.0, radius=a, **LENS))
    expected = peak * a / (np.pi * LENS["contact_modulus"]) * 2 * np.pi * np.mean(inner)
    u = hertz.surface_displacement(r, radius=a, sphere_radius=LENS["sphere_radius"])
    assert u == pytest.approx(expected, rel=1e-8)


def test_displacement_factor_is_smooth_where_the_series_takes_over():
    # the closed form cancels to 1e-16/q^3 = 1e-12 there, the series is exact to 3e-13
    below, above = displacement_factor(0.05 * (1 - 1e-9)), displacement_factor(0.05 * (1 + 1e-9))
    assert above == pytest.approx(float(below), abs=3e-12)
    assert displacement_factor(1.0) == pytest.approx(3 * np.pi / 8, rel=ROUNDING)


def edge_gap(distance, a, R):
    """Leading term of the gap at a small distance outside the edge (Appendix A of the paper)."""
    return 8 * np.sqrt(2 * a) / (3 * np.pi * R) * distance**1.5


def test_gap_matches_its_definition_and_its_edge():
    a, R = 2e-5, 1e-4
    r = a * np.array([1.3, 2.0, 5.0])
    definition = hertz.surface_displacement(r, radius=a, sphere_radius=R) - (2 * a**2 - r**2) / (2 * R)
    np.testing.assert_allclose(hertz.gap(r, radius=a, sphere_radius=R), definition, rtol=1e-12)
    assert hertz.gap(0.9 * a, radius=a, sphere_radius=R) == 0
    for part in (1e-3, 1e-5, 1e-7):
        exact = float(hertz.gap(a * (1 + part), radius=a, sphere_radius=R))
        leading = float(edge_gap(a * part, a, R))
        # the leading term exceeds the gap by (r - a)/(20 a); r - a itself is known to 1e-16/part
        assert leading / exact - 1 == pytest.approx(part / 20, abs=0.05 * part + 4e-16 / part)


def test_annulus_is_where_the_leading_gap_equals_the_roughness():
    width = float(hertz.annulus(0.2, roughness=3e-5, **LENS))
    a = float(hertz.radius(0.2, **LENS))
    assert edge_gap(width, a, 0.1288) == pytest.approx(3e-5, rel=ROUNDING)
    # and in the paper's form
    K = 4 / 3 * LENS["contact_modulus"]
    paper = (
        (3 * np.pi / (8 * np.sqrt(2))) ** (2 / 3) * 0.1288 ** (5 / 9) * 3e-5 ** (2 / 3) * (K / 0.2) ** (1 / 9)
    )
    assert width == pytest.approx(paper, rel=ROUNDING)


@pytest.mark.parametrize("kind", [list, tuple, np.array])
@pytest.mark.parametrize("law", [hertz.load, hertz.radius, hertz.peak_pressure, sphere.load, sphere.radius])
def test_each_contact_may_have_a_sphere_of_its_own(law, kind):
    both = law(1e-5, sphere_radius=kind([1e-4, 2e-4]), contact_modulus=4e6)
    alone = [float(law(1e-5, sphere_radius=radius, contact_modulus=4e6)) for radius in (1e-4, 2e-4)]
    np.testing.assert_allclose(both, alone, rtol=ROUNDING)


def test_refusals():
    with pytest.raises(InputError, match="load must not be negative"):
        hertz.radius(-1.0, **LENS)
    with pytest.raises(InputError, match="contact_modulus must be positive"):
        hertz.radius(1.0, sphere_radius=1.0, contact_modulus=0.0)
    with pytest.raises(InputError, match="must not be negative or NaN"):
        hertz.load(np.nan, **LENS)
    with pytest.raises(InputError, match=r"load must be positive, got 0\.0 N"):
        hertz.annulus([0.1, 0.0], roughness=1e-6, **LENS)
