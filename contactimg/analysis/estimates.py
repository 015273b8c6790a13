"""Numbers with their uncertainty: Student's intervals, and the scatter between places."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from contactimg.errors import InputError

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """A number with its standard uncertainty and confidence interval.

    Parameters
    ----------
    value : float
    std : float
        Standard deviation, however few the data are: of few, ``value +- 1.96 std`` covers less than 95 %
        (that of `contactimg.calibration.coverage_estimate.CoverageEstimate` is widened to cover it).
    low, high : float
        Infinite if no degree of freedom is left to estimate the scatter.
    """

    value: float
    std: float
    low: float
    high: float


def student_estimate(value: float, std: float, *, freedom: float, confidence: float = 0.95) -> Estimate:
    """A number with the symmetric confidence interval of Student's distribution.

    Parameters
    ----------
    value, std : float
    freedom : float
        Degrees of freedom behind ``std``; none make the interval infinite.
    confidence : float
        Probability that the interval holds the truth, between 0 and 1.

    Raises
    ------
    InputError
        If the confidence is not between 0 and 1.

    Examples
    --------
    >>> e = student_estimate(1.0, 0.1, freedom=4)
    >>> round(e.low, 3), round(e.high, 3)
    (0.722, 1.278)
    """
    if not 0 < confidence < 1:
        raise InputError(f"confidence must lie between 0 and 1 (exclusive), got {confidence!r}")
    if freedom < 1:
        return Estimate(value, std, -np.inf, np.inf)
    reach = float(stats.t.ppf((1 + confidence) / 2, freedom)) * std
    return Estimate(value, std, value - reach, value + reach)


def jackknife_covariance(without: ArrayLike) -> Values:
    """Covariance of parameters from their values with one place left out at a time.

    Parameters
    ----------
    without : array_like, shape (n, k)
        Row ``j``: the ``k`` parameters fitted to all places but ``j``; two rows or more.

    Returns
    -------
    ndarray, shape (k, k)
        ``(n - 1)/n sum_j (t_j - mean)(t_j - mean)^T``, with ``n - 1`` degrees of freedom. Valid for any
        correlation of the errors within a place.

    References
    ----------
    Efron, Stein, Ann. Statist. 9 (1981) 586, doi:10.1214/aos/1176345462, eq. (1.4).

    Examples
    --------
    Of means it is the squared standard error: 1, 2, 3 have the variance 1 and the mean's is 1/3.

    >>> float(jackknife_covariance([[2.5], [2.0], [1.5]])[0, 0])
    0.333333
    """
    table = np.asarray(without, dtype=np.float64)
    if table.ndim != 2 or len(table) < 2:
        raise InputError(f"leaving one out needs two places or more, got a table of shape {table.shape}")
    away = table - table.mean(axis=0)
    return (len(table) - 1) / len(table) * away.T @ away


def infinitesimal_covariance(influences: ArrayLike) -> Values:
    """Covariance of parameters from what each place changes of them when its weight changes a little.

    Parameters
    ----------
    influences : array_like, shape (n, k)
        Row ``j``: change of the ``k`` parameters per unit of weight taken from place ``j``; two rows or more.

    Returns
    -------
    ndarray, shape (k, k)
        ``n/(n - 1) sum_j (u_j - mean)(u_j - mean)^T``, with ``n - 1`` degrees of freedom: that of leaving out
        one at a time to first order, so that few contacts do not decide what is left out with them.

    References
    ----------
    Efron, Biometrika 68 (1981) 589, doi:10.1093/biomet/68.3.589, section 3: the infinitesimal jackknife.

    Examples
    --------
    The mean of 1, 2, 3 changes by (2 - 1)/3 when weight is taken from the first; its variance is 1/3.

    >>> float(infinitesimal_covariance([[1 / 3], [0.0], [-1 / 3]])[0, 0])
    0.333333
    """
    table = np.asarray(influences, dtype=np.float64)
    if table.ndim != 2 or len(table) < 2:
        raise InputError(f"the scatter of influences needs two places or more, got shape {table.shape}")
    away = table - table.mean(axis=0)
    return len(table) / (len(table) - 1) * away.T @ away


def of_another_surface(estimate: Estimate, *, measured_std: float = 0.0) -> Estimate:
    """What another surface of the same kind gives, at as many places.

    Parameters
    ----------
    estimate : Estimate
        Of this surface, with the uncertainty that its places were drawn by chance.
    measured_std : float
        The part of its standard uncertainty that comes from the errors of the measurement.

    Returns
    -------
    Estimate
        The same value; the variance of the places counts twice, once for the places of either surface, that
        of the measurement once. The interval is widened in proportion.

    Examples
    --------
    The places of either surface add 0.04: 0.05^2 + 0.04^2 = 0.064^2.

    >>> round(of_another_surface(Estimate(1.0, 0.05, 0.9, 1.1), measured_std=0.03).std, 3)
    0.064
    """
    if not estimate.std > 0:
        return estimate
    share = min(measured_std / estimate.std, 1.0)
    factor = float(np.sqrt(2 - share**2))
    low, high = (
        estimate.value + factor * (limit - estimate.value) for limit in (estimate.low, estimate.high)
    )
    return Estimate(estimate.value, factor * estimate.std, low, high)
