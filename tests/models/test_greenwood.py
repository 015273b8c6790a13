"""Greenwood-Williamson and Greenwood-Tripp: closed forms, reference table, limits, hard ratios."""

import tracemalloc

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ellipkm1
from scipy.stats import norm

from contactimg import (
    AsperityLayer,
    GaussianHeights,
    InputError,
    SampleHeights,
    UniformHeights,
    hertz,
    solve_greenwood_tripp,
    solve_greenwood_williamson,
)
from contactimg.models.greenwood_williamson import ring_weights

SURFACE = {"density": 18.45e6, "radius": 1e-4, "contact_modulus": 4e6}
LENS = {**SURFACE, "indenter_radius": 0.1288}
UNIFORM = UniformHeights(30e-6, 60e-6)
SAMPLE = SampleHeights(np.random.default_rng(0).uniform(30e-6, 60e-6, 500))
LAWS = [UNIFORM, GaussianHeights(9e-6, 2.4e-6), SAMPLE]


@pytest.mark.parametrize("power", [0, 0.5, 1, 1.5, 2.5])
@pytest.mark.parametrize("x", [-1.0, 0.3, 2.0, 24.9, 25.1, 400.0])
def test_gaussian_moments_are_integrals(power, x):
    law = GaussianHeights(0.0, 1.0)
    start = max(-x, -12.0)
    exact = quad(lambda z: (z + x) ** power * norm.pdf(z), start, 12, epsabs=0, epsrel=1e-11, limit=500)[0]
    assert law.moment(law.top + x, power) == pytest.approx(exact, rel=1e-8)


def test_uniform_moments_are_integrals():
    for depth in (1e-6, 29e-6, 45e-6, 1.0):
        exact = quad(lambda z, d=depth: max(d - z, 0.0) ** 1.5, 0, min(30e-6, depth), epsrel=1e-12)[0] / 30e-6
        assert UNIFORM.moment(depth, 1.5) == pytest.approx(exact, rel=1e-9)
    assert UNIFORM.moment(-1e-6, 1.5) == 0
    assert SAMPLE.moment(1.0, 0) == 1


def test_moments_of_many_heights_take_no_matrix_of_rings_and_heights():
    heights, depths = np.random.default_rng(2).uniform(30e-6, 60e-6, 50_000), np.linspace(-1e-6, 40e-6, 200)
    sample = SampleHeights(heights)
    tracemalloc.start()
    found = sample.moment(depths, 1.5)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    exact = [np.mean(np.maximum(heights - (sample.top - depth), 0) ** 1.5) for depth in depths]
    np.testing.assert_allclose(found, exact, rtol=1e-12)
    assert peak < 8e6  # bytes; 50,000 times 200 numbers are 8e7


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("pressure", [1e-3, 1e3, 1e6])
def test_depth_inverts_pressure(law, pressure):
    layer = AsperityLayer(law, **SURFACE)
    assert layer.pressure(layer.depth(pressure)) == pytest.approx(pressure, rel=1e-12)


@pytest.mark.parametrize("pressure", [10.0, 1e3, 1e4])
def test_uniform_power_laws(pressure):
    """Density eta/eta0 = (5/2)^{2/5} [p/(eta0 K R^{1/2} s^{3/2})]^{2/5} and the mean radii that follow."""
    layer, K, s = AsperityLayer(UNIFORM, **SURFACE), 16e6 / 3, 30e-6
    depth = layer.depth(pressure)
    eta = float(layer.contact_density(depth))
    law = 2.5**0.4 * (pressure / (18.45e6 * K * 1e-2 * s**1.5)) ** 0.4
    assert eta / 18.45e6 == pytest.approx(law, rel=1e-12)
    cube_mean = np.cbrt(pressure * 1e-4 / (K * eta))
    assert cube_mean == pytest.approx(
        0.4 ** (2 / 15) * (pressure * 1e-8 * s / (K * 18.45e6)) ** 0.2, rel=1e-12
    )
    # mean of sqrt over mean of 3/2 power: (2/3)/(2/5)^{1/3} = 0.905
    assert layer.mean_radius(depth) / cube_mean == pytest.approx((2 / 3) / 0.4 ** (1 / 3), rel=1e-12)
    assert layer.area_fraction(depth) == pytest.approx(np.pi * 1e-4 * eta * float(depth) / 2, rel=1e-12)


