"""JKR: a rigid sphere on an elastic half-space with adhesion, on its stable branch.

Lengths m, forces N. ``contact_modulus`` is ``E*``, ``K = 4 E*/3``, ``work_of_adhesion`` is ``w`` in J/m^2.
With ``w = 0`` every formula is the one of `contactimg.hertz`. JKR rather than DMT holds while Tabor's number
``(R w^2/(E*^2 z0^3))^{1/3}`` is well above one, as it is for rubber.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactimg.errors import InputError, ModelRangeError
from contactimg.mechanics import hertz
from contactimg.mechanics.checks import non_negative, positive

Values = NDArray[np.float64]


def _constants(
    sphere_radius: ArrayLike, contact_modulus: float, work_of_adhesion: float
) -> tuple[Any, float, float]:
    """R, K and w, checked; R may be an array."""
    w = float(work_of_adhesion)
    if not 0 <= w < np.inf:
        raise InputError(f"work_of_adhesion must not be negative, got {work_of_adhesion!r} J/m^2")
    return (
        positive("sphere_radius", sphere_radius, "m"),
        4 / 3 * positive("contact_modulus", contact_modulus, "Pa"),
        w,
    )


def radius(
    load: ArrayLike, *, sphere_radius: float, contact_modulus: float, work_of_adhesion: float
) -> Values:
    """Contact radius under a load: ``a^3 = (R/K) [P + 3 pi w R + sqrt(6 pi w R P + (3 pi w R)^2)]``.

    Parameters
    ----------
    load : array_like, N
        At or above the pull-off load; negative is a pull.
    sphere_radius : float, m
    contact_modulus : float, Pa
    work_of_adhesion : float, J/m^2

    Returns
    -------
    ndarray, m

    Raises
    ------
    ModelRangeError
        If a load lies below the pull-off load ``-(3/2) pi w R``: no contact can bear it.

    References
    ----------
    Johnson, Kendall, Roberts, Proc. R. Soc. A 324 (1971) 301, doi:10.1098/rspa.1971.0141, eq. (21).

    Examples
    --------
    >>> a = radius(0.0, sphere_radius=0.1288, contact_modulus=4e6, work_of_adhesion=0.05)
    >>> round(float(a) * 1e6, 1)
    1431.2
    """
    R, K, w = _constants(sphere_radius, contact_modulus, work_of_adhesion)
    P, pull = np.asarray(load, dtype=np.float64), 1.5 * np.pi * w * R
    above = P + pull
    _refuse_below(above >= -1e-12 * pull, P, "load", -pull, "N")
    # with P + pull >= 0: 6 pi w R P + (3 pi w R)^2 = 4 pull (P + pull)
    return np.cbrt(R / K * (np.sqrt(np.maximum(above, 0.0)) + np.sqrt(pull)) ** 2)


def load(
    radius: ArrayLike, *, sphere_radius: ArrayLike, contact_modulus: float, work_of_adhesion: float
) -> Values:
    """Load at a contact radius: ``P = K a^3/R - sqrt(6 pi w K a^3)``, the inverse of `radius`.

    Parameters
    ----------
    radius : array_like, m
        Any contact radius; the inverse gives back the stable ones, from `pull_off_radius` on.
    sphere_radius : float or array_like, m
    contact_modulus : float, Pa
    work_of_adhesion : float, J/m^2

    Returns
    -------
    ndarray, N

    References
    ----------
    Johnson, Kendall, Roberts, Proc. R. Soc. A 324 (1971) 301, doi:10.1098/rspa.1971.0141, eq. (21).

    Examples
    --------
    >>> p = load(100e-6, sphere_radius=0.01, contact_modulus=4e6, work_of_adhesion=0.05)
    >>> round(float(p) * 1e6, 1)
    -1708.7
    """
    R, K, w = _constants(sphere_radius, contact_modulus, work_of_adhesion)
    cube = non_negative("radius", radius, "m") ** 3
    return K * cube / R - np.sqrt(6 * np.pi * w * K * cube)


def indentation_from_radius(
    radius: ArrayLike, *, sphere_radius: ArrayLike, contact_modulus: float, work_of_adhesion: float
) -> Values:
    """Indentation at a contact radius: ``delta = a^2/R - sqrt(8 pi w a/(3 K))``.

    Parameters
    ----------
    radius : array_like, m
    sphere_radius : float or array_like, m
    contact_modulus : float, Pa
    work_of_adhesion : float, J/m^2

    Returns
    -------
    ndarray, m

    References
    ----------
    Maugis, Contact, Adhesion and Rupture of Elastic Solids (2000), section 4.2.

    Examples
    --------
    >>> where = dict(sphere_radius=0.01, contact_modulus=4e6, work_of_adhesion=0.05)
    >>> round(float(indentation_from_radius(200e-6, **where)) * 1e6, 3)
    0.037
    """
    R, K, w = _constants(sphere_radius, contact_modulus, work_of_adhesion)
    a = non_negative("radius", radius, "m")
    return a**2 / R - np.sqrt(8 * np.pi * w * a / (3 * K))


def indentation(
    load: ArrayLike, *, sphere_radius: float, contact_modulus: float, work_of_adhesion: float
) -> Values:
    """Indentation under a load, on the stable branch.

    Parameters
    ----------
    load : array_like, N
        At or above the pull-off load.
    sphere_radius : float, m
    contact_modulus : float, Pa
    work_of_adhesion : float, J/m^2

    Returns
    -------
    ndarray, m

    Examples
    --------
    Without load the indentation is a third of Hertz's at the same radius:

    >>> where = dict(sphere_radius=0.01, contact_modulus=4e6, work_of_adhesion=0.05)
    >>> round(float(indentation(0.0, **where) / (radius(0.0, **where) ** 2 / 0.01)), 9)
    0.333333333
    """
    a = radius(
        load, sphere_radius=sphere_radius, contact_modulus=contact_modulus, work_of_adhesion=work_of_adhesion
    )
    return indentation_from_radius(
        a, sphere_radius=sphere_radius, contact_modulus=contact_modulus, work_of_adhesion=work_of_adhesion
    )


def radius_from_indentation(
    indentation: ArrayLike, *, sphere_radius: float, contact_modulus: float, work_of_adhesion: float
) -> Values:
    """Contact radius at an imposed indentation, on the branch that is stable then.

    The larger root of ``x^4 - 2 x = s``, with ``x`` and ``s`` the scaled ``sqrt(a)`` and ``delta``.

    Parameters
    ----------
    indentation : array_like, m
        At or above `pull_off_indentation`; it may be negative.
    sphere_radius : float, m
    contact_modulus : float, Pa
    work_of_adhesion : float, J/m^2

    Returns
    -------
    ndarray, m

    Raises
    ------
    ModelRangeError
        If an indentation lies below the one at which the contact breaks.

    Examples
    --------
    >>> where = dict(sphere_radius=0.01, contact_modulus=4e6, work_of_adhesion=0.05)
    >>> delta = indentation_from_radius(200e-6, **where)
    >>> round(float(radius_from_indentation(delta, **where)) * 1e6, 6)
    200.0
    """
    R, K, w = _constants(sphere_radius, contact_modulus, work_of_adhesion)
    delta = np.asarray(indentation, dtype=np.float64)
    if w == 0:
        _refuse_below(delta >= 0, delta, "indentation", 0.0, "m")
        return np.sqrt(R * delta)
    # a = c x^2, delta = (c^2/R) (x^4 - 2 x) with c^{3/2} = (R/2) sqrt(8 pi w/(3 K))
    c = np.cbrt(R**2 * 2 * np.pi * w / (3 * K))
    s = delta * (R / c**2)
    fold = -1.5 * 0.5 ** (1 / 3)  # the least value of x^4 - 2 x, at x = 2^{-1/3}
    _refuse_below(s >= fold * (1 + 1e-12), delta, "indentation", fold * c**2 / R, "m")
    return c * _larger_root(np.maximum(s, fold)) ** 2


def _larger_root(s: Values) -> Values:
    """Larger real root of ``x^4 - 2 x = s``; Newton from above a convex branch, safe at the fold."""
    x = np.maximum(2.0, np.sqrt(np.sqrt(np.maximum(s, 0.0))) + 1.0)
    for _ in range(60):  # quadratic but at the fold, where the error halves: 2^-53 needs at most 53
        step = (x**4 - 2 * x - s) / np.maximum(4 * x**3 - 2, np.finfo(float).tiny)
        x = np.maximum(x - np.maximum(step, 0.0), 0.5 ** (1 / 3))
        if np.all(step <= 4e-16 * x):
            break
    return x


def pull_off_load(*, sphere_radius: float, work_of_adhesion: float) -> float:
    """Load at which a contact breaks under a dead weight: ``-(3/2) pi w R``.

    Parameters
    ----------
    sphere_radius : float, m
    work_of_adhesion : float, J/m^2

    Returns
    -------
    float, N
        Negative: a pull.

    Examples
    --------
    >>> round(pull_off_load(sphere_radius=100e-6, work_of_adhesion=0.05) * 1e6, 2)
    -23.56
    """
    R, _, w = _constants(sphere_radius, 1.0, work_of_adhesion)
    return -1.5 * np.pi * w * R


def pull_off_radius(
    *, sphere_radius: float, contact_modulus: float, work_of_adhesion: float, imposed: str = "load"
) -> float:
    """Contact radius at which a contact breaks.

    ``a^3 = 3 pi w R^2/(2 K)`` under an imposed load, ``a^3 = pi w R^2/(6 K)`` under an imposed indentation.

    Parameters
    ----------
    sphere_radius : float, m
    contact_modulus : float, Pa
    work_of_adhesion : float, J/m^2
    imposed : {"load", "indentation"}
        What the machine holds fixed.

    Returns
    -------
    float, m

    References
    ----------
    Maugis, Contact, Adhesion and Rupture of Elastic Solids (2000), section 4.2.

    Examples
    --------
    >>> where = dict(sphere_radius=100e-6, contact_modulus=4e6, work_of_adhesion=0.05)
    >>> round(pull_off_radius(**where) / pull_off_radius(**where, imposed="indentation"), 4)
    2.0801
    """
    R, K, w = _constants(sphere_radius, contact_modulus, work_of_adhesion)
    if imposed not in ("load", "indentation"):
        raise InputError(f'imposed must be "load" or "indentation", got {imposed!r}')
    return float(np.cbrt(np.pi * w * R**2 / K * (1.5 if imposed == "load" else 1 / 6)))


def pull_off_indentation(*, sphere_radius: float, contact_modulus: float, work_of_adhesion: float) -> float:
    """Indentation at which a contact breaks when the indentation is imposed: the fold of ``delta(a)``.

    ``delta = -3 a^2/R`` at the radius ``a`` of `pull_off_radius` with ``imposed = "indentation"``.

    Parameters
    ----------
    sphere_radius : float, m
    contact_modulus : float, Pa
    work_of_adhesion : float, J/m^2

    Returns
    -------
    float, m
        Negative: the sphere has to be lifted above first touch.

    Examples
    --------
    >>> where = dict(sphere_radius=100e-6, contact_modulus=4e6, work_of_adhesion=0.05)
    >>> round(pull_off_indentation(**where) * 1e9)
    -402
    """
    a = pull_off_radius(
        sphere_radius=sphere_radius,
        contact_modulus=contact_modulus,
        work_of_adhesion=work_of_adhesion,
        imposed="indentation",
    )
    return -3 * a**2 / sphere_radius


def gap(
    r: ArrayLike, *, radius: float, sphere_radius: float, contact_modulus: float, work_of_adhesion: float
) -> Values:
    """Gap between sphere and deformed surface at distances from the centre, zero inside the contact.

    The gap of Hertz's contact of the same radius and that of the flat punch which adhesion pulls back by
    ``sqrt(8 pi w a/(3 K))``: ``g(r) = g_Hertz(r) + (2/pi) sqrt(8 pi w a/(3 K)) acos(a/r)``.

    Parameters
    ----------
    r : array_like, m
    radius : float, m
        Contact radius ``a``.
    sphere_radius : float, m
    contact_modulus : float, Pa
    work_of_adhesion : float, J/m^2

    Returns
    -------
    ndarray, m

    Notes
    -----
    At the edge the gap opens as the square root of the distance, ``(2/pi) sqrt(16 pi w (r - a)/(3 K))``,
    where Hertz's opens as its power 3/2: adhesion makes the optical edge of a contact sharp.

    References
    ----------
    Maugis, Contact, Adhesion and Rupture of Elastic Solids (2000), section 4.2.

    Examples
    --------
    >>> where = dict(sphere_radius=0.1288, contact_modulus=4e6)
    >>> gap([1.51e-3], radius=1.5e-3, work_of_adhesion=0.05, **where) * 1e9
    array([807.1])
    >>> gap([1.51e-3], radius=1.5e-3, work_of_adhesion=0.0, **where) * 1e9
    array([11.4])
    """
    R, K, w = _constants(sphere_radius, contact_modulus, work_of_adhesion)
    a = positive("radius", radius, "m")
    q = np.maximum(non_negative("r", r, "m") / a, 1.0)
    pulled = np.sqrt(8 * np.pi * w * a / (3 * K))
    opened = (2 / np.pi) * pulled * np.arctan(np.sqrt((q - 1) * (q + 1)))  # acos(1/q) without cancellation
    return hertz.gap(r, radius=a, sphere_radius=R) + opened


def _refuse_below(fine: NDArray[np.bool_], values: Values, name: str, limit: ArrayLike, unit: str) -> None:
    """Refuse values beyond pull-off (NaN included)."""
    if not np.all(fine):
        least, wrong = (
            float(np.broadcast_to(each, np.shape(fine))[~np.asarray(fine)].flat[0])
            for each in (limit, values)
        )
        raise ModelRangeError(f"{name} must not be below pull-off, {least:.6g} {unit}, got {wrong!r} {unit}")
