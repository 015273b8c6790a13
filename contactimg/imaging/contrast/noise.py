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

from contactimg.compiled import njit
from contactimg.imaging.pixels.blocks import sample_background, side_of
from contactimg.imaging.pixels.robust import MAD_TO_STD, median, noise_std
from contactimg.timings import stage

LARGEST_LAG = 10
"""Distance of pixels up to which their covariance is measured, px. Chosen by hand; sensitivity not
measured."""

WAVE_NUMBERS, LARGEST_WAVE_NUMBER = 256, 4.0
"""Nodes of the integral over wave numbers, and its upper end over the inverse blur: ``exp(-k^2)`` is 1e-7
there."""
RADII = np.geomspace(0.3, 45.0, 12)
"""Tabulated radii, blur widths; the derivative of the widest disk oscillates 30 times over the wave
numbers."""
LAGS = np.arange(0.0, 25.0, 0.02)
"""Tabulated distances of two pixels, blur widths."""
SAMPLE_PIXELS = 20_000
"""Background pixels that give the noise: to 0.6 %."""
COVARIANCE_PIXELS = 240_000
"""Background pixels that give the covariance."""
LEAST_PIXELS = 300
"""Least number of pixels that give a variance: to 8 % (theory: sqrt(2/n))."""
ROW_RUN = 2 * LARGEST_LAG
"""Successive rows that are read together, as most of their partners below are the same; affects the time
alone."""
CLIP_SIGMA = 4.0
"""Standard deviations beyond which a background pixel is dirt. False-alarm rate 6e-5 (theory: normal
noise)."""


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

    def rim_inflation(
        self, radius: NDArray, blur: float, *, noise: Noise, gain: float
    ) -> NDArray[np.float64]:
        """Ratio of the variance of a radius to that for independent pixels.

        Parameters
        ----------
        radius : ndarray, px
        blur : float, px
            Standard deviation of the profile's Gaussian, pixel included.
        noise : Noise
        gain : float
            Brightness of a contact relative to the background, by which it multiplies the texture.

        Notes
        -----
        The derivative of a blurred disk with respect to its radius has the spectrum ``J0(k a) exp(-k^2
        s^2/2)``; its autocorrelation is the weight of the covariance of two pixels at that distance.
        """
        return self._inflation(radius / blur, blur, noise, 0.5, gain, _rim_autocorrelation())

    def plateau_inflation(
        self, radius: NDArray, blur: float, *, noise: Noise, gain: float
    ) -> NDArray[np.float64]:
        """The same for the contrast, whose derivative has the spectrum ``J1(k a)/(k a) exp(-k^2 s^2/2)``."""
        return self._inflation(radius / blur, blur, noise, 1.0, gain, _plateau_autocorrelation())

    def _inflation(
        self, radius: NDArray, blur: float, noise: Noise, level: float, gain: float, autocorrelation: NDArray
    ) -> NDArray[np.float64]:
        """Factor for a template at a contact level; radii in blur widths."""
        lags = np.arange(-LARGEST_LAG, LARGEST_LAG + 1)
        distance = np.hypot(lags[:, None], lags[None, :]).ravel()
        unique, counts = np.unique(distance[(distance > 0) & (distance <= LARGEST_LAG)], return_counts=True)
        covariance = np.interp(unique, np.arange(LARGEST_LAG + 1), self.covariance) * counts
        shared = np.array([np.interp(unique / blur, LAGS, row) @ covariance for row in autocorrelation])
        excess = (1.0 + level * (gain - 1.0)) ** 2 * shared
        factor = 1.0 + np.maximum(excess, 0.0) / (noise.variance * noise.at(level))
        return np.interp(np.log(np.clip(radius, RADII[0], RADII[-1])), np.log(RADII), factor)


@lru_cache(maxsize=1)
def _rim_autocorrelation() -> NDArray[np.float64]:
    """Autocorrelation of the derivative by the radius: a row for each of `RADII`, over `LAGS`."""
    k = (np.arange(WAVE_NUMBERS) + 0.5) * (LARGEST_WAVE_NUMBER / WAVE_NUMBERS)
    return _autocorrelation(k, special.j0(np.outer(RADII, k)))


@lru_cache(maxsize=1)
def _plateau_autocorrelation() -> NDArray[np.float64]:
    """Autocorrelation of the derivative with respect to the contrast."""
    k = (np.arange(WAVE_NUMBERS) + 0.5) * (LARGEST_WAVE_NUMBER / WAVE_NUMBERS)
    ka = np.outer(RADII, k)
    return _autocorrelation(k, special.j1(ka) / ka)