@pytest.mark.parametrize("law", LAWS)
def test_williamson_under_a_lens_bears_its_load(law):
    coarse, fine = (solve_greenwood_williamson(law, load=0.2, rings=n, **LENS) for n in (500, 1000))
    errors = [float(ring_weights(s.r) @ s.pressure) / 0.2 - 1 for s in (coarse, fine)]
    # trapezoidal sums over rings converge as the square of their width
    assert abs(errors[1]) < 2e-5
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.2)
    area = float(ring_weights(fine.r) @ fine.area_fraction)
    assert area == pytest.approx(fine.area, rel=2e-5)


@pytest.mark.parametrize(
    ("load", "depth", "area", "centre"),
    [(0.02, 14.365, 0.05012, 0.3815), (0.2, 37.112, 0.37851, 0.6637), (0.5, 58.276, 0.85744, 0.7640)],
)
def test_reference_values(load, depth, area, centre):
    solution = solve_greenwood_tripp(UNIFORM, load=load, **LENS)
    peak = float(hertz.peak_pressure(load, sphere_radius=0.1288, contact_modulus=4e6))
    assert solution.indentation * 1e6 == pytest.approx(depth, rel=1e-3)
    assert solution.area * 1e6 == pytest.approx(area, rel=1e-3)
    assert solution.pressure[0] / peak == pytest.approx(centre, rel=1e-3)


def test_order_of_convergence():
    fine = solve_greenwood_tripp(UNIFORM, load=0.5, rings=401, **LENS)
    errors = [
        solve_greenwood_tripp(UNIFORM, load=0.5, rings=n, **LENS).indentation - fine.indentation
        for n in (51, 101)
    ]
    # second order: 4 a halving; the fine one's own error adds (1/64 - 1)/(1/16 - 1) - 1: 5 %
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.25)
    assert abs(errors[1]) < 1e-4 * fine.indentation


@pytest.mark.parametrize("law", LAWS)
def test_each_ring_is_williamson_and_elastic(law):
    """p(x) to rounding, and x from the displacement by the pressure, integrated independently."""
    solution = solve_greenwood_tripp(law, load=0.2, **LENS)
    layer = AsperityLayer(law, **SURFACE)
    np.testing.assert_allclose(layer.pressure(solution.depth), solution.pressure, rtol=1e-10)
    assert float(ring_weights(solution.r) @ solution.pressure) == pytest.approx(0.2, rel=1e-9)
    offset = law.top - law.reference
    geometry = solution.indentation + offset - solution.r**2 / (2 * 0.1288)
    np.testing.assert_allclose(solution.depth + solution.displacement, geometry, atol=1e-10 * geometry[0])
    for k in (1, 40, 90):
        displaced = elliptic_displacement(solution.r[k], solution.r, solution.pressure)
        # 4000 nodes over the kinks of a piecewise linear pressure on 200 rings
        assert solution.displacement[k] == pytest.approx(displaced, rel=2e-5)


def elliptic_displacement(r, radii, pressure):
    """(4/(pi E*)) int t/(t+r) p(t) K(k) dt with t = r -+ x^3 on both sides of the logarithm."""
    x, weights = np.polynomial.legendre.leggauss(20)
    x = ((np.arange(100)[:, None] + 0.5 * (x + 1)) / 100).ravel()
    weights = np.tile(weights / 200, 100)
    total = 0.0
    for width, sign in ((r, -1), (radii[-1] - r, 1)):
        t, jacobian = r + sign * width * x**3, 3 * width * x**2
        m = 4 * r * t / np.maximum(r + t, 1e-300) ** 2
        p = np.interp(t, radii, pressure)
        total += weights @ (jacobian * t / np.maximum(t + r, 1e-300) * p * ellipkm1(np.maximum(1 - m, 1e-30)))
    return 4 / (np.pi * 4e6) * total


