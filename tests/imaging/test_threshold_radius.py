"""What a threshold makes of a blurred disk, and the radius that it takes back."""

import math

import numpy as np
import pytest

from contactimg.errors import InputError
from contactimg.imaging.profile.blurred_disk import blurred_disk
from contactimg.imaging.profile.threshold_radius import disk_radius, threshold_radius


@pytest.mark.parametrize("fraction", [0.05, 0.3, 0.5, 0.7, 0.95])
def test_the_threshold_radius_is_where_the_profile_crosses(fraction):
    a = np.array([2.6, 4.0, 11.0, 40.0])
    r = threshold_radius(a, blur_px=1.4, fraction=fraction)
    crossed = r > 0
    assert crossed[1:].all()
    # bisection to rounding; the profile's slope is below 0.4/s
    np.testing.assert_allclose(blurred_disk(r[crossed], a[crossed], 1.4), fraction, atol=1e-12)


def test_a_wide_disk_loses_the_curvature_term_at_half_height():
    a, s = np.array([20.0, 40.0]), 1.4
    lost = a - threshold_radius(a, blur_px=s)
    # s^2/(2 a), the next term is smaller by about (s/a)^2
    np.testing.assert_allclose(lost, s**2 / (2 * a), rtol=2 * (s / 20) ** 2)


def test_a_small_disk_does_not_reach_half_height():
    # its centre reaches 1 - exp(-a^2/(2 s^2)): one half at a = 1.1774 s
    assert threshold_radius(1.17, blur_px=1.0) == 0
    assert threshold_radius(1.18, blur_px=1.0) > 0


@pytest.mark.parametrize(("fraction", "error"), [(0.05, 3e-4), (0.5, 1e-5), (0.95, 3e-4)])
def test_disk_radius_inverts_the_threshold(fraction, error):
    smallest = math.sqrt(-2 * math.log1p(-fraction))
    a = np.geomspace(1.01 * smallest, 500.0, 500)
    found = disk_radius(threshold_radius(a, blur_px=1.0, fraction=fraction), blur_px=1.0, fraction=fraction)
    np.testing.assert_allclose(found, a, atol=error)


def test_lengths_scale_together():
    a = np.array([2.0, 5.0, 100.0])
    scaled = disk_radius(3 * a, blur_px=3 * 0.8)
    np.testing.assert_allclose(scaled, 3 * disk_radius(a, blur_px=0.8), rtol=1e-13)


@pytest.mark.parametrize(("blur", "fraction"), [(0.0, 0.5), (math.nan, 0.5), (1.0, 0.0), (1.0, 1.0)])
def test_what_has_no_meaning_is_refused(blur, fraction):
    with pytest.raises(InputError, match="must be"):
        disk_radius(3.0, blur_px=blur, fraction=fraction)
