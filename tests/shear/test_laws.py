"""Laws under tangential load: closed forms, limits, energies, units, and intervals that hold."""

import numpy as np
import pytest

from contactimg.analysis.estimates import Estimate
from contactimg.errors import InputError, ModelRangeError
from contactimg.mechanics import jkr
from contactimg.shear.laws import (
    AdhesiveSphere,
    fit_decrease,
    fit_rate_law,
    fit_strength,
    half_axes_along,
    local_friction,
    static_friction,
)

SPHERE = {"sphere_radius": 9.42e-3, "contact_modulus": 2.1e6, "work_of_adhesion": 0.027}


def test_static_friction_solves_its_equation_and_has_the_limit_without_shrinkage():
    area, sigma = 2e-8, 0.3e6
    for rate in (0.0, 1e-12, 1e-6, 1e-3, -1e-5):
        force = static_friction(area, rate=rate, strength=sigma)
        # Qs = sigma (A0 - alpha Qs^2), to rounding
        assert force == pytest.approx(sigma * (area - rate * force**2), rel=1e-14)
    # the printed form, where it does not cancel: 4 alpha sigma^2 A0 = 7.2
    printed = (-1 + np.sqrt(1 + 4 * 1e-3 * sigma**2 * area)) / (2 * 1e-3 * sigma)
    assert static_friction(area, rate=1e-3, strength=sigma) == pytest.approx(printed, rel=1e-13)


def test_a_contact_that_grows_too_fast_never_slides():
    # alpha = -1/(4 sigma^2 A0) is the last: Qs = 2 sigma A0
    last = -1 / (4 * 0.3e6**2 * 2e-8)
    assert static_friction(2e-8, rate=0.999999999 * last, strength=0.3e6) == pytest.approx(0.012, rel=1e-4)
    with pytest.raises(ModelRangeError, match="never slides"):
        static_friction(2e-8, rate=1.01 * last, strength=0.3e6)


def test_exact_decrease_is_found_whatever_the_sign_of_the_load_and_nan_is_left_out():
    load = np.array([-0.2, 0.0, 0.1, np.nan, 0.3])
    law = fit_decrease(load, 3e-8 - 1e-7 * load**2)
    assert (law.start.value, law.rate.value) == pytest.approx((3e-8, 1e-7), rel=1e-10)
    assert law.n_points == 4


def test_one_tangential_load_gives_no_law():
    with pytest.raises(InputError, match="two or more different tangential loads, got 1"):
        fit_decrease([0.1, -0.1, 0.1], [1e-8, 1.1e-8, 0.9e-8])


def test_intervals_of_the_decrease_hold(rng):
    load = np.linspace(0.0, 0.3, 8)
    true = 3e-8, 1e-7
    fits = [
        fit_decrease(load, true[0] - true[1] * load**2 + rng.normal(0, 1e-9, 8), std=1e-9, scatter=0.0)
        for _ in range(400)
    ]
    for name, value in zip(("start", "rate"), true, strict=True):
        found = np.array([getattr(fit, name).value for fit in fits])
        std = getattr(fits[0], name).std
        # the standard deviation of 400 values has an error of 3.5 %, their mean one of 5 % of std
        assert found.std() == pytest.approx(std, rel=0.12)
        assert abs(found.mean() - value) < 0.16 * std
    pairs = np.array([[fit.start.value, fit.rate.value] for fit in fits])
    # the error of a correlation r from n values is (1 - r^2)/sqrt(n) = 0.02
    assert np.corrcoef(pairs.T)[0, 1] == pytest.approx(fits[0].correlation, abs=0.08)


def test_rate_law_finds_beta_and_exponent_with_values_below_zero(rng):
    area = 10 ** rng.uniform(-9.5, -8, 300)
    area_std, rate_std = 0.01 * area, 0.6 * 2e-16 * area**-1.5
    inside = []
    for _ in range(60):
        rate = 2e-16 * area**-1.5 + rng.normal(0, rate_std)
        law = fit_rate_law(
            area + rng.normal(0, area_std), rate, area_std=area_std, rate_std=rate_std, confidence=0.95
        )
        inside.append([law.beta.low < 2e-16 < law.beta.high, law.exponent.low < -1.5 < law.exponent.high])
    assert (rate < 0).any()
    # 60 intervals of 95 %: fewer than 51 of them (57 +- 1.7) would be more than three standard deviations off
    assert (np.sum(inside, axis=0) >= 51).all()


def test_rate_law_holds_beta_where_the_scatter_is_in_proportion_to_alpha(rng):
    held = 0
    for _ in range(200):
        area = 10 ** rng.uniform(-10, -8, 40)
        law = 2e-16 * area**-1.5
        rate_std = 0.03 * law
        rate = law * rng.lognormal(-(0.2**2) / 2, 0.2, 40) + rng.normal(0, rate_std)
        beta = fit_rate_law(area, rate, area_std=1e-3 * area, rate_std=rate_std).beta
        held += beta.low < 2e-16 < beta.high
    # 190 +- 3.1; with one scatter for all contacts, which the smallest decide, it was 165
    assert held >= 180


