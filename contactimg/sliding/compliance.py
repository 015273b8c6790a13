"""Tangential compliance of contacts on a half-space, and the shear forces that displacements tell."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve

from contactimg.errors import InputError, finite_number

Values = NDArray[np.float64]

COLUMNS = ("x_m", "y_m", "radius_m")


@dataclass(frozen=True, eq=False)
class ShearForces:
    """Shear forces of single contacts with their uncertainty.

    Parameters
    ----------
    force : ndarray, shape (n,), N
    covariance : ndarray, shape (n, n), N^2
    """

    force: Values
    covariance: Values

    @property
    def std(self) -> Values:
        """Standard uncertainty of each force, N."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def total(self) -> tuple[float, float]:
        """Sum of the forces and its standard uncertainty, N."""
        return float(self.force.sum()), float(np.sqrt(max(self.covariance.sum(), 0.0)))


def tangential_compliance(
    contacts: pd.DataFrame, *, contact_modulus: float, poisson_ratio: float, direction: float = 0.0
) -> Values:
    """Displacement of each contact along the load per shear force on each of them: ``u = C q``.

    ``C_ii = (2 - nu)/(8 G a_i)`` and ``C_ij = [(1 - nu) + nu cos^2 theta]/(2 pi G r_ij)`` with
    ``G = E*(1 - nu)/2`` and theta the angle between load and the line from i to j.

    Parameters
    ----------
    contacts : DataFrame
        Columns ``x_m, y_m, radius_m``, of one frame or load.
    contact_modulus : float, Pa
        ``E* = E/(1 - nu^2)`` of the elastic body; the partner is rigid.
    poisson_ratio : float
        ``nu``.
    direction : float, rad
        Of the tangential load, from +x towards +y.

    Returns
    -------
    ndarray, shape (n, n), m/N
        Symmetric and positive definite.

    Raises
    ------
    InputError
        If there is no contact, a number breaks its rule, or two contacts overlap.

    Notes
    -----
    A half-space; a neighbour acts as a point force. Displacement and forces across the load are left out:
    the term between them is ``nu sin(theta) cos(theta)/(2 pi G r)``.

    References
    ----------
    Mindlin, J. Appl. Mech. 16 (1949) 259, doi:10.1115/1.4009973 (one contact); Johnson, Contact Mechanics
    (1985), section 3.6, the point force of Cerruti at z = 0. The first follows from the second with
    the traction ``q/(2 pi a sqrt(a^2 - r^2))`` that moves the whole contact by one displacement.

    Examples
    --------
    >>> contacts = pd.DataFrame({"x_m": [0.0, 1e-4], "y_m": [0.0, 0.0], "radius_m": [2e-5, 2e-5]})
    >>> tangential_compliance(contacts, contact_modulus=4e6, poisson_ratio=0.5) * 1e3  # um/mN
    array([[9.375     , 1.59154943],
           [1.59154943, 9.375     ]])
    """
    x, y, a = checked_contacts(contacts)
    nu = _poisson_ratio(poisson_ratio)
    G = _positive("contact_modulus", contact_modulus, "Pa") * (1 - nu) / 2
    dx, dy = x - x[:, None], y - y[:, None]
    r = np.hypot(dx, dy)
    np.fill_diagonal(r, np.inf)
    _refuse_overlaps(r, a)
    cosine = (dx * np.cos(direction) + dy * np.sin(direction)) / r
    C: Values = ((1 - nu) + nu * cosine**2) / (2 * np.pi * G * r)
    np.fill_diagonal(C, (2 - nu) / (8 * G * a))
    return C


