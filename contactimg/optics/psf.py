"""The point spread function on a grid finer than the pixels, as a short sum of separable kernels.

A kernel ``K[i, j] = sum_k u_k[i] v_k[j]`` blurs a patch and averages it over pixels with two matrix products
per term; the blurred fine image is never formed. A Gaussian has one term, an Airy pattern nine. A wide halo
varies slowly and is added on the grid of the pixels; in measured frames
`contactimg.imaging.fit.residual_light` finds and removes it.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import special

from contactimg.errors import InputError

Values = NDArray[np.float64]

MAX_SAMPLES_PER_PIXEL = 16  # along one axis; chosen to bound the time
MAX_SAMPLES_PER_SIGMA = 8  # chosen: more only costs time
GAUSSIAN_REACH_SIGMA = 5.0  # theory: 6e-7 of a normal distribution lies beyond
AIRY_REACH_SIGMA = 16.4706 / math.sqrt(2)  # theory: the fifth dark ring, a zero of J1
AIRY_EIGENVALUE_FRACTION = 1e-4  # of the largest one; keeps nine terms with an error of 2e-5 of the peak


def sampling_for(sigma_px: float, *, at_least: int) -> int:
    """Number of samples per pixel and axis that represents a blur: sigma spans one sample or more.

    The spectrum of a Gaussian has then fallen to ``exp(-pi^2/2) = 7e-3`` at half a cycle a sample and to
    ``exp(-2 pi^2) = 3e-9`` at one; that of an Airy pattern of the same peak ends at ``sqrt(2)/(pi sigma) =
    0.45/sigma``, below half a cycle a sample.

    Parameters
    ----------
    sigma_px : float, px
        0 for no blur.
    at_least : int
        Used unless it puts more than eight samples into sigma.

    Returns
    -------
    int

    Raises
    ------
    InputError
        If more than 16 samples per pixel are needed.

    Examples
    --------
    >>> sampling_for(1.4, at_least=4), sampling_for(0.15, at_least=4), sampling_for(20.0, at_least=4)
    (4, 7, 1)
    """
    if sigma_px == 0:
        return at_least
    if sigma_px * MAX_SAMPLES_PER_PIXEL < 1:
        raise InputError(
            f"a blur of {sigma_px:g} px is finer than the finest grid; blur_px must be 0 or at least "
            f"{1 / MAX_SAMPLES_PER_PIXEL:g}"
        )
    return max(min(at_least, math.ceil(MAX_SAMPLES_PER_SIGMA / sigma_px)), math.ceil(1 / sigma_px))


@dataclass(frozen=True, eq=False)
class Psf:
    """A sampled point spread function of unit sum.

    Parameters
    ----------
    rows, columns : ndarray, shape (terms, 2 half + 1)
        Factors ``u_k`` and ``v_k`` of the kernel ``sum_k u_k[i] v_k[j]``.
    sampling : int
        Samples per pixel and axis.
    """

    rows: Values
    columns: Values
    sampling: int

    @property
    def margin_px(self) -> int:
        """Width in pixels of the margin that a patch needs around the pixels to compute."""
        return -(-(self.rows.shape[1] // 2) // self.sampling)

    def bin_blurred(self, patch: Values) -> Values:
        """Blur a patch on the fine grid and average it over pixels.

        Parameters
        ----------
        patch : ndarray, shape ((n + 2 margin) sampling, (m + 2 margin) sampling)
            Fine samples of n x m pixels and of a margin of `margin_px` around them.

        Returns
        -------
        ndarray, shape (n, m)

        Examples
        --------
        >>> psf = gaussian_psf(0.5, sampling=2)
        >>> psf.bin_blurred(np.ones((20, 30))).shape, psf.margin_px
        ((4, 9), 3)
        """
        size = np.array(patch.shape) // self.sampling - 2 * self.margin_px
        terms = zip(self.rows, self.columns, strict=True)
        return sum(
            (self._matrix(u, size[0]) @ patch @ self._matrix(v, size[1]).T for u, v in terms),
            start=np.zeros(size),
        )

    def _matrix(self, kernel: Values, pixels: int) -> Values:
        """Banded matrix that blurs a finely sampled line and averages it over ``pixels`` pixels."""
        s, m = self.sampling, self.margin_px
        band = np.convolve(kernel, np.full(s, 1 / s))
        matrix = np.zeros((pixels, (pixels + 2 * m) * s))
        rows = np.arange(pixels)[:, None]
        matrix[rows, (rows + m) * s - len(kernel) // 2 + np.arange(len(band))] = band
        return matrix


def no_blur(*, sampling: int) -> Psf:
    """A point spread function without blur: each pixel is the mean of its samples."""
    return Psf(np.ones((1, 1)), np.ones((1, 1)), sampling)


def gaussian_psf(sigma_px: float, *, sampling: int) -> Psf:
    """Gaussian of standard deviation ``sigma_px``, truncated at 5 sigma.

    Parameters
    ----------
    sigma_px : float, px
    sampling : int
        Samples per pixel and axis; see `sampling_for`.

    Returns
    -------
    Psf

    Examples
    --------
    >>> psf = gaussian_psf(1.4, sampling=4)
    >>> float((psf.rows.T @ psf.columns).sum())
    1.0
    """
    half = math.ceil(GAUSSIAN_REACH_SIGMA * sigma_px * sampling)
    line = np.exp(-0.5 * (np.arange(-half, half + 1) / (sigma_px * sampling)) ** 2)
    line = (line / line.sum())[None]
    return Psf(line, line, sampling)


def airy_psf(sigma_px: float, *, sampling: int) -> Psf:
    """Airy pattern ``[2 J1(x)/x]^2`` with ``x = sqrt(2) r / sigma``, truncated at its fifth dark ring.

    Peak value, ``1/(2 pi sigma^2)``, and curvature at the peak are those of a Gaussian of the same sigma. The
    first dark ring lies at ``r = 2.71 sigma``; the mean intensity falls as ``1/r^3``.

    Parameters
    ----------
    sigma_px : float, px
        ``sigma``; the diffraction limit ``lambda N`` is ``pi sigma/sqrt(2)``.
    sampling : int

    Returns
    -------
    Psf

    Notes
    -----
    The 4 % of the light outside the fifth dark ring are redistributed: the kernel has unit sum.

    References
    ----------
    M. Born and E. Wolf, Principles of Optics, 7th ed. (1999), section 8.5.2, eqs (14) and (18).

    Examples
    --------
    >>> psf = airy_psf(1.4, sampling=4)
    >>> float((psf.rows.T @ psf.columns).sum())
    1.0
    """
    half = math.ceil(AIRY_REACH_SIGMA * sigma_px * sampling)
    axis = np.arange(-half, half + 1) / (sigma_px * sampling)
    r = np.hypot(axis[:, None], axis)
    x = np.sqrt(2) * np.where(r > 0, r, 1.0)
    kernel = np.where(r > 0, 2 * special.j1(x) / x, 1.0) ** 2 * (r <= AIRY_REACH_SIGMA)
    values, vectors = np.linalg.eigh(kernel)
    kept = np.abs(values) > AIRY_EIGENVALUE_FRACTION * np.abs(values).max()
    rows = (vectors[:, kept] * values[kept]).T
    columns = vectors[:, kept].T
    return Psf(rows / (rows.sum(1) @ columns.sum(1)), columns, sampling)


@dataclass(frozen=True)
class Halo:
    """A fraction of the light that is spread widely, as a second Gaussian.

    Parameters
    ----------
    fraction : float
        Fraction of the light in the halo.
    sigma_px : float, px
        Additional width of the halo, in quadrature: ``sqrt(w^2 - s^2)`` for a halo of total width ``w``
        around a core of width ``s``.
    """

    fraction: float
    sigma_px: float

    @property
    def margin_px(self) -> int:
        """Width in pixels of the margin from which light enters an image."""
        return math.ceil(GAUSSIAN_REACH_SIGMA * self.sigma_px)

    def spread(self, image: Values) -> Values:
        """Spread the fraction of the light of an image; light that crosses the border is lost.

        Parameters
        ----------
        image : ndarray, shape (rows, columns)
            Blurred by the core and averaged over pixels.

        Returns
        -------
        ndarray, shape (rows, columns)
        """
        size = 2 * self.margin_px + 1
        wide = cv2.GaussianBlur(image, (size, size), self.sigma_px, borderType=cv2.BORDER_CONSTANT)
        return (1 - self.fraction) * image + self.fraction * wide
