"""Annuli around the centre of the apparent contact: their area in the image and the contacts in them.

The contacts of an annulus are summed to moments (number, radii, forces and their products). Moments of
several places add up, so that averages over places are taken once, from the sums.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from contactimg.errors import InputError
from contactimg.models.ensemble import EnsembleMember
from contactimg.optics.coverage import disk_rectangle_area
from contactimg.pose import Pose

Values = NDArray[np.float64]

MOMENTS = ("area", "n", "n_forces", "a", "aa", "p", "pp", "ap")
"""Per annulus: area in the image (m^2), number of contacts, of contacts with a force, and their sums of
contact radius ``a``, ``a^2``, force ``p``, ``p^2`` and ``a p``, in SI units."""

MIN_PLACES_FOR_SCATTER = 4
"""Least number of places, or of sectors of places, whose scatter gives the uncertainty. Theory: the relative
uncertainty of a standard deviation of n values, 1/sqrt(2 (n - 1)), is then below the 45 % by which counting
overestimates it on dense patterns."""

SECTORS = 8
"""Sectors of a place, whose scatter stands for that between places. Chosen: a sector of the apparent contact
is wider than the asperities' spacing, and seven degrees of freedom know a standard deviation to 27 %."""

MOST_ANNULI = 100_000
"""Annuli of one place. Chosen: far more than a camera has pixels; only a wrong number asks for more."""

RAYS = 960
"""Directions over which the visible shares of sectors are summed. Chosen: shares are good to a per cent of a
sector where the image's edge cuts it; the sum over an annulus is exact."""


