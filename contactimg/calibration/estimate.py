"""An estimated number with its uncertainty, as every calibration states it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

__all__ = ["COVERAGE", "NORMAL_95", "Estimate", "estimate_from_draws", "student_estimate"]

COVERAGE = 0.95
NORMAL_95 = float(stats.norm.ppf(0.5 + COVERAGE / 2))
"""Half-width of a normal distribution's 95 % interval in standard deviations, 1.96."""


@dataclass(frozen=True)
class Estimate:
    """A number and how well it is known.

    Parameters
    ----------
    value : float
    std : float
        Standard uncertainty, stated such that ``value +- 1.96 std`` covers 95 %: half the width of the
        interval over 1.96, which with few data exceeds the standard deviation.
    low, high : float
        Ends of the 95 % interval.
    """

    value: float
    std: float
    low: float
    high: float

    def record(self, unit: str) -> dict[str, Any]:
        """As ``calibration.json`` states it.

        Examples
        --------
        >>> Estimate(3e6, 1e4, 2.98e6, 3.02e6).record("Pa")["std"]
        10000.0
        """
        return {
            "value": self.value,
            "std": self.std,
            "unit": unit,
            "low_95": self.low,
            "high_95": self.high,
        }

    def scaled(self, factor: float) -> "Estimate":
        """The estimate times a positive factor."""
        return Estimate(self.value * factor, self.std * factor, self.low * factor, self.high * factor)


def estimate_from_draws(draws: NDArray[np.float64]) -> Estimate:
    """Median and central 95 % interval of draws from a distribution."""
    low, value, high = np.quantile(draws, [0.5 - COVERAGE / 2, 0.5, 0.5 + COVERAGE / 2])
    return Estimate(float(value), float((high - low) / 2 / NORMAL_95), float(low), float(high))


def student_estimate(value: float, std: float, *, freedom: float, known_std: float = 0.0) -> Estimate:
    """An estimate whose standard deviation was itself estimated, plus an independent known part.

    Parameters
    ----------
    value, std : float
    freedom : float
        Degrees of freedom of ``std``.
    known_std : float
        Standard uncertainty of what is common to all data.

    Returns
    -------
    Estimate
        Its half-widths, Student's for the one part and normal for the other, add in quadrature.

    Examples
    --------
    >>> student_estimate(1.0, 0.01, freedom=4).high
    1.02776445
    """
    quantile = float(stats.t.ppf(0.5 + COVERAGE / 2, freedom)) if std > 0 else 0.0
    half = float(np.hypot(quantile * std, NORMAL_95 * known_std))
    return Estimate(value, half / NORMAL_95, value - half, value + half)
