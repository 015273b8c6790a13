"""Contacts that stick until they bear their strength, and slide one after the other.

The tangential compliance of contacts on a half-space also gives the shear forces that displacements tell.
The onset of sliding is a bounded problem:

``min_q q.C.q/2 - D sum(q)`` with ``0 <= q_i <= tau0 pi a_i^2``. As the displacement D grows, the solution is
piecewise linear: between two events the contacts that stick follow ``C_SS q_S = D - C_SF q_F``, and at an
event one of them reaches a bound, or one that slips sticks again. The path from event to event is followed
exactly, with one sweep (principal pivot) of the matrix an event.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve, cholesky
from scipy.linalg.blas import dger
from scipy.optimize import nnls

from contactimg.errors import ConvergenceError, InputError, finite_number
from contactimg.mechanics.checks import checked_poisson_ratio, non_negative, positive

Values = NDArray[np.float64]

TOLERANCE = 1e-8
"""Largest accepted residual. Chosen: as the bounded problem is asked for; rounding gives 1e-13."""

EVENTS_PER_CONTACT = 20
"""Events after which the path is given up. Chosen by hand: one a contact is usual."""


@dataclass(frozen=True, eq=False)
class SlidingOnset:
    """Shear forces of all contacts against the displacement of the glass.

    Parameters
    ----------
    compliance : ndarray, shape (n, n), m/N
    strength : ndarray, shape (n,), N
        Largest shear force of each contact.
    events : ndarray, shape (k,), m
        Displacements, from 0 on, between which every force is linear.
    forces : ndarray, shape (k, n), N
        At these displacements; from the last one on every contact slips.
    slip_displacement : ndarray, shape (n,), m
        Where each contact first bears its strength.
    residual : float
        Largest violation of the conditions of the minimum at the events, relative to the displacement.
    """

    compliance: Values
    strength: Values
    events: Values
    forces: Values
    slip_displacement: Values
    residual: float

    @property
    def order(self) -> NDArray[np.intp]:
        """Rows of the contacts in the order in which they slip."""
        return np.argsort(self.slip_displacement, kind="stable")

    def forces_at(self, displacements: ArrayLike) -> Values:
        """Shear forces (N) at displacements (m): one row a displacement, one column a contact."""
        D = _displacements(displacements)
        low = np.clip(np.searchsorted(self.events, D, side="right") - 1, 0, len(self.events) - 2)
        steps = np.diff(self.events)[low]
        share = np.divide(D - self.events[low], steps, out=np.ones_like(D), where=steps > 0)
        return self.forces[low] + np.clip(share, 0.0, 1.0)[:, None] * (
            self.forces[low + 1] - self.forces[low]
        )

    def independent_forces_at(self, displacements: ArrayLike) -> Values:
        """Return the forces on contacts that do not displace each other: ``min(D/C_ii, strength)``."""
        D = _displacements(displacements)
        return np.minimum(D[:, None] / np.diag(self.compliance), self.strength)

    def curve(self, displacements: ArrayLike) -> pd.DataFrame:
        """Force (N) against displacement (m), coupled and independent, and how many contacts slip."""
        D = _displacements(displacements)
        forces = self.forces_at(D)
        return pd.DataFrame(
            {
                "displacement_m": D,
                "force_N": forces.sum(axis=1),
                "independent_N": self.independent_forces_at(D).sum(axis=1),
                "slipping": (forces >= self.strength * (1 - TOLERANCE)).sum(axis=1),
            }
        )


def solve_sliding_onset(
    contacts: pd.DataFrame,
    *,
    shear_strength: float,
    contact_modulus: float,
    poisson_ratio: float,
    direction: float = 0.0,
) -> SlidingOnset:
    """Follow the contacts from rest to full slip as the glass is displaced tangentially.

    Parameters
    ----------
    contacts : DataFrame
        Columns ``x_m, y_m, radius_m``, of one frame or load (`InteractingSolution.contacts`,
        contacts.csv).
    shear_strength : float, Pa
        ``tau0``: shear force of a contact that slips, over its area.
    contact_modulus : float, Pa
        ``E* = E/(1 - nu^2)``.
    poisson_ratio : float
    direction : float, rad
        Of the tangential load, from +x towards +y.

    Returns
    -------
    SlidingOnset

    Raises
    ------
    InputError
        As `tangential_compliance`, or if the strength is not positive.
    ConvergenceError
        If the path does not end, or the forces do not minimise to 1e-8.

    Notes
    -----
    Each contact sticks as a whole and then slips as a whole, with the radius of pure compression. A contact
    of constant strength that slips from its rim inwards reaches the same force at ``4/pi`` times the
    displacement. The radius under shear is smaller; see the laws of area under shear.

    Examples
    --------
    Alone, a contact follows ``8 G a D/(2 - nu)`` up to ``tau0 pi a^2``:

    >>> contact = pd.DataFrame({"x_m": [0.0], "y_m": [0.0], "radius_m": [2e-5]})
    >>> onset = solve_sliding_onset(contact, shear_strength=4e5, contact_modulus=4e6, poisson_ratio=0.5)
    >>> [round(float(q) * 1e6, 2) for q in onset.forces_at([1e-6, 1e-5])[:, 0]]  # uN
    [106.67, 502.65]
    """
    stress = positive("shear_strength", finite_number(shear_strength, "shear_strength", "Pa"), "Pa")
    C = tangential_compliance(
        contacts, contact_modulus=contact_modulus, poisson_ratio=poisson_ratio, direction=direction
    )
    strength = stress * np.pi * checked_contacts(contacts)[2] ** 2
    events, forces = _follow(C, strength)
    residual = _residual(C, strength, events, forces)
    if not residual <= TOLERANCE:
        raise ConvergenceError(
            f"the shear forces violate the conditions of the minimum by {residual:.2g} of the displacement, "
            f"more than {TOLERANCE:g}; contacts may be too close for point forces"
        )
    full = forces >= strength * (1 - TOLERANCE)
    slips = np.where(full.any(axis=0), events[full.argmax(axis=0)], np.inf)
    return SlidingOnset(C, strength, events, forces, slips, residual)


def _displacements(displacements: ArrayLike) -> Values:
    """Displacements as an array, none of them negative."""
    D = np.atleast_1d(np.asarray(displacements, dtype=np.float64))
    if D.ndim != 1 or not (D >= 0).all():
        raise InputError("displacements must be a list of numbers in m, none of them negative or NaN")
    return D


def _follow(C: Values, strength: Values) -> tuple[Values, Values]:
    """Displacements of the events, and the forces there.

    ``T`` is C with the rows of the contacts that stick swept: ``-C_SS^-1``, ``C_SS^-1 C_SF`` and the
    Schur complement of the others. ``start`` and ``rate`` are the force of a contact that sticks, of others
    the displacement of the glass against the rubber, as ``start + rate D``.
    """
    n = len(C)
    T, held = C.copy(), np.zeros(n)  # held: forces of contacts that do not stick
    sticks = _first_sticking(C)
    for k in np.flatnonzero(sticks):
        _sweep(T, k)
    D, events, forces = 0.0, [0.0], [np.zeros(n)]
    for _ in range(EVENTS_PER_CONTACT * n):
        start, rate = -(T @ held), np.where(sticks, 0.0, 1.0) - T @ sticks.astype(float)
        slips = ~sticks & (held > 0)
        bound = np.where(sticks & (rate > 0), strength, 0.0)
        # a contact that slips sticks again where glass and rubber come to rest, one without force likewise
        leaves = np.where(sticks, rate != 0, np.where(slips, rate < 0, rate > 0))
        at = np.full(n, np.inf)
        at[leaves] = np.maximum((bound - start)[leaves] / rate[leaves], D)
        k = np.argmin(at)
        D = float(at[k])
        if not np.isfinite(D):  # every contact slips
            return np.array(events), np.array(forces)
        forces.append(np.where(sticks, np.clip(start + rate * D, 0.0, strength), held))
        events.append(D)
        held[k] = bound[k] if sticks[k] else 0.0
        forces[-1][k] = bound[k] if sticks[k] else forces[-1][k]
        sticks[k] = not sticks[k]
        _sweep(T, k)
    raise ConvergenceError(
        f"the onset of sliding of {n} contacts did not end in {EVENTS_PER_CONTACT * n} events; contacts "
        "may be too close for point forces"
    )


def _first_sticking(C: Values) -> NDArray[np.bool_]:
    """Contacts that bear shear from the first displacement on: others are moved by their neighbours."""
    one = np.ones(len(C))
    if (np.linalg.solve(C, one) > 0).all():
        return one > 0
    L = cholesky(C, lower=True)
    return np.asarray(nnls(L.T, np.linalg.solve(L, one))[0] > 0)


def _sweep(T: Values, k: np.intp) -> None:
    """Pivot on row k of a symmetric matrix, in place; a second time undoes it."""
    pivot, column = T[k, k], T[:, k].copy()
    # T -= outer(column, column)/pivot, without a copy
    dger(-1 / pivot, column, column, a=T.T, overwrite_a=1)
    T[k] = T[:, k] = column / abs(pivot)
    T[k, k] = -1 / pivot


def _residual(C: Values, strength: Values, events: Values, forces: Values) -> float:
    """Largest violation of the conditions of the minimum: ``C q = D`` between the bounds, below D at most."""
    excess = forces @ C - events[:, None]
    free = (forces > 0) & (forces < strength)
    wrong = np.where(
        free, np.abs(excess), np.where(forces > 0, np.maximum(excess, 0), np.maximum(-excess, 0))
    )
    scale = np.maximum(events[1:], np.finfo(np.float64).tiny)
    return float((wrong[1:].max(axis=1) / scale).max(initial=0.0))


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
    nu = checked_poisson_ratio(poisson_ratio)
    modulus = finite_number(contact_modulus, "contact_modulus", "Pa")
    G = positive("contact_modulus", modulus, "Pa") * (1 - nu) / 2
    dx, dy = x - x[:, None], y - y[:, None]
    r = np.hypot(dx, dy)
    np.fill_diagonal(r, np.inf)
    _refuse_overlaps(r, a)
    angle = finite_number(direction, "direction", "rad")
    cosine = (dx * np.cos(angle) + dy * np.sin(angle)) / r
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
    a_std = contacts.get("radius_std_m", 0 * contacts["radius_m"]).fillna(0.0).to_numpy(np.float64)
    non_negative("standard uncertainties of displacements and radii", np.append(u_std, a_std), "m")
    factor = _factor(C)
    q = cho_solve(factor, u)
    relative = a_std / contacts["radius_m"].to_numpy(np.float64)
    spread = cho_solve(factor, np.diag(np.hypot(u_std, np.diag(C) * q * relative)))
    modulus_std = finite_number(contact_modulus_std, "contact_modulus_std", "Pa")
    shared = non_negative("contact_modulus_std", modulus_std, "Pa") / contact_modulus * q
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