def test_smooth_sphere_limit_needs_stiff_asperities():
    peak = float(hertz.peak_pressure(0.5, sphere_radius=0.1288, contact_modulus=4e6))
    depth = float(hertz.indentation(0.5, sphere_radius=0.1288, contact_modulus=4e6))
    narrow = UniformHeights(0.0, 10e-9)
    soft = solve_greenwood_tripp(narrow, load=0.5, **LENS)
    assert soft.pressure[0] / peak == pytest.approx(0.83, abs=0.005)  # asperities of finite stiffness
    distance = []
    for factor in (1e4, 1e6):
        stiff = solve_greenwood_tripp(narrow, load=0.5, **{**LENS, "density": 18.45e6 * factor})
        distance.append(abs(stiff.pressure[0] / peak - 1) + abs(stiff.indentation / depth - 1))
    assert distance[1] < distance[0] < 2e-3


def test_williamson_as_the_lens_softens_into_a_rigid_one():
    """With few asperities the half-space hardly yields: GT -> GW under the same lens."""
    differences = []
    for density in (1e3, 1e2):
        where = {**LENS, "density": density}
        tripp, williamson = (
            f(UNIFORM, load=1e-5, **where) for f in (solve_greenwood_tripp, solve_greenwood_williamson)
        )
        differences.append(abs(tripp.indentation / williamson.indentation - 1))
    assert differences[1] < differences[0] / 2
    assert differences[1] < 0.01


@pytest.mark.parametrize("ratio", [1e-4, 1e-2, 1.0, 1e2, 1e4])
@pytest.mark.parametrize("stiffness", [1e-3, 1.0, 1e4])
def test_any_roughness(ratio, stiffness):
    depth = float(hertz.indentation(0.5, sphere_radius=0.1288, contact_modulus=4e6))
    where = {**LENS, "density": 18.45e6 * stiffness, "load": 0.5, "rings": 80}
    sample = SampleHeights(ratio * depth * np.random.default_rng(1).normal(size=200))
    for law in (UniformHeights(0.0, ratio * depth), GaussianHeights(0.0, ratio * depth), sample):
        solution = solve_greenwood_tripp(law, **where)
        assert solution.iterations <= 30
        assert np.all(np.isfinite(solution.pressure))


def test_change_of_units():
    base = solve_greenwood_tripp(UNIFORM, load=0.2, rings=60, **LENS)
    length, pressure = 7.0, 0.03
    scaled = solve_greenwood_tripp(
        UniformHeights(30e-6 * length, 60e-6 * length),
        density=18.45e6 / length**2,
        radius=1e-4 * length,
        indenter_radius=0.1288 * length,
        contact_modulus=4e6 * pressure,
        load=0.2 * pressure * length**2,
        rings=60,
    )
    np.testing.assert_allclose(
        scaled.pressure, base.pressure * pressure, rtol=1e-8, atol=1e-12 * base.pressure[0]
    )
    assert scaled.indentation == pytest.approx(length * base.indentation, rel=1e-9)


def test_the_last_ring_of_the_uncoupled_model_touches_nothing():
    loads = np.geomspace(0.01, 1.0, 30)
    ends = [solve_greenwood_williamson(SAMPLE, load=load, **LENS).density[-1] for load in loads]
    assert not np.any(ends)  # a rounding error in the depth would let one summit of 500 touch


def test_profile_table():
    table = solve_greenwood_tripp(UNIFORM, load=0.2, rings=50, **LENS).profile("0.2 N")
    assert set(table["model"]) == {"gt"}
    assert set(table["frame"]) == {"0.2 N"}
    np.testing.assert_array_less(np.diff(table["pressure_Pa"]), 1e-9)
    assert solve_greenwood_williamson(UNIFORM, load=0.2, **LENS).profile()["model"].iloc[0] == "gw"


def test_refusals():
    with pytest.raises(InputError, match="finite low below high"):
        UniformHeights(1.0, 1.0)
    with pytest.raises(InputError, match="positive std"):
        GaussianHeights(0.0, 0.0)
    with pytest.raises(InputError, match="at least one finite height"):
        SampleHeights(np.array([np.nan]))
    with pytest.raises(InputError, match="load must be positive"):
        solve_greenwood_tripp(UNIFORM, load=0.0, **LENS)
    with pytest.raises(InputError, match="density must be positive"):
        solve_greenwood_tripp(UNIFORM, load=0.1, **{**LENS, "density": -1.0})
    with pytest.raises(InputError, match="positive pressures"):
        AsperityLayer(UNIFORM, **SURFACE).depth(0.0)
