"""Hertz's contact of mildly elliptic outline: the load against that of the circle of equal area."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ellipe, ellipk

from contactimg.errors import InputError

ROUND = 1e-5
"""Squared eccentricity below which a contact counts as a circle. Accuracy: the ratio differs from 1 by less
than its square, and the closed form loses digits there."""


def load_ratio(semi_major: ArrayLike, semi_minor: ArrayLike) -> NDArray[np.float64]:
    """Load of an elliptic contact over that of the circular one of the same area and the same radius.

    ``P/P0 = 1/F1^3``, ``F1^3 = 4/(pi e^2) (b/a)^(3/2) sqrt{[(a/b)^2 E(e) - K(e)] [K(e) - E(e)]}`` with the
    half-axes ``a >= b``, ``e^2 = 1 - b^2/a^2``, and the complete elliptic integrals K and E.

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

    References
    ----------
    Johnson, Contact Mechanics (1985), doi:10.1017/CBO9781139171731, section 4.2, eqs (4.26) to (4.30).

    Examples
    --------
    >>> load_ratio([1.0, 1.2, 2.0], 1.0).round(4)
    array([1.    , 1.0031, 1.0452])
    """
    a, b = np.broadcast_arrays(np.asarray(semi_major, float), np.asarray(semi_minor, float))
    known = np.isfinite(a) & np.isfinite(b)
    if (b[known] <= 0).any() or (b[known] > a[known]).any():
        raise InputError("half-axes must be positive, the major one not smaller than the minor one")
    squared = 1.0 - (b / a) ** 2
    flat = np.maximum(squared, ROUND)
    stretch = np.sqrt(1.0 - flat)
    first, second = ellipk(flat), ellipe(flat)
    root = np.sqrt((second / stretch**2 - first) * (first - second))
    cubed = 4.0 / (np.pi * flat) * stretch**1.5 * root
    return np.where(squared > ROUND, 1.0 / cubed, np.where(known, 1.0, np.nan))
