"""A load cell whose zero is off: fitted where the loads show it, allowed for where they do not."""

import numpy as np
import pytest

from contactimg.calibration.jkr import calibrate_jkr
from contactimg.cli.scenes import _apply_calibration, _refuse_idle
from contactimg.errors import InputError
from contactimg.mechanics import jkr
from contactimg.plausibility import doubts_about_scene
from contactimg.scene import scene_from_dict

LAW = {"sphere_radius": 0.1288, "contact_modulus": 4e6, "work_of_adhesion": 0.05}
NOISE = 2e-3  # of each load


def calibration(loads, *, zero, seed):
    rng = np.random.default_rng([14, seed])
    radius = jkr.radius(loads, **LAW)
    read = loads * (1 + NOISE * rng.standard_normal(len(loads))) + zero
    radius_std = 5e-7
    radius = radius + radius_std * rng.standard_normal(len(loads))
    return calibrate_jkr(read, radius, sphere_radius=0.1288, poisson_ratio=0.5, radius_std=radius_std)


def test_a_zero_far_off_is_found_and_taken_off():
    loads = np.linspace(0.02, 0.5, 12)
    found = [calibration(loads, zero=2e-2, seed=seed) for seed in range(10)]
    fitted = [one for one in found if one.load_zero is not None]
    assert len(fitted) >= 8
    assert np.mean([one.load_zero.value for one in fitted]) == pytest.approx(2e-2, rel=0.2)


def test_a_zero_that_is_hardly_off_is_allowed_for():
    loads = np.linspace(0.02, 0.5, 12)
    found = calibration(loads, zero=2e-3, seed=1)
    assert found.load_zero is None
    assert found.load_zero_doubt >= 0.5
    # with exact data nothing is doubted
    exact = calibrate_jkr(loads, jkr.radius(loads, **LAW), sphere_radius=0.1288, poisson_ratio=0.5)
    assert exact.load_zero_doubt == 0.0
    assert exact.young_modulus.std < 1e-6 * 3e6


def test_a_true_zero_is_rarely_taken_for_one_that_is_off():
    loads = np.linspace(0.02, 0.5, 12)
    found = [calibration(loads, zero=0.0, seed=seed) for seed in range(40)]
    # 1 % of 40 is 0.4; four or more have a probability of 1e-3
    assert sum(one.load_zero is not None for one in found) <= 3


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
    _apply_calibration(data, record, sets_method=True)
    assert data["elastic"]["young_modulus_Pa"] == 2.85e6
    with pytest.raises(InputError, match='acts on the method "threshold" only'):
        _refuse_idle(data, record, "calibration.json", None)
    _refuse_idle(data, record, "calibration.json", "threshold")
