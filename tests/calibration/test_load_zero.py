"""What loads and lens may be off by: fitted where the frames show it, allowed for where they do not."""

import numpy as np
import pytest

from contactimg.analysis.load_cell import EXACT_LOADS, LoadCell
from contactimg.calibration.jkr import calibrate_jkr
from contactimg.cli.scenes import apply_calibration, refuse_idle
from contactimg.errors import InputError
from contactimg.mechanics import jkr
from contactimg.mechanics.layer import layer_factors
from contactimg.plausibility import doubts_about_scene
from contactimg.scene import scene_from_dict

LAW = {"sphere_radius": 0.1288, "contact_modulus": 4e6, "work_of_adhesion": 0.05}
E = 3e6
NOISE = 2e-3  # of each load
FIVE, TWELVE = np.array([0.02, 0.05, 0.1, 0.2, 0.5]), np.linspace(0.02, 0.5, 12)


def calibration(loads, *, zero=0.0, gain=0.0, seed=0, **more):
    rng = np.random.default_rng([14, seed])
    radius = jkr.radius(loads, **LAW)
    read = loads * (1 + gain) * (1 + NOISE * rng.standard_normal(len(loads))) + zero
    radius_std = 5e-7
    radius = radius + radius_std * rng.standard_normal(len(loads))
    # a rubber 10 m thick is a half-space, and no thickness is looked for, which takes half of the time
    sample = {"sphere_radius": 0.1288, "poisson_ratio": 0.5, "thickness": 10.0}
    return calibrate_jkr(read, radius, **sample, radius_std=radius_std, **more)


STATED = LoadCell(zero_std=2.5e-3)


def test_a_zero_far_off_is_found_and_taken_off():
    found = [
        calibration(TWELVE, zero=4e-2, seed=seed, load_cell=LoadCell(zero_std=2e-2)) for seed in range(5)
    ]
    assert all(one.load_zero_seen for one in found)
    # 1.3 mN each, over the root of five
    assert np.mean([one.load_zero.value for one in found]) == pytest.approx(4e-2, abs=2e-3)
    assert np.mean([one.young_modulus.value for one in found]) == pytest.approx(E, rel=0.01)


def test_a_zero_that_is_not_stated_is_not_fitted_but_asked_for():
    found = [calibration(TWELVE, zero=4e-2, seed=seed) for seed in range(5)]
    assert all(one.load_zero is None and not one.load_zero_seen for one in found)
    assert np.mean([one.zero_asked for one in found]) == pytest.approx(4e-2, abs=2e-3)
    right = [calibration(TWELVE, seed=seed).zero_asked for seed in range(20)]
    # 1 % of 20 is 0.2; three or more have a probability of 1e-3
    assert sum(zero is not None for zero in right) <= 2
    assert calibration(TWELVE, zero=4e-2, load_cell=STATED).zero_asked is None


def test_a_zero_that_is_hardly_off_is_allowed_for():
    """Loads cannot tell it, so that its prior width is what E must allow for."""
    wrong = {"zero": 2e-3, "seed": 1}
    found = calibration(FIVE, **wrong, load_cell=LoadCell(zero_std=2.5e-3, gain_std=0.0))
    trusting = calibration(FIVE, **wrong, load_cell=EXACT_LOADS)
    assert not found.load_zero_seen
    assert found.load_zero.low < 2e-3 < found.load_zero.high
    assert abs(found.young_modulus.value - E) < 2 * found.young_modulus.std
    assert trusting.load_zero is None
    stds = [
        np.median(
            [
                calibration(FIVE, seed=seed, load_cell=LoadCell(zero_std, gain_std=0.0)).young_modulus.std
                for seed in range(5)
            ]
        )
        for zero_std in (0.0, 1e-3, 1e-2)
    ]
    assert stds[0] < min(stds[1:])
    # with exact data the loads tell all
    exact = calibrate_jkr(
        TWELVE,
        jkr.radius(TWELVE, **LAW),
        sphere_radius=0.1288,
        poisson_ratio=0.5,
        load_cell=LoadCell(2.5e-3, 0),
    )
    assert exact.young_modulus.std < 1e-5 * E


def test_a_true_zero_is_rarely_taken_for_one_that_is_off():
    found = [calibration(TWELVE, seed=seed, load_cell=STATED) for seed in range(20)]
    # 1 % of 20 is 0.2; three or more have a probability of 1e-3
    assert sum(one.load_zero_seen for one in found) <= 2


def test_five_loads_with_a_zero_or_a_gain_off_state_what_they_do_not_know():
    """Two standard uncertainties hold 95 %; of 12 series 9 or fewer have a probability of 2 %."""
    for wrong in ({"zero": 2e-3}, {"gain": 0.01}):
        found = [calibration(FIVE, seed=seed, load_cell=STATED, **wrong).young_modulus for seed in range(12)]
        assert sum(abs(one.value - E) < 2 * one.std for one in found) >= 10


def test_three_loads_cannot_tell_the_zero_and_state_what_they_do_not_know():
    """With the zero three loads fit three numbers without a residual, which would leave no uncertainty."""
    three, cell, rng = np.array([0.05, 0.2, 0.5]), LoadCell(1e-2, gain_std=0.0), np.random.default_rng(5)
    radius, sample = jkr.radius(three, **LAW), {"sphere_radius": 0.1288, "poisson_ratio": 0.5}
    found = [
        calibrate_jkr(three + 1e-2 * zero, radius, **sample, thickness=10.0, load_cell=cell).young_modulus
        for zero in rng.standard_normal(12)
    ]
    assert sum(one.low < E < one.high for one in found) >= 10  # 9 or fewer have a probability of 2 %
    # P = K a^3/R - ... a^(3/2): what a zero of one standard uncertainty makes of the first term
    terms = np.column_stack([radius**3, radius**1.5])
    change = np.linalg.lstsq(terms, np.full(3, 1e-2), rcond=None)[0][0] * 0.1288 * 0.75 * 0.75
    stds = [one.std for one in found]
    assert min(stds) > abs(change) > 0.02 * E
    # what is stated of the zero is no guess from one residual, whose intervals are six times as wide
    assert np.median(stds) < 2 * abs(change)


