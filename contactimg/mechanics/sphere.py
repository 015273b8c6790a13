"""Sneddon: a rigid sphere with its exact profile on an elastic half-space, for large ``a/R``.

``delta = (a/2) ln((R + a)/(R - a))``, ``P = E* [(a^2 + R^2)/2 ln((R + a)/(R - a)) - a R]``. Hertz's laws are
the leading terms of both in ``a/R``. Lengths m, forces N, ``contact_modulus`` is ``E*``.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactimg.compiled import njit
from contactimg.errors import ModelRangeError
from contactimg.mechanics.checks import non_negative, positive

Values = NDArray[np.float64]

_NEWTON_STEP = 1e-9
"""Relative step of Newton's method that leaves rounding errors. Theory: the error left is its square."""

_SERIES_BELOW = 0.1
# (1 + s^2) sum s^(2n+1)/(2n+1) - s = sum_{n>=1} s^(2n+1) [1/(2n+1) + 1/(2n-1)]
# the ninth term is below 0.1^18/17 of the first
_SERIES = 1 / (2 * np.arange(1, 9) + 1) + 1 / (2 * np.arange(1, 9) - 1)


def _inside(radius: ArrayLike, sphere_radius: float) -> Values:
    """a/R, refused from 1 on: there the sphere is indented to its equator."""
    ratio = non_negative("radius", radius, "m") / positive("sphere_radius", sphere_radius, "m")
    if np.any(ratio >= 1):
        raise ModelRangeError(
            f"radius must stay below the sphere's radius, got a/R = {float(ratio.max()):.6g}"
        )
    return ratio


def scaled_indentation(ratio: Values) -> Values:
    """delta/R at ``ratio = a/R < 1``: ``s atanh(s)``."""
    return ratio * np.arctanh(ratio)


def scaled_load(ratio: Values) -> Values:
    """P/(E* R^2) at ``ratio = a/R < 1``: ``(1 + s^2) atanh(s) - s``, by its series where that cancels."""
    small = np.minimum(ratio, _SERIES_BELOW)
    series = small**3 * np.polynomial.polynomial.polyval(small**2, _SERIES)
    large = np.maximum(ratio, _SERIES_BELOW)
    return np.where(ratio < _SERIES_BELOW, series, (1 + large**2) * np.arctanh(large) - large)


def scaled_radius(depth: Values) -> Values:
    """a/R at ``depth = delta/R``."""
    return np.tanh(_angle(depth))


def scaled_curvatures(ratio: Values) -> tuple[Values, Values, Values]:
    """Curvatures times ``R`` of paraboloids that act like the sphere at ``s = a/R``: 1 for small ``s``.

    ``k = R delta'(a)/(2 a)``, which says how far the edge moves; ``(dk/ds)/s``; and ``3 R P/(4 E* a^3)``.
    """
    s = np.maximum(ratio, 1e-4)  # the limits there, to 1e-8
    plain, steep = np.arctanh(s) / s, 1 / (1 - s**2)
    growth = 0.5 * (steep - plain) / s**2 + steep**2
    return 0.5 * (plain + steep), growth, 0.75 * scaled_load(s) / s**3


def scaled_response(depth: Values) -> tuple[Values, Values]:
    """P/(E* R^2) and a/R at ``depth = delta/R``, also where a/R rounds to one."""
    t = _angle(depth)
    return _load_at(t), np.tanh(t)


def _load_at(t: Values) -> Values:
    """P/(E* R^2) at ``t = atanh(a/R)``."""
    s = np.tanh(t)
    return np.where(s < _SERIES_BELOW, scaled_load(np.minimum(s, _SERIES_BELOW)), (1 + s**2) * t - s)


def scaled_bent_response(depth: Values, curvature: Values, quartic: Values) -> tuple[Values, Values]:
    """P/(E* R^2) and a/R for a sphere whose profile has added ``curvature rho^2/(2 R) + quartic rho^4/R^3``.

    Sneddon: ``delta/R = s atanh(s) + curvature s^2 + (8/3) quartic s^4``; the added terms bear
    ``(4/3) curvature s^3 + (64/15) quartic s^5``. Newton's method within bounds, which follow from
    ``s^4 <= s^2 <= s atanh(s)``; ``curvature > -1`` and ``quartic >= 0``.
    """
    least, most = (
        depth / (1 + np.maximum(curvature, 0.0) + 8 / 3 * quartic),
        depth / (1 + np.minimum(curvature, 0.0)),
    )
    # tanh(t) lies between t/(1 + t) and both t and 1
    low, high = np.maximum(np.sqrt(least), least), 0.5 * (most + np.sqrt(most) * np.sqrt(most + 4))
    t = _angle(depth / (1 + curvature))
    for _ in range(100):
        t = np.clip(t, low, high)
        s = np.tanh(t)
        excess = t * s + s**2 * (curvature + 8 / 3 * quartic * s**2) - depth
        low, high = np.where(excess < 0, t, low), np.where(excess > 0, t, high)
        slope = s + (1 - s**2) * (t + s * (2 * curvature + 32 / 3 * quartic * s**2))
        newton = t - excess / np.where(slope > 0, slope, 1.0)
        inside = (newton >= low) & (newton <= high)
        step = np.where(inside, newton, 0.5 * (low + high)) - t
        t = t + step
        if np.all(np.abs(step) <= np.where(inside, _NEWTON_STEP, 4e-16) * t):
            break
    s = np.tanh(t)
    return _load_at(t) + s**3 * (4 / 3 * curvature + 64 / 15 * quartic * s**2), s


