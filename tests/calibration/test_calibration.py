"""Calibrations on numbers: modulus and adhesion with honest intervals, threshold, modulus, plateau."""

import numpy as np
import pytest
from scipy import stats

from contactimg.analysis.estimates import CoverageEstimate, student_estimate
from contactimg.analysis.load_cell import EXACT_LOADS, LoadCell
from contactimg.calibration.area_plateau import find_plateau
from contactimg.calibration.jkr import calibrate_jkr, classify_branches
from contactimg.calibration.threshold_and_modulus import calibrate_modulus, calibrate_threshold, load_slope
from contactimg.errors import InputError
from contactimg.mechanics import jkr

LENS, MODULUS, ADHESION = 0.1288, 3.0e6, 0.05
LAW = {"sphere_radius": LENS, "contact_modulus": MODULUS / 0.75, "work_of_adhesion": ADHESION}
LOADS = np.array([-0.01, 0.0, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5])


def fit(load, radius, **more):
    return calibrate_jkr(load, radius, sphere_radius=LENS, poisson_ratio=0.5, **more)


def test_exact_data_give_exact_answers():
    found = fit(LOADS, jkr.radius(LOADS, **LAW))
    # the noise is never taken below 1e-9 of the loads; the draws' median is good to that
    assert found.young_modulus.value == pytest.approx(MODULUS, rel=1e-6)
    assert found.work_of_adhesion.value == pytest.approx(ADHESION, rel=1e-6)
    assert found.points["used"].all()


def test_uncertainties_that_are_not_one_each_are_refused():
    with pytest.raises(
        InputError, match=r"one uncertainty or one each, got shapes \(8,\), \(8,\) and \(2,\)"
    ):
        fit(LOADS, jkr.radius(LOADS, **LAW), radius_std=[1e-6, 1e-6])


def test_radii_in_micrometres_are_doubted():
    with pytest.raises(InputError, match=r"over that of the sphere = .* pixel_size_m and radius_m in metres"):
        fit(LOADS, 1e6 * jkr.radius(LOADS, **LAW))


@pytest.mark.parametrize(
    ("length", "sentence"),
    [
        ({"pixel_size": 6.0}, "pixel_size_m = 6 .* given in µm"),
        ({"sphere_radius": 128.8}, r"\[indenter\] radius_m = 129 .* given in mm"),
    ],
)
def test_a_length_in_another_unit_is_refused(length, sentence):
    with pytest.raises(InputError, match=f"calibrate_jkr: {sentence}"):
        calibrate_jkr(
            LOADS, jkr.radius(LOADS, **LAW), **{"sphere_radius": LENS, "poisson_ratio": 0.5} | length
        )


@pytest.mark.parametrize("zero_std", [0.0, 2e-3])
def test_change_of_units(rng, zero_std):
    """Every length times l, every pressure times p: loads times p l^2, E times p, w times p l."""
    load = LOADS * (1 + 0.01 * rng.standard_normal(LOADS.size))
    radius = jkr.radius(LOADS, **LAW)
    length, pressure = 7.0, 0.3
    here = fit(load, radius, radius_std=1e-7, load_cell=LoadCell(zero_std))
    there = calibrate_jkr(
        load * pressure * length**2,
        radius * length,
        load_cell=LoadCell(zero_std * pressure * length**2),
        radius_std=1e-7 * length,
        sphere_radius=LENS * length,
        poisson_ratio=0.5,
    )
    for name, factor in (("young_modulus", pressure), ("work_of_adhesion", pressure * length)):
        one, other = getattr(here, name), getattr(there, name)
        assert [other.value, other.low, other.high] == pytest.approx(
            [factor * one.value, factor * one.low, factor * one.high], rel=1e-9
        )


