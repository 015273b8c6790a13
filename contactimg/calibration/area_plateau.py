"""The plateau of the area-threshold curve, for surfaces whose radii are not known one by one.

The total area ``A`` falls as the threshold ``t`` rises, fast near the background and near the contacts' full
brightness, slowly between. The plateau is the range about the slowest fall in which

    |d ln A / d t|  <=  steepness x its smallest value,

1.5 times by default: for edges blurred by a Gaussian, where ``d ln A/d t`` goes as one over the density of
the normal distribution, that is about the range of thresholds from 0.18 to 0.82 of the contrast.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactimg.errors import InputError

Values = NDArray[np.float64]

STEEPNESS = 1.5
"""How many times faster than at its slowest the area may fall within the plateau. Chosen by hand."""

MAX_RELATIVE_FALL = 0.2
"""Largest relative change of the area over a plateau. Chosen by hand; sensitivity not measured."""

LEAST_FALL_RATE = 1e-9
"""Rate below which the area does not fall. Theory: rounding errors make some 1e-14."""


@dataclass(frozen=True, eq=False)
class Plateau:
    """Two extreme thresholds and the area between them.

    Parameters
    ----------
    threshold_low, threshold_high : float
    threshold : float
        Where the area falls slowest.
    area, area_std : ndarray, shape (n,), m^2
        Of each frame: middle and half of the areas at the two extremes.
    relative_fall : float
        Of the summed area from the one extreme to the other.
    marginal : bool
        Whether it changes by less than 20 %.
    thresholds, fall_rates : ndarray, shape (m,)
        The curve: ``-d ln A/d t`` of the summed area.
    """

    threshold_low: float
    threshold_high: float
    threshold: float
    area: Values
    area_std: Values
    relative_fall: float
    marginal: bool
    thresholds: Values
    fall_rates: Values


def find_plateau(thresholds: ArrayLike, areas: ArrayLike) -> Plateau:
    """Find the thresholds between which the total contact area changes only marginally.

    Parameters
    ----------
    thresholds : array_like, shape (m,)
        Fractions of the contact contrast, five or more.
    areas : array_like, shape (m,) or (m, n), m^2
        Total area of each of n frames at each threshold.

    Returns
    -------
    Plateau

    Raises
    ------
    InputError
        If there are fewer than five different thresholds, or an area is negative or not finite, or none.

    Notes
    -----
    The derivative is that of a parabola through five neighbouring thresholds: it is free of the steps that
    counting pixels leaves.

    Examples
    --------
    >>> from scipy.special import ndtri
    >>> t = np.linspace(0.02, 0.98, 97)
    >>> plateau = find_plateau(t, np.pi * (20e-6 - 1.4e-6 * ndtri(t)) ** 2)
    >>> round(plateau.threshold_low, 2), round(plateau.threshold_high, 2)
    (0.17, 0.79)
    """
    t, A = np.asarray(thresholds, float), np.asarray(areas, float)
    if A.ndim == 1:
        A = A[:, None]
    if t.ndim != 1 or t.size < 5 or A.shape[0] != t.size:
        raise InputError(
            f"a plateau needs five thresholds or more and one area each, got {t.size}, {A.shape}"
        )
    if np.unique(t).size < t.size or not (np.isfinite(t).all() and np.isfinite(A).all() and (A >= 0).all()):
        raise InputError("the thresholds of a plateau must differ, and its areas be finite and not negative")
    order = np.argsort(t)
    t, A = t[order], A[order]
    total = A.sum(axis=1)
    positive = total > 0
    if np.count_nonzero(positive) < 5:
        raise InputError("a plateau needs contact area at five thresholds or more")
    t, A, total = t[positive], A[positive], total[positive]
    # the derivative of a parabola through five neighbours
    starts, logs = np.clip(np.arange(len(t)) - 2, 0, len(t) - 5), np.log(total)
    rate = np.empty(len(t))
    for k, i in enumerate(starts):
        near = np.polynomial.Polynomial.fit(t[i : i + 5] - t[k], logs[i : i + 5], 2)
        rate[k] = -near.deriv()(0.0)
    slowest = int(rate.argmin())
    steep = np.flatnonzero(rate > STEEPNESS * max(rate[slowest], LEAST_FALL_RATE))
    low = int(steep[steep < slowest].max(initial=-1)) + 1
    high = int(steep[steep > slowest].min(initial=len(t))) - 1
    middle, half = (A[low] + A[high]) / 2, np.abs(A[low] - A[high]) / 2
    fall = float(1 - total[high] / total[low])
    first, last, best = t[[low, high, slowest]].tolist()
    return Plateau(first, last, best, middle, half, fall, abs(fall) < MAX_RELATIVE_FALL, t, rate)
