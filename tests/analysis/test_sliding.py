"""Sliding: stresses by hand."""

import numpy as np
import pandas as pd
import pytest

from contactimg import fit_power_law
from contactimg.analysis.friction import stress_by_velocity
from contactimg.errors import InputError


def friction(velocity, stress, area=(1e-7, 2e-7, 4e-7)):
    v, s, a = (np.ravel(x) for x in np.broadcast_arrays(np.c_[velocity], np.c_[stress], np.array([area])))
    return pd.DataFrame({"velocity_m_s": v, "friction_N": s * a, "area_m2": a, "area_std_m2": 0.0})


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
