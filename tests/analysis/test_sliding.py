"""Sliding: stresses by hand, change of units, and areas of the same contacts in two states."""

import numpy as np
import pandas as pd
import pytest

from contactimg import fit_power_law
from contactimg.analysis.friction import compare_areas, stress_by_velocity
from contactimg.errors import InputError


def friction(velocity, stress, area=(1e-7, 2e-7, 4e-7)):
    v, s, a = (np.ravel(x) for x in np.broadcast_arrays(np.c_[velocity], np.c_[stress], np.array([area])))
    return pd.DataFrame({"velocity_m_s": v, "friction_N": s * a, "area_m2": a, "area_std_m2": 0.0})


def contacts(radius, *, shift=0.0):
    n = len(radius)
    return pd.DataFrame(
        {
            "x_m": 1e-4 * np.arange(n) + shift,
            "y_m": np.zeros(n),
            "radius_m": radius,
            "frame": "a",
            "label": np.arange(1, n + 1),
            "asperity": -1,
            "force_N": np.nan,
        }
    )


def test_stress_at_each_velocity_and_its_exponent():
    velocity = np.array([1e-5, 1e-4, 1e-3, 5e-3])
    table = friction(velocity, 4e5 * (velocity / 1e-3) ** 0.05).sample(frac=1, random_state=1)
    found = stress_by_velocity(table, friction_std=1e-3)
    assert found["velocity_m_s"].to_numpy() == pytest.approx(velocity)
    assert found["stress_Pa"].to_numpy() == pytest.approx(4e5 * (velocity / 1e-3) ** 0.05)
    # of a line through the origin: std(Q)/sqrt(sum A^2) = 1e-3/sqrt(21e-14)
    assert found["stress_std_Pa"].to_numpy() == pytest.approx(1e-3 / np.sqrt(21e-14), rel=1e-6)
    law = fit_power_law(found["velocity_m_s"], found["stress_Pa"], y_std=found["stress_std_Pa"])
    assert law.exponent.value == pytest.approx(0.05)


def test_direction_and_nearly_equal_velocities():
    table = friction([1e-3, -1.02e-3, 2e-3], [4e5, -4e5, 5e5])
    table.loc[0, "velocity_m_s"] = 0.0  # at rest
    found = stress_by_velocity(table)
    assert found["n_frames"].tolist() == [5, 3]
    assert found["stress_Pa"].to_numpy() == pytest.approx([4e5, 5e5])


def test_one_frame_without_stated_error_has_no_uncertainty():
    found = stress_by_velocity(friction([1e-3], [4e5], area=(1e-7,)))
    assert found["stress_std_Pa"].isna().all()
    with pytest.raises(InputError, match="velocity_m_s"):
        stress_by_velocity(friction([np.nan], [4e5]))


def test_areas_in_two_states_by_hand():
    first, second = contacts([3e-6, 4e-6, 5e-6]), contacts([3e-6, 4e-6, 0.0], shift=1e-6)
    second = pd.concat([second.iloc[[1, 0]], contacts([6e-6], shift=5e-3)])
    change = compare_areas(first, second, max_distance=1e-5)
    assert (change.n_pairs, change.n_lost, change.n_gained) == (2, 1, 1)
    assert change.ratio.value == pytest.approx(1.0)
    assert change.ratio.std == pytest.approx(0.0, abs=1e-12)
    assert change.total == pytest.approx((9 + 16 + 36) / (9 + 16 + 25))


def test_ratio_scatters_as_stated(rng):
    radius = rng.uniform(5e-6, 3e-5, 100)
    ratios = []
    for _ in range(60):
        noise = 1 + 0.02 * rng.standard_normal((2, 100))
        ratios.append(compare_areas(contacts(radius * noise[0]), contacts(0.98 * radius * noise[1])).ratio)
    values, stds = (np.array([getattr(ratio, name) for ratio in ratios]) for name in ("value", "std"))
    assert values.mean() == pytest.approx(0.98**2, abs=4 * values.std() / np.sqrt(60))
    assert stds.mean() == pytest.approx(values.std(), rel=4 / np.sqrt(120))  # a std of 60 is good to 9 %


def test_ratio_does_not_depend_on_units(rng):
    first, second = contacts(rng.uniform(5e-6, 3e-5, 20)), contacts(rng.uniform(5e-6, 3e-5, 20))
    lengths = ["x_m", "y_m", "radius_m"]
    here = compare_areas(first, second)
    there = compare_areas(first.assign(**1e6 * first[lengths]), second.assign(**1e6 * second[lengths]))
    assert there.ratio.value == pytest.approx(here.ratio.value)
    assert there.ratio.std == pytest.approx(here.ratio.std)


def test_two_pairs_are_needed():
    with pytest.raises(InputError, match="two contacts at least"):
        compare_areas(contacts([1e-5, 1e-5]), contacts([1e-5], shift=1e-6))
