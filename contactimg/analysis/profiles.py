"""Profiles: contacts averaged over annuli about the centre of the apparent contact."""

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from contactimg.errors import InputError
from contactimg.tables import PROFILE

__all__ = ["annulus_edges", "radial_profile"]


def annulus_edges(contacts: pd.DataFrame, *, centre: tuple[float, float], width: float) -> np.ndarray:
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
    if not width > 0:
        raise InputError(f"the width of an annulus must be positive, got {width!r} m")
    distance = np.hypot(contacts["x_m"] - centre[0], contacts["y_m"] - centre[1])
    count = int(np.floor(distance.max() / width)) + 1 if len(contacts) else 1
    return width * np.arange(count + 1)


def radial_profile(
    contacts: pd.DataFrame, *, centre: tuple[float, float], edges: ArrayLike, frame: str, model: str
) -> pd.DataFrame:
    """Average contacts over annuli.

    Parameters
    ----------
    contacts : DataFrame
        Contacts table of one frame with ``x_m, y_m, radius_m, area_m2, force_N``.
    centre : (float, float)
        Centre of the apparent contact, sample coordinates, m.
    edges : array_like, shape (n + 1,)
        Increasing radii that bound the annuli, m.
    frame, model : str
        Entered in the columns of that name.

    Returns
    -------
    DataFrame
        Profile table, one row an annulus, ``r_m`` its middle. An annulus without contacts has zero pressure,
        density and area fraction, and an empty mean radius. ``pressure_std_Pa`` is the scatter expected of
        independent contacts, ``sqrt(sum p_i^2)/area``.

    Raises
    ------
    InputError
        If the edges do not increase.
    """
    edges = np.asarray(edges, float)
    if edges.ndim != 1 or len(edges) < 2 or not (np.diff(edges) > 0).all():
        raise InputError("the edges of the annuli must increase, and there must be two or more")
    distance = np.hypot(contacts["x_m"] - centre[0], contacts["y_m"] - centre[1]).to_numpy(float)
    force = contacts["force_N"].to_numpy(float)

    def total(weights: np.ndarray) -> np.ndarray:
        return np.histogram(distance, bins=edges, weights=weights)[0]

    count, area = total(np.ones(len(contacts))), np.pi * np.diff(edges**2)
    with np.errstate(invalid="ignore"):
        mean_radius = total(contacts["radius_m"].to_numpy(float)) / count
    return PROFILE.conform(
        {
            "frame": [frame] * len(count),
            "model": [model] * len(count),
            "r_m": (edges[1:] + edges[:-1]) / 2,
            "pressure_Pa": total(force) / area,
            "density_per_m2": count / area,
            "mean_radius_m": mean_radius,
            "area_fraction": total(contacts["area_m2"].to_numpy(float)) / area,
            "pressure_std_Pa": np.sqrt(total(force**2)) / area,
        }
    )
