"""Noise of the difference image: how large, how it grows with the level, and how it is correlated.

The texture of the surface that the reference does not remove is noise that neighbouring pixels share. The
Fisher information of independent pixels then understates the uncertainty of a radius. The sum over all pairs
of pixels of their covariance, weighted by the derivative of the disk with respect to its radius, gives the
factor.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from contactimg.imaging.pixels.blocks import is_background, sample_background, strips
from contactimg.imaging.pixels.masks import Flags, Values
from contactimg.imaging.pixels.robust import CLIP_SIGMA, FEWEST_VALUES, MANY, SAMPLE, noise_std, robust_std

LARGEST_LAG = 10
"""Distance of pixels up to which their covariance is measured, px. By hand; sensitivity not measured."""

RADII = np.geomspace(0.3, 45.0, 12)
"""Tabulated radii, blur widths; the derivative of the widest oscillates 30 times over the wave numbers."""
LAGS = np.arange(0.0, 25.0, 0.02)
"""Tabulated distances of two pixels, blur widths."""


@dataclass(frozen=True)
class Noise:
    """Variance of a pixel at the fraction p of the contrast.

    It is ``variance (1 + slope p + rim 4 p (1-p)) / brightness``.

    Parameters
    ----------
    variance : float
        Of a background pixel, squared grey levels.
    slope : float
        Relative increase at full contrast: shot noise, and texture that a contact makes brighter.
    rim : float
        Relative increase at half height: what pixels of a sharp edge differ from its profile. Theory: a pixel
        that is 0 with the probability ``1-p`` and else 1 has the variance ``p (1-p)``.
    """

    variance: float
    slope: float = 0.0
    rim: float = 0.0

    def at(self, height: ArrayLike) -> NDArray:
        """Variance at a fraction of the contrast, relative to that of the background."""
        p = np.asarray(height)
        return 1.0 + self.slope * p + self.rim * 4.0 * p * (1.0 - p)


@dataclass(frozen=True, eq=False)
class NoiseCorrelation:
    """Covariance of background pixels against their distance.

    Parameters
    ----------
    covariance : ndarray, shape (LARGEST_LAG + 1,)
        Squared grey levels at distances 0, 1, 2, ... px.
    """

    covariance: NDArray[np.float64]

    @classmethod
    def independent(cls) -> "NoiseCorrelation":
        """The correlation of pixels that share no noise."""
        return cls(np.zeros(LARGEST_LAG + 1))

    def inflation(
        self, radius: NDArray, blur: float, *, noise: Noise, gain: float, rim: bool
    ) -> NDArray[np.float64]:
        """Ratio of the variance of a radius (``rim``) or of a contrast to that for independent pixels.

        Parameters
        ----------
        radius : ndarray, px
        blur : float, px
            Standard deviation of the profile's Gaussian, pixel included.
        noise : Noise
        gain : float
            Brightness of a contact relative to the background, by which it multiplies the texture.
        rim : bool
            Whether it is that of the radius, whose pixels are at half height.

        Notes
        -----
        The derivative of a blurred disk with respect to its radius has the spectrum ``J0(k a) exp(-k^2
        s^2/2)``, that with respect to its contrast ``J1(k a)/(k a) exp(-k^2 s^2/2)``; its autocorrelation is
        the weight of the covariance of two pixels at that distance.
        """
        level = 0.5 if rim else 1.0
        lags = np.arange(-LARGEST_LAG, LARGEST_LAG + 1)
        distance = np.hypot(lags[:, None], lags[None, :]).ravel()
        unique, counts = np.unique(distance[(distance > 0) & (distance <= LARGEST_LAG)], return_counts=True)
        covariance = np.interp(unique, np.arange(LARGEST_LAG + 1), self.covariance) * counts
        weights = _autocorrelation(rim=rim)
        shared = np.array([np.interp(unique / blur, LAGS, row) @ covariance for row in weights])
        excess = (1.0 + level * (gain - 1.0)) ** 2 * shared
        factor = 1.0 + np.maximum(excess, 0.0) / (noise.variance * noise.at(level))
        return np.interp(np.log(np.clip(radius / blur, RADII[0], RADII[-1])), np.log(RADII), factor)


@lru_cache(maxsize=2)
def _autocorrelation(*, rim: bool) -> NDArray[np.float64]:
    """Autocorrelation of the derivative by the radius, or by the contrast: a row for each of `RADII`."""
    k = (np.arange(256) + 0.5) * (4.0 / 256)  # over the inverse blur: exp(-k^2) is 1e-7 at 4
    ka = np.outer(RADII, k)
    power = (special.j0(ka) if rim else special.j1(ka) / ka) ** 2 * np.exp(-(k**2)) * k
    return np.asarray(power @ special.j0(np.outer(k, LAGS)) / power.sum(axis=1, keepdims=True))


def estimate_noise(image: Values, background: Flags) -> float:
    """Robust standard deviation of a background pixel, grey levels.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Difference image.
    background : ndarray of bool
        Background blocks, see `contactimg.imaging.pixels.blocks`.
    """
    every = max(int(np.sqrt(image.size / SAMPLE)), 1)
    sample = sample_background(image, background, (every, every))
    if len(sample) < FEWEST_VALUES:
        # no background: neighbouring pixels differ by the noise of both
        difference = np.diff(image[::every], axis=1)
        return float(robust_std(difference, centre=0.0) / np.sqrt(2)) if difference.size else 0.0
    return noise_std(sample)


def measure_correlation(image: Values, model: Values, background: Flags, *, noise: float) -> NoiseCorrelation:
    """Covariance of background pixels along rows and columns.

    Parameters
    ----------
    image, model : ndarray, shape (rows, columns)
        Difference image, and the fitted model.
    background : ndarray of bool
        Background blocks.
    noise : float
        Standard deviation of a background pixel.
    """
    height = 4 * LARGEST_LAG  # three quarters of the rows of a strip have all their partners below
    inside = (min(height, len(image)) - LARGEST_LAG, image.shape[1] - LARGEST_LAG)
    if min(inside) <= 0:
        return NoiseCorrelation.independent()
    number = int(np.clip(MANY // (inside[0] * inside[1]), 1, max(len(image) // height, 1)))
    rows, _ = strips(len(image), height, number, 0)
    rest = (image[rows] - model[rows]).reshape(number, -1, image.shape[1])
    usual = np.abs(rest) <= np.float32(CLIP_SIGMA * noise)
    rest[~usual] = 0.0
    free = is_background(background, rows, np.arange(image.shape[1]), image.shape).reshape(rest.shape)

    def moved(part: NDArray, down: int, right: int) -> NDArray:
        return part[:, down : down + inside[0], right : right + inside[1]]

    # both ends of the longest lag lie in background blocks, hence nearly all pixels between
    counted = moved(usual, 0, 0) & moved(free, 0, 0)
    counted &= moved(free, LARGEST_LAG, 0) & moved(free, 0, LARGEST_LAG)
    here, count = np.where(counted, moved(rest, 0, 0), np.float32(0.0)), max(int(counted.sum()), 1)
    shared = [np.einsum("ijk,ijk->", here, moved(rest, *lags)) for k in range(LARGEST_LAG + 1)
              for lags in ((0, k), (k, 0))]  # fmt: skip
    middle = float(here.sum(dtype=float)) / count
    return NoiseCorrelation(np.reshape(shared, (-1, 2)).mean(axis=1).astype(float) / count - middle**2)
