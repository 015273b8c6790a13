"""Spatial order of contacts or asperities: pairs at each distance against patterns made at random.

A pair correlation is the number of pairs over the number that a random pattern has in the same window. What
"random" keeps decides the question: points uniform in the window, points at their distance from the apex in a
random direction, or contacts chosen at random among the asperities of a ring. Random patterns in the same
window need no correction of its edge.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from contactimg.errors import InputError

Values = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PairCorrelation:
    """Pairs of points at each distance, relative to random patterns.

    Parameters
    ----------
    table : DataFrame
        One row a range of distances: ``inner_m, outer_m``; ``pairs``; ``random_pairs``, the mean of
        random patterns; ``correlation``, their ratio ``g``; ``low, high``, the band that the ``g`` of a
        random pattern leaves at any distance with the probability ``1 - confidence``. NaN where no random
        pattern has a pair.
    p_value : float
        Probability that a random pattern deviates as much at its worst distance.
    confidence : float
    """

    table: pd.DataFrame
    p_value: float
    confidence: float


def count_pairs(points: ArrayLike, *, edges: ArrayLike) -> Values:
    """Number of pairs of points in each range of distances, every pair once.

    Parameters
    ----------
    points : array_like, shape (n, 2), m
    edges : array_like, shape (k + 1,), m
        Increasing distances; a pair counts where ``inner < r <= outer``, coincident points where inner is 0.

    Returns
    -------
    ndarray, shape (k,)
        Counts of several patterns add up.

    Raises
    ------
    InputError
        If the points are no list of two finite coordinates each, or the edges do not increase from 0 or more.

    Examples
    --------
    The corners of a square: four sides and two diagonals.

    >>> count_pairs([[0, 0], [0, 1], [1, 0], [1, 1]], edges=[0, 1.2, 2]).tolist()
    [4.0, 2.0]
    """
    places, edges = _checked_points(points), _checked_edges(edges)
    if len(places) < 2:
        return np.zeros(len(edges) - 1)
    tree = KDTree(places)
    # both orders of a pair are counted, and each point with itself, which the difference takes off
    within = np.asarray(tree.count_neighbors(tree, edges), np.float64)
    if edges[0] == 0:
        within[0] = len(places)
    return np.diff(within) / 2


def nearest_distances(points: ArrayLike) -> Values:
    """Distance of every point to its nearest neighbour.

    Parameters
    ----------
    points : array_like, shape (n, 2), m
        Two or more.

    Returns
    -------
    ndarray, shape (n,), m

    Raises
    ------
    InputError
        If there are fewer than two points, or a coordinate is not finite.

    Notes
    -----
    Points scattered at random with the density ``eta`` have the mean ``1/(2 sqrt(eta))``, away from the edge
    of the window.

    References
    ----------
    Clark, Evans, Ecology 35 (1954) 445, doi:10.2307/1931034, eq. (1).

    Examples
    --------
    >>> nearest_distances([[0, 0], [0, 1], [3, 0]]).tolist()
    [1.0, 1.0, 3.0]
    """
    places = _checked_points(points)
    if len(places) < 2:
        raise InputError(f"nearest neighbours need two points at least, got {len(places)}")
    distance = np.asarray(KDTree(places).query(places, k=2)[0], np.float64)
    return distance[:, 1]


def turn_points(points: ArrayLike, *, centre: tuple[float, float], rng: np.random.Generator) -> Values:
    """Points at the same distances from a centre in random directions: random but for the radial profile.

    Parameters
    ----------
    points : array_like, shape (n, 2), m
    centre : (float, float), m
    rng : numpy.random.Generator

    Returns
    -------
    ndarray, shape (n, 2), m

    Examples
    --------
    >>> turned = turn_points([[3, 4]], centre=(0, 0), rng=np.random.default_rng(1))
    >>> float(np.hypot(*turned[0]))
    5.0
    """
    away = _checked_points(points) - np.asarray(centre, np.float64)
    distance = np.hypot(away[:, 0], away[:, 1])
    angle = rng.uniform(0, 2 * np.pi, len(away))
    return np.asarray(centre, np.float64) + distance[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)


def choose_in_rings(
    chosen: ArrayLike,
    points: ArrayLike,
    *,
    centre: tuple[float, float],
    width: float,
    rng: np.random.Generator,
) -> NDArray[np.bool_]:
    """Draw as many points of every ring around a centre as were chosen there: contacts at random.

    Parameters
    ----------
    chosen : array_like of bool, shape (n,)
        Which asperities touch.
    points : array_like, shape (n, 2), m
        All asperities.
    centre : (float, float), m
    width : float, m
        Of a ring; chosen so that the density of contacts hardly varies across one.
    rng : numpy.random.Generator

    Returns
    -------
    ndarray of bool, shape (n,)

    Raises
    ------
    InputError
        If the width is not positive or the lengths differ.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> places = [[1, 0], [0, 1], [9, 0]]
    >>> touching = choose_in_rings([True, False, False], places, centre=(0, 0), width=2.0, rng=rng)
    >>> int(touching[:2].sum()), bool(touching[2])
    (1, False)
    """
    places, mask = _checked_points(points), np.asarray(chosen, np.bool_)
    if mask.shape != (len(places),):
        raise InputError(f"chosen must have one value for each of the {len(places)} points, got {mask.shape}")
    if not (np.isfinite(width) and width > 0):
        raise InputError(f"the width of a ring must be positive, got {width!r} m")
    ring = np.floor(np.hypot(*(places - np.asarray(centre, np.float64)).T) / width)
    result = np.empty_like(mask)
    result[np.lexsort((rng.random(len(ring)), ring))] = mask[np.argsort(ring, kind="stable")]
    return result


def pair_correlation(
    pairs: ArrayLike, random_pairs: ArrayLike, *, edges: ArrayLike, confidence: float = 0.95
) -> PairCorrelation:
    """Compare the pairs of a pattern, or of many together, with those of random patterns.

    Parameters
    ----------
    pairs : array_like, shape (k,)
        From `count_pairs`, summed over patterns if there are several.
    random_pairs : array_like, shape (m, k)
        The same for ``m`` random patterns, or sets of as many; 19 or more.
    edges : array_like, shape (k + 1,), m
        Those of `count_pairs`.
    confidence : float
        Of the band.

    Returns
    -------
    PairCorrelation

    Raises
    ------
    InputError
        If shapes do not fit, or there are too few random patterns for the band.

    Notes
    -----
    The deviation of each distance is divided by its standard deviation among the random patterns; the largest
    one decides, so that many distances do not make many false alarms. Distances in which fewer than one
    random pair is expected do not take part: there the counts are nowhere near normal.

    References
    ----------
    Myllymaki et al., J. R. Stat. Soc. B 79 (2017) 381, doi:10.1111/rssb.12172 (studentised envelope test).

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> edges = np.linspace(0.0, 0.2, 5)
    >>> made = [count_pairs(rng.random((100, 2)), edges=edges) for _ in range(100)]
    >>> lattice = np.stack(np.meshgrid(np.arange(10), np.arange(10)), axis=-1).reshape(-1, 2) / 10
    >>> found = pair_correlation(count_pairs(lattice, edges=edges), made[1:], edges=edges)
    >>> bool(found.p_value <= 0.01), float(found.table["correlation"][0])
    (True, 0.0)
    """
    edges, own, made = (
        _checked_edges(edges),
        np.asarray(pairs, np.float64),
        np.asarray(random_pairs, np.float64),
    )
    if own.shape != (len(edges) - 1,) or made.ndim != 2 or made.shape[1:] != own.shape:
        raise InputError(
            f"pairs and random_pairs need {len(edges) - 1} columns, one a distance, "
            f"got {own.shape} and {made.shape}"
        )
    if not 0 < confidence < 1 or (len(made) + 1) * (1 - confidence) < 1:
        raise InputError(
            f"a band of {confidence:g} needs {int(np.ceil(1 / (1 - min(confidence, 0.999)))) - 1} random "
            f"patterns or more, got {len(made)}"
        )
    mean, std = made.mean(axis=0), made.std(axis=0, ddof=1)
    counts = (mean >= 1) & (std > 0)
    scale = np.where(counts, std, np.inf)
    worst = np.max(np.abs(made - mean) / scale, axis=1)
    reach = float(np.quantile(worst, confidence, method="higher"))
    exceeded = np.sum(worst >= np.max(np.abs(own - mean) / scale))
    over = np.where(mean > 0, mean, np.nan)
    half = np.where(counts, reach * std, np.nan) / over
    table = {"inner_m": edges[:-1], "outer_m": edges[1:], "pairs": own, "random_pairs": mean}
    table |= {"correlation": own / over, "low": np.maximum(1 - half, 0.0), "high": 1 + half}
    return PairCorrelation(pd.DataFrame(table), float((1 + exceeded) / (len(made) + 1)), confidence)


def _checked_points(points: ArrayLike) -> Values:
    """Points as an array of two finite columns."""
    places = np.asarray(points, np.float64)
    if places.size == 0:
        return np.empty((0, 2))
    if places.ndim != 2 or places.shape[1] != 2 or not np.isfinite(places).all():
        raise InputError(f"points need two finite coordinates each, got an array of shape {places.shape}")
    return places


def _checked_edges(edges: ArrayLike) -> Values:
    """Edges of distances that increase from zero or more."""
    limits = np.asarray(edges, np.float64)
    if limits.ndim != 1 or len(limits) < 2 or not (np.diff(limits) > 0).all() or limits[0] < 0:
        raise InputError(
            "the edges of the distances must increase from 0 or more, and there must be two or more"
        )
    return limits
