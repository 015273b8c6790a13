"""A rigid sphere on a bonded layer, with adhesion: load and indentation at a contact radius.

The half-space's law with factors that depend on ``a/t`` and on Poisson's ratio alone,

    P = H(a/t) K a^3/R - A(a/t) sqrt(6 pi w K a^3),    delta = D(a/t) a^2/R - B(a/t) sqrt(2 pi w a/E*),

because the pressure that the support reflects is linear in the pressure. With ``g(s) = int_s^a r p(r)
(r^2 - s^2)^{-1/2} dr`` the contact is an integral equation of the second kind on ``0 < s < a``, smooth
throughout,

    g(s) - (2/pi) int_0^a g(x) int_0^inf (1 - L(k t)) cos(k x) cos(k s) dk dx = (E*/2)(delta - s^2/R),

with the load ``4 int g ds`` and Griffith's condition ``g(a) = -sqrt(pi a E* w/2)`` at the edge, where the
layer is a half-space. ``L`` is that of `contactimg.mechanics.layer`.
"""

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.special import roots_legendre

from contactimg.errors import ModelRangeError
from contactimg.mechanics.checks import non_negative
from contactimg.mechanics.layer import missing_response

Values = NDArray[np.float64]

LARGEST_RATIO = 2.0
"""Largest ``a/t``. Chosen: the quadratures are good to 1e-9 there (against twice as many nodes)."""

NODES, WAVES = 40, 400
"""Numbers of Gauss nodes in ``s`` and in the wavenumber. Sensitivity: halving them changes the factors by
less than 1e-9 up to `LARGEST_RATIO`."""

STEP = 0.01
"""Step in ``a/t`` of the table that is interpolated by cubic splines: exact to 1e-9."""

WIDEST_WAVE = 24.0
"""``k t`` at which ``1 - L`` has fallen to 1e-18."""


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
            f"{float(np.max(ratio)):.3g}"
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
    x, weight, q, missing = _quadrature(poisson_ratio)
    waves = np.cos(ratio * np.outer(np.append(x, 1.0), q))  # the last row is the edge
    kernel = 2 / np.pi * ratio * (waves * missing) @ waves[:-1].T * weight
    sides = np.column_stack([np.ones_like(x), x**2])
    inside = np.linalg.solve(np.eye(len(x)) - kernel[:-1], sides)
    flat, parabola = 1.0 + kernel[-1] @ inside  # at the edge, where both right-hand sides are 1
    flat_sum, parabola_sum = weight @ inside
    pressing = 1.5 * (flat_sum * parabola / flat - parabola_sum)
    return float(pressing), float(flat_sum / flat), float(parabola / flat), float(1 / flat)


@cache
def _quadrature(poisson_ratio: float = 0.5) -> tuple[Values, Values, Values, Values]:
    """Nodes and weights on ``0 < s/a < 1``, wavenumbers, and ``1 - L`` there times their weights."""
    x, weight = roots_legendre(NODES)
    q, q_weight = roots_legendre(WAVES)
    wave = 0.5 * WIDEST_WAVE * (q + 1)
    missing = missing_response(wave, poisson_ratio) * 0.5 * WIDEST_WAVE * q_weight
    return 0.5 * (x + 1), 0.5 * weight, wave, missing
