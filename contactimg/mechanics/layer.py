"""An elastic layer bonded to a rigid support: displacement of its surface by a point force.

``u(r) = P/(pi E*) int_0^inf L(k t) J0(k r) dk`` with ``L(q) = (2 kappa sinh 2q - 4q)/(2 kappa cosh 2q + 1 +
kappa^2 + 4 q^2)`` and ``kappa = 3 - 4 nu``, 1 for an incompressible layer. Written as the half-space's
``P/(pi E* r)`` minus a smooth deficit,
``P/(pi E* t) phi(r/t)`` with ``phi(s) = int_0^inf (1 - L(q)) J0(q s) dq``.
"""

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import j0, j1, roots_legendre

from contactimg.errors import InputError
from contactimg.mechanics.checks import non_negative, positive

Values = NDArray[np.float64]

STEP = 0.01
"""Spacing of `deficit_table` in ``r/t``: cubic interpolation is then exact to 1e-10."""

_REACH = 32.0
"""``r/t`` from which the layer's surface lies still: the deficit is ``t/r`` to 1e-11."""


def response(wavenumber: ArrayLike, *, poisson_ratio: float = 0.5) -> Values:
    """``L(q)``: compliance of the layer over that of the half-space at ``q = k t``.

    Parameters
    ----------
    wavenumber : array_like
        ``q``, without dimension.
    poisson_ratio : float

    Returns
    -------
    ndarray
        From ``2 q^3/3`` at long waves, or ``4 q (kappa - 1)/(kappa + 1)^2``, to 1 at short ones.

    Examples
    --------
    >>> [round(float(value), 4) for value in response([0.1, 1.0, 10.0])]
    [0.0007, 0.2406, 1.0]
    """
    return 1 - missing_response(np.asarray(wavenumber, dtype=np.float64), poisson_ratio)


def missing_response(q: Values, poisson_ratio: float) -> Values:
    """1 - L, multiplied through by ``exp(-2q)`` so that nothing overflows or cancels."""
    decay, kappa = np.exp(-2 * q), 3 - 4 * poisson_ratio
    square = 1 + kappa**2 + 4 * q**2
    return decay * (2 * kappa * decay + square + 4 * q) / (kappa * (1 + decay**2) + decay * square)


def deficit(distance: ArrayLike, *, poisson_ratio: float = 0.5) -> Values:
    """``phi(s)``: what the support takes from the half-space's displacement, at ``s = r/t``.

    Parameters
    ----------
    distance : array_like
        ``s``, without dimension.
    poisson_ratio : float

    Returns
    -------
    ndarray
        Falls from ``phi(0)`` to ``1/s``.

    Examples
    --------
    >>> round(float(deficit(0.0)), 4)
    1.7702
    """
    s = np.atleast_1d(non_negative("distance", distance, ""))
    nodes, weights = _quadrature()
    inside = j0(np.minimum(s, _REACH)[..., None] * nodes) @ (weights * missing_response(nodes, poisson_ratio))
    return np.where(s < _REACH, inside, 1 / np.maximum(s, _REACH)).reshape(np.shape(distance))


@cache
def _quadrature() -> tuple[Values, Values]:
    """Gauss-Legendre nodes on ``0 < q < 24``, where ``1 - L`` has fallen to 1e-18; exact for ``s <= 32``."""
    nodes, weights = roots_legendre(500)
    return 12 * (nodes + 1), 12 * weights


@cache
def deficit_table(poisson_ratio: float = 0.5) -> tuple[Values, Values]:
    """``phi`` and its derivative at multiples of `STEP` up to where the layer's surface lies still.

    Returns
    -------
    value, slope : ndarray

    Examples
    --------
    >>> value, slope = deficit_table()
    >>> round(float(value[0]), 4), float(slope[0])
    (1.7702, 0.0)
    """
    s = STEP * np.arange(round(_REACH / STEP) + 1)
    nodes, weights = _quadrature()
    phase = s[:, None] * nodes
    missing = weights * missing_response(nodes, poisson_ratio)
    return j0(phase) @ missing, 0.0 - j1(phase) @ (missing * nodes)


def surface_displacement(
    r: ArrayLike, *, load: float, contact_modulus: float, thickness: float, poisson_ratio: float = 0.5
) -> Values:
    """Displacement of the layer's surface, into it, by a normal point force at a distance.

    Parameters
    ----------
    r : array_like, m
        Positive distances.
    load : float, N
    contact_modulus : float, Pa
        ``E*``: ``(4/3) E`` of an incompressible layer.
    thickness : float, m
        ``t``.
    poisson_ratio : float

    Returns
    -------
    ndarray, m

    Raises
    ------
    InputError
        If a distance or a constant is not positive.

    References
    ----------
    Gacoin, Fretigny, Chateauminois, Perriot, Barthel, Tribol. Lett. 21 (2006) 245,
    doi:10.1007/s11249-006-9030-y, for the bonded layer.

    Examples
    --------
    A thick layer is a half-space:

    >>> u = surface_displacement(1e-4, load=1e-3, contact_modulus=4e6, thickness=1.0)
    >>> round(float(u) * np.pi * 4e6 * 1e-4 / 1e-3, 3)
    1.0
    """
    distance = non_negative("r", r, "m")
    if np.any(distance == 0):
        raise InputError("r must be positive: the displacement under a point force is infinite")
    t, E = positive("thickness", thickness, "m"), positive("contact_modulus", contact_modulus, "Pa")
    return load / (np.pi * E) * (1 / distance - deficit(distance / t, poisson_ratio=poisson_ratio) / t)
