"""Intervals of weighted sums over few contacts: Garwood's limits, coverage, weights of both signs."""

import numpy as np
import pytest
from scipy import stats

from contactimg.analysis.annuli import annulus_moments
from contactimg.analysis.radial_profiles import average_profile, weighted_count_interval
from contactimg.tables import CONTACTS


def test_equal_weights_give_garwoods_exact_interval():
    n = np.array([0.0, 1.0, 4.0, 30.0])
    low, high = weighted_count_interval(2.0 * n, 4.0 * n, 2.0)
    assert high == pytest.approx(stats.chi2.ppf(0.975, 2 * n + 2))
    assert low[1:] == pytest.approx(stats.chi2.ppf(0.025, 2 * n[1:]))
    assert low[0] == 0.0


def test_many_contacts_give_the_normal_interval():
    low, high = weighted_count_interval(1e6, 1e6, 1.0)
    assert (float(low), float(high)) == pytest.approx((1e6 - 1959.96, 1e6 + 1959.96), abs=4)


@pytest.mark.parametrize("number", [0.7, 3.0, 20.0])
def test_unequal_weights_are_covered_where_the_normal_interval_is_not(number):
    rng = np.random.default_rng(int(10 * number))
    count = rng.poisson(number, 4000)
    weights = rng.random((4000, count.max())) * (np.arange(count.max()) < count[:, None])
    total, squares = weights.sum(axis=1), (weights**2).sum(axis=1)
    low, high = weighted_count_interval(total, squares, 1.0)
    held = np.mean((low <= number / 2) & (number / 2 <= high))
    normal = np.mean(np.abs(total - number / 2) <= 1.96 * np.sqrt(squares))
    assert held >= 0.95
    assert held > normal
    assert number >= 3.0 or normal < 0.6


def test_weights_of_both_signs_give_a_symmetric_interval():
    low, high = weighted_count_interval([-0.1, 0.1], [4.0, 4.0], 1.0)
    assert (low + high) / 2 == pytest.approx([-0.1, 0.1])
    assert (high - low) / 2 == pytest.approx(2 * stats.norm.ppf(0.975))


def test_no_contact_anywhere_has_no_upper_limit():
    moments = annulus_moments(CONTACTS.empty(), centre=(0.0, 0.0), edges=[0.0, 1.0])
    rows = average_profile([moments], frame="f", model="measured")
    assert rows["pressure_low_Pa"][0] == 0.0
    assert np.isnan(rows["pressure_high_Pa"][0])
