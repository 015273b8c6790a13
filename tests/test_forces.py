"""Forces: Hertz's law row by row, and the sums with their uncertainties."""

import numpy as np
import pytest

from contactimg.forces import assign_forces, total_area, total_force
from contactimg.tables import CONTACTS, Flag


def contacts(radius, std):
    radius, std = np.asarray(radius, float), np.asarray(std, float)
    return CONTACTS.conform({"radius_m": radius, "radius_std_m": std, "area_m2": np.pi * radius**2})


def test_hertz_by_hand():
    # p = 4 E* a^3 / (3 R) = 4 * 4e6 * (3e-5)^3 / (3 * 1e-4) = 1.44e-3 N
    table = assign_forces(contacts([3e-5], [3e-7]), 1e-4, contact_modulus=4e6, modulus_relative_std=0.04)
    assert table["force_N"][0] == pytest.approx(1.44e-3, rel=1e-12)
    # 3 * 1 % from the radius and 4 % from the modulus make 5 %
    assert table["force_std_N"][0] == pytest.approx(0.05 * 1.44e-3, rel=1e-12)


def test_force_scales_with_units():
    length, pressure = 7.0, 11.0
    small = assign_forces(contacts([3e-5, 1e-5], [3e-7, 1e-7]), 1e-4, contact_modulus=4e6)
    large = assign_forces(
        contacts(length * np.array([3e-5, 1e-5]), length * np.array([3e-7, 1e-7])),
        length * 1e-4,
        contact_modulus=pressure * 4e6,
    )
    scale = pressure * length**2
    np.testing.assert_allclose(large["force_N"], scale * small["force_N"], rtol=1e-13)
    np.testing.assert_allclose(large["force_std_N"], scale * small["force_std_N"], rtol=1e-13)


def test_unknown_radius_leaves_the_force_empty_and_out_of_the_sum():
    table = assign_forces(contacts([3e-5, 2e-5], [0, 0]), [1e-4, np.nan], contact_modulus=4e6)
    assert np.isnan(table["force_N"][1])
    assert total_force(table).value == pytest.approx(1.44e-3)


def test_beyond_hertz_is_flagged_above_a_third_of_the_radius():
    table = assign_forces(contacts([3.2e-5, 3.4e-5], [0, 0]), 1e-4, contact_modulus=4e6)
    assert table["flags"].tolist() == [0, int(Flag.BEYOND_HERTZ)]


def test_sums_add_independent_errors_in_quadrature_and_the_modulus_linearly():
    table = assign_forces(contacts([3e-5] * 4, [3e-7] * 4), 1e-4, contact_modulus=4e6)
    total = total_force(table, modulus_relative_std=0.1)
    assert total.value == pytest.approx(4 * 1.44e-3)
    assert total.std == pytest.approx(np.hypot(np.sqrt(4) * 0.03 * 1.44e-3, 0.1 * 4 * 1.44e-3))
    area = total_area(table)
    assert area.value == pytest.approx(4 * np.pi * 9e-10)
    assert area.std == pytest.approx(np.sqrt(4) * 0.02 * np.pi * 9e-10)


def test_sums_of_nothing():
    assert total_force(CONTACTS.empty()).value == 0
    assert total_area(CONTACTS.empty()).value == 0
    assert np.isnan(total_force(contacts([1e-5], [0])).value)
