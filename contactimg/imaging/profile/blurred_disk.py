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

from contactimg.compiled import njit

Values = NDArray[np.float64]

PIXEL_VARIANCE = 1.0 / 12.0
"""Variance of the position inside a square pixel, px^2."""

INNER_BLUR_WIDTHS = 6.0  # first column, inside the rim; theory: the profile is 1 to 1e-9 there
STEPS_PER_BLUR_WIDTH = 32  # columns; theory: linear interpolation errs by (1/32)^2/8 * max|P''| = 3e-5
TABLE_ROWS = 128  # radii; accuracy
END_BLUR_WIDTHS = 3.7
"""Distance from the rim at which the profile of a uniform disk is 1 or 0 to 1e-4 (theory)."""
PROFILE_DEGREE = 15
"""Of the polynomial for the profile up to there, which errs by 3e-5."""
SLOPE_DEGREE = 13
"""Of the polynomials for its derivatives, which err by 7e-4; they set the steps of a fit, not its result."""


class EdgeTable(NamedTuple):
    """Profile and derivatives of a blurred contact against the distance from the rim.

    Row ``k`` holds the radius ``a = s (1-q)/q`` with ``q = k/(rows-1)`` (row 0 is the straight edge), between
    which rows are interpolated.

    Parameters
    ----------
    values : ndarray, shape (rows, columns, 3), float32
        ``P``, ``s dP/da``, ``s dP/dr`` for linear interpolation; column ``j`` is at the distance from the rim
        ``u = (r - a)/s = -6 + j/32``.
    outer : float
        Distance from the rim, in units of s, at which the profile ends.
    powers : ndarray, shape (rows, PROFILE_DEGREE + 1, 3), float32
        Of the uniform disk: coefficients of polynomials in ``u/END_BLUR_WIDTHS`` for the same, highest power
        first, which are faster than the table; otherwise empty. Those of the derivatives, whose degree is
        lower, start with zeros.
    """

    values: NDArray[np.float32]
    outer: float
    powers: NDArray[np.float32] = np.zeros((0, PROFILE_DEGREE + 1, 3), np.float32)


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
    inside = r < a - INNER_BLUR_WIDTHS - 2
    far = inside | (r > a + INNER_BLUR_WIDTHS + 2)
    profile = special.chndtr(np.where(far, 1.0, a) ** 2, 2, np.where(far, 1.0, r) ** 2)
    return np.where(far, inside, profile)


@lru_cache(maxsize=1)
def disk_table() -> EdgeTable:
    """Table of the blurred uniform disk; the same for every blur."""
    outer = INNER_BLUR_WIDTHS
    u = np.arange(-INNER_BLUR_WIDTHS, outer + 0.5 / STEPS_PER_BLUR_WIDTH, 1.0 / STEPS_PER_BLUR_WIDTH)
    values = np.empty((TABLE_ROWS, len(u), 3), np.float32)
    slope = np.exp(-(u**2) / 2) / np.sqrt(2 * np.pi)
    values[0] = np.stack([special.ndtr(-u), slope, -slope], axis=-1)
    for k in range(1, TABLE_ROWS):
        q = k / (TABLE_ROWS - 1)
        a = (1 - q) / q
        r = a + u  # even continuation below r = 0, so that interpolation is smooth there
        gauss = np.exp(-((np.abs(r) - a) ** 2) / 2)
        values[k, :, 0] = blurred_disk(r, a, 1.0) if a > 0 else 0.0
        values[k, :, 1] = a * gauss * special.ive(0, np.abs(r) * a)
        values[k, :, 2] = -a * gauss * special.ive(1, np.abs(r) * a) * np.sign(r)
    return EdgeTable(values, outer, _powers(u, values))


def _powers(u: NDArray[np.float64], values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Polynomials fitted to the rows of a table between ``-END_BLUR_WIDTHS`` and ``END_BLUR_WIDTHS``."""
    near = np.abs(u) <= END_BLUR_WIDTHS
    rows, _, columns = values.shape
    wanted = np.swapaxes(values[:, near].astype(float), 0, 1).reshape(np.count_nonzero(near), -1)
    powers = np.zeros((PROFILE_DEGREE + 1, rows * columns))
    for column, degree in enumerate((PROFILE_DEGREE, SLOPE_DEGREE, SLOPE_DEGREE)):
        series = chebyshev.chebfit(u[near] / END_BLUR_WIDTHS, wanted[:, column::columns], degree)
        for k, part in enumerate(series):
            row = chebyshev.cheb2poly(np.eye(degree + 1)[k])
            powers[PROFILE_DEGREE - np.arange(len(row)), column::columns] += np.outer(row, part)
    powers = powers.reshape(PROFILE_DEGREE + 1, rows, columns)
    return np.ascontiguousarray(np.swapaxes(powers, 0, 1), np.float32)


def blurred_disks(r: Values, a: Values, s: Values | float) -> Values:
    """``P(r; a, s)`` from the table of the plain disk, for shapes (n, k), (n, 1) and (n, 1) or a number."""
    return np.asarray(look_up(disk_table().values, r, a, s)[0])


def look_up(table: NDArray[np.float32], r: Values, a: Values, s: Values | float, count: int = 1) -> Values:
    """The first of ``P``, ``s dP/da``, ``s dP/dr`` from the values of an edge table, shape (count, n, k)."""
    blur = np.broadcast_to(np.asarray(s, float), a.shape)
    return np.asarray(_interpolate(table, np.array(a[:, 0]), np.array(blur[:, 0]), r, count))


@njit(cache=True, error_model="numpy")
def _interpolate(table, radius, blur, distance, count):
    """Profile and derivatives from the table of the plain disk, shape (count, n, k)."""
    out = np.zeros((count, *distance.shape))
    rows, columns = table.shape[:2]
    for i in range(len(radius)):
        a, s = radius[i], blur[i]
        row = s / (s + a) * (rows - 1)
        k = min(int(row), rows - 2)
        f = row - k
        for n in range(distance.shape[1]):
            column = ((distance[i, n] - a) / s + INNER_BLUR_WIDTHS) * STEPS_PER_BLUR_WIDTH
            if column <= 0.0:
                out[0, i, n] = 1.0
            elif column < columns - 1:
                j = int(column)
                g = column - j
                for m in range(count):
                    low = table[k, j, m] + g * (table[k, j + 1, m] - table[k, j, m])
                    high = table[k + 1, j, m] + g * (table[k + 1, j + 1, m] - table[k + 1, j, m])
                    out[m, i, n] = low + f * (high - low)
    return out
