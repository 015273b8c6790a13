"""Hertz's contact of elliptic outline, with exact elliptic integrals.

A summit with the principal radii of curvature ``R' >= R"`` touches a flat in an ellipse with the half-axes
``a >= b``, the major one along the direction of the larger radius. With the equivalent radius ``Re = sqrt(R'
R")``: ``c = sqrt(a b) = (3 P Re/(4 E*))^(1/3) F1`` and ``delta = (9 P^2/(16 E*^2 Re))^(1/3) F2``. The factors
are 1 for a circle and follow from ``b/a``. Carlson's integrals give them without cancellation.

References
----------
Johnson, Contact Mechanics (1985), doi:10.1017/CBO9781139171731, section 4.2, eqs (4.24) to (4.30).
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import elliprd, elliprf

from contactimg.errors import InputError

Values = NDArray[np.float64]

MAX_STEPS = 50
"""Most Newton steps for an axis ratio. A safety limit: four to seven suffice for ratios up to 1e12."""

NEARLY_ROUND = 1e-3
"""``1 - (b/a)^2`` below which the slope of Newton's method is that of the circle, -3/2. It affects the number
of steps only; the exact slope loses digits there."""


def axis_ratio(radius_ratio: ArrayLike) -> Values:
    """Ratio ``b/a`` of the half-axes of the contact of a summit.

    ``R'/R" = [(a/b)^2 E(e) - K(e)]/[K(e) - E(e)]`` with ``e^2 = 1 - b^2/a^2``, solved for ``b/a``.

    Parameters
    ----------
    radius_ratio : array_like
        ``R'/R"``, from 1 on: the larger principal radius of curvature over the smaller one.

    Returns
    -------
    ndarray
        From 1 down; about ``(R"/R')^(2/3)`` for mild ellipses.

    Raises
    ------
    InputError
        If a ratio is not finite or below 1.

    Examples
    --------
    >>> axis_ratio([1.0, 2.0, 10.0]).round(4)
    array([1.    , 0.6306, 0.2222])
    """
    ratio = np.asarray(radius_ratio, float)
    if not (np.isfinite(ratio) & (ratio >= 1)).all():
        raise InputError(f"radius_ratio must be finite and from 1 on, got {radius_ratio!r}")
    target = np.log(ratio)
    logarithm = -target / 1.5
    for _ in range(MAX_STEPS):
        squared = np.exp(2 * logarithm)
        first, second = elliprd(0, squared, 1), elliprd(0, 1, squared)
        step = (np.log(second / first) - target) / _slope(squared, first, second)
        logarithm = np.minimum(logarithm - step, 0.0)
        if np.all(np.abs(step) <= 4e-16 * (1 + np.abs(logarithm))):
            break
    return np.exp(logarithm)


def _slope(squared: Values, first: Values, second: Values) -> Values:
    """``d ln(R'/R")/d ln(b/a)`` at ``(b/a)^2``: ``E/(K - E) - (b/a)^2 K/[E - (b/a)^2 K] - 2``."""
    modulus = np.maximum(1 - squared, NEARLY_ROUND)
    K = elliprf(0, squared, 1)
    E = K - modulus * first / 3
    exact = 3 * E / (modulus * first) - 3 * K / (modulus * second) - 2
    return np.where(1 - squared > NEARLY_ROUND, exact, -1.5)


def area_factor(ratio: ArrayLike) -> Values:
    """``F1^3`` at ``b/a``: the cube of ``c`` over that of a sphere of radius ``Re`` under the same load.

    ``F1^3 = 4/(pi e^2) (b/a)^(3/2) sqrt{[(a/b)^2 E(e) - K(e)] [K(e) - E(e)]}``.

    Parameters
    ----------
    ratio : array_like
        ``b/a``, above 0 and up to 1.

    Examples
    --------
    >>> area_factor([1.0, 0.5]).round(4)
    array([1.    , 0.9568])
    """
    ratio = np.asarray(ratio, float)
    squared = ratio**2
    product = elliprd(0, 1, squared) * elliprd(0, squared, 1)
    return 4 / (3 * np.pi) * ratio**1.5 * np.sqrt(product)


def depth_factor(ratio: ArrayLike) -> Values:
    """``F2`` at ``b/a``: the indentation over that of a sphere of radius ``Re`` under the same load.

    ``F2 = (2/pi) sqrt(b/a) K(e)/F1``.

    Parameters
    ----------
    ratio : array_like
        ``b/a``, above 0 and up to 1.

    Examples
    --------
    >>> depth_factor([1.0, 0.5]).round(4)
    array([1.    , 0.9852])
    """
    return punch_factor(ratio) / np.cbrt(area_factor(ratio))


def punch_factor(ratio: ArrayLike) -> Values:
    """``(2/pi) sqrt(b/a) K(e)``: indentation by an elliptic flat punch over that by a circle of its area.

    The circular one indents by ``P/(2 E* c)``.

    Examples
    --------
    >>> punch_factor([1.0, 0.5]).round(4)
    array([1.    , 0.9708])
    """
    ratio = np.asarray(ratio, float)
    return 2 / np.pi * np.sqrt(ratio) * elliprf(0, ratio**2, 1)


def load_ratio(semi_major: ArrayLike, semi_minor: ArrayLike) -> Values:
    """Load of an elliptic contact over that of the circular one of the same area and the same radius.

    ``P/P0 = 1/F1^3``, see `area_factor`, with the half-axes ``a >= b``.

    Parameters
    ----------
    semi_major, semi_minor : array_like, any one unit
        Half-axes a and b; they broadcast.

    Returns
    -------
    ndarray
        1 for a circle, and more for every ellipse.

    Raises
    ------
    InputError
        If a half-axis is not positive, or the minor one is the larger.

    Notes
    -----
    ``P0 = 4 E* c^3/(3 R)`` with ``c = sqrt(a b)``. R is the equivalent radius ``sqrt(R1 R2)`` of the relative
    curvatures 1/R1 and 1/R2, the geometric mean. Of an asperity that is a sphere by its table but touches in
    an ellipse, that mean is taken to be the radius in the table. Valid where Hertz's law is.

    Examples
    --------
    >>> load_ratio([1.0, 1.2, 2.0], 1.0).round(4)
    array([1.    , 1.0031, 1.0452])
    """
    a, b = np.broadcast_arrays(np.asarray(semi_major, float), np.asarray(semi_minor, float))
    known = np.isfinite(a) & np.isfinite(b)
    if (b[known] <= 0).any() or (b[known] > a[known]).any():
        raise InputError("half-axes must be positive, the major one not smaller than the minor one")
    ratio = np.divide(b, a, out=np.ones(a.shape), where=known)
    return np.where(known, 1 / area_factor(ratio), np.nan)