def test_order_of_the_frames_does_not_matter_unless_it_is_a_branch(rng):
    load = LOADS * (1 + 0.01 * rng.standard_normal(LOADS.size))
    order = rng.permutation(LOADS.size)
    sorted_, shuffled = (fit(load[k], jkr.radius(LOADS[k], **LAW)) for k in (slice(None), order))
    assert shuffled.young_modulus.value == pytest.approx(sorted_.young_modulus.value, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("noise", "kind", "zero_std"),
    [(0.002, "each", 0.0), (0.002, "each", 2.5e-3), (0.01, "largest", 0.0), (0.1, "largest", 2.5e-3)],
)
def test_intervals_hold_the_truth_as_often_as_they_say(noise, kind, zero_std):
    """95 % of 40 seeds; a count falls below 35 with a chance of 1.4 %. The gain would hide the rest."""
    radius, inside, errors = jkr.radius(LOADS, **LAW), [], []
    for seed in range(40):
        rng = np.random.default_rng(1000 + seed)
        scale = np.abs(LOADS) if kind == "each" else LOADS.max()
        load = LOADS + noise * scale * rng.standard_normal(LOADS.size) + zero_std * rng.standard_normal()
        read = radius * (1 + 3e-5 * rng.standard_normal(LOADS.size))
        # a rubber 10 m thick is a half-space, and no thickness is looked for, which takes half of the time
        cell = LoadCell(zero_std, gain_std=0.0)
        found = fit(load, read, radius_std=3e-5 * radius, load_cell=cell, thickness=10.0)
        E, w = found.young_modulus, found.work_of_adhesion
        inside.append((E.low <= MODULUS <= E.high, w.low <= ADHESION <= w.high))
        errors.append((E.value / MODULUS - 1, w.value / ADHESION - 1))
    assert stats.binom.cdf(34, 40, 0.95) < 0.014
    assert np.sum(inside, axis=0).min() >= 35
    if noise == 0.002 and kind == "each":
        demanded = [0.01, 0.01] if zero_std == 0 else [0.01, 0.05]  # the price of an uncertain zero
        assert (np.abs(errors).max(axis=0) < demanded).all()


def test_noise_of_the_radii_counts(rng):
    """Without load noise the radii's own sets the uncertainty: the law's slope turns it into load."""
    load = np.tile([0.02, 0.05, 0.1, 0.2, 0.5], 8)
    true = jkr.radius(load, **LAW)
    std = 0.003 * true
    found = fit(load, true + std * rng.standard_normal(load.size), radius_std=std, load_cell=EXACT_LOADS)
    a, K = true, 4 / 3 * LAW["contact_modulus"]
    design = np.column_stack([a**3 / LENS, -np.sqrt(6 * np.pi * K * ADHESION) * a**1.5 / (2 * ADHESION)])
    design[:, 0] -= np.sqrt(6 * np.pi * ADHESION / K) * a**1.5 / 2
    slope = 3 * K * a**2 / LENS - 1.5 * np.sqrt(6 * np.pi * ADHESION * K * a)
    spread = np.sqrt(np.linalg.inv(design.T @ (design / ((slope * std) ** 2)[:, None]))[0, 0]) / K
    # 40 points know their scatter to 1/sqrt(2 x 38) = 11 %: three times that
    assert found.young_modulus.std / MODULUS == pytest.approx(spread, rel=0.34)
    assert abs(found.young_modulus.value / MODULUS - 1) < 3 * spread


def test_a_stray_frame_is_left_out_and_named_in_the_table(rng):
    load = LOADS * (1 + 0.002 * rng.standard_normal(LOADS.size))
    radius = jkr.radius(LOADS, **LAW)
    radius[5] *= 0.8
    found = fit(load, radius)
    assert found.points["used"].tolist() == [k != 5 for k in range(8)]
    assert found.young_modulus.value == pytest.approx(MODULUS, rel=0.01)


def test_unloading_that_adheres_more_has_its_own_work_of_adhesion(rng):
    up, down = np.array([0.02, 0.05, 0.1, 0.2, 0.5]), np.array([0.2, 0.1, 0.05, 0.02, -0.02])
    stuck = LAW | {"work_of_adhesion": 0.12}
    load = np.concatenate([up, down])
    radius = np.concatenate([jkr.radius(up, **LAW), jkr.radius(down, **stuck)])
    found = fit(load * (1 + 0.002 * rng.standard_normal(10)), radius)
    assert found.points["branch"].tolist() == ["loading"] * 5 + ["unloading"] * 5
    assert found.work_of_adhesion.low <= ADHESION <= found.work_of_adhesion.high
    assert found.work_of_adhesion_unloading.low <= 0.12 <= found.work_of_adhesion_unloading.high
    same = fit(load * (1 + 0.002 * rng.standard_normal(10)), jkr.radius(load, **LAW))
    assert same.work_of_adhesion_unloading is None


