"""The sphere through the top of an asperity."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.summits.base import MAD_TO_STD

Values = NDArray[np.float64]

ROUNDS = 12
"""Rounds of Gauss and Newton; pixels are chosen anew in each. Chosen: 6 suffice on caps with noise."""

CLIP_SIGMAS = 4.5
"""Pixels farther from the sphere are spikes. Theory: 1 of 150,000 pixels of normal noise."""

MIN_PIXELS = 12
"""Fewest pixels of a fit: three for each of its parameters."""

LAGS = 5
"""Distance in pixels up to which residuals may be correlated (filters and interpolation of the instrument).
Chosen: the optics of profilometers blur over 1 to 4 px."""


def sphere_heights(sphere: Values, x: Values, y: Values) -> Values:
    """Heights ``z0 - k r^2 / (1 + sqrt(1 - k^2 r^2))`` of a sphere near its summit, m.

    Parameters
    ----------
    sphere : ndarray, shape (4,)
        x, y and z0 of the summit (m), and the curvature ``k`` (1/m), the inverse of the radius.
    x, y : ndarray, m
        Beyond the equator the heights are those at the equator.
    """
    x0, y0, z0, curvature = sphere
    squared = (x - x0) ** 2 + (y - y0) ** 2
    root = np.sqrt(np.clip(1 - curvature**2 * squared, 0.0, None))
    return np.asarray(z0 - curvature * squared / (1 + root))


@dataclass(frozen=True)
class SphereFit:
    """A sphere with the uncertainties of its parameters.

    Parameters
    ----------
    sphere : ndarray, shape (4,)
        x, y, z and curvature, see `sphere_heights`.
    covariance : ndarray, shape (4, 4)
        Of these, for residuals that are white.
    pixels : ndarray of bool
        Which of the pixels were fitted.
    residuals : ndarray, m
        Of all pixels.
    scatter : float, m
        Standard deviation of the residuals of the fitted pixels.
    """

    sphere: Values
    covariance: Values
    pixels: NDArray[np.bool_]
    residuals: Values
    scatter: float


def fit_sphere(points: Values, start: Values, *, depth: float, noise: float) -> SphereFit | None:
    """Fit a sphere to the pixels whose height on the sphere is less than ``depth`` below the summit.

    Parameters
    ----------
    points : ndarray, shape (3, n), m
        x, y and height of the pixels of a region.
    start : ndarray, shape (4,)
        The sphere to begin with.
    depth : float, m
        How far the fit reaches down.
    noise : float, m
        Least standard deviation of the residuals at which pixels are taken for spikes.

    Returns
    -------
    SphereFit or None
        None where fewer than `MIN_PIXELS` pixels are left or they do not define a summit.
    """
    sphere, x, y, z = start, *points
    for _ in range(ROUNDS):
        fitted = sphere_heights(sphere, x, y)
        residuals, chosen = z - fitted, fitted > sphere[2] - depth
        if chosen.sum() < MIN_PIXELS:
            return None
        spread = MAD_TO_STD * float(np.median(np.abs(residuals[chosen] - np.median(residuals[chosen]))))
        chosen &= np.abs(residuals - np.median(residuals[chosen])) < CLIP_SIGMAS * max(spread, noise, 1e-300)
        if chosen.sum() < MIN_PIXELS:
            return None
        jacobian, scale = _jacobian(sphere, x[chosen], y[chosen])
        normal = jacobian.T @ jacobian
        if np.linalg.cond(normal) > 1e12:
            return None
        step = np.linalg.solve(normal, jacobian.T @ residuals[chosen]) / scale
        if not np.isfinite(step).all():
            return None
        sphere, curvature = sphere + step, sphere[3]
        sphere[3] = min(max(sphere[3], curvature / 2), 2 * curvature)
    residuals = z - sphere_heights(sphere, x, y)
    scatter = float(np.sqrt((residuals[chosen] ** 2).sum() / (chosen.sum() - 4)))
    covariance = np.linalg.inv(normal) / np.outer(scale, scale) * scatter**2
    return SphereFit(sphere, covariance, chosen, residuals, scatter)


def _jacobian(sphere: Values, x: Values, y: Values) -> tuple[Values, Values]:
    """Derivatives of the heights by x, y, z and curvature, each divided by its scale, and the scales."""
    dx, dy, k = x - sphere[0], y - sphere[1], sphere[3]
    squared = dx**2 + dy**2
    root = np.sqrt(np.clip(1 - k**2 * squared, 0.01, None))
    slope = k / root
    columns = np.stack([slope * dx, slope * dy, np.ones_like(dx), -squared / (root * (1 + root))], axis=1)
    scale = np.sqrt((columns**2).mean(axis=0)) + 1e-300
    return columns / scale, scale


def correlation_factor(residuals: Values) -> float:
    """By how much the variance of a mean of neighbouring residuals exceeds that of white noise.

    Parameters
    ----------
    residuals : ndarray, shape (rows, columns)
        NaN outside the fitted pixels.

    Returns
    -------
    float
        Sum of the autocorrelation over lags within `LAGS` px, at least 1.
    """
    valid = np.isfinite(residuals)
    values = np.where(valid, residuals, 0.0)
    pad = ((0, 2 * LAGS), (0, 2 * LAGS))
    spectra = [np.fft.rfft2(np.pad(part.astype(np.float64), pad)) for part in (values, valid)]
    size = (values.shape[0] + 2 * LAGS, values.shape[1] + 2 * LAGS)
    products, pairs = (np.fft.irfft2(np.abs(spectrum) ** 2, s=size) for spectrum in spectra)
    rows, columns = np.ix_(np.arange(-LAGS, LAGS + 1), np.arange(-LAGS, LAGS + 1))
    near = (rows**2 + columns**2 <= LAGS**2) & (pairs[rows, columns] > 0.5)
    if products[0, 0] <= 0:
        return 1.0
    covariances = products[rows, columns][near] / pairs[rows, columns][near]
    return max(1.0, float(covariances.sum() / (products[0, 0] / pairs[0, 0])))
