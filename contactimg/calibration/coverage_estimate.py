"""A calibrated number with its 95 % interval and the standard uncertainty that represents it.

The ``std`` of `contactimg.analysis.estimates.Estimate` is a standard deviation. Here ``std`` is that of a
normal distribution with the same 95 % interval, because later steps use only ``std``, not its degrees of
freedom.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from contactimg.analysis.estimates import Estimate

COVERAGE = 0.95
NORMAL_95 = float(special.ndtri(0.5 + COVERAGE / 2))
"""Half-width of a normal distribution's 95 % interval in standard deviations, 1.96."""

ROUNDED_NORMAL_95 = 1.96
"""The same to three digits, as stated uncertainties use it."""


@dataclass(frozen=True)
class CoverageEstimate(Estimate):
    """A number and its 95 % interval, which ``std`` stands for.

    Parameters
    ----------
    value : float
    std : float
        Standard uncertainty, stated such that ``value +- 1.96 std`` covers 95 %: half the width of the
        interval over 1.96, which with few data exceeds the standard deviation that
        `contactimg.analysis.estimates.Estimate` states.
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
        half = ROUNDED_NORMAL_95 * std
        return cls(value, std, value - half, value + half)

    def record(self, unit: str) -> dict[str, Any]:
        """The number as ``calibration.json`` states it.

        Examples
        --------
        >>> CoverageEstimate(3e6, 1e4, 2.98e6, 3.02e6).record("Pa")["std"]
        10000.0
        """
        return {
            "value": self.value,
            "std": self.std,
            "unit": unit,
            "low_95": self.low,
            "high_95": self.high,
        }


def estimate_from_draws(draws: NDArray[np.float64]) -> CoverageEstimate:
    """Median and central 95 % interval of draws from a distribution."""
    low, value, high = np.quantile(draws, [0.5 - COVERAGE / 2, 0.5, 0.5 + COVERAGE / 2])
    return CoverageEstimate(float(value), float((high - low) / 2 / NORMAL_95), float(low), float(high))


def coverage_estimate(
    value: float, std: float, *, freedom: float, known_std: float = 0.0
) -> CoverageEstimate:
    """An estimate whose standard deviation was itself estimated, plus an independent known part.

    Parameters
    ----------
    value : float
    std : float
        Standard deviation; the estimate's ``std`` is larger, by Student's quantile over 1.96.
    freedom : float
        Degrees of freedom of ``std``.
    known_std : float
        Standard uncertainty of what is common to all data.

    Returns
    -------
    CoverageEstimate
        Its half-widths, Student's for the one part and normal for the other, add in quadrature.

    Examples
    --------
    >>> coverage_estimate(1.0, 0.01, freedom=4).high
    1.02776445
    """
    quantile = float(special.stdtrit(freedom, 0.5 + COVERAGE / 2)) if std > 0 else 0.0
    half = float(np.hypot(quantile * std, NORMAL_95 * known_std))
    return CoverageEstimate(value, half / NORMAL_95, value - half, value + half)
