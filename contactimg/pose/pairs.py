"""One-to-one pairs of points and targets in a plane, and of the contacts of two tables."""

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import min_weight_full_bipartite_matching
from scipy.spatial import KDTree

from contactimg.errors import InputError
from contactimg.pose.pose import Pose
from contactimg.tables import CONTACTS, MATCHES

PAIRING_FRACTION = 0.15
"""Pairing distance over the median spacing of the targets. Chosen by hand; sensitivity not measured."""

MIN_PAIRING_PX = 2.0
"""Lower limit of the pairing distance, and of that beyond which a pair is an outlier: exact points have no
scatter. Chosen by hand; sensitivity not measured."""

OUTLIER_SIGMA = 4.0
"""Standard deviations beyond which a point is an outlier, which is dropped or has little weight. Chosen: of
normal values 1 in 16,000 is."""

MAD_TO_STD = 1.4826
"""Theory: standard deviation over median absolute deviation of a normal distribution."""

ROUNDS = 20
"""Most fits, each without the outliers of the one before; usually nothing changes after a few."""

FEWEST_CONTACTS = 10
"""Fewer contacts show neither where the camera looks, which the false-alarm rate would not accept, nor where
the apex is: the gap below the lens has four terms."""


def pair_points(
    points: ArrayLike, targets: ArrayLike, *, max_distance: float
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
    """One-to-one pairs of points and targets with the least sum of squared distances.

    A point without a partner costs ``max_distance**2``, so a pair further apart is never made.

    Parameters
    ----------
    points : array_like, shape (n, 2)
    targets : array_like, shape (m, 2)
    max_distance : float
        Same unit as the coordinates.

    Returns
    -------
    point_index, target_index : ndarray of int, shape (k,)
        Sorted by ``point_index``.
    distance : ndarray, shape (k,)

    Examples
    --------
    >>> pair_points([[0, 0], [5, 5]], [[0.1, 0], [0.2, 0]], max_distance=1.0)[1]
    array([0])
    """
    points, targets = (np.asarray(places, float).reshape(-1, 2) for places in (points, targets))
    n, m = len(points), len(targets)
    if n == 0 or m == 0:
        return np.empty(0, np.intp), np.empty(0, np.intp), np.empty(0)
    near = KDTree(points).sparse_distance_matrix(KDTree(targets), max_distance, output_type="coo_matrix")
    # a zero weight would read as "no edge": costs begin with 1 (distance 0), and the longest pair has 2; a
    # price that no rearrangement of all pairs is worth does as well as a higher one, and rounds less
    longest = float(near.data.max(initial=0.0)) or 1.0
    alone = 1 + min((max_distance / longest) ** 2, n + 1.0)
    cost = np.concatenate([1 + (near.data / longest) ** 2, np.full(n, alone)])
    row = np.concatenate([near.row, np.arange(n)])
    column = np.concatenate([near.col, m + np.arange(n)])
    costs = coo_array((cost, (row, column)), shape=(n, m + n)).tocsr()
    rows, columns = min_weight_full_bipartite_matching(costs)
    real = columns < m
    point, target = np.asarray(rows, np.intp)[real], np.asarray(columns, np.intp)[real]
    return point, target, np.linalg.norm(points[point] - targets[target], axis=1)


def pairing_distance(targets: ArrayLike, pose: Pose) -> float:
    """Largest distance (m) of a contact from its target: well below their spacing, at least two pixels.

    Parameters
    ----------
    targets : array_like, shape (m, 2)
        Sample coordinates of the places where contacts can be, m.
    pose : Pose
        Gives the pixel size.
    """
    points = np.asarray(targets, float).reshape(-1, 2)
    return max(PAIRING_FRACTION * median_spacing(points), MIN_PAIRING_PX * pose.pixel_size)


def median_spacing(points: NDArray[np.float64]) -> float:
    """Median distance to the nearest neighbour; 0 for fewer than two points."""
    if len(points) < 2:
        return 0.0
    return float(np.median(np.asarray(KDTree(points).query(points, k=2)[0])[:, 1]))


def match_contacts(
    measured: pd.DataFrame, predicted: pd.DataFrame, *, max_distance: float | None = None
) -> pd.DataFrame:
    """Match two contacts tables one to one, by position in the sample.

    Parameters
    ----------
    measured, predicted : DataFrame
        Contacts tables of one frame: ``x_m, y_m``, and of ``frame, label, asperity, radius_m, force_N`` those
        that are to be copied.
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
        If ``max_distance`` is not positive, or a contact has no place.
    """
    used = ["frame", "label", "asperity", "x_m", "y_m", "radius_m", "force_N"]
    measured, predicted = (
        CONTACTS.conform(table[table.columns.intersection(used)]) for table in (measured, predicted)
    )
    places = [table[["x_m", "y_m"]].to_numpy(float) for table in (measured, predicted)]
    if not all(np.isfinite(table).all() for table in places):
        raise InputError("match_contacts: each contact needs its place, finite numbers in x_m and y_m")
    if max_distance is None:
        half = median_spacing(places[1]) / 2
        max_distance = half or float(predicted["radius_m"].max() if len(predicted) else 1.0)
    if not max_distance > 0:
        raise InputError(f"match_contacts: max_distance must be a positive length, got {max_distance!r} m")
    i, j, distance = pair_points(*places, max_distance=max_distance)
    left, right = measured.iloc[i].reset_index(), predicted.iloc[j].reset_index()
    both = {"frame": left["frame"], "measured_label": left["label"], "asperity": right["asperity"]}
    for side, table in (("measured", left), ("predicted", right)):
        both |= {f"radius_{side}_m": table["radius_m"], f"force_{side}_N": table["force_N"]}
    return MATCHES.conform(both | {"distance_m": distance})
