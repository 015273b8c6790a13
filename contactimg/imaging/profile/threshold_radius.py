"""Radius at which a blurred disk crosses a threshold, and the disk radius from it.

A disk of radius ``a`` blurred by a Gaussian of standard deviation ``s`` crosses a fraction ``f`` of its
contrast at the radius ``r`` with ``P(r; a, s) = f`` (`contactimg.imaging.profile.blurred_disk`). At half
height ``r`` is smaller than ``a``, by ``s^2/(2 a)`` for wide disks, and a disk with ``a < 1.18 s`` does
not reach it.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chndtrinc, ndtri

from contactimg.errors import InputError

Values = NDArray[np.float64]


NODES = 800  # radii in the table; accuracy


def threshold_radius(radius_px: ArrayLike, *, blur_px: float, fraction: float = 0.5) -> Values:
    """Radius at which blurred disks cross a threshold.

    Parameters
    ----------
    radius_px : array_like
        Of the disks.
    blur_px : float
        Standard deviation of the blur, pixel included.
    fraction : float
        Threshold as a fraction of the contrast.

    Returns
    -------
    ndarray
        0 where the disk does not reach the threshold.

    Examples
    --------
    >>> threshold_radius([1.0, 2.0, 10.0], blur_px=1.0).round(3)
    array([0.   , 1.714, 9.95 ])
    """
    _check(blur_px, fraction)
    a = np.asarray(radius_px, float) / blur_px
    reaches = a > _smallest_radius(fraction)
    # the profile is the distribution of a noncentral chi-square, here inverted in its noncentrality
    crossed = np.sqrt(chndtrinc(np.where(reaches, a, 1.0) ** 2, 2, fraction))
    return np.where(reaches, crossed, 0.0) * blur_px


def disk_radius(threshold_radius_px: ArrayLike, *, blur_px: float, fraction: float = 0.5) -> Values:
    """Radius of the disks that cross a threshold at given radii: the inverse of `threshold_radius`.

    Parameters
    ----------
    threshold_radius_px : array_like
        ``sqrt(area/pi)`` of the pixels above the threshold.
    blur_px : float
        Standard deviation of the blur, pixel included.
    fraction : float

    Returns
    -------
    ndarray
        By interpolation of a table, to 1e-5 of the blur at half height and 3e-4 at 0.05 and 0.95.

    Examples
    --------
    >>> disk_radius([1.714, 9.95], blur_px=1.0).round(2)
    array([ 2., 10.])
    """
    _check(blur_px, fraction)
    r = np.asarray(threshold_radius_px, float) / blur_px
    crossed, radii = _table(float(fraction))
    straight = ndtri(fraction)  # beyond the table: the shift of a straight edge, and what falls as 1/r
    bent = (radii[-1] - crossed[-1] - straight) * radii[-1]
    beyond = r + straight + bent / np.maximum(r, crossed[-1])
    return np.where(r > crossed[-1], beyond, np.interp(r, crossed, radii)) * blur_px


@lru_cache(maxsize=64)  # more than a calibration tries; speed only
def _table(fraction: float) -> tuple[Values, Values]:
    """Crossings and radii in blur widths, from the smallest disk that reaches the threshold."""
    smallest = _smallest_radius(fraction)
    # the crossing rises as the square root from there
    # Up to 60 blur widths; above, a straight edge with its first correction is as accurate.
    radii = smallest + (60.0 - smallest) * np.linspace(0.0, 1.0, NODES) ** 3
    crossed = threshold_radius(radii, blur_px=1.0, fraction=fraction)
    crossed[0] = 0.0
    return crossed, radii


def _smallest_radius(fraction: float) -> float:
    """Radius, in blur widths, of the disk whose centre just reaches a threshold."""
    return float(np.sqrt(-2 * np.log1p(-fraction)))


def _check(blur_px: float, fraction: float) -> None:
    """Refuse a blur or a fraction without meaning."""
    if not (np.isfinite(blur_px) and blur_px > 0):
        raise InputError(f"blur_px must be positive, got {blur_px!r}")
    if not 0 < fraction < 1:
        raise InputError(f"a threshold must be a fraction between 0 and 1, got {fraction!r}")
