"""The edge of a contact as the camera sees it: a disk convolved with the optics and with the pixel.

A uniform disk of radius a seen through a Gaussian point spread function of standard deviation s has the
radial profile (a non-central chi-square distribution with two degrees of freedom)::

    P(r; a, s) = int_0^a (t/s^2) exp(-(r^2 + t^2)/(2 s^2)) I0(r t/s^2) dt

with dP/da = (a/s^2) exp(-(r-a)^2/(2 s^2)) I0e(r a/s^2), dP/dr = -(a/s^2) exp(-(r-a)^2/(2 s^2)) I1e(r a/s^2),
and, because P depends on lengths only through their ratios, s dP/ds = -(a dP/da + r dP/dr). A square pixel
adds 1/12 px^2 to s^2.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray
from scipy import special

PIXEL_VARIANCE = 1.0 / 12.0
"""Variance of the position inside a square pixel, px^2."""

INNER = 6.0  # columns start this many blur widths inside the rim, where the profile has reached 1 to 1e-9
STEPS_PER_WIDTH = 32  # linear interpolation errs by less than (1/32)^2/8 * max|P''| = 3e-5
ROWS = 128
ENDS = 3.7
"""Blur widths from the rim at which the profile of a plain disk has reached 1 and 0 (to 1e-4)."""
DEGREE = 15
"""Of its polynomial, which errs by 3e-5 between -ENDS and ENDS."""
SLOPE_DEGREE = 13
"""Of those of its derivatives, which err by 7e-4: they say where to go, not where the best disk is."""


class EdgeTable(NamedTuple):
    """Profile and derivatives of a blurred contact against the distance from the rim.

    Row ``k`` holds the radius ``a = s (1-q)/q`` with ``q = k/(rows-1)`` (row 0 is the straight edge), between
    which rows are interpolated.

    Parameters
    ----------
    values : ndarray, shape (rows, columns, 3), float32
        ``P``, ``s dP/da``, ``s dP/dr`` at the distance ``u = (r - a)/s = -INNER + j/steps`` in column ``j``,
        for linear interpolation.
    outer : float
        Distance from the rim, in units of s, at which the profile ends.
    powers : ndarray, shape (rows, DEGREE + 1, 3), float32
        Of a plain disk: coefficients of polynomials in ``u/ENDS`` for the same, highest power first, which a
        compiled loop computes faster than it looks anything up; otherwise empty. Those of the derivatives
        start with zeros: their degree is lower.
    """

    values: NDArray[np.float32]
    outer: float
    powers: NDArray[np.float32] = np.zeros((0, DEGREE + 1, 3), np.float32)


def blurred_disk(r: ArrayLike, a: ArrayLike, s: float) -> NDArray[np.float64]:
    """Profile ``P(r; a, s)`` of a unit disk of radius ``a`` blurred by a Gaussian.

    Parameters
    ----------
    r, a : array-like, px
        Distance from the centre and radius of the disk.
    s : float, px
        Standard deviation of the Gaussian; for pixels of a camera ``sqrt(sigma^2 + 1/12)``.

    Returns
    -------
    ndarray
        Between 0 and 1.

    Notes
    -----
    Integration over the pixel as a contribution to ``s^2`` is accurate to 1e-3 for sigma >= 0.8 px, to 1e-4
    for 1.4 px.

    Examples
    --------
    >>> float(blurred_disk(0.0, 1.0, 1.0))  # 1 - exp(-1/2)
    0.39346934
    """
    r, a = np.broadcast_arrays(np.abs(np.asarray(r, float)) / s, np.asarray(a, float) / s)
    # the series of the distribution loses digits far inside the rim, where the profile is 1 anyway
    inside = r < a - INNER - 2
    outside = r > a + INNER + 2
    profile = special.chndtr(
        np.where(inside | outside, 1.0, a) ** 2, 2, np.where(inside | outside, 1.0, r) ** 2
    )
    return np.where(inside, 1.0, np.where(outside, 0.0, profile))


@lru_cache(maxsize=1)
def disk_table() -> EdgeTable:
    """Table of the blurred uniform disk; the same for every blur."""
    outer = INNER
    u = np.arange(-INNER, outer + 0.5 / STEPS_PER_WIDTH, 1.0 / STEPS_PER_WIDTH)
    values = np.empty((ROWS, len(u), 3), np.float32)
    gauss = np.exp(-(u**2) / 2)
    values[0] = np.stack([special.ndtr(-u), gauss / np.sqrt(2 * np.pi), -gauss / np.sqrt(2 * np.pi)], axis=-1)
    for k in range(1, ROWS):
        q = k / (ROWS - 1)
        a = (1 - q) / q
        r = a + u  # even continuation below r = 0, so that interpolation is smooth there
        gauss = np.exp(-((np.abs(r) - a) ** 2) / 2)
        values[k, :, 0] = blurred_disk(r, a, 1.0) if a > 0 else 0.0
        values[k, :, 1] = a * gauss * special.ive(0, np.abs(r) * a)
        values[k, :, 2] = -a * gauss * special.ive(1, np.abs(r) * a) * np.sign(r)
    return EdgeTable(np.ascontiguousarray(values), outer, _powers(u, values))


def _powers(u: NDArray[np.float64], values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Polynomials that follow the rows of a table between ``-ENDS`` and ``ENDS``."""
    near = np.abs(u) <= ENDS
    rows, _, columns = values.shape
    wanted = np.swapaxes(values[:, near].astype(float), 0, 1).reshape(np.count_nonzero(near), -1)
    powers = np.zeros((DEGREE + 1, rows * columns))
    for column, degree in enumerate((DEGREE, SLOPE_DEGREE, SLOPE_DEGREE)):
        series = chebyshev.chebfit(u[near] / ENDS, wanted[:, column::columns], degree)
        for k, part in enumerate(series):
            row = chebyshev.cheb2poly(np.eye(degree + 1)[k])
            powers[DEGREE - np.arange(len(row)), column::columns] += np.outer(row, part)
    powers = powers.reshape(DEGREE + 1, rows, columns)
    return np.ascontiguousarray(np.swapaxes(powers, 0, 1), np.float32)