def test_branches():
    assert classify_branches([0.5, 0.2]).tolist() == ["unloading"] * 2
    assert classify_branches([0.1, 0.3, 0.2, 0.5]).tolist() == [""] * 4
    assert classify_branches([]).tolist() == []


@pytest.mark.parametrize(
    ("load", "radius", "sentence"),
    [
        ([0.1, 0.2, 0.2], [1e-3, 2e-3, 2e-3], "three different loads or more, got 2"),
        ([-0.03, -0.02, -0.01], [1e-3, 1.1e-3, 1.2e-3], "pull-off branch only"),
        ([0.1, 0.2, 0.3, 0.4], [2e-3, 1.8e-3, 1.5e-3, 1e-3], "does not grow with the load"),
        ([0.1, 0.2, 0.3, 0.4], [1e-3] * 4, "does not grow with the load"),
        ([0.1, 0.2, 0.3], [1e-3, np.nan, 2e-3], "radii positive"),
        ([0.1, 0.2, 0.3], [1e-3, 2e-3], "one radius a load"),
    ],
)
def test_series_that_determine_nothing_are_refused(load, radius, sentence):
    with pytest.raises(InputError, match=sentence):
        fit(load, radius)


def test_slope_is_least_squares_through_the_origin(rng):
    load = rng.uniform(0.01, 0.5, 7)
    forces = 1.03 * load + 0.01 * rng.standard_normal(7)
    expected = np.linalg.lstsq(load[:, None], forces, rcond=None)[0][0]
    found = load_slope(np.append(forces, 0.3), np.append(load, 0.0))  # a load of 0 does not count
    assert found.value == pytest.approx(expected, rel=1e-12)
    rest = forces - expected * load
    even = np.sqrt(rest @ rest / 6 / (load @ load))
    assert found.high - found.value >= stats.t.ppf(0.975, 6) * even * (1 - 1e-12)


def test_slope_refuses_pulls_and_nothing():
    with pytest.raises(InputError, match="must not be negative"):
        load_slope([1.0, 1.0], [0.1, -0.1])
    with pytest.raises(InputError, match="no load presses"):
        load_slope([0.0], [0.0])


def test_of_one_load_only_the_modulus_is_uncertain():
    found = load_slope([0.103], [0.1], relative_std=0.02)
    assert (found.value, found.std) == pytest.approx((1.03, 0.0206), rel=1e-12)


def test_student_and_known_parts_add_in_quadrature():
    load, forces = np.array([0.1, 0.2, 0.3, 0.4]), np.array([0.11, 0.19, 0.32, 0.41])
    found, square = load_slope(forces, load, relative_std=0.02), load @ load
    rest = forces - found.value * load
    even, own = rest @ rest / 3 / square, np.sum((load * rest / (1 - load**2 / square)) ** 2) / square**2
    student = stats.t.ppf(0.975, 3) * np.sqrt(max(even, own))
    half = np.hypot(student, 0.02 * found.value * stats.norm.ppf(0.975))
    assert (found.low, found.high) == pytest.approx((found.value - half, found.value + half), rel=1e-12)
    assert student > 0.3 * half  # neither part hides the other


def test_a_calibrated_std_is_that_of_a_normal_distribution_with_the_same_interval():
    analysed = student_estimate(5.0, 2.0, freedom=3)
    calibrated = CoverageEstimate.of_interval(5.0, analysed.low, analysed.high)
    assert (calibrated.low, calibrated.high) == (analysed.low, analysed.high)
    assert analysed.std == 2.0
    # t(0.975, 3) = 3.182446, z(0.975) = 1.959964
    assert calibrated.std == pytest.approx(2.0 * 3.182446 / 1.959964, rel=1e-6)
    assert calibrated.record("1")["std"] == calibrated.std


def curve(t, load):
    return (1.9 - 1.6 * t - 0.3 * t**2)[:, None] * load


def test_threshold_of_slope_one():
    t, load = np.linspace(0.1, 0.9, 33), np.array([0.3, 0.1, 0.0, 0.1, 0.5])  # unsorted, repeated, zero
    found = calibrate_threshold(t[::-1], curve(t, load)[::-1], load, relative_std=0.03)
    exact = (-1.6 + np.sqrt(1.6**2 + 4 * 0.3 * 0.9)) / 0.6
    # linear between thresholds 0.025 apart: 0.3/1.9 (0.025)^2/4 = 2.5e-5
    assert found.threshold.value == pytest.approx(exact, abs=3e-5)
    assert found.threshold.std == pytest.approx(0.03 / (1.6 + 0.6 * exact), rel=1e-3)
    assert found.slope.value == pytest.approx(1.0, rel=1e-12)


