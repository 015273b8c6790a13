"""Blurred ellipses: their image against supersampling, derivatives, and the uncertainties of a fit."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.stats import norm

from contactimg.imaging.contrast.noise import Noise
from contactimg.imaging.fit.disks import render_disks
from contactimg.imaging.fit.shapes import CommonOptics, Window, fit_ellipse, render_ellipse
from contactimg.imaging.kernels import ellipse_equations
from contactimg.imaging.kernels.ellipse_equations import (
    _bell,
    eliminate_parameters,
    fit_one_ellipse,
    sum_ellipse,
)

BLUR = 1.43


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


def test_gradient_is_the_derivative_of_the_loss():
    rng = np.random.default_rng(2)
    start = parameters(15.4, 16.1, 6.0, 1.4, 1.1, 90.0)
    image = render_ellipse(start, BLUR, (33, 33)) + rng.normal(0, 3, (33, 33)).astype(np.float32)
    everything, noise = np.zeros((1, 1), np.uint8), np.array([9.0, 0.0])
    normal, gradient = np.zeros((7, 7)), np.zeros(7)
    at = start + np.array([0.05, -0.04, 0.03, 0.01, -0.01, 0.5])
    sum_ellipse(image, everything, at, BLUR, noise, normal, gradient)
    slope = gradient[:6].copy()
    for k, step in enumerate([1e-3, 1e-3, 1e-3, 1e-4, 1e-4, 1e-2]):
        shift = step * np.eye(6)[k]
        losses = [
            sum_ellipse(image, everything, at + s, BLUR, noise, normal, gradient)[0] for s in (shift, -shift)
        ]
        # the loss is the sum of squares: its derivative is -2 times the gradient of the fit
        assert (losses[0] - losses[1]) / (2 * step) == pytest.approx(-2 * slope[k], rel=0.02, abs=2.0)


def test_density_and_integral_of_the_table_are_those_of_the_normal_distribution():
    # 64 steps a width, h <= 1/128: a series of three terms errs by less than h^4 phi <= 1.5e-9, of the
    # density by h^4 u^4/24 phi, less than 4e-8
    reach = ellipse_equations.NODE_REACH_BLUR_WIDTHS - 1e-3
    at = np.linspace(-reach, reach, 1501)
    density, whole = np.array([_bell(each) for each in at]).T
    assert np.abs(density - norm.pdf(at)).max() < 4e-8
    assert np.abs(whole - norm.cdf(at)).max() < 2e-9


def test_a_fit_that_starts_where_it_ends_does_not_look_further(monkeypatch):
    # the weights depend on the model: near its least value the loss no longer falls along its gradient, and
    # ten steps with ever more damping were tried
    rng, sums = np.random.default_rng(5), []

    def counted(*args):
        sums.append(args)
        return sum_ellipse(*args)

    monkeypatch.setattr(ellipse_equations, "sum_ellipse", counted)
    everything, noise, prior = np.zeros((1, 1), np.uint8), np.array([4.0, 0.0137]), np.array([91.0, 0.1])
    for _ in range(20):
        image = render_ellipse(parameters(15.4, 16.1, 6.0, 1.4, 1.1, 91.0), BLUR, (33, 33))
        image += rng.normal(0, np.sqrt(4.0 + 0.05 * image)).astype(np.float32)
        start = parameters(15.0, 16.0, 6.3, 1.2, 1.0, 91.0)
        first = fit_one_ellipse.py_func(image, everything, start, BLUR, noise, prior, False, 12)
        sums.clear()
        again = fit_one_ellipse.py_func(image, everything, first[0], BLUR, noise, prior, False, 12)
        assert len(sums) <= 2
        shift = again[0] - first[0]
        assert shift @ again[1][:6, :6] @ shift < 0.03


def test_half_axes_and_angle_scatter_as_stated():
    rng, noise, deviations = np.random.default_rng(11), 2.6, []
    optics = CommonOptics(100.0, 0.3, BLUR, np.diag([1e-4, 1e-4]) ** 2)
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
        window = Window(image, None, (0, 0), Noise(noise**2))
        fit = fit_ellipse(window, np.array([20.0, 20.0, 5.2, 0, 0, 100.0]), optics, inflation=1.0)
        e = np.hypot(true[3], true[4])
        angle = 0.5 * np.arctan2(true[4], true[3])
        turn = (fit.angle - angle + np.pi / 2) % np.pi - np.pi / 2
        deviations.append(np.array([*(fit.half_axes - 5.0 * np.exp([e, -e])), turn]) / fit.shape_std)
    # 360 normal deviates: 68.3 +- 2.5 % within one, 95.4 +- 1.1 % within two
    assert np.mean(np.abs(deviations) < 1) == pytest.approx(0.683, abs=0.075)
    assert np.mean(np.abs(deviations) < 2) == pytest.approx(0.954, abs=0.034)


def test_elimination_is_that_of_the_whole_normal_matrix():
    at = parameters(15.4, 16.1, 6.0, 1.4, 1.1, 90.0)
    image = render_ellipse(at, BLUR, (33, 33)) + np.random.default_rng(3).normal(0, 3, (33, 33))
    contrast, spread = 88.0, 2.0
    best, normal, score, *_ = fit_one_ellipse(
        image.astype(np.float32), np.zeros((1, 1), np.uint8), at, BLUR, np.array([9.0, 0.0]),
        np.array([contrast, spread]), False, 12,
    )  # fmt: skip
    inverse, response, own, information = eliminate_parameters(best, normal, score, contrast, spread)
    # rows: the six parameters, then ln C, whose prior ties the contrast to it, then the blur
    tight, whole = spread**-2, np.zeros((8, 8))
    whole[:6, :6], whole[7, 7] = normal[:6, :6], normal[6, 6]
    whole[:6, 7] = whole[7, :6] = normal[:6, 6]
    whole[5, 6] = whole[6, 5] = -tight * contrast
    whole[6, 6] = tight * contrast**2
    np.testing.assert_allclose(np.linalg.inv(whole)[6:, 6:], np.linalg.inv(information), rtol=1e-6)
    np.testing.assert_allclose(inverse @ whole[:6, :6], np.eye(6), atol=1e-6)
    np.testing.assert_allclose(
        response, -np.linalg.solve(whole[:6, :6], whole[:6, 6:]), rtol=1e-6, atol=1e-12
    )
    expected = np.array([tight * contrast * (best[5] - contrast), score[6]]) + response.T @ score[:6]
    np.testing.assert_allclose(own, expected, rtol=1e-9)