@dataclass(frozen=True)
class FieldOfView:
    """The part of the sample that is in the image.

    Parameters
    ----------
    pose : Pose
        Of the camera over the reference frame.
    shift_px : (float, float)
        Position in the frame minus position in the reference.
    """

    pose: Pose
    shift_px: tuple[float, float] = (0.0, 0.0)

    def holds(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.bool_]:
        """Whether sample points (m) lie in the image."""
        rows, columns = self.pose.shape
        x_px, y_px = self._pixels(x, y)
        return (np.abs(x_px - (columns - 1) / 2) <= columns / 2) & (np.abs(y_px - (rows - 1) / 2) <= rows / 2)

    def disc_area(self, centre: tuple[float, float], radius: float) -> float:
        """Area (m^2) of a disc on the sample that lies in the image; exact.

        Examples
        --------
        A disc about the corner of the image shows a quarter of itself:

        >>> field = FieldOfView(Pose(shape=(100, 200), pixel_size=1e-6))
        >>> 4 * field.disc_area((-100e-6, -50e-6), 10e-6) / 1e-10
        3.14159265
        """
        if radius <= 0:
            return 0.0
        rows, columns = self.pose.shape
        x_px, y_px = self._pixels(*centre)
        left, top = -0.5 - float(x_px), -0.5 - float(y_px)
        radius_px = radius / self.pose.pixel_size
        inside = disk_rectangle_area(left, left + columns, top, top + rows, radius_px)
        return float(inside) * self.pose.pixel_size**2

    def sector_areas(self, centre: tuple[float, float], edges: Values, sectors: int) -> Values:
        """Areas (m^2) of the sectors of annuli that lie in the image, shape (annuli, sectors).

        Sector ``k`` holds the directions ``2 pi k/sectors`` to ``2 pi (k + 1)/sectors`` of the sample. Each
        annulus has its exact area; its shares are sums over `RAYS` directions.

        Examples
        --------
        Of a disc about the middle of an image's left edge, half is seen:

        >>> field = FieldOfView(Pose(shape=(100, 200), pixel_size=1e-6))
        >>> field.sector_areas((-100e-6, 0.0), np.array([0.0, 10e-6]), 4).round(12).tolist()
        [[7.9e-11, 0.0, 0.0, 7.9e-11]]
        """
        rays = max(RAYS // sectors, 1) * sectors
        angle = 2 * np.pi * (np.arange(rays) + 0.5) / rays
        enter, leave = self._crossings(centre, angle)
        reach = np.clip(np.asarray(edges)[:, None], enter, np.maximum(leave, enter))
        rings = np.diff(reach**2, axis=0).reshape(len(edges) - 1, sectors, -1).sum(axis=2)
        exact = np.diff([self.disc_area(centre, r) for r in edges])
        total = rings.sum(axis=1, keepdims=True)
        share = np.divide(rings, total, out=np.full(rings.shape, 1 / sectors), where=total > 0)
        return np.asarray(share * exact[:, None], np.float64)

    def _crossings(self, centre: tuple[float, float], angle: Values) -> tuple[Values, Values]:
        """Distances (m) from a point at which rays enter and leave the image."""
        here = np.array(self._pixels(*centre), np.float64)[:, None, None]
        along = np.array(self._pixels(centre[0] + np.cos(angle), centre[1] + np.sin(angle)))[..., None] - here
        ends = np.array([[-0.5, size - 0.5] for size in self.pose.shape[::-1]])[:, None, :]
        sides = np.sort((ends - here) / np.where(along == 0, np.finfo(float).tiny, along), axis=-1)
        return np.maximum(sides[..., 0].max(axis=0), 0.0), sides[..., 1].min(axis=0)

    def _pixels(self, x: ArrayLike, y: ArrayLike) -> tuple[Values, Values]:
        """Where sample points are seen in the frame."""
        x_px, y_px = self.pose.to_pixels(x, y)
        return x_px + self.shift_px[0], y_px + self.shift_px[1]


def annulus_edges(contacts: pd.DataFrame, *, centre: tuple[float, float], width: float) -> Values:
    """Edges of annuli of one width that hold every contact, m; two edges at least.

    Parameters
    ----------
    contacts : DataFrame
        Contacts table with ``x_m, y_m``.
    centre : (float, float)
        Sample coordinates, m.
    width : float
        Width of an annulus, m.

    Raises
    ------
    InputError
        If the width is not positive, or a contact is more than `MOST_ANNULI` widths away.
    """
    if not (np.isfinite(width) and width > 0):
        raise InputError(f"the width of an annulus must be positive, got {width!r} m")
    x, y = (contacts[name].to_numpy(float) for name in ("x_m", "y_m"))
    farthest = float(np.fmax.reduce(np.hypot(x - centre[0], y - centre[1]), initial=0.0))  # not the NaN
    if not farthest < MOST_ANNULI * width:
        raise InputError(
            f"a contact lies {farthest:.3g} m from the apex, more than {MOST_ANNULI} annuli of {width:.3g} m "
            "away; check x_m and y_m in the contacts table, apex_m and the width of the annuli"
        )
    count = int(np.floor(farthest / width)) + 1
    return np.asarray(width * np.arange(count + 1), np.float64)


def annulus_moments(
    contacts: pd.DataFrame,
    *,
    centre: tuple[float, float],
    edges: ArrayLike,
    field: FieldOfView | None = None,
    sectors: int = 1,
) -> pd.DataFrame:
    """Sum the contacts of one frame over annuli.

    Parameters
    ----------
    contacts : DataFrame
        Contacts table with ``x_m, y_m, radius_m, force_N``.
    centre : (float, float)
        Centre of the apparent contact, sample coordinates, m.
    edges : array_like, shape (n + 1,)
        Increasing radii that bound the annuli, m.
    field : FieldOfView, optional
        Field of view; contacts and area outside do not count. Default: unlimited.
    sectors : int
        Equal sectors, counted from the x axis towards y, into which each annulus is divided. Their scatter
        tells what another place would give.

    Returns
    -------
    DataFrame
        One row an annulus and sector: ``inner, outer`` (m), ``sector`` and the columns of `MOMENTS`. A
        contact without a force counts in ``n`` and in the sums of radii only.

    Raises
    ------
    InputError
        If the edges do not increase.
    """
    edges = np.asarray(edges, dtype=np.float64)
    if edges.ndim != 1 or len(edges) < 2 or not (np.diff(edges) > 0).all():
        raise InputError("the edges of the annuli must increase, and there must be two or more")
    area = np.repeat(np.pi * np.diff(edges**2) / sectors, sectors)
    if field is not None:
        contacts = contacts[field.holds(contacts["x_m"], contacts["y_m"])]
        area = field.sector_areas(centre, edges, sectors).ravel()
    x, y, a, p = (contacts[name].to_numpy(float) for name in ("x_m", "y_m", "radius_m", "force_N"))
    dx, dy, has_force = x - centre[0], y - centre[1], np.isfinite(p)
    p = np.where(has_force, p, 0.0)
    place = np.hypot(dx, dy), np.arctan2(dy, dx) / (2 * np.pi) % 1.0
    cells = [edges, np.linspace(0.0, 1.0, sectors + 1)]
    values = np.ones(len(a)), has_force.astype(float), a, a**2, p, p**2, a * p
    sums = [np.histogram2d(*place, bins=cells, weights=value)[0].ravel() for value in values]
    ends = {"inner": np.repeat(edges[:-1], sectors), "outer": np.repeat(edges[1:], sectors)}
    table = pd.DataFrame(ends | {"sector": np.tile(np.arange(sectors), len(edges) - 1)})
    return table.assign(**dict(zip(MOMENTS, [area, *sums], strict=True)))


def sum_moments(tables: Iterable[pd.DataFrame]) -> pd.DataFrame:
    """Moments of several frames together.

    Parameters
    ----------
    tables : iterable of DataFrame
        From `annulus_moments`, with annuli of the same edges as far as they reach; one at least.
    """
    together = pd.concat(list(tables), ignore_index=True)
    return together.groupby(["inner", "outer"], as_index=False, sort=True)[list(MOMENTS)].sum()


def density_beside(sums: ArrayLike, area: ArrayLike) -> Values:
    """Density of the annuli beside each annulus, which does not depend on its own contacts.

    Parameters
    ----------
    sums : array_like, shape (..., n)
        Number of contacts, load, ... of each annulus, from the centre on.
    area : array_like, shape (..., n)
        Of the annuli in the image, m^2.

    Returns
    -------
    ndarray, shape (..., n)
        Geometric mean of the densities on either side, which is exact for an exponential profile; where one
        side is not seen, and at the centre, that of the other. Beyond the last annulus there is no contact.
        0 where a side has none, or nothing is seen.

    Examples
    --------
    >>> density_beside([8.0, 5.0, 2.0, 1.0], [1.0, 1.0, 1.0, 1.0]).tolist()
    [5.0, 4.0, 2.23606797749979, 0.0]
    """
    sums, area = np.broadcast_arrays(np.asarray(sums, np.float64), np.asarray(area, np.float64))
    density = np.maximum(np.divide(sums, area, out=np.zeros(sums.shape), where=area > 0), 0.0)
    ends = [(0, 0)] * (sums.ndim - 1) + [(1, 1)]
    density, seen = np.pad(density, ends), np.pad(area > 0, ends, constant_values=(False, True))
    inner, outer = density[..., :-2], density[..., 2:]
    both = np.sqrt(inner) * np.sqrt(outer)
    return np.where(seen[..., :-2] & seen[..., 2:], both, np.where(seen[..., 2:], outer, inner))


def gather_annuli(
    members: Iterable[EnsembleMember], *, centre: tuple[float, float], edges: ArrayLike, groups: int = 1
) -> dict[tuple[str, float], dict[str, pd.DataFrame]]:
    """Sum the contacts of many patterns over annuli, one pattern after the other.

    Parameters
    ----------
    members : iterable of EnsembleMember
        From `contactimg.solve_ensemble`; one at least. None is kept.
    centre : (float, float), m
        Centre of the apparent contact.
    edges : array_like, shape (n + 1,)
        Increasing radii that bound the annuli, m.
    groups : int
        Patterns are dealt in turn to this many groups: the scatter between them is the uncertainty of what
        all of them give. An ensemble of fewer patterns has a group each.

    Returns
    -------
    dict
        ``(coupling, load)`` -> name of the group -> sums over its patterns: the columns of `annulus_moments`
        (``area`` is that of the annulus times the patterns) and ``patterns``; ``occupied``, how many of them
        have a contact in the annulus; ``own_radius`` (m), the sum of each pattern's own mean contact radius
        there, zero where it has none. In the form that `contactimg.fit_contact_law` takes for places, and the
        tables of one load in that of `contactimg.average_profile`.

    Raises
    ------
    InputError
        If there are no members, or fewer than one group.

    Notes
    -----
    ``a/n`` is the mean radius of all contacts, ``own_radius/patterns`` the mean over patterns in which an
    annulus without contacts counts as one with contacts of radius zero. They part where many are empty.

    Examples
    --------
    >>> from contactimg import solve_ensemble
    >>> members = solve_ensemble(
    ...     "SA", patterns=4, loads=[0.02], side=4e-3, indenter_radius=0.1288, contact_modulus=4e6, seed=1
    ... )
    >>> sums = gather_annuli(members, centre=(2e-3, 2e-3), edges=[0.0, 1e-3, 3e-3], groups=2)
    >>> [round(float(group["p"].sum()), 6) for group in sums["asymptotic", 0.02].values()]  # 2 x 0.02 N
    [0.04, 0.04]
    """
    if groups < 1:
        raise InputError(f"groups must be at least 1, got {groups!r}")
    edges = np.asarray(edges, dtype=np.float64)
    sums: dict[tuple[str, float], dict[str, pd.DataFrame]] = {}
    for member in members:
        name = str(member.index % groups)
        for key, one in member.solutions.items():
            # the whole table of contacts would cost more than the solution
            bare = {"x_m": one.x, "y_m": one.y, "radius_m": one.radius, "force_N": one.force}
            contacts = pd.DataFrame(bare).iloc[one.touching]
            found = annulus_moments(contacts, centre=centre, edges=edges)
            pattern = found[list(MOMENTS)].assign(
                patterns=1.0,
                occupied=(found["n"] > 0).astype(float),
                own_radius=found["a"] / found["n"].clip(lower=1.0),
            )
            so_far = sums.setdefault(key, {})
            so_far[name] = so_far[name] + pattern if name in so_far else pattern
    if not sums:
        raise InputError("an ensemble needs one pattern and one load at least")
    ends = pd.DataFrame({"inner": edges[:-1], "outer": edges[1:], "sector": 0})
    return {key: {name: ends.join(table) for name, table in tables.items()} for key, tables in sums.items()}
