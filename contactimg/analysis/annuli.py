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
from contactimg.optics.coverage import disk_rectangle_area
from contactimg.pose import Pose

Values = NDArray[np.float64]

MOMENTS = ("area", "n", "n_forces", "a", "aa", "p", "pp", "ap")
"""Per annulus: area in the image (m^2), number of contacts, of contacts with a force, and their sums of
contact radius ``a``, ``a^2``, force ``p``, ``p^2`` and ``a p``, in SI units."""


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
        If the width is not positive.
    """
    if not (np.isfinite(width) and width > 0):
        raise InputError(f"the width of an annulus must be positive, got {width!r} m")
    distance = np.hypot(contacts["x_m"] - centre[0], contacts["y_m"] - centre[1])
    count = int(np.floor(distance.max() / width)) + 1 if len(contacts) else 1
    return np.asarray(width * np.arange(count + 1), np.float64)


def annulus_moments(
    contacts: pd.DataFrame, *, centre: tuple[float, float], edges: ArrayLike, field: FieldOfView | None = None
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

    Returns
    -------
    DataFrame
        One row an annulus: ``inner, outer`` (m) and the columns of `MOMENTS`. A contact without a force
        counts in ``n`` and in the sums of radii only.

    Raises
    ------
    InputError
        If the edges do not increase.
    """
    edges = np.asarray(edges, dtype=np.float64)
    if edges.ndim != 1 or len(edges) < 2 or not (np.diff(edges) > 0).all():
        raise InputError("the edges of the annuli must increase, and there must be two or more")
    x, y = contacts["x_m"].to_numpy(float), contacts["y_m"].to_numpy(float)
    in_image = np.ones(len(x), bool) if field is None else field.holds(x, y)
    distance = np.hypot(x - centre[0], y - centre[1])[in_image]
    a, p = (contacts[name].to_numpy(float)[in_image] for name in ("radius_m", "force_N"))
    has_force = np.isfinite(p)
    p = np.where(has_force, p, 0.0)
    one = np.ones(len(a))
    parts = {
        "n": one,
        "n_forces": has_force.astype(float),
        "a": a,
        "aa": a**2,
        "p": p,
        "pp": p**2,
        "ap": a * p,
    }
    sums = {name: np.histogram(distance, bins=edges, weights=part)[0] for name, part in parts.items()}
    area = (
        np.pi * np.diff(edges**2) if field is None else np.diff([field.disc_area(centre, r) for r in edges])
    )
    return pd.DataFrame({"inner": edges[:-1], "outer": edges[1:], "area": area} | sums)


def sum_moments(tables: Iterable[pd.DataFrame]) -> pd.DataFrame:
    """Moments of several frames together.

    Parameters
    ----------
    tables : iterable of DataFrame
        From `annulus_moments`, with annuli of the same edges as far as they reach; one at least.
    """
    together = pd.concat(list(tables), ignore_index=True)
    return together.groupby(["inner", "outer"], as_index=False, sort=True)[list(MOMENTS)].sum()