def test_rate_law_does_not_depend_on_units(rng):
    area = 10 ** rng.uniform(-9.5, -8, 40)
    rate = 2e-16 * area**-1.5 * rng.normal(1, 0.1, 40)
    here, there = fit_rate_law(area, rate), fit_rate_law(1e12 * area, 1e12 * 1e-6 * rate)
    # lengths by 1e6, forces by 1e3: alpha is m^2/N^2, beta m^5/N^2; the scatter is found to 1e-6
    assert there.beta.value == pytest.approx(1e30 * 1e-6 * here.beta.value, rel=1e-5)
    assert there.exponent.value == pytest.approx(here.exponent.value, abs=1e-5)
    # the mean of alpha by its true sizes and not by areas alone: exponent 0 would need equal rates
    assert fit_rate_law(area, np.full(40, 3.0)).exponent.value == pytest.approx(0.0, abs=1e-6)
    # contacts that do not shrink have no exponent
    noise = np.random.default_rng(3).normal(size=40)
    assert np.isnan(fit_rate_law(area, noise, rate_std=1.0).exponent.value)


def test_strength_inverts_static_friction_and_its_error_is_that_of_its_parts(rng):
    load = np.linspace(0, 0.006, 9)
    law = fit_decrease(load, 2e-8 - 1e-4 * load**2, std=1e-10, scatter=0.0)
    force = static_friction(2e-8, rate=1e-4, strength=0.3e6)
    found = fit_strength(law, float(force), std=1e-5)
    assert found.value == pytest.approx(0.3e6, rel=1e-9)
    drawn = [
        fit_strength(
            fit_decrease(load, 2e-8 - 1e-4 * load**2 + rng.normal(0, 1e-10, 9), std=1e-10, scatter=0.0),
            float(force) + rng.normal(0, 1e-5),
        ).value
        for _ in range(400)
    ]
    assert np.std(drawn) == pytest.approx(found.std, rel=0.12)  # 3.5 % from 400 values
    with pytest.raises(ModelRangeError, match="no contact area is left"):
        fit_strength(law, 0.02)
    with pytest.raises(InputError, match="std must not be negative"):
        fit_strength(law, 0.005, std=-1e-5)


def test_half_axes_are_those_of_second_moments():
    # the variance of the coordinate along a direction, of points spread evenly over a turned ellipse, times 4
    radius, turn = np.sqrt((np.arange(200_000) + 0.5) / 200_000), np.pi * (3 - 5**0.5) * np.arange(200_000)
    u, v = 5.0 * radius * np.cos(turn), 3.0 * radius * np.sin(turn)
    x, y = u * np.cos(0.4) - v * np.sin(0.4), u * np.sin(0.4) + v * np.cos(0.4)
    along, across = half_axes_along(5.0, 3.0, 0.4, direction=1.1)
    # points of equal areas give moments to some 1/n
    assert along == pytest.approx(2 * np.std(x * np.cos(1.1) + y * np.sin(1.1)), rel=1e-4)
    assert across == pytest.approx(2 * np.std(y * np.cos(1.1) - x * np.sin(1.1)), rel=1e-4)
    assert half_axes_along(4.0, 4.0, np.nan, direction=1.1) == (4.0, 4.0)
    assert np.isnan(half_axes_along(5.0, 3.0, 0.4, direction=np.nan)).all()


def test_local_friction_adds_up_and_its_error_is_that_of_its_parts(rng):
    strength = Estimate(0.4e6, 0.02e6, 0.36e6, 0.44e6)
    radius, std = np.array([10e-6, 20e-6]), np.array([0.5e-6, 0.5e-6])
    force, error = local_friction(radius, strength=strength, radius_std=std)
    assert force.sum() == pytest.approx(0.4e6 * np.pi * 500e-12, rel=1e-14)
    drawn = rng.normal(0.4e6, 0.02e6, (20_000, 1)) * np.pi * rng.normal(radius, std, (20_000, 2)) ** 2
    # the law is quadratic in a radius of 5 % error: 2 % more, beside 0.5 % of chance
    assert drawn.std(axis=0) == pytest.approx(error, rel=0.03)


def test_adhesive_sphere_without_coupling_or_shear_is_jkr():
    loads = np.array([-0.0005, 0.0, 0.05])
    expected = jkr.radius(loads, **SPHERE)
    plain = AdhesiveSphere(*SPHERE.values(), 0.5)
    coupled = AdhesiveSphere(*SPHERE.values(), 0.5, mode_coupling=0.002)
    assert plain.radius(loads, 0.3) == pytest.approx(expected, rel=1e-13)
    assert coupled.radius(loads, 0.0) == pytest.approx(expected, rel=1e-13)
    assert plain.largest_tangential(0.05) == np.inf


