"""Blurred ellipses: their image against supersampling, derivatives, and the uncertainties of a fit."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.stats import norm

from contactimg.imaging.fit.disks import render_disks
from contactimg.imaging.fit.problem import ContrastPrior, FitProblem
from contactimg.imaging.fit.shapes import fit_ellipse, render_ellipse
from contactimg.imaging.kernels.ellipse_equations import _bell, sample_ellipse
from contactimg.imaging.pixels.noise import Noise
from contactimg.imaging.profile.limits import CLEAR_BLUR_WIDTHS

BLUR, EXACT = 1.43, np.diag([1e-8, 1e-8])


def parameters(x, y, radius, ratio, angle, contrast):  # noqa: PLR0917
    e = 0.5 * np.log(ratio)
    return np.array([x, y, radius, e * np.cos(2 * angle), e * np.sin(2 * angle), contrast])


@pytest.mark.parametrize(("radius", "ratio"), [(2.0, 2.0), (7.0, 1.3), (12.0, 3.0)])
def test_image_is_that_of_a_supersampled_ellipse(radius, ratio):
    size, fine, angle = 61, 15, 0.7
    grid = (np.arange(size * fine) + 0.5) / fine - 0.5
    x, y = grid - 30.2, (grid - 29.6)[:, None]
    along, across = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
    a, b = radius * np.sqrt(ratio), radius / np.sqrt(ratio)
    sharp = (np.hypot(along / a, across / b) < 1).astype(float)
    expected = gaussian_filter(sharp, BLUR * fine, truncate=6)[fine // 2 :: fine, fine // 2 :: fine]
    image = render_ellipse(parameters(30.2, 29.6, radius, ratio, angle, 1.0), BLUR, (size, size))
    # a sharp rim on subpixels of 1/15 px errs by some 1e-3 of the contrast
    assert np.abs(image - expected).max() < 2e-3
    assert image.sum() == pytest.approx(np.pi * radius**2, rel=1e-4)


def test_without_ellipticity_it_is_the_disk():
    disk = render_disks(np.array([[20.3, 19.8, 9.0, 1.0]]), BLUR, (41, 41))
    circle = render_ellipse(np.array([20.3, 19.8, 9.0, 0.0, 0.0, 1.0]), BLUR, (41, 41))
    assert np.abs(disk - circle).max() < 4e-4  # the table of the disk is interpolated over radii


def test_derivatives_are_those_of_the_profile():
    at, step = parameters(15.4, 16.1, 6.0, 1.4, 1.1, 1.0), 1e-2  # the places of the nodes make jumps of 1e-5
    found = sample_ellipse((33, 33), at, BLUR)
    for k in range(5):
        shift = step * np.eye(6)[k]
        above, below = (sample_ellipse((33, 33), at + s, BLUR)[:, :, 5] for s in (shift, -shift))
        np.testing.assert_allclose(found[:, :, k], (above - below) / (2 * step), atol=6e-3)
    above, below = (sample_ellipse((33, 33), at, BLUR + s)[:, :, 5] for s in (step, -step))
    np.testing.assert_allclose(found[:, :, 6], (above - below) / (2 * step), atol=6e-3)


def test_density_and_integral_of_the_table_are_those_of_the_normal_distribution():
    # 64 steps a width, h <= 1/128: a series of three terms errs by less than h^4 phi <= 1.5e-9, of the
    # density by h^4 u^4/24 phi, less than 4e-8
    reach = CLEAR_BLUR_WIDTHS - 1e-3
    at = np.linspace(-reach, reach, 1501)
    density, whole = np.array([_bell(each) for each in at]).T
    assert np.abs(density - norm.pdf(at)).max() < 4e-8
    assert np.abs(whole - norm.cdf(at)).max() < 2e-9


def fitted(image, start, *, blur=BLUR, prior=(100.0, 0.3), covariance=EXACT, noise=2.6):
    window = FitProblem(image, Noise(noise**2), ContrastPrior.loose(prior[0]))
    return fit_ellipse(window, start, blur=blur, prior=prior, covariance=covariance)


def test_half_axes_and_angle_scatter_as_stated():
    rng, noise, deviations = np.random.default_rng(11), 2.6, []
    for _ in range(120):
        true = parameters(
            20 + rng.uniform(-1, 1),
            20 + rng.uniform(-1, 1),
            5.0,
            rng.uniform(1.2, 2),
            rng.uniform(-1.5, 1.5),
            100.0,
        )
        image = render_ellipse(true, BLUR, (41, 41)) + rng.normal(0, noise, (41, 41)).astype(np.float32)
        fit = fitted(image, np.array([20.0, 20.0, 5.2, 0, 0, 100.0]))
        e = np.hypot(true[3], true[4])
        angle = 0.5 * np.arctan2(true[4], true[3])
        turn = (fit.angle - angle + np.pi / 2) % np.pi - np.pi / 2
        deviations.append(np.array([*(fit.half_axes - 5.0 * np.exp([e, -e])), turn]) / fit.shape_std)
    # 360 normal deviates: 68.3 +- 2.5 % within one, 95.4 +- 1.1 % within two
    assert np.mean(np.abs(deviations) < 1) == pytest.approx(0.683, abs=0.075)
    assert np.mean(np.abs(deviations) < 2) == pytest.approx(0.954, abs=0.034)


def test_shifts_are_those_of_fits_at_another_contrast_and_blur():
    at, rng = parameters(15.4, 16.1, 6.0, 1.4, 1.1, 100.0), np.random.default_rng(3)
    image = render_ellipse(at, BLUR, (33, 33)) + rng.normal(0, 2.6, (33, 33)).astype(np.float32)
    covariance = np.diag([0.01, 0.02]) ** 2
    shifts = fitted(image, at, covariance=covariance).shifts
    ends = [
        [fitted(image, at, prior=(100.0 * np.exp(s * 0.01), 0.3)).parameters for s in (1, -1)],
        [fitted(image, at, blur=BLUR + s * 0.02).parameters for s in (1, -1)],
    ]
    for column, (above, below) in zip(shifts.T, ends, strict=True):
        np.testing.assert_allclose(column, 0.5 * (above - below), rtol=0.1, atol=2e-3)


@pytest.mark.parametrize("hole", [np.nan, 0.0])
def test_a_window_that_shows_nothing_raises_nothing(hole):
    start = parameters(15.4, 16.1, 6.0, 1.4, 1.1, 100.0)
    found = fitted(np.full((33, 33), hole, np.float32), start)
    assert np.isfinite(found.parameters).all() == np.isfinite(hole)
