"""Hertz: a rigid sphere (its paraboloid) on an elastic half-space, and the gap it leaves around the contact.

All lengths m, forces N, pressures Pa. ``contact_modulus`` is ``E* = E/(1 - nu^2)``; the formulas use
``K = 4 E*/3``. Everything holds while the contact radius is small against the sphere's, ``a/R <= 0.33``.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactimg.mechanics.checks import non_negative, positive

Values = NDArray[np.float64]


def _stiffness(contact_modulus: float) -> float:
    """K = 4 E*/3."""
    return 4 / 3 * positive("contact_modulus", contact_modulus, "Pa")


def load(radius: ArrayLike, *, sphere_radius: ArrayLike, contact_modulus: float) -> Values:
    """Load that presses a sphere to a contact radius: ``P = K a^3 / R``.

    Parameters
    ----------
    radius : array_like, m
        Contact radius ``a``.
    sphere_radius : array_like, m
        Radius of curvature ``R`` of each contact or of all (for two spheres, ``R1 R2/(R1 + R2)``).
    contact_modulus : float, Pa
        ``E*``; ``K = 4 E*/3``.

    Returns
    -------
    ndarray, N

    Raises
    ------
    InputError
        If a radius is negative or a constant is not positive.

    Notes
    -----
    Small against measured loads by a few per cent from ``a/R`` of about 0.33 on.

    References
    ----------
    Yashima et al., Soft Matter 11 (2015) 871, doi:10.1039/C4SM02346C, eq. (1).

    Examples
    --------
    >>> float(load(30e-6, sphere_radius=100e-6, contact_modulus=4e6)) * 1e3
    1.44
    """
    R = positive("sphere_radius", sphere_radius, "m")
    return _stiffness(contact_modulus) * non_negative("radius", radius, "m") ** 3 / R


def radius(load: ArrayLike, *, sphere_radius: float, contact_modulus: float) -> Values:
    """Contact radius under a load: ``a = (P R / K)^{1/3}``, the inverse of `load`.

    Parameters
    ----------
    load : array_like, N
    sphere_radius : float, m
    contact_modulus : float, Pa

    Returns
    -------
    ndarray, m

    Raises
    ------
    InputError
        If a load is negative or a constant is not positive.

    Examples
    --------
    The apparent contact of the lens of 128.8 mm at 0.5 N is 4.6 mm wide without roughness:

    >>> round(float(2e3 * radius(0.5, sphere_radius=0.1288, contact_modulus=4e6)), 2)
    4.59
    """
    R = positive("sphere_radius", sphere_radius, "m")
    return np.cbrt(non_negative("load", load, "N") * (R / _stiffness(contact_modulus)))


def indentation_from_radius(radius: ArrayLike, *, sphere_radius: float) -> Values:
    """Indentation at a contact radius: ``delta = a^2 / R``.

    Parameters
    ----------
    radius : array_like, m
    sphere_radius : float, m

    Returns
    -------
    ndarray, m

    Examples
    --------
    >>> float(indentation_from_radius(20e-6, sphere_radius=100e-6)) * 1e6
    4.0
    """
    return non_negative("radius", radius, "m") ** 2 / positive("sphere_radius", sphere_radius, "m")


def radius_from_indentation(indentation: ArrayLike, *, sphere_radius: float) -> Values:
    """Contact radius at an indentation: ``a = sqrt(R delta)``.

    Parameters
    ----------
    indentation : array_like, m
    sphere_radius : float, m

    Returns
    -------
    ndarray, m

    Examples
    --------
    >>> float(radius_from_indentation(4e-6, sphere_radius=100e-6)) * 1e6
    20.0
    """
    R = positive("sphere_radius", sphere_radius, "m")
    return np.sqrt(non_negative("indentation", indentation, "m") * R)


def indentation(load: ArrayLike, *, sphere_radius: float, contact_modulus: float) -> Values:
    """Indentation under a load: ``delta = (P / (K sqrt(R)))^{2/3}``.

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
    >>> float(indentation(1.44e-3, sphere_radius=100e-6, contact_modulus=4e6)) * 1e6
    9.0
    """
    return indentation_from_radius(
        radius(load, sphere_radius=sphere_radius, contact_modulus=contact_modulus),
        sphere_radius=sphere_radius,
    )


def load_from_indentation(indentation: ArrayLike, *, sphere_radius: float, contact_modulus: float) -> Values:
    """Load at an indentation: ``P = K sqrt(R) delta^{3/2}``.

    Parameters
    ----------
    indentation : array_like, m
    sphere_radius : float, m
    contact_modulus : float, Pa

    Returns
    -------
    ndarray, N

    Examples
    --------
    >>> float(load_from_indentation(9e-6, sphere_radius=100e-6, contact_modulus=4e6)) * 1e3
    1.44
    """
    return load(
        radius_from_indentation(indentation, sphere_radius=sphere_radius),
        sphere_radius=sphere_radius,
        contact_modulus=contact_modulus,
    )


def peak_pressure(load: ArrayLike, *, sphere_radius: float, contact_modulus: float) -> Values:
    """Pressure at the centre: ``p0 = 3 K a / (2 pi R) = 3 P / (2 pi a^2)``.

    Parameters
    ----------
    load : array_like, N
    sphere_radius : float, m
    contact_modulus : float, Pa

    Returns
    -------
    ndarray, Pa

    References
    ----------
    Yashima et al., doi:10.1039/C4SM02346C, Appendix A.

    Examples
    --------
    >>> round(float(peak_pressure(0.5, sphere_radius=0.1288, contact_modulus=4e6)), -2)
    45400.0
    """
    a = radius(load, sphere_radius=sphere_radius, contact_modulus=contact_modulus)
    return 1.5 / np.pi * (_stiffness(contact_modulus) / positive("sphere_radius", sphere_radius, "m")) * a


def pressure(r: ArrayLike, *, radius: float, sphere_radius: float, contact_modulus: float) -> Values:
    """Pressure at distances from the centre: ``p0 sqrt(1 - r^2/a^2)``, zero outside.

    Parameters
    ----------
    r : array_like, m
    radius : float, m
        Contact radius ``a``.
    sphere_radius : float, m
    contact_modulus : float, Pa

    Returns
    -------
    ndarray, Pa

    Examples
    --------
    >>> at = pressure([0.0, 0.6e-3, 2e-3], radius=1e-3, sphere_radius=0.1, contact_modulus=4e6)
    >>> [float(value) for value in at / at[0]]
    [1.0, 0.8, 0.0]
    """
    a = positive("radius", radius, "m")
    inside = np.maximum(1 - (non_negative("r", r, "m") / a) ** 2, 0.0)
    R = positive("sphere_radius", sphere_radius, "m")
    return 1.5 / np.pi * _stiffness(contact_modulus) * a / R * np.sqrt(inside)


def surface_displacement(r: ArrayLike, *, radius: float, sphere_radius: float) -> Values:
    """Displacement of the half-space's surface, into it, at distances from the centre of the contact.

    ``[(2 a^2 - r^2) asin(a/r) + r a sqrt(1 - a^2/r^2)] / (pi R)`` outside, ``a^2/R - r^2/(2 R)`` inside.

    Parameters
    ----------
    r : array_like, m
    radius : float, m
        Contact radius ``a``.
    sphere_radius : float, m

    Returns
    -------
    ndarray, m

    Notes
    -----
    Far away ``u -> P/(pi E* r)`` times ``1 + (a/r)^2/10 + ...``. Beyond ``r = 20 a`` that series is
    summed, because the closed form loses digits to cancellation as ``(r/a)^3``.

    References
    ----------
    Yashima et al., doi:10.1039/C4SM02346C, Appendix A; Johnson, Contact Mechanics (1985), eq. (3.42).

    Examples
    --------
    >>> round(float(surface_displacement(20e-6, radius=20e-6, sphere_radius=100e-6)) * 1e6, 12)
    2.0
    """
    a, R = positive("radius", radius, "m"), positive("sphere_radius", sphere_radius, "m")
    distance = non_negative("r", r, "m")
    outside = np.maximum(distance / a, 1.0)
    u = np.where(distance > a, displacement_factor(1 / outside) * 4 / (3 * np.pi * outside), 0.0)
    return a**2 / R * np.where(distance > a, u, 1 - np.minimum(distance / a, 1.0) ** 2 / 2)


def displacement_factor(ratio: ArrayLike) -> Values:
    """Displacement outside a Hertz contact over that of a point force, at ``ratio = a/r <= 1``.

    ``(3/(4 q^3)) [(2 q^2 - 1) asin(q) + q sqrt(1 - q^2)]``, ``q = a/r``: 1 far away, ``3 pi/8`` at the edge.
    Below 0.05 the series ``1 + q^2/10 + 9 q^4/280 + 5 q^6/336``, exact there to 1e-12.
    """
    q = np.asarray(ratio, dtype=np.float64)
    far = q < 0.05
    near = np.where(far, 1.0, q)
    closed = (2 * near**2 - 1) * np.arcsin(near) + near * np.sqrt(1 - near**2)
    series = 1 + q**2 * (1 / 10 + q**2 * (9 / 280 + q**2 * (5 / 336)))
    return np.where(far, series, 0.75 * closed / near**3)


def gap(r: ArrayLike, *, radius: ArrayLike, sphere_radius: ArrayLike) -> Values:
    """Gap between sphere and deformed surface at distances from the centre, zero inside the contact.

    ``g(r) = u(r) - (2 a^2 - r^2)/(2 R)`` with ``u`` from `surface_displacement`.

    Parameters
    ----------
    r : array_like, m
    radius, sphere_radius : array_like, m
        Contact radii ``a`` and radii of curvature of the spheres; all three broadcast.

    Returns
    -------
    ndarray, m

    Notes
    -----
    Evaluated in a form that does not cancel at the edge (and there by its series), to 1e-9 relative
    wherever ``r`` can be told from ``a``.

    References
    ----------
    Yashima et al., doi:10.1039/C4SM02346C, Appendix A.

    Examples
    --------
    >>> round(float(gap(30e-6, radius=20e-6, sphere_radius=100e-6)) * 1e9, 1)
    1691.2
    """
    a, R = positive("radius", radius, "m"), positive("sphere_radius", sphere_radius, "m")
    q = np.maximum(non_negative("r", r, "m") / a, 1.0)
    # with asin(1/q) = pi/2 - theta, cos theta = 1/q, the terms of order 1 cancel exactly:
    # pi R g/a^2 = (q^2 - 2) theta + sqrt(q^2 - 1)
    root = np.sqrt((q - 1) * (q + 1))
    exact = (q**2 - 2) * np.arctan(root) + root
    # in t = sqrt(q^2-1): (t^2 - 1)(t - t^3/3 + t^5/5 - ...) + t = 4/3 t^3 - 8/15 t^5 + 12/35 t^7 - 16/63 t^9
    series = root**3 * (4 / 3 - root**2 * (8 / 15 - root**2 * (12 / 35 - root**2 * (16 / 63))))
    return a**2 / (np.pi * R) * np.where(root < 0.01, series, exact)


def annulus(load: ArrayLike, *, sphere_radius: float, contact_modulus: float, roughness: float) -> Values:
    """Width of the ring around the Hertz circle over which the gap opens by the roughness.

    ``Delta = (3 pi/(8 sqrt 2))^{2/3} R^{5/9} sigma^{2/3} K^{1/9} P^{-1/9}``.

    Parameters
    ----------
    load : array_like, N
        Positive.
    sphere_radius : float, m
    contact_modulus : float, Pa
    roughness : float, m
        ``sigma``, the length that stands for the height distribution.

    Returns
    -------
    ndarray, m

    Notes
    -----
    From the leading term of the gap at the edge: it needs ``Delta`` well below the Hertz radius.

    References
    ----------
    Yashima et al., doi:10.1039/C4SM02346C, Appendix A, last equation.

    Examples
    --------
    >>> round(float(annulus(0.5, sphere_radius=0.1288, contact_modulus=4e6, roughness=30e-6)) * 1e3, 2)
    1.65
    """
    P, sigma = positive("load", load, "N"), positive("roughness", roughness, "m")
    a = radius(P, sphere_radius=sphere_radius, contact_modulus=contact_modulus)
    # just outside the edge the gap is 8 sqrt(2 a)/(3 pi R) (r - a)^(3/2); it is sigma at r - a = Delta
    R = positive("sphere_radius", sphere_radius, "m")
    return (3 * np.pi * R * sigma / (8 * np.sqrt(2))) ** (2 / 3) / np.cbrt(a)
