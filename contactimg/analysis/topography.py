"""Profilometry of asperities: distributions of height and radius, and the contact angle of droplets."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import scipy
from numpy.typing import NDArray

from contactimg.analysis.estimates import Estimate
from contactimg.analysis.linear_fit import Points, fit_proportional
from contactimg.errors import InputError


@dataclass(frozen=True)
class Topography:
    """The statistics of a table of asperities.

    Parameters
    ----------
    slope : Estimate
        ``h/R = 1 - cos(theta)`` of caps of one contact angle.
    contact_angle : Estimate, rad
        ``theta``; NaN if the slope is not between 0 and 2.
    correlation : float
        Spearman's rank correlation of height and radius; NaN if one of them does not vary.
    p_value : float
        Probability of as strong a correlation of independent heights and radii.
    height_mean, height_std, radius_mean, radius_std : float, m
        Of the asperities, stated errors not removed.
    height_normality, radius_normality : float
        Probability that normal values deviate as much from a normal law (Shapiro and Wilk); NaN if all are
        equal.
    n_points : int
    confidence : float
        Of the intervals.
    """

    slope: Estimate
    contact_angle: Estimate
    correlation: float
    p_value: float
    height_mean: float
    height_std: float
    radius_mean: float
    radius_std: float
    height_normality: float
    radius_normality: float
    n_points: int
    confidence: float

    @property
    def one_angle(self) -> bool:
        """Whether height grows with radius, so that the contact angle has a meaning."""
        return bool(self.correlation > 0 and self.p_value < 1 - self.confidence)

    def radius(self, height: NDArray[np.float64]) -> NDArray[np.float64]:
        """``R(h) = h/(1 - cos theta)``, m."""
        return np.asarray(height, dtype=np.float64) / self.slope.value


def describe_topography(table: pd.DataFrame, *, confidence: float = 0.95) -> Topography:
    """Contact angle and ``R(h)`` of asperities, with errors in height and radius.

    Parameters
    ----------
    table : DataFrame
        Columns of `contactimg.tables.TOPOGRAPHY`, m; an uncertainty that is not stated is none. Three rows
        or more.
    confidence : float
        Of the intervals.

    Returns
    -------
    Topography

    Raises
    ------
    InputError
        If there are fewer than three asperities, or a height or radius is not positive.

    Notes
    -----
    ``h = R (1 - cos theta)``, a line through the origin with errors on both axes and excess scatter in h, as
    in the paper's Fig. 2. Without a correlation (RA-) the angle has no meaning: see ``one_angle``.

    References
    ----------
    Yashima et al., Soft Matter 11 (2015) 871, doi:10.1039/C4SM02346C, Table 1 and Fig. 2; Shapiro, Wilk,
    Biometrika 52 (1965) 591, doi:10.1093/biomet/52.3-4.591.

    Examples
    --------
    >>> caps = pd.DataFrame({"height_m": [2e-5, 3e-5, 4e-5], "radius_m": [4.4e-5, 6.6e-5, 8.8e-5]})
    >>> round(float(np.degrees(describe_topography(caps).contact_angle.value)), 1)
    56.9
    """
    if len(table) < 3:
        raise InputError(f"a topography needs three asperities at least, got {len(table)}")
    for name in ("height_m", "radius_m"):
        if not (table[name] > 0).all():
            raise InputError(f"topography: {name} must be positive, got {table[name].min()!r}")
    h, R = table["height_m"].to_numpy(float), table["radius_m"].to_numpy(float)
    stated = table.reindex(columns=["radius_std_m", "height_std_m"]).fillna(0.0).to_numpy(float)
    slope = fit_proportional(Points(R, h, *stated.T)).estimate(0, confidence=confidence)
    correlation, p_value = (np.nan, 1.0) if np.ptp(h) == 0 or np.ptp(R) == 0 else scipy.stats.spearmanr(h, R)
    return Topography(
        slope=slope,
        contact_angle=_angle(slope),
        correlation=float(correlation),
        p_value=float(p_value),
        height_mean=float(h.mean()),
        height_std=float(h.std(ddof=1)),
        radius_mean=float(R.mean()),
        radius_std=float(R.std(ddof=1)),
        height_normality=_normality(h),
        radius_normality=_normality(R),
        n_points=len(h),
        confidence=confidence,
    )


def _normality(values: NDArray[np.float64]) -> float:
    """P-value of the test of Shapiro and Wilk."""
    return float(scipy.stats.shapiro(values / values.mean()).pvalue) if np.ptp(values) > 0 else np.nan


def _angle(slope: Estimate) -> Estimate:
    """``acos(1 - slope)``; its derivative is ``1/sin(theta)``."""
    if not 0 < slope.value < 2:
        return Estimate(np.nan, np.nan, np.nan, np.nan)
    low, value, high = np.arccos(1 - np.clip([slope.low, slope.value, slope.high], 0.0, 2.0)).tolist()
    return Estimate(value, slope.std / float(np.sin(value)), low, high)
