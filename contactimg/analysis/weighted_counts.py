"""Intervals of a sum over few contacts, each of which counts with its force."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

Values = NDArray[np.float64]

LEAST_EFFECTIVE_COUNT = 0.5
"""Below this the interval is symmetric. Theory: positive weights leave (sum w)^2/sum w^2 >= 1, so that less
comes from weights of both signs, for which no gamma distribution stands. Chosen: half of the bound leaves
room for the estimate of the variance from few places."""


def weighted_count_interval(
    total: ArrayLike, variance: ArrayLike, one_more: ArrayLike, *, confidence: float = 0.95
) -> tuple[Values, Values]:
    """Interval of the mean of a sum ``sum w_i`` over a Poisson number of contacts.

    Parameters
    ----------
    total : array_like, shape (n,)
        The sums found.
    variance : array_like, shape (n,)
        Their variances: ``sum w_i^2`` of independent contacts, or from a scatter.
    one_more : array_like, shape (n,)
        Weight of the contact that may have been missed by chance; the largest weight is on the safe side.
    confidence : float
        Probability that the interval holds the mean.

    Returns
    -------
    low, high : ndarray, shape (n,)
        Of a sum without contacts from 0 to the upper limit ``-ln((1 - confidence)/2) one_more``; NaN for
        the limit if ``one_more`` is not positive. Symmetric where weights of both signs all but cancel.

    References
    ----------
    Fay, Feuer, Statist. Med. 16 (1997) 791, the gamma interval; for equal weights that of Garwood,
    Biometrika 28 (1936) 437, which is exact.

    Examples
    --------
    Three contacts, then none, of weight 1:

    >>> low, high = weighted_count_interval([3.0, 0.0], [3.0, 0.0], [1.0, 1.0])
    >>> low.round(3).tolist(), high.round(3).tolist()
    ([0.619, 0.0], [8.767, 3.689])
    """
    y, v, w = np.broadcast_arrays(*(np.asarray(part, np.float64) for part in (total, variance, one_more)))
    tail = (1 - confidence) / 2
    few = (y**2 < LEAST_EFFECTIVE_COUNT * v) | (y < 0)
    reach = float(stats.norm.ppf(1 - tail)) * np.sqrt(v)
    positive = np.where(y > 0, y, np.nan)
    scale = np.where(v > 0, v, np.nan) / positive
    low = np.nan_to_num(scale * stats.gamma.ppf(tail, positive / scale), nan=0.0)
    more, more_variance = y + w, v + w**2
    upper = np.where(more_variance > 0, more_variance, np.nan) / np.where(more > 0, more, np.nan)
    high = upper * stats.gamma.ppf(1 - tail, more / upper)
    return np.where(few, y - reach, low), np.where(few, y + reach, high)
