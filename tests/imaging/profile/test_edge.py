"""The blurred disk and its tables against brute-force sums, derivatives and limits."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy import special

from contactimg.imaging.fit.disks import render_disks
from contactimg.imaging.profile.blurred_disk import (
    INNER_BLUR_WIDTHS,
    PIXEL_VARIANCE,
    STEPS_PER_BLUR_WIDTH,
    blurred_disk,
    disk_table,
)
from contactimg.imaging.profile.film_rim import rim_table


def brute_force(a, sigma, x0, y0, *, half=12, k=40):
    """Disk sampled at k x k points a pixel, Gaussian as sum of the same points, averaged over each pixel."""
    n = 2 * half + 1
    axis = (np.arange(n * k) + 0.5) / k - 0.5 - half
    fine = (np.hypot(axis[None, :] - x0, axis[:, None] - y0) < a).astype(float)
    kernel = np.exp(-(np.arange(-6 * k * 2, 6 * k * 2 + 1) ** 2) / (2 * (sigma * k) ** 2))
    kernel /= kernel.sum()
    fine = np.apply_along_axis(np.convolve, 0, fine, kernel, mode="same")
    fine = np.apply_along_axis(np.convolve, 1, fine, kernel, mode="same")
    return fine.reshape(n, k, n, k).mean(axis=(1, 3))


@pytest.mark.parametrize(("a", "sigma"), [(0.7, 0.8), (2.0, 1.4), (5.3, 0.8), (6.0, 2.0)])
def test_profile_is_the_blurred_pixel_averaged_disk(a, sigma):
    # a pixel is a box of variance 1/12; its fourth cumulant, -1/120, times P''''/24 <= 1.4/sigma^4/24 is what
    # counting it as a Gaussian leaves out: 9e-4 at sigma 0.8, and two axes; the brute force errs by 1/(40
    # sqrt(12)) px
    tolerance = 2 * 1.4 / 24 / 120 / (sigma**2 + PIXEL_VARIANCE) ** 2 + 3e-4
    truth = brute_force(a, sigma, 0.3, -0.2)
    s = np.hypot(sigma, np.sqrt(PIXEL_VARIANCE))
    model = render_disks(np.array([[12.3, 11.8, a, 1.0]]), s, truth.shape)
    assert np.abs(model - truth).max() < tolerance


def test_light_of_a_disk_is_its_area():
    # the sum over pixels of a band-limited function is its integral, pi a^2, whatever the blur
    for a in (0.3, 1.5, 8.0):
        image = render_disks(np.array([[30.2, 29.7, a, 1.0]]), 1.3, (61, 61))
        # the drawn profile ends 5 blur widths out, where 3e-7 of the edge is left; the table interpolates to
        # 3e-5
        assert image.sum() == pytest.approx(np.pi * a**2, rel=2e-3)


def test_profile_depends_on_ratios_only():
    r, a = np.linspace(0, 12, 50), 4.0
    assert np.allclose(blurred_disk(r, a, 1.3), blurred_disk(3 * r, 3 * a, 3 * 1.3), rtol=0, atol=1e-12)


def test_small_disk_is_the_point_spread_function_and_large_one_a_straight_edge():
    r, s = np.linspace(0, 5, 30), 1.4
    # a^2/(2 s^2) exp(-r^2/2s^2), next term of relative order (a/s)^2
    point = 0.05**2 / (2 * s**2) * np.exp(-(r**2) / (2 * s**2))
    assert np.allclose(blurred_disk(r, 0.05, s), point, rtol=4 * (0.05 / s) ** 2 * 10, atol=0)
    # the curvature of the rim lowers half height by s/(2 sqrt(2 pi) a)
    edge = blurred_disk(400.0 + r, 400.0, s)
    assert np.allclose(edge, special.ndtr(-r / s), rtol=0, atol=s / (2 * np.sqrt(2 * np.pi) * 400.0) * 1.1)


def test_half_height_is_reached_only_above_1_18_blur_widths():
    # 1 - exp(-a^2/(2 s^2)) = 1/2 at a = sqrt(2 ln 2) s
    assert blurred_disk(0.0, np.sqrt(2 * np.log(2)), 1.0) == pytest.approx(0.5, abs=1e-12)


def test_table_derivatives_are_those_of_the_profile():
    table = disk_table()
    rows, columns, _ = table.values.shape
    h = 1e-5
    for k in (20, 64, 100):
        q = k / (rows - 1)
        a = (1 - q) / q
        u = np.arange(columns) / STEPS_PER_BLUR_WIDTH - INNER_BLUR_WIDTHS
        inside = a + u > 0.05
        r = (a + u)[inside]
        by_a = (blurred_disk(r, a + h, 1.0) - blurred_disk(r, a - h, 1.0)) / (2 * h)
        by_r = (blurred_disk(r + h, a, 1.0) - blurred_disk(r - h, a, 1.0)) / (2 * h)
        # central differences of a series good to 1e-9 or so, in single precision
        assert np.allclose(table.values[k, inside, 1], by_a, rtol=0, atol=2e-4)
        assert np.allclose(table.values[k, inside, 2], by_r, rtol=0, atol=2e-4)


@dataclass(frozen=True)
class LinearRim:
    """Light that falls linearly over a width, px."""

    width_px: float

    def excess(self, distance_px, _radius_px):
        return np.clip(1.0 - distance_px / self.width_px, 0.0, 1.0)

    def extent_px(self, _radius_px):
        return self.width_px


def test_a_rim_adds_its_light():
    # linear rim of width w: excess volume 2 pi int_0^w (1 - x/w)(a + x) dx = 2 pi (a w/2 + w^2/6)
    a, w, s = 6.0, 3.0, 1.4
    image = render_disks(np.array([[30.2, 29.7, a, 1.0]]), s, (61, 61), profile=rim_table(LinearRim(w), s))
    expected = np.pi * a**2 + 2 * np.pi * (a * w / 2 + w**2 / 6)
    # rows of the table are interpolated linearly in a: 1e-3 of the profile over the rim's area
    assert image.sum() == pytest.approx(expected, rel=3e-3)