def _autocorrelation(k: NDArray[np.floating], spectrum: NDArray[np.floating]) -> NDArray[np.float64]:
    """Autocorrelation of a template behind a blur, from its spectrum at wave numbers (over the blur)."""
    power = spectrum**2 * np.exp(-(k**2)) * k
    return np.asarray(power @ special.j0(np.outer(k, LAGS)) / power.sum(axis=1, keepdims=True))


@stage("contrast")
def estimate_noise(image: NDArray[np.float32], background: NDArray[np.bool_]) -> float:
    """Robust standard deviation of a background pixel, grey levels.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Difference image.
    background : ndarray of bool
        Background blocks, see `contactimg.imaging.pixels.blocks`.
    """
    every = max(int(np.sqrt(image.size / SAMPLE_PIXELS)), 1)
    sample = sample_background(image, background, (every, every))
    if len(sample) < LEAST_PIXELS:
        # no background: neighbouring pixels differ by the noise of both
        difference = np.abs(np.diff(image[::every], axis=1))
        return float(MAD_TO_STD * median(difference) / np.sqrt(2)) if difference.size else 0.0
    return noise_std(sample)


def measure_correlation(
    image: NDArray[np.float32],
    model: NDArray[np.float32],
    background: NDArray[np.bool_],
    *,
    noise: float,
) -> NoiseCorrelation:
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
    side = side_of(background.shape, image.shape)
    wide = background.repeat(side, axis=1)[:, : image.shape[1]]
    return NoiseCorrelation(_covariance(image, model, wide, side, np.float32(CLIP_SIGMA * noise)))


@njit(cache=True)
def _covariance(image, model, background, side, clip):
    """Covariance of background pixels against distance along rows and columns, from a sample of the rows.

    ``background`` has a row for every ``side`` rows of the image, and all its columns.
    """
    rows, columns = image.shape
    size, seen = LARGEST_LAG + 1, 0
    value, usual = np.zeros((size, columns), np.float32), np.zeros((size, columns), np.float32)
    counted, here = np.empty(columns, np.float32), np.empty(columns, np.float32)
    wide = columns - LARGEST_LAG
    total, count = np.zeros(LARGEST_LAG + 1), np.zeros(LARGEST_LAG + 1)
    middle = 0.0
    every = max(rows * columns // COVARIANCE_PIXELS, 1)
    for y in range(1, rows - LARGEST_LAG):
        if (y // ROW_RUN) % every:
            continue
        seen = max(seen, y)
        while seen <= y + LARGEST_LAG:
            _clip(image, model, seen, clip, value, usual)
            seen += 1
        # both ends of the longest lag lie in background blocks, hence nearly all pixels between
        _mark(background[y // side], background[(y + LARGEST_LAG) // side], counted)
        for x in range(columns):
            counted[x] *= usual[y % size, x]
            here[x] = counted[x] * value[y % size, x]
            middle += here[x] if x < wide else 0.0
        for lag in range(size):
            total[lag] += _product(here, value, y % size, lag, wide)
            total[lag] += _product(here, value, (y + lag) % size, 0, wide)
            count[lag] += _product(counted, usual, y % size, lag, wide)
            count[lag] += _product(counted, usual, (y + lag) % size, 0, wide)
    middle /= max(0.5 * count[0], 1.0)
    for lag in range(size):
        total[lag] = total[lag] / max(count[lag], 1.0) - middle * middle
    return total


@njit(cache=True)
def _mark(top, bottom, counted):
    """Mark background pixels of a row with background `LARGEST_LAG` to the right and below."""
    counted[:] = 0.0
    for x in range(len(counted) - LARGEST_LAG):
        counted[x] = top[x] & bottom[x] & top[x + LARGEST_LAG]


@njit(cache=True, fastmath=True, forceinline=True)
def _clip(image, model, row, clip, value, usual):
    """Residuals of a row with dirt set to zero, and where there is none, written to ring buffers."""
    levels, fitted = image[row], model[row]
    value, usual = value[row % len(value)], usual[row % len(usual)]
    for x in range(len(levels)):
        rest = levels[x] - fitted[x]
        keep = np.float32(abs(rest) <= clip)
        usual[x], value[x] = keep, rest * keep


@njit(cache=True, fastmath=True, forceinline=True)
def _product(one, rows, row, lag, n):
    """Sum of products with a row, ``lag`` pixels further on."""
    total, first, other = np.float32(0.0), one[:n], rows[row, lag : lag + n]
    for x in range(len(other)):
        total += first[x] * other[x]
    return total
