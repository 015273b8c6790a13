"""The force on a contact of a given radius: of a paraboloid or sphere, and what adhesion takes."""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactimg.errors import InputError
from contactimg.mechanics import hertz, sphere

Values = NDArray[np.float64]

HERTZ_EXPONENT = 3.0
"""Theory: p ~ a^3 (Hertz)."""

ForceLaw = Literal["hertz", "sphere"]
"""Hertz's law of a paraboloid, or the sphere's exact law (Sneddon)."""


def pressing_force(
    radius: ArrayLike,
    sphere_radius: ArrayLike,
    *,
    contact_modulus: float,
    law: ForceLaw = "hertz",
) -> Values:
    """Force (N) that presses contacts to their radius, without adhesion.

    Hertz: ``p = 4 E* a^3/(3 R)``; sphere: ``p = E* [(a^2 + R^2)/2 ln((R + a)/(R - a)) - a R]``.

    Parameters
    ----------
    radius, sphere_radius : array_like, m
        They broadcast.
    contact_modulus : float, Pa
    law : {"hertz", "sphere"}

    Returns
    -------
    ndarray
        NaN where a radius is not known, and by the sphere's law for a contact as wide as its sphere.

    Raises
    ------
    InputError
        If there is no such law.

    Examples
    --------
    >>> pressing_force([3e-5], 1e-4, contact_modulus=4e6).round(8)
    array([0.00144])
    """
    if law not in ("hertz", "sphere"):
        raise InputError(f'law must be "hertz" or "sphere", got {law!r}')
    a, R = np.broadcast_arrays(np.asarray(radius, float), np.asarray(sphere_radius, float))
    known = np.isfinite(a) & np.isfinite(R)
    if law == "sphere":
        known &= np.where(known, a, 0.0) < np.where(known, R, 1.0)
    force = np.full(a.shape, np.nan)
    if law == "sphere":
        force[known] = contact_modulus * R[known] ** 2 * sphere.scaled_load(a[known] / R[known])
    else:
        force[known] = hertz.load(a[known], sphere_radius=R[known], contact_modulus=contact_modulus)
    return force


def force_exponents(radius: ArrayLike, sphere_radius: ArrayLike, *, law: ForceLaw = "hertz") -> Values:
    """Exponent ``d ln p/d ln a`` of the force law at each contact: 3 for Hertz, more for the sphere.

    Parameters
    ----------
    radius, sphere_radius : array_like, m
        They broadcast.
    law : {"hertz", "sphere"}

    Returns
    -------
    ndarray
        NaN where a radius is not known, or where the law gives no force (a contact as wide as its sphere).

    Raises
    ------
    InputError
        If there is no such law.

    Examples
    --------
    >>> force_exponents([1e-6, 5e-5], 1e-4, law="sphere").round(3)
    array([3.   , 3.258])
    """
    if law not in ("hertz", "sphere"):
        raise InputError(f'law must be "hertz" or "sphere", got {law!r}')
    a, R = np.broadcast_arrays(np.asarray(radius, float), np.asarray(sphere_radius, float))
    exponent = np.where(np.isfinite(a) & np.isfinite(R), HERTZ_EXPONENT, np.nan)
    if law == "sphere":
        ratio = np.where(np.isfinite(exponent), a, 0.0) / np.where(np.isfinite(exponent), R, 1.0)
        inside = (ratio > 0) & (ratio < 1)
        s = ratio[inside]
        # dP/ddelta = 2 E* a and ddelta/da = atanh(s) + s/(1 - s^2), s = a/R
        exponent[inside] = 2 * s**2 * (np.arctanh(s) + s / (1 - s**2)) / sphere.scaled_load(s)
        exponent[ratio >= 1] = np.nan
    return exponent


def adhesive_pull(radius: ArrayLike, *, contact_modulus: float, work_of_adhesion: float) -> Values:
    """Force (N) by which adhesion reduces the load on a contact: ``sqrt(8 pi w E* a^3)`` (JKR).

    Parameters
    ----------
    radius : array_like, m
    contact_modulus : float, Pa
    work_of_adhesion : float, J/m^2

    Examples
    --------
    >>> adhesive_pull([2e-5], contact_modulus=4e6, work_of_adhesion=0.05).round(7)
    array([0.0002005])
    """
    return np.sqrt(8 * np.pi * work_of_adhesion * contact_modulus * np.asarray(radius, float) ** 3)
