"""Where the apex of the indenter stands, as the contacts show it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist

from contactimg.pose.pairs import FEWEST_CONTACTS, MAD_TO_STD, OUTLIER_SIGMA, ROUNDS

InView = Callable[..., NDArray[np.bool_]]
"""Tells which points (x, y) the camera sees."""

STATED, FOUND = "stated", "found from the contacts"
"""How a pose or an apex is known."""

SIGNIFICANT_STDS = 3.0
"""Standard deviations beyond which a number contradicts another, a gap opens, or a height is none of the
base. Theory: 0.3 % of false alarms, 0.1 % to one side."""

_ANGLES = np.pi / 4 * np.arange(1, 8)
TURNS = np.array([[np.cos(_ANGLES), -np.sin(_ANGLES)], [np.sin(_ANGLES), np.cos(_ANGLES)]])
"""Rotations about the centre, to places where contacts out of view are to be expected. Chosen: with quarter
turns an apex at a corner of the view is off by half as much again, with finer ones by no less."""

REGION_SHARE = 0.95
"""Share of the contact area within the circle that counts as the contact region. Chosen: in random patterns
of 200 contacts the 68 and 95 % intervals hold for whole regions; of those that lack a tenth of their width
9 % pass, their centre two standard uncertainties off."""


@dataclass(frozen=True)
class Apex:
    """The point of the sample below the apex of the indenter.

    Attributes
    ----------
    place : (float, float)
        Sample coordinates, m.
    std : (float, float)
        Standard uncertainty along x and y, m; 0 where it was stated.
    known : str
        "stated" or "found from the contacts".
    radius : float or None
        Radius of the indenter that the contacts show, m; None where it was stated.
    radius_std : float
        Its standard uncertainty, m.
    """

    place: tuple[float, float]
    std: tuple[float, float] = (0.0, 0.0)
    known: str = STATED
    radius: float | None = None
    radius_std: float = 0.0

    def sentence(self) -> str:
        """Where the apex is, in mm, and how that is known."""
        (x, y), std = self.place, max(self.std)
        uncertainty = f" +- {1e3 * std:.1g}" if std > 0 else ""
        return f"apex of the lens, {self.known}: x = {1e3 * x:.4f}, y = {1e3 * y:.4f} mm{uncertainty}"


def find_apex(
    points: ArrayLike, heights: ArrayLike, radii: ArrayLike, contact_radii: ArrayLike, *, in_view: InView
) -> Apex | None:
    """The centre of the contact region: where the gap below the lens, as the contacts show it, is smallest.

    Parameters
    ----------
    points : array_like, shape (n, 2)
        Asperities in contact, sample coordinates, m.
    heights, radii : array_like, shape (n,)
        Of these asperities, m.
    contact_radii : array_like, shape (n,)
        Of their contacts, m.
    in_view : callable
        Which points (x, y) the camera sees. Those as far from the centre stand for contacts out of view.

    Returns
    -------
    Apex or None
        None if there are fewer than `FEWEST_CONTACTS`, the gap does not open away from a centre, or that lies
        far outside the contacts.

    Notes
    -----
    A contact of radius a on an asperity of height h and radius R has the indentation ``a^2/R`` and the force
    ``4 E* a^3/(3 R)``, by which it lowers the surface at the distance d by ``4 a^3/(3 pi R d)``: the modulus
    cancels. Indentation minus height plus what all other contacts lower the surface by is
    ``c - r^2/(2 R_lens)`` about the apex, a parabola whose linear least squares give apex and radius of the
    lens. An error of a contact radius that changes its own term by e changes that of another by ``2 a
    e/(pi d)``. Such errors, of one size for all contacts that the residuals tell, give the uncertainties.
    Each contact stands for the part of its ring about the apex that is out of view. What these contacts
    change of the place and, over half the size of the region, of the curvature adds to the uncertainties.
    """
    points = np.asarray(points, float).reshape(-1, 2)
    heights, radii, a = (np.asarray(values, float) for values in (heights, radii, contact_radii))
    if len(a) < FEWEST_CONTACTS:
        return None
    middle = points.mean(axis=0)
    at, lowering = points - middle, 4 * a**3 / (3 * np.pi * radii)
    scale = float(np.hypot(*at.T).max())
    distance = cdist(at, at)
    np.fill_diagonal(distance, np.inf)
    if not (scale > 0 and distance.min() > 0):
        return None
    x, y = (at / scale).T
    design = np.column_stack([np.ones_like(x), x, y, x**2 + y**2])
    whole = a**2 / radii - heights + (1 / distance) @ lowering
    shared = np.eye(len(a)) + 2 * a / (np.pi * distance)
    gap, kept, found = whole, np.ones(len(a), bool), list[NDArray[np.float64]]()
    for _ in range(ROUNDS):
        solution, covariance, residual = _least_squares(design, gap, kept, shared)
        curvature, curvature_std = float(solution[3]), float(np.sqrt(covariance[3, 3]))
        if not curvature < -SIGNIFICANT_STDS * curvature_std:
            return None
        radius = -(scale**2) / (2 * curvature)
        found.append(np.append(radius * solution[1:3] / scale, radius))
        spread = MAD_TO_STD * float(np.median(np.abs(residual)))
        kept = np.abs(residual) <= OUTLIER_SIGMA * spread if spread > 0 else kept
        turned = found[-1][:2] + np.einsum("ijk,nj->kni", TURNS, at - found[-1][:2])
        seen = in_view(*np.moveaxis(turned + middle, -1, 0))
        share = lowering / (1 + seen.sum(axis=0)) * ~seen
        gap = whole + (1 / cdist(at, turned[~seen])) @ share[~seen]
    centre = found[-1][:2]
    per_centre = np.column_stack([np.eye(2), 2 * centre / scale]) / (2 * curvature)
    variance = scale**2 * np.einsum("ij,jk,ik->i", per_centre, covariance[1:, 1:], per_centre)
    # half of what contacts out of view change counts as unknown, since their asperities differ. Chosen:
    # corners of SA+ are then up to 3.7 standard uncertainties off, with 0.3 in place of 0.5 up to 5
    cut = (found[-1] - found[0]) * 0.5 + (found[-1] - found[-2])
    std = np.sqrt(variance + cut[:2] @ cut[:2] + (scale / 2 * cut[2] / radius) ** 2)
    if not (std < scale).all():
        return None
    (x, y), (x_std, y_std) = (middle + centre).tolist(), std.tolist()
    radius_std = float(np.hypot(radius * curvature_std / curvature, cut[2]))
    return Apex((x, y), (x_std, y_std), FOUND, radius, radius_std)


def find_centre(points: ArrayLike, areas: ArrayLike, *, in_view: InView) -> Apex | None:
    """The centre of the contact region, where no asperities are known: the mean place of the contact area.

    Parameters
    ----------
    points : array_like, shape (n, 2)
        Contacts, sample coordinates, m.
    areas : array_like, shape (n,)
        m^2.
    in_view : callable
        Which points (x, y) the camera sees.

    Returns
    -------
    Apex or None
        With the standard uncertainty of a mean of independent contacts. None if there are fewer than
        `FEWEST_CONTACTS`, or the circle that holds `REGION_SHARE` of the area is not in view as a whole.
    """
    at, weight = np.asarray(points, float).reshape(-1, 2), np.asarray(areas, float)
    if len(at) < FEWEST_CONTACTS or not weight.sum() > 0:
        return None
    share = weight / weight.sum()
    centre = share @ at
    away = np.hypot(*(at - centre).T)
    order = np.argsort(away)
    radius = away[order][np.searchsorted(np.cumsum(share[order]), REGION_SHARE)]
    turn = np.linspace(0, 2 * np.pi, 64)
    if not in_view(centre[0] + radius * np.cos(turn), centre[1] + radius * np.sin(turn)).all():
        return None
    x, y = centre.tolist()
    x_std, y_std = np.sqrt(((share[:, None] * (at - centre)) ** 2).sum(axis=0)).tolist()
    return Apex((x, y), (x_std, y_std), FOUND)


def _least_squares(
    design: NDArray[np.float64],
    values: NDArray[np.float64],
    kept: NDArray[np.bool_],
    shared: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Solution and covariance from the rows that are kept, and the residuals of all rows.

    ``shared`` holds what independent errors of equal size, one a column, change of the values.
    """
    rows, changes = design[kept], shared[kept]
    inverse = np.linalg.pinv(rows)
    solution, effect = inverse @ values[kept], inverse @ changes
    residual = values - design @ solution
    left = float(np.sum((changes - rows @ effect) ** 2))
    variance = float(np.sum(residual[kept] ** 2)) / max(left, np.finfo(float).tiny)
    return solution, variance * effect @ effect.T, residual
