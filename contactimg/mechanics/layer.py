"""An elastic layer bonded to a rigid support: displacement by a point force, and contact with a sphere.

``u(r) = P/(pi E*) int_0^inf L(k t) J0(k r) dk`` with ``L(q) = (2 kappa sinh 2q - 4q)/(2 kappa cosh 2q + 1 +
kappa^2 + 4 q^2)`` and ``kappa = 3 - 4 nu``, 1 for an incompressible layer. Written as the half-space's
``P/(pi E* r)`` minus a smooth deficit,
``P/(pi E* t) phi(r/t)`` with ``phi(s) = int_0^inf (1 - L(q)) J0(q s) dq``.

A rigid sphere on it, with adhesion, has the half-space's law with factors that depend on ``a/t`` and on
Poisson's ratio alone,

    P = H(a/t) K a^3/R - A(a/t) sqrt(6 pi w K a^3),    delta = D(a/t) a^2/R - B(a/t) sqrt(2 pi w a/E*),

because the pressure that the support reflects is linear in the pressure. With ``g(s) = int_s^a r p(r)
(r^2 - s^2)^{-1/2} dr`` the contact is an integral equation of the second kind on ``0 < s < a``, smooth
throughout,

    g(s) - (2/pi) int_0^a g(x) int_0^inf (1 - L(k t)) cos(k x) cos(k s) dk dx = (E*/2)(delta - s^2/R),

with the load ``4 int g ds`` and Griffith's condition ``g(a) = -sqrt(pi a E* w/2)`` at the edge, where the
layer is a half-space.
"""

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.special import j0, j1, roots_legendre

from contactimg.errors import InputError, ModelRangeError
from contactimg.mechanics.checks import checked_poisson_ratio, non_negative, positive

Values = NDArray[np.float64]

STEP = 0.01
"""Step of the tables, in ``r/t`` and ``a/t``: `deficit_table` by cubic interpolation is then exact to 1e-10,
`factor_table` by cubic splines to 1e-9."""

WIDEST_WAVE = 24.0
"""``k t`` at which ``1 - L`` has fallen to 1e-18."""

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
    decay, kappa = np.exp(-2 * q), 3 - 4 * checked_poisson_ratio(poisson_ratio)
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
    nodes, weights = _wave_nodes()
    inside = j0(np.minimum(s, _REACH)[..., None] * nodes) @ (weights * missing_response(nodes, poisson_ratio))
    return np.where(s < _REACH, inside, 1 / np.maximum(s, _REACH)).reshape(np.shape(distance))


@cache
def _wave_nodes() -> tuple[Values, Values]:
    """Gauss-Legendre nodes on ``0 < q <`` `WIDEST_WAVE`; exact for ``s <= 32``."""
    nodes, weights = roots_legendre(500)
    return WIDEST_WAVE / 2 * (nodes + 1), WIDEST_WAVE / 2 * weights


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
    nodes, weights = _wave_nodes()
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


LARGEST_RATIO = 2.0
"""Largest ``a/t``. Chosen: the quadratures are good to 1e-9 there (against twice as many nodes)."""

NODES, WAVES = 40, 400
"""Numbers of Gauss nodes in ``s`` and in the wavenumber. Sensitivity: halving them changes the factors by
less than 1e-9 up to `LARGEST_RATIO`."""


def layer_factors(radius_over_thickness: ArrayLike, *, poisson_ratio: float = 0.5) -> tuple[Values, Values]:
    """Factors of the Hertzian and of the adhesive part of the load on a layer.

    Parameters
    ----------
    radius_over_thickness : array_like
        ``a/t``, from 0 to 2.
    poisson_ratio : float

    Returns
    -------
    pressing, adhesive : ndarray
        ``H`` and ``A``; both 1 on a half-space, from which they depart with the cube of ``a/t``.

    Raises
    ------
    ModelRangeError
        If the contact is wider than four thicknesses.

    References
    ----------
    Barthel, Perriot, J. Phys. D 40 (2007) 1059, doi:10.1088/0022-3727/40/4/021, for the transform ``g`` and
    the adhesive contact of a coated body; Gacoin, Fretigny, Chateauminois, Perriot, Barthel, Tribol. Lett. 21
    (2006) 245, doi:10.1007/s11249-006-9030-y, for the bonded layer.

    Examples
    --------
    >>> pressing, adhesive = layer_factors([0.0, 0.2, 0.5])
    >>> [round(float(value), 4) for value in pressing]
    [1.0, 1.0062, 1.0789]
    """
    ratio = non_negative("radius_over_thickness", radius_over_thickness, "")
    if np.any(ratio > LARGEST_RATIO):
        raise ModelRangeError(
            f"contact radii of up to {LARGEST_RATIO:g} thicknesses of the layer are within the model, got "
            f"{float(np.max(ratio)):.6g}"
        )
    factors = factor_table(poisson_ratio)(ratio)
    return np.asarray(factors[..., 0]), np.asarray(factors[..., 1])


@cache
def factor_table(poisson_ratio: float = 0.5) -> CubicSpline:
    """``H``, ``A``, ``D`` and ``B`` against ``a/t``, from 0 to `LARGEST_RATIO`."""
    ratios = np.linspace(0.0, LARGEST_RATIO, round(LARGEST_RATIO / STEP) + 1)
    return CubicSpline(ratios, [layer_factors_at(float(ratio), poisson_ratio) for ratio in ratios])


def layer_factors_at(ratio: float, poisson_ratio: float = 0.5) -> tuple[float, float, float, float]:
    """``H``, ``A``, ``D`` and ``B`` at one ratio, from the responses to a flat and a parabolic indenter."""
    x, weight, q, missing = _contact_nodes(poisson_ratio)
    waves = np.cos(ratio * np.outer(np.append(x, 1.0), q))  # the last row is the edge
    kernel = 2 / np.pi * ratio * (waves * missing) @ waves[:-1].T * weight
    sides = np.column_stack([np.ones_like(x), x**2])
    inside = np.linalg.solve(np.eye(len(x)) - kernel[:-1], sides)
    flat, parabola = 1.0 + kernel[-1] @ inside  # at the edge, where both right-hand sides are 1
    flat_sum, parabola_sum = weight @ inside
    pressing = 1.5 * (flat_sum * parabola / flat - parabola_sum)
    return float(pressing), float(flat_sum / flat), float(parabola / flat), float(1 / flat)


@cache
def _contact_nodes(poisson_ratio: float = 0.5) -> tuple[Values, Values, Values, Values]:
    """Nodes and weights on ``0 < s/a < 1``, wavenumbers, and ``1 - L`` there times their weights."""
    x, weight = roots_legendre(NODES)
    q, q_weight = roots_legendre(WAVES)
    wave = 0.5 * WIDEST_WAVE * (q + 1)
    missing = missing_response(wave, poisson_ratio) * 0.5 * WIDEST_WAVE * q_weight
    return 0.5 * (x + 1), 0.5 * weight, wave, missing
