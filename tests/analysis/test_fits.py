"""Fits of the analysis: published figures, closed forms, units, coverage, and corrections that matter."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from contactimg.analysis.estimates import Estimate, bootstrap_estimates, bootstrap_weights, student_estimate
from contactimg.analysis.friction import compare_stress, fit_shear_stress
from contactimg.analysis.linear_fit import Points, fit_line, fit_proportional
from contactimg.analysis.power_laws import fit_broken_law, fit_power_law
from contactimg.analysis.topography import describe_topography
from contactimg.errors import InputError

# Pearson's data with York's weights
X = np.array([0, 0.9, 1.8, 2.6, 3.3, 4.4, 5.2, 6.1, 6.5, 7.4])
Y = np.array([5.9, 5.4, 4.4, 4.6, 3.5, 3.7, 2.8, 2.8, 2.4, 1.5])
X_STD = np.array([1000, 1000, 500, 800, 200, 80, 60, 20, 1.8, 1]) ** -0.5
Y_STD = np.array([1, 1.8, 4, 8, 20, 20, 70, 70, 100, 500]) ** -0.5


def test_line_gives_yorks_published_figures():
    fit = fit_line(Points(X, Y, X_STD, Y_STD), scatter=0.0)
    # York et al. 2004, table II: a = 5.47991022, b = -0.480533407, sigma_a = 0.294971, sigma_b = 0.0579850,
    # and S/(n - 2) = 1.4832942; as many digits as are printed
    assert fit.parameters.tolist() == pytest.approx([5.47991022, -0.480533407], rel=3e-7)
    assert np.sqrt(np.diag(fit.covariance)).tolist() == pytest.approx([0.294971, 0.0579850], rel=3e-6)
    assert fit.chi_square / fit.freedom == pytest.approx(1.4832942, rel=1e-7)


def test_line_does_not_depend_on_units():
    here = fit_line(Points(X, Y, X_STD, Y_STD))
    there = fit_line(Points(1e-9 * X, 1e6 * Y, 1e-9 * X_STD, 1e6 * Y_STD))
    # the scatter is found to 1e-6 of its variance
    assert there.parameters.tolist() == pytest.approx((here.parameters * [1e6, 1e15]).tolist(), rel=1e-6)
    assert there.covariance[1, 1] == pytest.approx(1e30 * here.covariance[1, 1], rel=1e-5)
    assert there.scatter == pytest.approx(1e6 * here.scatter, rel=1e-5)


def test_line_treats_both_axes_alike():
    along, across = (
        fit_line(points, scatter=0.0) for points in (Points(X, Y, X_STD, Y_STD), Points(Y, X, Y_STD, X_STD))
    )
    assert across.parameters[1] == pytest.approx(1 / along.parameters[1], rel=1e-6)
    assert across.chi_square == pytest.approx(along.chi_square, rel=1e-9)


def test_line_without_stated_errors_is_ordinary_least_squares():
    fit, plain = fit_line(Points(X, Y)), stats.linregress(X, Y)
    assert fit.parameters.tolist() == pytest.approx([plain.intercept, plain.slope], rel=1e-9)
    # all scatter is excess: the standard error with n - 2 degrees of freedom
    assert np.sqrt(fit.covariance[1, 1]) == pytest.approx(plain.stderr, rel=1e-6)
    assert fit.chi_square == pytest.approx(fit.freedom, rel=1e-6)


def test_no_excess_scatter_where_the_errors_explain_the_distances():
    fit = fit_line(Points(X, Y, 1.0, 1.0))
    assert fit.scatter == 0.0
    assert fit.chi_square < fit.freedom


def test_proportional_without_errors_is_least_squares_through_the_origin():
    fit = fit_proportional(Points(X, Y))
    assert fit.parameters[0] == pytest.approx((X @ Y) / (X @ X), rel=1e-9)


def test_errors_along_the_line_cost_nothing():
    # the errors of a point move it along y = 2 x: no distance from it
    assert Points([1.0], [2.0], 0.1, 0.2, 1.0).variance(np.array([2.0])) == pytest.approx(0.0, abs=1e-17)
    assert Points([1.0], [2.0], 0.1, 0.2, -1.0).variance(np.array([2.0])) == pytest.approx(0.4**2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([1.0, np.nan], [1.0, 2.0]), "must be finite"),
        (([1.0, 2.0, 3.0], [1.0, 2.0]), "as many x as y"),
        (([1.0, 2.0], [1.0, 2.0], -0.1), "must not be negative"),
        (([1.0, 2.0], [1.0, 2.0], 0.1, 0.1, 1.5), "between -1 and 1"),
    ],
)
def test_bad_points_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        Points(*arguments)


def test_a_line_needs_two_x_and_a_proportion_one():
    with pytest.raises(InputError, match="two or more different x"):
        fit_line(Points([1.0, 1.0], [1.0, 2.0]))
    with pytest.raises(InputError, match="two or more different x"):  # but for rounding
        fit_line(Points([0.1 + 0.2, 0.3, 0.3], [1.0, 2.0, 3.0]))
    with pytest.raises(InputError, match="away from it"):
        fit_proportional(Points([0.0, 0.0], [1.0, 2.0]))


def test_interval_is_students():
    # t(0.975; 9) = 2.262157
    estimate = student_estimate(5.0, 2.0, freedom=9)
    assert (estimate.low, estimate.high) == pytest.approx((5 - 4.524314, 5 + 4.524314), rel=1e-6)
    with pytest.raises(InputError, match="confidence must lie"):
        student_estimate(5.0, 2.0, freedom=9, confidence=1.0)


def test_bootstrap_of_a_mean_has_its_standard_error(rng):
    for count in (4, 8, 24):
        values = rng.normal(size=count)
        replicates = bootstrap_weights(count) @ values / count
        (found,) = bootstrap_estimates(np.array([values.mean()]), replicates[:, None], blocks=count)
        # 1000 replicates know the central 68 % to 3 %; with four weights these are no normal distribution's
        assert found.std == pytest.approx(values.std(ddof=1) / np.sqrt(count), rel=0.15)
        assert found.high - found.value == pytest.approx(stats.t.ppf(0.975, count - 1) * found.std)


def test_power_law_is_found_in_any_unit():
    load = np.array([0.5, 0.02, 0.1, 0.1])  # not sorted, one repeated
    for unit in (1.0, 1e3):
        law = fit_power_law(unit * load, 3e-6 * load**0.9, y_std=1e-9)
        assert law.exponent.value == pytest.approx(0.9, rel=1e-9)
        assert law.value(unit * 0.3) == pytest.approx(3e-6 * 0.3**0.9, rel=1e-9)
        assert (law.low, law.high) == (unit * 0.02, unit * 0.5)


def test_two_points_give_an_exponent_but_no_interval():
    law = fit_power_law([1.0, 10.0], [1.0, 5.0], x_std=0.1, y_std=0.1)
    assert law.exponent.value == pytest.approx(np.log10(5))
    assert (law.exponent.low, law.exponent.high) == (-np.inf, np.inf)
    assert (law.amplitude.low, law.amplitude.high) == (0.0, np.inf)


@pytest.mark.parametrize("x", [[0.0, 1.0], [-1.0, 1.0]])
def test_power_law_refuses_what_has_no_logarithm(x):
    with pytest.raises(InputError, match="positive points"):
        fit_power_law(x, [1.0, 2.0])


def noisy_power_law(rng, x_relative, y_relative):
    x = np.geomspace(0.2, 0.6, 8)
    y = 3e-6 * x**0.9
    return x * (1 + x_relative * rng.standard_normal(8)), y * (1 + y_relative * rng.standard_normal(8))


@pytest.mark.slow
def test_errors_of_the_load_are_needed_and_make_intervals_honest():
    repeats, x_std, y_std = 150, 0.1, 0.02
    right, wrong, held = [], [], 0
    for seed in range(7000, 7000 + repeats):
        x, y = noisy_power_law(np.random.default_rng(seed), x_std, y_std)
        law = fit_power_law(x, y, x_std=x_std * x, y_std=y_std * y)
        right.append(law.exponent.value)
        wrong.append(fit_power_law(x, y, y_std=y_std * y).exponent.value)
        held += law.exponent.low <= 0.9 <= law.exponent.high
    standard_error = np.std(right) / np.sqrt(repeats)
    assert np.mean(right) == pytest.approx(0.9, abs=4 * standard_error)
    # ln x varies by 0.36 (standard deviation), its errors by 0.1: attenuated by 1/(1 + (0.1/0.36)^2) = 0.93
    # for many points, by 0.95 for eight, which is 0.045 of the exponent
    assert np.mean(np.subtract(right, wrong)) == pytest.approx(0.045, abs=0.015)
    # binomial, four standard deviations of sqrt(0.95 * 0.05/150) = 0.018
    assert held / repeats >= 0.95 - 4 * 0.018


def broken(x, low, high, at=50.0):
    return np.where(x < at, (x / at) ** low, (x / at) ** high)


def test_broken_law_is_found_in_any_unit():
    x = np.geomspace(1, 1e4, 25)
    for unit in (1.0, 1e-6):
        law = fit_broken_law(unit * x, broken(x, 0.78, 0.4), y_std=1e-4 * broken(x, 0.78, 0.4))
        assert law.supported
        assert law.low_exponent.value == pytest.approx(0.78, rel=1e-6)
        assert law.high_exponent.value == pytest.approx(0.4, rel=1e-6)
        assert law.break_x.value == pytest.approx(unit * 50, rel=1e-5)
        assert law.break_x.low < unit * 50 < law.break_x.high
        assert law.value(unit * np.array([25.0, 100.0])).tolist() == pytest.approx(
            [0.5**0.78, 2**0.4], rel=1e-4
        )


def test_straight_points_support_no_break(rng):
    x = np.geomspace(1, 1e4, 25)
    law = fit_broken_law(x, x**0.4 * (1 + 0.05 * rng.standard_normal(25)), y_std=0.05 * x**0.4)
    assert not law.supported
    assert law.single.exponent.low < 0.4 < law.single.exponent.high
    assert (law.break_x.low, law.break_x.high) == (0.0, np.inf)  # it could be anywhere


@pytest.mark.slow
def test_breaks_are_imagined_rarely_and_intervals_of_true_ones_hold():
    repeats, x, held, imagined = 20, np.geomspace(2, 2e5, 30), np.zeros(3), 0
    for seed in range(8000, 8000 + repeats):
        rng = np.random.default_rng(seed)
        noise = 0.1 * rng.standard_normal((2, 30))
        errors = {"x_std": 0.1 * x, "y_std": 0.1 * broken(x, 0.78, 0.4)}
        law = fit_broken_law(x * (1 + noise[0]), broken(x, 0.78, 0.4) * (1 + noise[1]), **errors)
        pairs = ((law.low_exponent, 0.78), (law.high_exponent, 0.4), (law.break_x, 50.0))
        held += [estimate.low <= truth <= estimate.high for estimate, truth in pairs]
        errors["y_std"] = 0.1 * broken(x, 0.4, 0.4)
        imagined += fit_broken_law(
            x * (1 + noise[0]), broken(x, 0.4, 0.4) * (1 + noise[1]), **errors
        ).supported
    # binomial, four standard deviations of sqrt(0.95 * 0.05/20) = 0.049
    assert (held / repeats >= 0.95 - 4 * 0.049).all()
    assert imagined / repeats <= 0.05 + 4 * 0.049


@pytest.mark.parametrize("count", [3, 6])
def test_two_laws_need_seven_points(count):
    with pytest.raises(InputError, match="7 points"):
        fit_broken_law(np.arange(1.0, count + 1), np.arange(1.0, count + 1))


def test_two_laws_need_points_in_both_parts():
    with pytest.raises(InputError, match="crowd at one end"):
        fit_broken_law([1, 1.01, 1.02, 1.03, 1.04, 1.05, 1.06, 1e6], np.ones(8))


def friction(area, force, std=0.0):
    return pd.DataFrame({"area_m2": area, "friction_N": force, "area_std_m2": std})


def test_shear_stress_is_least_squares_whatever_the_direction():
    area = np.array([1e-7, 3e-7, 6e-7])
    force = np.array([0.05, -0.16, 0.28])  # slid to and fro
    found = fit_shear_stress(friction(area, force))
    assert found.stress.value == pytest.approx(np.abs(force) @ area / (area @ area), rel=1e-9)
    assert (found.low, found.high, found.n_points) == (1e-7, 6e-7, 3)


def test_frames_without_friction_or_contact_do_not_count():
    table = friction([1e-7, 2e-7, 0.0], [0.05, np.nan, 0.01])
    found = fit_shear_stress(table)
    assert found.n_points == 1
    assert found.stress.value == pytest.approx(0.5e6)
    assert found.stress.high == np.inf  # one point says nothing of the scatter
    with pytest.raises(InputError, match="friction_N"):
        fit_shear_stress(table[table["friction_N"].isna()])


@pytest.mark.parametrize(("frames", "relative"), [(8, 0.0), (2, 0.05), (3, 0.05), (5, 0.05)])
def test_interval_of_the_shear_stress_holds_it(rng, frames, relative):
    """Errors as stated, or a scatter in proportion to the load, of which they say nothing."""
    area, held = np.linspace(1e-7, 8e-7, frames), 0
    for _ in range(300):
        seen = area * (1 + 0.02 * rng.standard_normal(frames))
        force = 0.49e6 * area * (1 + relative * rng.standard_normal(frames))
        std = 0.0 if relative else 0.01
        force += std * rng.standard_normal(frames)
        found = fit_shear_stress(friction(seen, force, 0.02 * area), friction_std=std).stress
        held += found.low <= 0.49e6 <= found.high
    # 90 % less two binomial standard deviations; where only scatter of one size counts, 74 % of two frames
    assert held / 300 > 0.865


def test_without_stated_errors_the_scatter_alone_tells_the_interval():
    area, force = np.array([1e-7, 2e-7, 4e-7]), np.array([0.05, 0.09, 0.2])
    found = fit_shear_stress(friction(area, force))
    assert found.freedom == 2
    rest, square = force - found.stress.value * area, area @ area
    even = rest @ rest / 2 / square
    own = np.sum((area * rest / (1 - area**2 / square)) ** 2) / square**2
    assert found.stress.std == pytest.approx(np.sqrt(max(even, own)), rel=1e-6)


def test_ratio_of_stresses_adds_relative_variances():
    rough = fit_shear_stress(friction([1e-7, 2e-7, 4e-7], [0.05, 0.098, 0.196], 1e-9), friction_std=1e-3)
    ratio = compare_stress(rough, Estimate(0.34e6, 0.017e6, 0, 0))
    relative = np.hypot(rough.stress.std / rough.stress.value, 0.05)
    assert ratio.value == pytest.approx(rough.stress.value / 0.34e6)
    assert ratio.std == pytest.approx(ratio.value * relative)
    with pytest.raises(InputError, match="must be positive"):
        compare_stress(rough, Estimate(0.0, 0.0, 0, 0))
    still = replace(rough, stress=Estimate(0.0, 1e4, 0.0, 0.0))  # the lens did not slide
    assert compare_stress(still, Estimate(0.34e6, 0.017e6, 0, 0)).std == pytest.approx(1e4 / 0.34e6)


def caps(height, radius, **std):
    return pd.DataFrame({"height_m": height, "radius_m": radius} | std)


def test_contact_angle_of_exact_caps():
    radius = np.array([20e-6, 50e-6, 90e-6])
    found = describe_topography(caps(radius * (1 - np.cos(np.radians(57))), radius))
    assert np.degrees(found.contact_angle.value) == pytest.approx(57, rel=1e-9)
    assert found.radius(np.array([30e-6]))[0] == pytest.approx(30e-6 / (1 - np.cos(np.radians(57))))
    assert (found.height_mean, found.radius_std) == pytest.approx(
        (radius.mean() * (1 - np.cos(np.radians(57))), np.std(radius, ddof=1))
    )


def test_errors_of_the_radius_are_needed():
    rng = np.random.default_rng(11)
    radius = rng.uniform(20e-6, 100e-6, 2000)
    table = caps(0.45 * radius, radius + 15e-6 * rng.standard_normal(2000), radius_std_m=15e-6)
    table = table[table["radius_m"] > 0]
    found = describe_topography(table).slope
    assert found.low < 0.45 < found.high
    # left out, they flatten the line by sum R^2/(sum R^2 + n 15^2) = 1 - 225/4358 = 0.948
    plain = describe_topography(table.drop(columns="radius_std_m")).slope
    assert plain.high < 0.45


def test_no_angle_without_correlation(rng):
    found = describe_topography(caps(rng.normal(9e-6, 2e-6, 293), rng.normal(50e-6, 10e-6, 293)))
    assert not found.one_angle
    assert abs(found.correlation) < 4 / np.sqrt(292)  # its standard deviation is 1/sqrt(n - 1)


def test_caps_higher_than_spheres_have_no_angle():
    assert np.isnan(describe_topography(caps([3.0, 3.1, 2.9], [1.0, 1.0, 1.0])).contact_angle.value)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (caps([1.0, 2.0], [1.0, 2.0]), "three asperities"),
        (caps([1.0, -2.0, 1.0], [1.0, 2.0, 3.0]), "must be positive"),
    ],
)
def test_bad_topography_is_refused(table, message):
    with pytest.raises(InputError, match=message):
        describe_topography(table)


def test_normal_heights_look_normal_and_others_do_not():
    rng = np.random.default_rng(5)
    normal = [describe_topography(caps(*rng.normal(5e-5, 1e-5, (2, 119)))) for _ in range(40)]
    p_values = [p for found in normal for p in (found.height_normality, found.radius_normality)]
    assert stats.kstest(p_values, "uniform").pvalue > 0.001
    skew = describe_topography(caps(rng.lognormal(-10, 0.5, 119), rng.uniform(1e-5, 9e-5, 119)))
    assert skew.height_normality < 1e-3
    assert np.isnan(describe_topography(caps([3.0, 3.1, 2.9], [1.0, 1.0, 1.0])).radius_normality)


def test_no_point_is_a_sentence():
    with pytest.raises(InputError, match="got 0"):
        fit_power_law([], [])


def test_places_of_the_break_where_the_fit_diverges_are_left_out():
    """Three points of large errors on one side of the break do not decide on an exponent there."""
    x = [262.3, 131.5, 25.53, 3.237, 555.3, 193.4, 48.22, 1.7, 464.2, 107.1, 3.463]
    y = [1.971, 1.428, 0.7276, 0.1032, 2.546, 1.682, 0.9491, 0.06701, 2.409, 1.311, 0.2583]
    x_std = [53.79, 29.35, 8.962, 2.568, 71.47, 31.91, 9.704, 1.45, 52.03, 18.07, 1.544]
    y_std = [0.2846, 0.2347, 0.1627, 0.0596, 0.2521, 0.201, 0.1482, 0.03869, 0.2172, 0.1579, 0.06904]
    correlation = [0.704, 0.737, 0.637, 0.728, 0.769, 0.724, 0.776, 0.677, 0.805, 0.713, 0.6]
    law = fit_broken_law(x, y, x_std=x_std, y_std=y_std, correlation=correlation)
    assert law.high_exponent.value == pytest.approx(0.41, abs=0.02)
    assert np.isfinite([law.break_x.value, law.low_exponent.value, law.low_exponent.std]).all()
    assert law.break_x.low == 0