def test_the_gain_goes_into_the_modulus_in_full():
    exact, one_percent = (
        calibration(FIVE, load_cell=LoadCell(zero_std=0.0, gain_std=gain)) for gain in (0.0, 0.01)
    )
    expected = np.hypot(exact.young_modulus.std, 0.01 * exact.young_modulus.value)
    # both are spreads of 20000 draws, the tails of the first wider than a normal distribution's
    assert one_percent.young_modulus.std == pytest.approx(expected, rel=0.03)
    assert one_percent.work_of_adhesion.std > exact.work_of_adhesion.std


def test_a_sphere_of_unequal_curvature_widens_both():
    round_, astigmatic = (
        calibration(FIVE, load_cell=EXACT_LOADS, sphere_radius_std=0.1288 * std) for std in (0.0, 0.01)
    )
    expected = np.hypot(round_.young_modulus.std, 0.01 * round_.young_modulus.value)
    assert astigmatic.young_modulus.std == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("thickness", [15e-3, 5e-3])
def test_the_layer_has_its_own_law(thickness):
    radius = jkr.radius(FIVE, **LAW)
    pressing, adhesive = layer_factors(radius / thickness)
    K, w = 4 / 3 * LAW["contact_modulus"], LAW["work_of_adhesion"]
    load = pressing * K * radius**3 / 0.1288 - adhesive * np.sqrt(6 * np.pi * w * K * radius**3)
    where = {"sphere_radius": 0.1288, "poisson_ratio": 0.5, "load_cell": EXACT_LOADS}
    layer = calibrate_jkr(load, radius, **where, thickness=thickness)
    assert layer.young_modulus.value == pytest.approx(E, rel=1e-5)
    assert layer.work_of_adhesion.value == pytest.approx(w, rel=1e-4)
    ignored = calibrate_jkr(load, radius, **where).young_modulus.value / E - 1
    # the largest load counts most, and there the factor is largest
    assert 0.7 * (pressing[-1] - 1) < ignored < 1.1 * (pressing[-1] - 1)


def test_a_layer_that_is_not_stated_is_asked_for():
    radius = jkr.radius(FIVE, **LAW)
    rng = np.random.default_rng(2)
    for thickness, asked in ((5e-3, True), (1.0, False)):
        pressing, adhesive = layer_factors(radius / thickness)
        K, w = 4 / 3 * LAW["contact_modulus"], LAW["work_of_adhesion"]
        load = pressing * K * radius**3 / 0.1288 - adhesive * np.sqrt(6 * np.pi * w * K * radius**3)
        read = load * (1 + 1e-3 * rng.standard_normal(5))
        found = calibrate_jkr(read, radius, sphere_radius=0.1288, poisson_ratio=0.5, radius_std=1e-7)
        assert (found.layer_asked is not None) == asked
        if found.layer_asked is not None:
            assert 3e-3 < found.layer_asked[0] < 8e-3
            assert found.layer_asked[1] < -0.04


def test_a_drift_of_the_zero_is_told_from_hysteresis_or_both_are_named():
    """Up and down: the drift adds to each load in turn, hysteresis to the way back only."""
    loads = np.concatenate([FIVE, FIVE[-2::-1]])
    rng = np.random.default_rng(5)
    radius = jkr.radius(loads, **LAW)
    time = np.linspace(-0.5, 0.5, len(loads))
    read = loads * (1 + 5e-4 * rng.standard_normal(len(loads))) + 4e-3 * time
    found = calibrate_jkr(read, radius, sphere_radius=0.1288, poisson_ratio=0.5, radius_std=2e-7)
    assert "drift of the zero" in (found.departure, found.rival)
    assert abs(found.young_modulus.value - E) < 2 * found.young_modulus.std
    if found.departure == "drift of the zero":
        assert found.drift.low < 4e-3 < found.drift.high
    still = calibrate_jkr(
        read - 4e-3 * time, radius, sphere_radius=0.1288, poisson_ratio=0.5, radius_std=2e-7
    )
    assert not still.departure


def test_the_modulus_that_is_sought_need_not_be_stated():
    scene = scene_from_dict({"elastic": {"poisson_ratio": 0.49}})
    assert list(doubts_about_scene(scene)) == []
    elastic = scene.elastic
    assert elastic.poisson_ratio == 0.49
    with pytest.raises(InputError, match="young_modulus_Pa is missing"):
        _ = elastic.young_modulus


def test_a_threshold_is_refused_where_it_cannot_act_and_brings_its_modulus_where_it_can():
    record = {
        "kind": "threshold",
        "method": "threshold",
        "threshold": {"value": 0.45, "std": 0.01},
        "fixed": {"young_modulus": {"value": 2.85e6, "std": 1e4}},
    }
    data = {"elastic": {"young_modulus_Pa": 3e6}, "measure": {"method": "disk"}}
    apply_calibration(data, record, sets_method=True)
    assert data["elastic"]["young_modulus_Pa"] == 2.85e6
    with pytest.raises(InputError, match='acts on the method "threshold" only'):
        refuse_idle(record, "calibration.json", method="disk")
    refuse_idle(record, "calibration.json", method="threshold")
