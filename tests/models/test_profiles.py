"""Asperities of stated profiles: closed forms, limits, tables against them, their way through the solver."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad

from contactimg import (
    InputError,
    ModelRangeError,
    PowerLawProfile,
    TabulatedProfile,
    generate_asperities,
    solve_interacting,
    sphere,
)

R, E = 1e-4, 4e6
PARABOLA = PowerLawProfile(2.0, width=R, drop=R / 2)
A = np.linspace(2e-6, 4e-5, 9)
LENS = {"indenter_radius": 0.1288, "contact_modulus": E, "apex": (1e-3, 1e-3)}


@pytest.fixture(scope="module")
def patch():
    return generate_asperities("SA", side=2e-3, rng=np.random.default_rng(4))


def sneddon(slope, a):
    """Indentation and force over E* by quadrature, r = a sin(t)."""
    depth = a * quad(lambda t: slope(a * np.sin(t)), 0, np.pi / 2, epsabs=0)[0]
    force = 2 * a**2 * quad(lambda t: np.sin(t) ** 2 * slope(a * np.sin(t)), 0, np.pi / 2, epsabs=0)[0]
    return depth, force


@pytest.mark.parametrize("n", [1.0, 1.5, 2.0, 4.0, 7.3])
def test_power_laws_are_sneddons_integrals(n):
    profile = PowerLawProfile(n, width=3e-5, drop=2e-6)
    for a in A:
        depth, force = sneddon(lambda r: n * 2e-6 * r ** (n - 1) / 3e-5**n, a)
        at = np.array([a])
        assert profile.indentation(at)[0] == pytest.approx(depth, rel=1e-9)
        assert profile.force(at)[0] == pytest.approx(force, rel=1e-9)


def test_two_is_hertz_and_one_is_a_cone():
    np.testing.assert_allclose(PARABOLA.indentation(A), A**2 / R, rtol=1e-14)
    np.testing.assert_allclose(PARABOLA.force(A), 4 * A**3 / (3 * R), rtol=1e-14)
    cone = PowerLawProfile(
        1.0, width=1.0, drop=0.2
    )  # delta = (pi/2) a tan(beta), P = (pi/2) E* a^2 tan(beta)
    np.testing.assert_allclose(cone.indentation(A), np.pi / 2 * 0.2 * A, rtol=1e-14)
    np.testing.assert_allclose(cone.force(A), np.pi / 2 * 0.2 * A**2, rtol=1e-14)


def test_tables_converge_to_sphere_and_power_law():
    exact = PowerLawProfile(4.0, width=3e-5, drop=2e-6)
    laws = {
        "sphere": (
            lambda r: R - np.sqrt(R**2 - r**2),
            R * sphere.scaled_indentation(A / R),
            R**2 * sphere.scaled_load(A / R),
        ),
        "power": (lambda r: 2e-6 * (r / 3e-5) ** 4, exact.indentation(A), exact.force(A)),
    }
    for height, depth, force in laws.values():
        errors = []
        for count in (100, 400):
            r = np.linspace(0, 5e-5, count)
            table = TabulatedProfile(tuple(zip(r, height(r), strict=True)))
            found = np.stack([table.indentation(A) / depth, table.force(A) / force])
            errors.append(np.abs(found - 1).max())
        # interpolation errs by f'' h^2/8 at most: (h/a)^2/8 of the drop, with h/a = 1/16 at the smallest a
        assert errors[1] < 1 / 8 / 16**2
        assert errors[1] < errors[0] / 6  # second order or better: 1/16


@pytest.mark.parametrize("kind", ["power", "table"])
def test_stiffness_is_twice_the_radius(kind):
    r = np.linspace(0, 5e-5, 12)
    table = TabulatedProfile(tuple(zip(r, r**3 / 1e-9 + r**2 / 3e-4, strict=True)))
    profile = table if kind == "table" else PowerLawProfile(3.1, width=2e-5, drop=1e-6)
    step = 1e-6 * A
    slope = (profile.indentation(A + step) - profile.indentation(A - step)) / (2 * step)
    np.testing.assert_allclose(profile.steepness(A), slope, rtol=1e-6)
    force = (profile.force(A + step) - profile.force(A - step)) / (2 * step)
    np.testing.assert_allclose(force, 2 * A * slope, rtol=1e-6)


@pytest.mark.parametrize("coupling", ["none", "asymptotic"])
def test_a_parabola_handed_over_is_hertz(patch, coupling):
    own = solve_interacting(patch, load=0.05, coupling=coupling, **LENS)
    handed = solve_interacting(patch, load=0.05, coupling=coupling, law=PARABOLA, **LENS)
    np.testing.assert_allclose(handed.force, own.force, atol=1e-10 * 0.05)
    np.testing.assert_allclose(handed.radius, own.radius, rtol=1e-9)
    fast = solve_interacting(patch, load=0.05, coupling="asymptotic", law=PARABOLA, method="fast", **LENS)
    dense = solve_interacting(patch, load=0.05, coupling="asymptotic", law=PARABOLA, **LENS)
    np.testing.assert_allclose(fast.force, dense.force, atol=1e-6 * 0.05)


@pytest.mark.parametrize("n", [1.0, 4.0])
def test_one_asperity_follows_the_closed_form_and_many_balance_the_load(patch, n):
    profile = PowerLawProfile(n, width=3e-5, drop=4e-6)
    one = pd.DataFrame({"x_m": [0.0], "y_m": [0.0], "height_m": [4e-5], "radius_m": [R]})
    single = solve_interacting(one, load=2e-4, law=profile, indenter_radius=np.inf, contact_modulus=E)
    assert E * profile.force(single.radius)[0] == pytest.approx(2e-4, rel=1e-9)
    assert single.indentation == pytest.approx(profile.indentation(single.radius)[0], rel=1e-9)
    many = solve_interacting(patch, load=0.02, law=profile, **LENS)
    hertz = solve_interacting(patch, load=0.02, **LENS)
    assert many.force.sum() == pytest.approx(0.02, rel=1e-9)
    assert abs(many.area / hertz.area - 1) > 0.02


def test_change_of_units(patch):
    base = solve_interacting(patch, load=0.02, law=PowerLawProfile(4.0, width=3e-5, drop=4e-6), **LENS)
    scaled = solve_interacting(
        7 * patch,
        load=0.02 * 3 * 49,
        law=PowerLawProfile(4.0, width=21e-5, drop=28e-6),
        indenter_radius=7 * 0.1288,
        contact_modulus=3 * E,
        apex=(7e-3, 7e-3),
    )
    np.testing.assert_allclose(scaled.force, 147 * base.force, rtol=1e-8)


def test_refusals(patch):
    with pytest.raises(InputError, match='take "asymptotic"'):
        solve_interacting(patch, load=0.02, law=PARABOLA, coupling="full", **LENS)
    short = TabulatedProfile(((0, 0), (1e-6, 1e-8), (2e-6, 4e-8), (3e-6, 9e-8)))
    with pytest.raises(ModelRangeError, match="beyond the end of the profile"):
        solve_interacting(patch, load=0.1, law=short, **LENS)
    with pytest.raises(InputError, match=r"both increasing from \(0, 0\)"):
        TabulatedProfile(((0, 0), (1e-6, 1e-8), (2e-6, 1e-8), (3e-6, 9e-8)))
    with pytest.raises(InputError, match="exponent of a profile must be positive"):
        PowerLawProfile(0.0, width=1e-5, drop=1e-6)