def recover_shear_forces(
    contacts: pd.DataFrame,
    displacements: ArrayLike,
    *,
    displacement_std: ArrayLike,
    contact_modulus: float,
    contact_modulus_std: float = 0.0,
    poisson_ratio: float,
    direction: float = 0.0,
) -> ShearForces:
    """Shear force on each contact from the displacements of all: ``q = C^-1 u``.

    Parameters
    ----------
    contacts : DataFrame
        Columns ``x_m, y_m, radius_m``; ``radius_std_m`` where it is known.
    displacements, displacement_std : array_like, shape (n,) or scalar, m
        Of the rubber in each contact along the load, against the rubber far away, and their standard
        uncertainties (independent errors). A contact that sticks moves with the glass.
    contact_modulus, contact_modulus_std : float, Pa
        ``E*`` with its standard uncertainty, an error that all forces share.
    poisson_ratio : float
    direction : float, rad
        Of the tangential load, from +x towards +y.

    Returns
    -------
    ShearForces

    Raises
    ------
    InputError
        As `tangential_compliance`, or if a displacement is not finite.

    Notes
    -----
    To first order ``dq = C^-1 (du - dC q)`` with ``dC_ii = -C_ii da_i/a_i``: the covariance is
    ``C^-1 diag(s_u^2 + (C_ii q_i s_a/a_i)^2) C^-1 + (s_E/E)^2 q q'``. Every contact that bears shear must be
    in the table.

    Examples
    --------
    >>> contacts = pd.DataFrame({"x_m": [0.0, 1e-4], "y_m": [0.0, 0.0], "radius_m": [2e-5, 2e-5]})
    >>> found = recover_shear_forces(
    ...     contacts, 1e-6, displacement_std=1e-8, contact_modulus=4e6, poisson_ratio=0.5
    ... )
    >>> [round(float(value) * 1e6, 3) for value in (found.force[0], found.std[0])]  # uN
    [91.186, 1.114]
    """
    C = tangential_compliance(
        contacts, contact_modulus=contact_modulus, poisson_ratio=poisson_ratio, direction=direction
    )
    u, u_std = _per_contact("displacements", displacements, C), _per_contact("stds", displacement_std, C)
    a_std = np.zeros(len(C))
    if "radius_std_m" in contacts:
        a_std = np.nan_to_num(contacts["radius_std_m"].to_numpy(np.float64))
    factor = _factor(C)
    q = cho_solve(factor, u)
    relative = a_std / contacts["radius_m"].to_numpy(np.float64)
    spread = cho_solve(factor, np.diag(np.hypot(u_std, np.diag(C) * q * relative)))
    shared = finite_number(contact_modulus_std, "contact_modulus_std", "Pa") / contact_modulus * q
    return ShearForces(q, spread @ spread.T + np.outer(shared, shared))


def checked_contacts(contacts: pd.DataFrame) -> tuple[Values, Values, Values]:
    """Centres and radii (m) of the contacts, or an `InputError` naming the first row that breaks a rule."""
    missing = [name for name in COLUMNS if name not in contacts]
    if missing:
        raise InputError(f"contacts: column {missing[0]!r} is missing; they need {', '.join(COLUMNS)}")
    if len(contacts) == 0:
        raise InputError("contacts: the table is empty; shear forces need at least one contact")
    x, y, a = (contacts[name].to_numpy(np.float64) for name in COLUMNS)
    for name, values, good in zip(
        COLUMNS, (x, y, a), (np.isfinite(x), np.isfinite(y), (a > 0) & np.isfinite(a)), strict=True
    ):
        if not good.all():
            row, rule = int(np.argmin(good)), "positive" if name == "radius_m" else "finite"
            raise InputError(
                f"contacts: row {row}, column {name!r} must be {rule}, got {float(values[row])!r}; leave out "
                "what does not touch"
            )
    return x, y, a


def _refuse_overlaps(r: Values, a: Values) -> None:
    """Refuse contacts whose circles overlap; ``r`` are their distances."""
    row, column = np.unravel_index(int(np.argmin(r - a - a[:, None])), r.shape)
    if r[row, column] < a[row] + a[column]:
        i, j = sorted((int(row), int(column)))
        raise InputError(
            f"contacts: rows {i} and {j} overlap: they are {r[i, j] * 1e6:.4g} um apart, with radii of "
            f"{a[i] * 1e6:.4g} and {a[j] * 1e6:.4g} um; merge them, and give the contacts of one frame only"
        )


def _factor(C: Values) -> Any:
    try:
        return cho_factor(C)
    except np.linalg.LinAlgError:
        raise InputError(
            "the compliance of the contacts is not positive definite: they are too close for point forces"
        ) from None


def _per_contact(name: str, values: ArrayLike, C: Values) -> Values:
    """One finite value a contact."""
    given = np.asarray(values, dtype=np.float64)
    if given.shape not in ((), (len(C),)) or not np.isfinite(given).all():
        raise InputError(f"{name} must be one finite number, or one for each of the {len(C)} contacts, in m")
    return np.broadcast_to(given, len(C))


def _poisson_ratio(value: float) -> float:
    nu = finite_number(value, "poisson_ratio", "1")
    if not -1 < nu <= 0.5:
        raise InputError(f"poisson_ratio must be above -1 and at most 0.5, got {nu!r}")
    return nu


def _positive(name: str, value: float, unit: str) -> float:
    number = finite_number(value, name, unit)
    if not number > 0:
        raise InputError(f"{name} must be positive, got {number!r} {unit}")
    return number
