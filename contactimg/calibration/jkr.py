"""Modulus and work of adhesion from the contact radii of a smooth sphere (JKR).

In the stiffness ``K`` and the adhesion ``S = sqrt(w K)`` the law is linear,

    P = K a^3/R - sqrt(6 pi) S a^{3/2},

so that for loads and radii with known errors the fit is weighted and linear at the latent (true) radii
(`contactimg.calibration.jkr_fit`). What is common to all loads is averaged over: the zero of the load cell,
which the loads tell in part, and its gain, which they do not tell at all.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import special, stats

from contactimg.analysis.load_cell import LoadCell
from contactimg.calibration.coverage_estimate import CoverageEstimate, estimate_from_draws
from contactimg.calibration.jkr_departures import Departure, choose_departure
from contactimg.calibration.jkr_edge import EdgeShift, find_edge_shift, with_shifted_edge
from contactimg.calibration.jkr_fit import (
    JkrFit,
    JkrSeries,
    average_noises,
    even_draws,
    without_outliers,
)
from contactimg.calibration.loading_branches import classify_branches
from contactimg.errors import InputError

Values = NDArray[np.float64]

MIN_GROWTH_SIGMA = 1.5
"""Least slope of radius against load, in its standard errors. Chosen by hand; sensitivity not measured."""
ZERO_FALSE_ALARM_RATE = 0.01
"""False-alarm rate: probability that a true zero is called off. Theory: posterior quantile, two-sided."""


@dataclass(frozen=True)
class SmoothSphere:
    """The smooth sphere and its elastic partner.

    Parameters
    ----------
    radius : float, m
    poisson_ratio : float
    radius_std : float
        Standard uncertainty of the radius, relative: that which a lens of unequal curvature adds.
    thickness : float or None, m
        Of the elastic layer, bonded to a rigid support and incompressible; None for a half-space.
    """

    radius: float
    poisson_ratio: float
    radius_std: float = 0.0
    thickness: float | None = None


@dataclass(frozen=True, eq=False)
class JkrCalibration:
    """Modulus and work of adhesion from a series of contact radii.

    Parameters
    ----------
    young_modulus : CoverageEstimate, Pa
    work_of_adhesion : CoverageEstimate, J/m^2
        Of the loading branch, where the branches differ; else of all frames.
    work_of_adhesion_unloading : CoverageEstimate or None, J/m^2
        Of the unloading branch, where it differs.
    correlation : float
        Between modulus and work of adhesion.
    load_zero : CoverageEstimate or None, N
        What the load cell reads without load, as far as the data and what is known of it beforehand tell; it
        is taken off the loads. None where it was stated to be exact.
    load_zero_seen : bool
        Whether the data show that it is off.
    departure, rival : str
        What makes unloading differ from loading (`contactimg.calibration.jkr_departures`), and what else may;
        empty if nothing does.
    drift : CoverageEstimate or None, N or relative
        Of the zero or of the gain over the series, where it is fitted.
    load_noise : float, N
        Root mean square of the loads' residuals, corrected for the fitted numbers.
    points : DataFrame
        One row a frame: load_N, radius_m, branch, fitted_N, residual_N, used.
    problem : JkrProblem
        What was fitted, for `contactimg.calibration.jkr_uncertainties`.
    edge : EdgeShift or None
        How far the edge seems to lie outside the true one; None where it was not looked for.
    """

    young_modulus: CoverageEstimate
    work_of_adhesion: CoverageEstimate
    work_of_adhesion_unloading: CoverageEstimate | None
    correlation: float
    load_zero: CoverageEstimate | None
    load_zero_seen: bool
    departure: str
    rival: str
    drift: CoverageEstimate | None
    load_noise: float
    points: pd.DataFrame = field(repr=False)
    problem: "JkrProblem" = field(repr=False)
    edge: EdgeShift | None = field(default=None, repr=False)


def calibrate_jkr(
    load: ArrayLike,
    radius: ArrayLike,
    *,
    sphere_radius: float,
    poisson_ratio: float,
    radius_std: ArrayLike = 0.0,
    load_cell: LoadCell | None = None,
    thickness: float | None = None,
    sphere_radius_std: float = 0.0,
    pixel_size: float | None = None,
) -> JkrCalibration:
    """Fit modulus and work of adhesion to contact radii of a smooth sphere under several loads.

    Parameters
    ----------
    load : array_like, shape (n,), N
        In the order in which they were applied, which tells loading from unloading; negative is a pull.
    radius : array_like, shape (n,), m
    sphere_radius : float, m
    poisson_ratio : float
    radius_std : array_like, m
        Standard uncertainty of the radii, one each or one for all.
    load_cell : LoadCell, optional
        How well its zero and its gain are known; default: half a percent of the largest load, and 1 %.
    thickness : float, optional, m
        Of the elastic layer, bonded and incompressible; default: a half-space.
    sphere_radius_std : float, m
        Standard uncertainty of the sphere's radius.
    pixel_size : float, optional, m
        Of the images that the radii come from, for the shift of their edges; default: it is not looked for.

    Returns
    -------
    JkrCalibration
        Intervals of 95 % for a noise of the loads that is estimated from the fit itself.

    Raises
    ------
    InputError
        If there are fewer than three different loads, none of them presses, or the radius does not grow with
        the load.

    Notes
    -----
    Outliers are removed one by one, each with a residual that chance exceeds in one series of a thousand. The
    noise of the radii enters through the slope of the law at the latent radii (errors in both variables). An
    error common to all radii, such as that of the pixel size, is not included.

    References
    ----------
    Johnson, Kendall, Roberts, Proc. R. Soc. A 324 (1971) 301, doi:10.1098/rspa.1971.0141, eq. (21).
    York et al., Am. J. Phys. 72 (2004) 367, doi:10.1119/1.1632486, for errors in both variables.

    Examples
    --------
    >>> from contactimg.mechanics import jkr
    >>> law = dict(sphere_radius=0.1288, contact_modulus=4e6, work_of_adhesion=0.05)
    >>> loads = np.array([0.02, 0.05, 0.1, 0.2, 0.5])
    >>> calibration = calibrate_jkr(
    ...     loads, jkr.radius(loads, **law), sphere_radius=0.1288, poisson_ratio=0.5
    ... )
    >>> round(calibration.young_modulus.value, -3), round(calibration.work_of_adhesion.value, 5)
    (3000000.0, 0.05)
    """
    cell = LoadCell() if load_cell is None else load_cell
    sphere = SmoothSphere(sphere_radius, poisson_ratio, sphere_radius_std / sphere_radius, thickness)
    plain = _series(load, radius, radius_std, cell, thickness)
    check_loads(plain.load)
    _check_growth(plain.load, plain.radius)
    branch = classify_branches(plain.load)
    used = without_outliers(plain)
    found = choose_departure(plain, branch, used)
    edge = None if pixel_size is None else find_edge_shift(found.series.part(used), pixel_size)
    if edge is not None and edge.seen and pixel_size is not None:
        shifted = with_shifted_edge(found.series, found.series.part(used), pixel_size)
        found = replace(found, series=shifted)
    fit = average_noises(found.series.part(used))
    estimates = _estimates(found.series, fit, sphere, gain_std=cell.gain_std)
    if found.rival is not None:
        estimates = estimates.widened(solve_series(found.rival.series, used, sphere), found.doubt)
    rest, points = _points(found.series, fit, branch, used)
    freedom = max(int(used.sum()) - len(fit.centre), 1)
    return JkrCalibration(
        young_modulus=estimates.modulus,
        work_of_adhesion=estimates.work[0],
        work_of_adhesion_unloading=estimates.work[1] if len(estimates.work) > 1 else None,
        correlation=estimates.correlation,
        load_zero=estimates.load_zero,
        load_zero_seen=estimates.zero_seen,
        departure=found.name,
        rival=found.rival.name if found.rival is not None else "",
        drift=estimates.drift,
        load_noise=float(np.sqrt(np.sum(rest[used] ** 2) / freedom)),
        points=points,
        problem=JkrProblem(found, used, sphere, cell),
        edge=edge,
    )


@dataclass(frozen=True, eq=False)
class JkrProblem:
    """The series with its departure, the frames used, the sphere and the load cell."""

    found: Departure
    used: NDArray[np.bool_]
    sphere: SmoothSphere
    cell: LoadCell


@dataclass(frozen=True)
class JkrEstimates:
    """Modulus (Pa), works of adhesion of the branches (J/m^2), zero of the loads (N) and drift."""

    modulus: CoverageEstimate
    work: tuple[CoverageEstimate, ...]
    load_zero: CoverageEstimate | None
    zero_seen: bool
    drift: CoverageEstimate | None
    correlation: float

    def widened(self, other: "JkrEstimates", doubt: float) -> "JkrEstimates":
        """With the uncertainty added by a rival of probability ``doubt``."""

        def wide(estimate: CoverageEstimate, rival: CoverageEstimate) -> CoverageEstimate:
            return estimate.widened(np.sqrt(doubt) * abs(rival.value - estimate.value))

        work = tuple(wide(one, other.work[min(k, len(other.work) - 1)]) for k, one in enumerate(self.work))
        return replace(self, modulus=wide(self.modulus, other.modulus), work=work)

    def change_to(self, other: "JkrEstimates") -> tuple[float, float]:
        """Relative changes of modulus and adhesion."""
        return (
            other.modulus.value / self.modulus.value - 1,
            other.work[0].value / max(self.work[0].value, np.finfo(float).tiny) - 1,
        )


def _series(
    load: ArrayLike, radius: ArrayLike, radius_std: ArrayLike, cell: LoadCell, thickness: float | None
) -> JkrSeries:
    """Loads and radii, checked, with their scales."""
    P, a = np.atleast_1d(np.asarray(load, float)), np.atleast_1d(np.asarray(radius, float))
    if P.ndim != 1 or P.shape != a.shape:
        raise InputError(f"one radius a load is needed, got shapes {P.shape} and {a.shape}")
    std = np.broadcast_to(np.asarray(radius_std, float), a.shape)
    if not (
        np.isfinite(P).all() and np.all(np.isfinite(a) & (a > 0)) and np.all(np.isfinite(std) & (std >= 0))
    ):
        raise InputError("loads must be finite, radii positive and their uncertainties not negative")
    scale = float(np.sqrt(np.mean(P**2))) if P.size else 0.0
    return JkrSeries(
        load=P,
        radius=a,
        radius_std=std,
        load_scale=scale or 1.0,
        radius_scale=float(a.max(initial=0.0)) or 1.0,
        zero_std=cell.zero_width(P),
        thickness=thickness,
        branches=np.ones((P.size, 1)),
        drift=np.ones((P.size, 0)),
    )


def solve_series(series: JkrSeries, used: NDArray[np.bool_], sphere: SmoothSphere) -> JkrEstimates:
    """The estimates of a series, without what its gain and its sphere add."""
    return _estimates(
        series, average_noises(series.part(used)), replace(sphere, radius_std=0.0), gain_std=0.0
    )


def _estimates(series: JkrSeries, fit: JkrFit, sphere: SmoothSphere, *, gain_std: float) -> JkrEstimates:
    """The physical quantities from the draws of a fit."""
    draws = fit.draws()
    common = special.ndtri(even_draws(2)[: len(draws)])
    # the draws of the fit are ordered by nothing that these are, but not independent of them: shuffled
    gain, bend = np.random.default_rng(0).permutation(common).T * [[gain_std], [sphere.radius_std]]
    K = draws[:, 0] * series.load_scale * sphere.radius / series.radius_scale**3
    E = 0.75 * (1 - sphere.poisson_ratio**2) * K
    S = np.maximum(draws[:, 1 : series.physical] * series.load_scale / series.radius_scale**1.5, 0.0)
    w = S**2 / (6 * np.pi * K[:, None])
    E, w = E * (1 + gain) * (1 + bend), w * ((1 + gain) * (1 - bend))[:, None]
    zero = draws[:, -1] * series.load_scale if series.zero_std else None
    return JkrEstimates(
        estimate_from_draws(E),
        tuple(estimate_from_draws(column) for column in w.T),
        None if zero is None else estimate_from_draws(zero),
        zero is not None and bool(min((zero < 0).mean(), (zero > 0).mean()) < ZERO_FALSE_ALARM_RATE / 2),
        estimate_from_draws(draws[:, series.physical]) if series.drift.shape[1] else None,
        _correlation(E, w[:, 0]),
    )


def _points(
    series: JkrSeries, fit: JkrFit, branch: NDArray[np.str_], used: NDArray[np.bool_]
) -> tuple[Values, pd.DataFrame]:
    """Residuals of the loads (N), and the table of the frames."""
    fitted = series.load_scale * (series.design(series.radius) @ fit.centre)
    rest = series.load - fitted
    columns = {
        "load_N": series.load,
        "radius_m": series.radius,
        "branch": branch,
        "fitted_N": fitted,
        "residual_N": rest,
        "used": used,
    }
    return rest, pd.DataFrame(columns)


def check_loads(load: ArrayLike) -> None:
    """Refuse loads that do not allow a JKR fit.

    Parameters
    ----------
    load : array_like, shape (n,), N
        NaN where a frame has none.

    Raises
    ------
    InputError
        If there are fewer than three different loads, or none of them presses.
    """
    P = np.asarray(load, float)
    loads = np.unique(P[np.isfinite(P)])
    if loads.size < 3:
        raise InputError(
            f"a JKR fit needs three different loads or more, got {loads.size}; "
            "it has two parameters and needs a third load to test them"
        )
    if not (loads > 0).any():
        raise InputError(
            "no load presses: with the pull-off branch only, stiffness and adhesion cannot be told apart; "
            "add frames at positive loads"
        )


def _check_growth(load: Values, radius: Values) -> None:
    """Refuse radii that do not increase with the load."""
    trend = stats.linregress(load, radius)
    grows = trend.slope > 0 and stats.kendalltau(load, radius).statistic > 0
    noise = trend.stderr
    if not grows or trend.slope < MIN_GROWTH_SIGMA * noise or np.ptp(radius) < 1e-9 * radius.max():
        raise InputError(
            "the contact radius does not grow with the load "
            f"({1e6 * trend.slope:.3g} +- {1e6 * noise:.2g} um/N); "
            "check that frames and loads belong together and that the frames show the contact"
        )


def _correlation(first: Values, second: Values) -> float:
    """Rank correlation, robust against wide tails; 0 if one of the two does not vary."""
    if np.ptp(first) == 0 or np.ptp(second) == 0:
        return 0.0
    return float(stats.spearmanr(first, second).statistic)
