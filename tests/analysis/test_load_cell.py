"""The zero and the gain that all loads share, in A(P) and in the slope of force sums."""

import numpy as np
import pandas as pd
import pytest

import contactimg
from contactimg.analysis.area_power_law import fit_area_law
from contactimg.analysis.load_cell import LoadCell
from contactimg.calibration.threshold_and_modulus import calibrate_modulus, load_slope
from contactimg.errors import InputError
from contactimg.scene import scene_from_dict

EXPONENT, ZERO = 0.86, 2e-3
LOADS = np.array([0.02, 0.05, 0.1, 0.2, 0.5])


def areas(*, zero, places=6, seed=0):
    """Areas with 0.5 % of noise at loads that read too much by ``zero``; places differ by 3 %."""
    rng = np.random.default_rng(seed)
    place = np.repeat(np.arange(places), len(LOADS))
    load = np.tile(LOADS, places)
    level = (1 + 0.03 * rng.standard_normal(places))[place]
    area = 1e-6 * (load / 0.1) ** EXPONENT * level * (1 + 5e-3 * rng.standard_normal(len(load)))
    return pd.DataFrame(
        {"place": place, "load": load + zero, "area": area, "area_std": 5e-3 * area, "sampling_std": 0.0}
    )


STATED = LoadCell(zero_std=2.5e-3)


def test_a_stated_zero_is_fitted_and_one_that_is_not_stated_is_not():
    off = areas(zero=ZERO)
    trusting, found = (fit_area_law(off, load_cell=cell) for cell in (LoadCell(), STATED))
    assert trusting.zero == 0.0
    assert not trusting.exponent.low < EXPONENT < trusting.exponent.high
    assert found.exponent.low < EXPONENT < found.exponent.high
    assert found.zero == pytest.approx(ZERO, rel=0.5)  # 25 points of 0.5 % see it
    assert found.exponent.std > trusting.exponent.std
    right = fit_area_law(areas(zero=0.0), load_cell=STATED)
    assert abs(right.zero) < 0.5 * ZERO


def test_the_exponent_without_data_that_tell_is_as_uncertain_as_the_zero():
    """Two loads: dm/dzero = (1/P1 - 1/P2) m/ln(P2/P1), and nothing tells the zero."""
    two = pd.DataFrame(
        {"place": 0, "load": [0.1, 0.4], "area": [1e-6, 3e-6], "area_std": 0.0, "sampling_std": 0.0}
    )
    law = fit_area_law(two, load_cell=LoadCell(zero_std=1e-3, gain_std=0.0))
    expected = 1e-3 * (1 / 0.1 - 1 / 0.4) * np.log(3) / np.log(4) ** 2
    # curvature over one standard uncertainty, 1 % of the smallest load
    assert law.exponent.std == pytest.approx(expected, rel=0.02)


def test_the_gain_changes_the_amplitude_only():
    exact, gain = (fit_area_law(areas(zero=0.0), load_cell=LoadCell(0.0, std)) for std in (0.0, 0.1))
    assert gain.exponent == exact.exponent
    # 10 % of the load are 0.1 m of the area
    added = np.sqrt(gain.amplitude.std**2 - exact.amplitude.std**2) / exact.amplitude.value
    assert added == pytest.approx(0.1 * exact.exponent.value, rel=1e-6)


def test_slope_and_modulus_know_the_zero():
    load = np.array([0.1, 0.2, 0.4])
    exact, zero = (load_slope(load, load, zero_std=std) for std in (0.0, ZERO))
    # d slope = -zero sum(P)/sum(P^2)
    assert exact.std == 0.0
    assert zero.std == pytest.approx(ZERO * 0.7 / 0.21, rel=1e-3)
    tuned = calibrate_modulus(load, load, young_modulus=3e6, young_modulus_std=0.0, zero_std=ZERO)
    assert tuned.young_modulus.std == pytest.approx(3e6 * zero.std, rel=1e-3)


def test_what_a_scene_states_of_the_load_cell():
    stated = scene_from_dict({"load": {"zero_std_N": 1e-3}})
    cell = LoadCell.stated(stated.load)
    assert (cell.zero_std, cell.gain_std) == (1e-3, 0.01)
    assert LoadCell.stated(scene_from_dict({}).load).zero_std == 0.0
    with pytest.raises(InputError, match="zero must not be negative"):
        LoadCell(zero_std=-1.0)


def test_the_table_of_areas_has_a_public_maker():
    frames = pd.DataFrame({"frame": ["a", "b"], "load_N": [0.1, 0.4], "area_m2": [1e-6, 4e-6]})
    frames["area_std_m2"] = 0.0
    with pytest.raises(InputError, match=r"column 'place' is missing; give the table of `frame_areas`"):
        fit_area_law(frames)
    contacts = pd.DataFrame({"frame": ["a", "b"], "radius_m": [1e-4, 2e-4], "area_m2": [1e-6, 4e-6]})
    areas = contactimg.frame_areas(frames, contacts, place="here")
    assert fit_area_law(areas).exponent.value == pytest.approx(1.0)
