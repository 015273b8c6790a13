"""Numbers with their uncertainty: Student's intervals, and the bootstrap over places or sectors.

The ``std`` of an `Estimate` is a standard deviation. That of a calibrated number, `CoverageEstimate`, is that
of a normal distribution with the same 95 % interval, because later steps use only ``std``, not its degrees of
freedom.
"""

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from contactimg.errors import InputError

Values = NDArray[np.float64]

REPLICATES = 1000
"""Replicates of a bootstrap. Theory: they know a standard deviation to 1/sqrt(2 n) = 2.2 %."""

SMOOTHNESS = 4
"""Inverse variance of a block's weight in a replicate. Chosen: with 1 (exponential weights) two of eight
sectors often decide, and logarithms of few contacts make the uncertainty of one place a quarter too large."""

COVERAGE = 0.95
NORMAL_95 = float(special.ndtri(0.5 + COVERAGE / 2))
"""Half-width of a normal distribution's 95 % interval in standard deviations, 1.96."""


@dataclass(frozen=True)
class Estimate:
    """A number with its standard uncertainty and confidence interval.

    Parameters
    ----------
    value : float
    std : float
        Standard deviation, however few the data are: of few, ``value +- 1.96 std`` covers less than 95 %
        (that of `CoverageEstimate` is widened to cover it).
    low, high : float
        Infinite if no degree of freedom is left to estimate the scatter.
    """

    value: float
    std: float
    low: float
    high: float

    def widened(self, std: float, *, confidence: float = 0.95) -> Self:
        """Return the estimate with one more standard uncertainty, added in quadrature.

        Examples
        --------
        >>> Estimate(1.0, 0.03, 0.94, 1.06).widened(0.04).std
        0.05
        """
        reach = float(special.ndtri((1 + confidence) / 2)) * std
        low = self.value - float(np.hypot(self.value - self.low, reach))
        high = self.value + float(np.hypot(self.high - self.value, reach))
        return replace(self, std=float(np.hypot(self.std, std)), low=low, high=high)


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
    reach = float(special.stdtrit(freedom, (1 + confidence) / 2)) * std
    return Estimate(value, std, value - reach, value + reach)


def bootstrap_weights(blocks: int) -> Values:
    """Weights of blocks (places, or sectors of places) in replicates of a bootstrap.

    Parameters
    ----------
    blocks : int

    Returns
    -------
    ndarray, shape (`REPLICATES`, blocks)
        Of a gamma distribution with mean 1 and variance 1/4: none is zero, so that no annulus that some block
        shows is empty in a replicate. The same numbers at every call.

    References
    ----------
    Rubin, Ann. Statist. 9 (1981) 130, doi:10.1214/aos/1176345338: the Bayesian bootstrap.
    """
    weights = np.random.default_rng(0).gamma(SMOOTHNESS, size=(REPLICATES, blocks))
    return np.asarray(weights / weights.mean(axis=1, keepdims=True))


def bootstrap_estimates(
    values: Values, replicates: Values, *, blocks: int, known_std: ArrayLike = 0.0, confidence: float = 0.95
) -> list[Estimate]:
    """Numbers whose uncertainty is their spread over the replicates of a bootstrap.

    Parameters
    ----------
    values : ndarray, shape (k,)
        From all blocks with equal weights.
    replicates : ndarray, shape (n, k)
        With the weights of `bootstrap_weights`.
    blocks : int
    known_std : array_like, shape (k,) or scalar
        Standard uncertainties that the blocks do not show, in quadrature.
    confidence : float

    Notes
    -----
    Half the range of the central 68 % of the replicates. Of a mean of ``n`` values such weights of variance
    ``1/k`` give it the variance ``sum (x - <x>)^2/(n (k n + 1))``, which ``(k n + 1)/(n - 1)`` makes that of
    the mean; the interval is Student's with ``n - 1`` degrees of freedom.

    Examples
    --------
    The mean of 1, 2, 3 has the variance 1/3:

    >>> means = bootstrap_weights(3) @ [1.0, 2.0, 3.0] / 3
    >>> (mean,) = bootstrap_estimates(np.array([2.0]), means[:, None], blocks=3)
    >>> abs(mean.std - 3**-0.5) < 0.05
    True
    """
    stds = np.hypot(bootstrap_std(replicates.T, blocks=blocks), known_std)
    return [
        student_estimate(float(value), float(std), freedom=blocks - 1, confidence=confidence)
        for value, std in zip(values, stds, strict=True)
    ]


def bootstrap_std(replicates: ArrayLike, *, blocks: int) -> Values:
    """The standard deviation that `bootstrap_estimates` states, of replicates of shape (..., n)."""
    # a normal distribution has one standard deviation on either side between these probabilities
    low, high = np.quantile(np.asarray(replicates, float), (0.158655, 0.841345), axis=-1)
    return np.asarray((high - low) / 2 * np.sqrt((SMOOTHNESS * blocks + 1) / (blocks - 1)))


@dataclass(frozen=True)
class CoverageEstimate(Estimate):
    """A number and its 95 % interval, which ``std`` stands for.

    Parameters
    ----------
    value : float
    std : float
        Standard uncertainty, stated such that ``value +- 1.96 std`` covers 95 %: half the width of the
        interval over 1.96, which with few data exceeds the standard deviation that
        `Estimate` states.
    low, high : float
        Ends of the 95 % interval.
    """

    @classmethod
    def of_normal(cls, value: float, std: float) -> "CoverageEstimate":
        """A number with a normal distribution of known standard deviation.

        Examples
        --------
        >>> CoverageEstimate.of_normal(3e6, 1e4).high
        3019600.0
        """
        half = 1.96 * std  # rounded, as stated uncertainties use it
        return cls(value, std, value - half, value + half)

    @classmethod
    def of_interval(cls, value: float, low: float, high: float) -> "CoverageEstimate":
        """A number with this 95 % interval.

        Examples
        --------
        >>> found = student_estimate(1.0, 0.01, freedom=4)
        >>> CoverageEstimate.of_interval(1.0, found.low, found.high).std > found.std
        True
        """
        return cls(value, (high - low) / 2 / NORMAL_95, low, high)

    def record(self, unit: str) -> dict[str, Any]:
        """The number as ``calibration.json`` states it.

        Examples
        --------
        >>> CoverageEstimate(3e6, 1e4, 2.98e6, 3.02e6).record("Pa")["std"]
        10000.0
        """
        return {"value": self.value, "std": self.std, "unit": unit, "low_95": self.low, "high_95": self.high}