def _angle(depth: Values) -> Values:
    """``t = atanh(a/R)``: ``t tanh(t) = depth``."""
    return np.asarray(_angles(np.ravel(depth)).reshape(np.shape(depth)))


@njit(cache=True)
def _angles(depth):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """`_angle` of a row of depths, by Newton's method.

    ``t tanh(t)`` is close to ``t^2`` below one and to ``t`` above, so a handful of steps suffice.
    """
    angles = np.empty_like(depth)
    for i, d in enumerate(depth):
        t = np.sqrt(d * (1 + d / 3 + 4 / 45 * d * d)) if d < 1 else d
        for _ in range(30):
            s = np.tanh(t)
            slope = s + t * (1 - s * s)
            step = (t * s - d) / (slope if slope > 0 else 1.0)
            t = max(t - step, 0.0)
            if abs(step) <= _NEWTON_STEP * t:
                break
        angles[i] = t
    return angles


def indentation_from_radius(radius: ArrayLike, *, sphere_radius: float) -> Values:
    """Indentation at a contact radius: ``delta = (a/2) ln((R + a)/(R - a))``.

    Parameters
    ----------
    radius : array_like, m
        Contact radius ``a < R``.
    sphere_radius : float, m
        ``R``.

    Returns
    -------
    ndarray, m

    Raises
    ------
    ModelRangeError
        If a contact radius reaches the sphere's radius.

    References
    ----------
    Sneddon, Int. J. Eng. Sci. 3 (1965) 47, doi:10.1016/0020-7225(65)90019-4, section 6.

    Examples
    --------
    >>> round(float(indentation_from_radius(50e-6, sphere_radius=100e-6)) * 1e6, 3)
    27.465
    """
    return sphere_radius * scaled_indentation(_inside(radius, sphere_radius))


def radius_from_indentation(indentation: ArrayLike, *, sphere_radius: float) -> Values:
    """Contact radius at an indentation, the inverse of `indentation_from_radius`.

    Parameters
    ----------
    indentation : array_like, m
    sphere_radius : float, m

    Returns
    -------
    ndarray, m

    Examples
    --------
    >>> delta = indentation_from_radius(50e-6, sphere_radius=100e-6)
    >>> round(float(radius_from_indentation(delta, sphere_radius=100e-6)) * 1e6, 9)
    50.0
    """
    R = positive("sphere_radius", sphere_radius, "m")
    return R * scaled_radius(non_negative("indentation", indentation, "m") / R)


def load(radius: ArrayLike, *, sphere_radius: float, contact_modulus: float) -> Values:
    """Load at a contact radius: ``P = E* [(a^2 + R^2)/2 ln((R + a)/(R - a)) - a R]``.

    Parameters
    ----------
    radius : array_like, m
        Contact radius ``a < R``.
    sphere_radius : float, m
    contact_modulus : float, Pa

    Returns
    -------
    ndarray, N

    Raises
    ------
    ModelRangeError
        If a contact radius reaches the sphere's radius.

    Notes
    -----
    Above Hertz's ``K a^3/R`` by a fraction ``(2/5)(a/R)^2`` to first order: 4.4 % at ``a/R = 0.33``.

    References
    ----------
    Sneddon, Int. J. Eng. Sci. 3 (1965) 47, doi:10.1016/0020-7225(65)90019-4, section 6.

    Examples
    --------
    >>> from contactimg.mechanics import hertz
    >>> where = dict(sphere_radius=100e-6, contact_modulus=4e6)
    >>> round(float(load(33e-6, **where) / hertz.load(33e-6, **where)), 3)
    1.047
    """
    E, R = positive("contact_modulus", contact_modulus, "Pa"), positive("sphere_radius", sphere_radius, "m")
    return E * R**2 * scaled_load(_inside(radius, sphere_radius))


def radius(load: ArrayLike, *, sphere_radius: float, contact_modulus: float) -> Values:
    """Contact radius under a load, the inverse of `load`.

    Parameters
    ----------
    load : array_like, N
    sphere_radius : float, m
    contact_modulus : float, Pa

    Returns
    -------
    ndarray, m

    Examples
    --------
    >>> where = dict(sphere_radius=100e-6, contact_modulus=4e6)
    >>> round(float(radius(load(33e-6, **where), **where)) * 1e6, 9)
    33.0
    """
    R = positive("sphere_radius", sphere_radius, "m")
    target = non_negative("load", load, "N") / (positive("contact_modulus", contact_modulus, "Pa") * R**2)
    # in the depth delta/R the load is convex with slope 2 a/R: Newton from Hertz's depth
    depth = (0.75 * target) ** (2 / 3)
    for _ in range(60):
        reached, s = scaled_response(depth)
        step = (reached - target) / np.where(s > 0, 2 * s, 1.0)
        depth = np.maximum(depth - step, 0.0)
        if np.all(np.abs(step) <= 4e-16 * depth):
            break
    return R * scaled_radius(depth)
