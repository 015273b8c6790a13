"""From contact radii to local forces: Hertz's law contact by contact, and the sums over a frame."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from contactimg.mechanics import hertz
from contactimg.models.validity import HERTZ_LIMIT
from contactimg.tables import Flag

__all__ = ["Total", "assign_forces", "total_area", "total_force"]


@dataclass(frozen=True)
class Total:
    """A sum over the contacts of a frame, with its standard uncertainty."""

    value: float
    std: float


def assign_forces(
    contacts: pd.DataFrame,
    sphere_radius: ArrayLike,
    *,
    contact_modulus: float,
    modulus_relative_std: float = 0.0,
) -> pd.DataFrame:
    """Fill ``force_N`` and ``force_std_N`` by Hertz's law, ``p = 4 E* a^3/(3 R)``; flag ``BEYOND_HERTZ``.

    Parameters
    ----------
    contacts : DataFrame
        Contacts table with ``radius_m`` and ``radius_std_m``; not changed.
    sphere_radius : array_like, shape (n,) or scalar
        Composite radius ``R Rl/(R + Rl)`` of each contact's asperity, m; NaN where it is not known, which
        leaves the force empty.
    contact_modulus : float
        E*, Pa.
    modulus_relative_std : float
        Relative standard uncertainty of E*; it enters every force alike.

    Returns
    -------
    DataFrame
        The same table with forces.

    Notes
    -----
    Valid while a/R <= 0.33. The relative uncertainty is ``sqrt((3 std(a)/a)^2 + (std(E)/E)^2)``.

    References
    ----------
    Yashima et al., eq. (1).
    """
    a = contacts["radius_m"].to_numpy(float)
    R = np.broadcast_to(np.asarray(sphere_radius, float), a.shape)
    known = np.isfinite(R) & np.isfinite(a)
    force = np.full(a.shape, np.nan)
    force[known] = hertz.load(a[known], sphere_radius=R[known], contact_modulus=contact_modulus)
    relative = np.hypot(3 * _relative_radius_std(contacts), modulus_relative_std)
    beyond = np.zeros(a.shape, bool)
    beyond[known] = a[known] > HERTZ_LIMIT * R[known]
    flags = contacts["flags"].to_numpy(np.int64) & ~int(Flag.BEYOND_HERTZ)
    return contacts.assign(
        force_N=force,
        force_std_N=force * relative,
        flags=flags | np.where(beyond, int(Flag.BEYOND_HERTZ), 0),
    )


def total_area(contacts: pd.DataFrame) -> Total:
    """Real contact area ``A = sum pi a_i^2`` (m^2); radius errors of different contacts are independent."""
    area = contacts["area_m2"].to_numpy(float)
    return Total(float(area.sum()), float(np.sqrt(np.sum((2 * area * _relative_radius_std(contacts)) ** 2))))


def total_force(contacts: pd.DataFrame, *, modulus_relative_std: float = 0.0) -> Total:
    """Sum of the local forces (N); radius errors are independent, the modulus is common to all contacts.

    NaN if no contact has a force although there are contacts; zero if there is no contact.
    """
    force = contacts["force_N"].to_numpy(float)
    known = np.isfinite(force)
    if len(force) and not known.any():
        return Total(np.nan, np.nan)
    value = float(force[known].sum())
    independent = np.sqrt(np.sum((3 * force * _relative_radius_std(contacts))[known] ** 2))
    return Total(value, float(np.hypot(independent, modulus_relative_std * value)))


def _relative_radius_std(contacts: pd.DataFrame) -> np.ndarray:
    """Relative standard uncertainty of the radii; 0 where none is stated."""
    std = contacts["radius_std_m"].to_numpy(float) / contacts["radius_m"].to_numpy(float)
    return np.nan_to_num(std, nan=0.0)