def test_a_threshold_that_is_wrong_breaks_the_slope():
    t, load = np.linspace(0.1, 0.9, 33), np.array([0.1, 0.3])
    found = calibrate_threshold(t, curve(t, load), load)
    off = np.interp(found.threshold.value + 0.1, found.thresholds, found.slopes)
    assert off == pytest.approx(1 - 0.1 * (1.6 + 0.6 * found.threshold.value), abs=0.004)  # 0.3 x 0.1^2


@pytest.mark.parametrize(("factor", "side"), [(0.3, "too small"), (5.0, "too large")])
def test_no_threshold_brackets_one(factor, side):
    t, load = np.linspace(0.1, 0.8, 20), np.array([0.1, 0.3])
    with pytest.raises(
        InputError, match=f"no threshold between 0.1 and 0.8 gives slope 1.*{side}: .*pixel size"
    ):
        calibrate_threshold(t, factor * curve(t, load), load)


def test_modulus_and_its_distance_from_the_measured_one():
    load = np.array([0.1, 0.2, 0.4])
    near = calibrate_modulus(load / 1.02, load, young_modulus=3e6, young_modulus_std=5e4)
    assert near.young_modulus.value == pytest.approx(1.02 * 3e6, rel=1e-12)
    assert near.compatible
    assert not near.message
    far = calibrate_modulus(load / 1.10, load, young_modulus=3e6, young_modulus_std=5e4)
    assert not far.compatible
    assert "outside the measured 3 +- 0.05 MPa" in far.message
    # forces grow with the cube of the pixel size: 1.1^(1/3)
    assert far.message.endswith("or pixels 1.03 times as large as stated")


def test_both_on_one_curve_are_refused():
    load = np.array([0.1, 0.2])
    with pytest.raises(InputError, match="cannot both be fitted on one load curve"):
        calibrate_modulus(np.ones((3, 2)), load, young_modulus=3e6, young_modulus_std=0.0)


def test_plateau_of_blurred_edges():
    """Wide straight edges: d ln A/dt ~ 1/phi(z), 1.5 times its least where z^2 = 2 ln 1.5."""
    t = np.linspace(0.02, 0.98, 481)
    area = np.pi * (1e-3 - 1e-6 * stats.norm.ppf(t)) ** 2
    found = find_plateau(t, np.column_stack([area, 2 * area]))
    end = stats.norm.cdf(np.sqrt(2 * np.log(1.5)))
    # thresholds are 0.002 apart; the radius varies by 0.2 %, which tilts the curve by as much
    assert (found.threshold_low, found.threshold_high) == pytest.approx((1 - end, end), abs=0.005)
    middle = np.interp([1 - end, end], t, area)
    assert found.area[0] == pytest.approx(middle.mean(), rel=1e-4)
    assert found.area_std[1] == pytest.approx(2 * np.ptp(middle) / 2, rel=0.02)
    assert found.marginal


def test_no_plateau_of_small_contacts_is_said():
    t = np.linspace(0.05, 0.95, 37)
    found = find_plateau(t, (3.0 - 1.5 * stats.norm.ppf(t)).clip(0) ** 2)
    assert not found.marginal
    with pytest.raises(InputError, match="needs contact area"):
        find_plateau(t, np.zeros(37))


def test_an_area_that_grows_is_no_plateau_and_one_that_stays_is_one_throughout():
    t = np.linspace(0.1, 0.9, 9)
    assert not find_plateau(t, np.linspace(1.0, 2.0, 9)).marginal
    found = find_plateau(t, np.full(9, 1e-8))
    assert (found.threshold_low, found.threshold_high, found.marginal) == (0.1, 0.9, True)
    for thresholds, areas in ((t, np.append(np.ones(8), np.nan)), (np.full(9, 0.5), np.ones(9))):
        with pytest.raises(InputError, match="must differ, and its areas be finite"):
            find_plateau(thresholds, areas)
