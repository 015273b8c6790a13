"""Match two tables of contacts one to one, by position in the sample."""

import numpy as np
import pandas as pd
from scipy.spatial import KDTree

from contactimg.errors import InputError
from contactimg.pose.pairs import pair_points
from contactimg.tables import MATCHES
from contactimg.timings import stage


@stage("matching")
def match_contacts(
    measured: pd.DataFrame, predicted: pd.DataFrame, *, max_distance: float | None = None
) -> pd.DataFrame:
    """Match two contacts tables one to one, by position in the sample.

    Parameters
    ----------
    measured, predicted : DataFrame
        Contacts tables (columns ``x_m, y_m, radius_m, force_N, label, asperity``) of one frame.
    max_distance : float, optional
        Largest distance of a pair, m. Default: half the median distance of a predicted contact to its nearest
        neighbour, beyond which a pair would be ambiguous; with a single predicted contact, its radius.

    Returns
    -------
    DataFrame
        The matches table (`contactimg.tables.MATCHES`), one row a pair.

    Raises
    ------
    InputError
        If ``max_distance`` is not positive.
    """
    if max_distance is None:
        max_distance = _half_spacing(predicted)
    if not max_distance > 0:
        raise InputError(f"match_contacts: max_distance must be a positive length, got {max_distance!r} m")
    i, j, distance = pair_points(
        measured[["x_m", "y_m"]].to_numpy(float),
        predicted[["x_m", "y_m"]].to_numpy(float),
        max_distance=max_distance,
    )
    left, right = measured.iloc[i], predicted.iloc[j]
    return MATCHES.conform(
        {
            "frame": left["frame"].to_numpy(),
            "measured_label": left["label"].to_numpy(),
            "asperity": right["asperity"].to_numpy(),
            "distance_m": distance,
            "radius_measured_m": left["radius_m"].to_numpy(),
            "radius_predicted_m": right["radius_m"].to_numpy(),
            "force_measured_N": left["force_N"].to_numpy(),
            "force_predicted_N": right["force_N"].to_numpy(),
        }
    )


def _half_spacing(contacts: pd.DataFrame) -> float:
    """Half the median distance to the nearest neighbour."""
    if len(contacts) < 2:
        return float(contacts["radius_m"].max()) if len(contacts) else 1.0
    points = contacts[["x_m", "y_m"]].to_numpy(float)
    distance = np.asarray(KDTree(points).query(points, k=2)[0])
    return float(np.median(distance[:, 1]) / 2) or float(contacts["radius_m"].max())