def test_energy_release_rates_are_those_of_the_compliances():
    # at fixed forces G = (1/2) F^2 dC/dA: the punch that pulls back has C = 1/(2 E* a), and a contact
    # without slip C = (2 - nu)/(8 G a) with G = E* (1 - nu)/2; differences of C at a (1 +- 1e-5)
    nu, a, modulus, force = 0.3, 1e-4, 2e6, 0.01
    shear = modulus * (1 - nu) / 2

    def release(compliance):
        change = compliance(a * (1 + 1e-5)) - compliance(a * (1 - 1e-5))
        return 0.5 * force**2 * -change / (np.pi * a**2 * ((1 + 1e-5) ** 2 - (1 - 1e-5) ** 2))

    normal = release(lambda radius: 1 / (2 * modulus * radius))
    tangential = release(lambda radius: (2 - nu) / (8 * shear * radius))
    assert normal == pytest.approx(force**2 / (8 * np.pi * modulus * a**3), rel=1e-8)
    kappa = AdhesiveSphere(0.01, modulus, 0.05, nu).kappa
    assert tangential / normal == pytest.approx(kappa, rel=1e-8)


def test_rim_of_the_adhesive_sphere_is_in_equilibrium_up_to_the_end_of_the_law():
    sphere = AdhesiveSphere(*SPHERE.values(), 0.4, mode_coupling=0.01)
    end = sphere.largest_tangential(0.05)
    for tangential in (0.0, 0.5 * end, 0.999999 * end):
        a = sphere.radius(0.05, tangential)
        hertz = 4 * sphere.contact_modulus * a**3 / (3 * sphere.sphere_radius)
        unit = 8 * np.pi * sphere.contact_modulus * a**3
        released = ((hertz - 0.05) ** 2 + 0.01 * sphere.kappa * tangential**2) / unit
        assert released == pytest.approx(sphere.work_of_adhesion, rel=1e-9)
    with pytest.raises(ModelRangeError, match="the law ends at a tangential load"):
        sphere.radius(0.05, 1.000001 * end)
    assert sphere.radius(0.05, end) == pytest.approx(a, rel=1e-3)
    # there the larger root is the only one: P_H = P + 3 pi w R
    assert hertz == pytest.approx(0.05 + 3 * np.pi * 0.027 * 9.42e-3, rel=1e-3)


def test_small_tangential_loads_shrink_the_sphere_by_a_square():
    # dP_H/dT^2 = -lambda kappa/(2 sqrt(S)), and A = pi (3 R P_H/(4 E*))^(2/3):
    # alpha = A0 lambda kappa/(3 P_H sqrt(S))
    sphere = AdhesiveSphere(*SPHERE.values(), 0.5, mode_coupling=0.01)
    push = 3 * np.pi * 0.027 * 9.42e-3
    root = np.sqrt(2 * push * 0.05 + push**2)
    area = np.pi * sphere.radius(0.05, 0.0) ** 2
    load = np.array([0.0, 1e-3])
    law = fit_decrease(load, np.pi * sphere.radius(0.05, load) ** 2)
    assert law.rate.value == pytest.approx(
        area * 0.01 * sphere.kappa / (3 * (0.05 + push + root) * root), rel=1e-3
    )


def test_mode_coupling_is_found_and_its_interval_holds(rng):
    sphere = AdhesiveSphere(*SPHERE.values(), 0.5, mode_coupling=0.01)
    load = np.linspace(0, 0.8 * float(sphere.largest_tangential(0.05)), 10)
    radius = sphere.radius(0.05, load)
    assert sphere.fit_mode_coupling(0.05, load, radius).value == pytest.approx(0.01, rel=1e-9)
    std, held = 1e-6, 0
    for _ in range(100):
        found = sphere.fit_mode_coupling(0.05, load, radius + rng.normal(0, std, 10), radius_std=std)
        held += found.low < 0.01 < found.high
    assert held >= 88  # 95 +- 2.2


def test_nonsense_is_refused_in_one_sentence():
    with pytest.raises(InputError, match="poisson_ratio must be above -1"):
        AdhesiveSphere(*SPHERE.values(), 0.7)
    with pytest.raises(InputError, match="radius must be positive, got 0"):
        AdhesiveSphere(*SPHERE.values(), 0.5).fit_mode_coupling(0.05, [0.0, 0.1], [1e-4, 0.0])
    with pytest.raises(InputError, match="two contacts or more, got 1"):
        fit_rate_law([1e-9], [1e-5])
    with pytest.raises(InputError, match="strength must be positive"):
        static_friction(1e-8, rate=0.0, strength=0.0)
