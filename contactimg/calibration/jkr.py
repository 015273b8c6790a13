"""Modulus and work of adhesion from the contact radii of a smooth sphere (JKR).

In the stiffness ``K`` and the adhesion ``S = sqrt(w K)`` the law is linear,

    P = K a^3/R - sqrt(6 pi) S a^{3/2},

so that for loads and radii with known errors the fit is weighted and linear at the latent (true) radii. The
noise of the loads is unknown: it is modelled as a constant part plus a part proportional to the load, and the
fits for many amplitudes of the two are averaged, each weighted by its restricted likelihood. For few data the
average has the wide tails of Student's distribution, and it is valid whether the scale or the zero of the
loads is noisy.
"""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import special, stats

from contactimg.calibration.coverage_estimate import CoverageEstimate, estimate_from_draws
from contactimg.calibration.loading_branches import classify_branches
from contactimg.errors import InputError

Values = NDArray[np.float64]

CONSTANT_VARIANCE_SHARES = np.array([1.0, 0.1, 0.003])
"""Shares of the noise variance, at the rms load, that do not grow with the load. Chosen by hand; sensitivity
not measured."""
SHARE_PRIORS = np.array([0.5, 0.25, 0.25])
"""Prior weights of these shares. Chosen: a noisy zero is as likely as a noisy scale."""
NOISE_SCALES = np.geomspace(0.03, 1e4, 160)
"""Noise in units of the scatter of the residuals. Theory: the likelihood vanishes below, and the part above
is 1e-4 of Student's tail at one degree of freedom."""
N_DRAWS = 20000
"""Number of draws from the distribution of the parameters. Chosen by hand; sensitivity not measured."""
MIN_GROWTH_SIGMA = 1.5
"""Least slope of radius against load, in its standard errors. Chosen by hand; sensitivity not measured."""
N_LATENT_ITERATIONS = 4
"""Number of iterations of the latent radii. Chosen by hand; sensitivity not measured."""
MIN_OUTLIER_FRACTION = 1e-6
"""Least residual of an outlier relative to the rms load: below it residuals are rounding errors. Chosen by
hand."""
OUTLIER_FALSE_ALARM_RATE = 1e-3
"""False-alarm rate: probability that a series without outliers loses a frame."""
LOAD_ZERO_PROBABILITY = 0.95
"""Probability from which the zero of the loads is fitted. Chosen; below it the uncertainties allow for it."""
LOAD_ZERO_RANGE = 0.2
"""Width of the range of zeros expected beforehand, in units of the rms load. Chosen: 10 % to either side;
the probability changes as its inverse."""
LEAST_LOAD_ZERO_DOUBT = 0.5
"""Least probability that the zero is off by what the fit with it finds. Chosen: modulus and adhesion absorb
most of a wrong zero, so that its absence cannot be told from the loads; 0 would state half the true error."""
EXACT_CHI_SQUARE = 1e-18
"""Chi-square of scaled loads below which residuals are rounding errors."""
HYSTERESIS_FALSE_ALARM_RATE = 0.01
"""False-alarm rate: probability that a series without hysteresis gets two works of adhesion."""


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
        What the load cell reads without load, where the data show it; it is taken off the loads.
    load_zero_doubt : float
        Probability that the zero is off although it was not fitted; the uncertainties allow for it.
    load_noise : float, N
        Root mean square of the loads' residuals, corrected for the fitted numbers.
    points : DataFrame
        One row a frame: load_N, radius_m, branch, fitted_N, residual_N, used.
    """

    young_modulus: CoverageEstimate
    work_of_adhesion: CoverageEstimate
    work_of_adhesion_unloading: CoverageEstimate | None
    correlation: float
    load_zero: CoverageEstimate | None
    load_zero_doubt: float
    load_noise: float
    points: pd.DataFrame


def calibrate_jkr(
    load: ArrayLike,
    radius: ArrayLike,
    *,
    sphere_radius: float,
    poisson_ratio: float,
    radius_std: ArrayLike = 0.0,
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
    >>> calibration.young_modulus.value, calibration.work_of_adhesion.value
    (3000000.0, 0.05)
    """
    data = _Data.of(load, radius, radius_std)
    check_loads(data.load)
    _check_growth(data.load, data.radius)
    branch = classify_branches(data.load)
    used = _without_outliers(data)
    columns = _branch_columns(data, branch, used)
    sphere = _Sphere(sphere_radius, poisson_ratio)
    offset, doubt = replace(data, zero=True), _load_zero_probability(data, columns, used)
    if doubt > LOAD_ZERO_PROBABILITY:
        data, doubt = offset, 0.0
    fit = _average_noises(data.part(used), columns[used])
    centre = fit.centre
    estimates = _estimates(data, fit, sphere)
    if doubt:
        other = _average_noises(offset.part(used), columns[used])
        estimates = estimates.widened(_estimates(offset, other, sphere), doubt)
    fitted = data.design(data.radius, columns) @ centre
    freedom = max(int(used.sum()) - len(centre), 1)
    rest = data.load_scale * (data.scaled_load - fitted)
    points = pd.DataFrame(
        {
            "load_N": data.load,
            "radius_m": data.radius,
            "branch": branch,
            "fitted_N": data.load_scale * fitted,
            "residual_N": rest,
            "used": used,
        }
    )
    return JkrCalibration(
        young_modulus=estimates.modulus,
        work_of_adhesion=estimates.work[0],
        work_of_adhesion_unloading=estimates.work[1] if len(estimates.work) > 1 else None,
        correlation=estimates.correlation,
        load_zero=estimates.load_zero,
        load_zero_doubt=doubt,
        load_noise=float(np.sqrt(np.sum(rest[used] ** 2) / freedom)),
        points=points,
    )


@dataclass(frozen=True)
class _Sphere:
    """Radius of the smooth sphere (m) and Poisson's ratio of its partner."""

    radius: float
    poisson_ratio: float


@dataclass(frozen=True)
class _Estimates:
    """Modulus (Pa), works of adhesion of the branches (J/m^2), and the zero of the loads (N) if fitted."""

    modulus: CoverageEstimate
    work: tuple[CoverageEstimate, ...]
    load_zero: CoverageEstimate | None
    correlation: float

    def widened(self, other: "_Estimates", doubt: float) -> "_Estimates":
        """With the uncertainty added by a rival of probability ``doubt``."""

        def wide(estimate: CoverageEstimate, rival: CoverageEstimate) -> CoverageEstimate:
            return estimate.widened(np.sqrt(doubt) * abs(rival.value - estimate.value))

        work = tuple(wide(*pair) for pair in zip(self.work, other.work, strict=True))
        return replace(self, modulus=wide(self.modulus, other.modulus), work=work)


def _estimates(data: "_Data", fit: "_Fit", sphere: _Sphere) -> _Estimates:
    """The physical quantities from the draws of a fit."""
    draws = fit.draws()
    K = draws[:, 0] * data.load_scale * sphere.radius / data.radius_scale**3
    E = 0.75 * (1 - sphere.poisson_ratio**2) * K
    adhesion = draws[:, 1:-1] if data.zero else draws[:, 1:]
    S = np.maximum(adhesion * data.load_scale / data.radius_scale**1.5, 0.0)
    w = S**2 / (6 * np.pi * K[:, None])
    return _Estimates(
        estimate_from_draws(E),
        tuple(estimate_from_draws(column) for column in w.T),
        estimate_from_draws(draws[:, -1] * data.load_scale) if data.zero else None,
        _correlation(E, w[:, 0]),
    )


@dataclass(frozen=True, eq=False)
class _Data:
    """Loads and radii with the scales that make the fit one of numbers of order one.

    With ``zero`` the loads have an unknown zero, which is fitted.
    """

    load: Values
    radius: Values
    radius_std: Values
    load_scale: float
    radius_scale: float
    zero: bool = False

    @classmethod
    def of(cls, load: ArrayLike, radius: ArrayLike, radius_std: ArrayLike) -> "_Data":
        P, a = np.atleast_1d(np.asarray(load, float)), np.atleast_1d(np.asarray(radius, float))
        if P.ndim != 1 or P.shape != a.shape:
            raise InputError(f"one radius a load is needed, got shapes {P.shape} and {a.shape}")
        std = np.broadcast_to(np.asarray(radius_std, float), a.shape)
        if not (
            np.isfinite(P).all()
            and np.all(np.isfinite(a) & (a > 0))
            and np.all(np.isfinite(std) & (std >= 0))
        ):
            raise InputError("loads must be finite, radii positive and their uncertainties not negative")
        scale = float(np.sqrt(np.mean(P**2))) if P.size else 0.0
        return cls(P, a, std, scale or 1.0, float(a.max(initial=0.0)) or 1.0)

    @property
    def scaled_load(self) -> Values:
        return self.load / self.load_scale

    def part(self, used: NDArray[np.bool_]) -> "_Data":
        return replace(self, load=self.load[used], radius=self.radius[used], radius_std=self.radius_std[used])

    def design(self, radius: Values, columns: Values) -> Values:
        """Scaled load per unit of the stiffness, of each branch's adhesion, and of the zero if fitted."""
        x = radius / self.radius_scale
        zero = np.ones((len(x), int(self.zero)))
        return np.column_stack([x**3, -(x**1.5)[:, None] * columns, zero])

    def slope(self, radius: Values, columns: Values, theta: Values) -> Values:
        """Derivative of the scaled load by the radius, 1/m."""
        x, adhesion = radius / self.radius_scale, theta[1 : 1 + columns.shape[1]]
        return (3 * theta[0] * x**2 - 1.5 * x**0.5 * (columns @ adhesion)) / self.radius_scale


@dataclass(frozen=True, eq=False)
class _Fit:
    """The fits for every noise model with their weights.

    ``variance`` is that of the most likely one, ``evidence`` the logarithm of their summed likelihoods.
    """

    centres: Values
    covariances: Values
    weights: Values
    variance: Values
    evidence: float

    @property
    def centre(self) -> Values:
        """Mean of the fitted numbers."""
        return self.weights @ self.centres

    def draws(self) -> Values:
        """Draws from the distribution of the parameters, with positive stiffness."""
        freedom = max(len(self.variance) - self.centres.shape[1], 1)
        spread = _draw(self.centres, self.covariances, self.weights) - self.centre
        # the amplitude and the growth of the noise are estimated from the same residuals: two degrees of
        # freedom less; without this, 90 % of the intervals contain the truth for noise proportional to the
        # load
        draws = self.centre + np.sqrt((freedom + 2) / freedom) * spread
        return draws[draws[:, 0] > 0]


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


def _branch_columns(data: _Data, branch: NDArray[np.str_], used: NDArray[np.bool_]) -> Values:
    """One column of ones, or one per branch if loading and unloading differ in adhesion."""
    together = np.ones((len(branch), 1))
    apart = np.column_stack([branch == "loading", branch == "unloading"]).astype(float)
    counts = apart[used].sum(axis=0)
    if counts.min() < 2 or counts.sum() < used.sum() or used.sum() < 5:
        return together
    rest = [_least_squares(data.part(used), columns[used]) for columns in (together, apart)]
    freedom = int(used.sum()) - 3
    ratio = (rest[0] - rest[1]) / max(rest[1] / freedom, np.finfo(float).tiny)
    differs = rest[0] > rest[1] + 1e-18 and stats.f.sf(ratio, 1, freedom) < HYSTERESIS_FALSE_ALARM_RATE
    return apart if differs else together


def _load_zero_probability(data: _Data, columns: Values, used: NDArray[np.bool_]) -> float:
    """Probability that the zero of the loads is off, against an even prior; 0 where too few frames tell."""
    n, parameters = int(used.sum()), columns.shape[1] + 2
    if n < parameters + 2 or len(np.unique(data.load[used])) < parameters + 1:
        return 0.0
    part, rival = data.part(used), replace(data, zero=True).part(used)
    if _least_squares(part, columns[used]) < EXACT_CHI_SQUARE:
        return 0.0
    logs = [_average_noises(one, columns[used]).evidence for one in (rival, part)]
    odds = logs[0] - logs[1] + 0.5 * np.log(2 * np.pi) - np.log(LOAD_ZERO_RANGE)
    return max(float(special.expit(odds)), LEAST_LOAD_ZERO_DOUBT)


def _least_squares(data: _Data, columns: Values) -> float:
    """Chi-square of the scaled residuals for noise with a constant and a growing part."""
    weight = 1 / np.sqrt(0.05 + data.scaled_load**2)
    design = data.design(data.radius, columns) * weight[:, None]
    theta: Values = np.linalg.lstsq(design, data.scaled_load * weight, rcond=None)[0].astype(np.float64)
    return float(np.sum((data.scaled_load * weight - design @ theta) ** 2))


def _without_outliers(data: _Data) -> NDArray[np.bool_]:
    """Mask of the frames to use: outliers from the fit to all others are removed one by one."""
    used = np.ones(len(data.load), bool)
    columns = np.ones((len(data.load), 1))
    for _ in range(len(used) // 4):
        n = int(used.sum())
        if n < 5 or len(np.unique(data.load[used])) < 4:
            break
        part = data.part(used)
        variance = _average_noises(part, columns[used]).variance
        design = part.design(part.radius, columns[used]) / np.sqrt(variance)[:, None]
        hat = design @ np.linalg.pinv(design)
        rest = part.scaled_load / np.sqrt(variance)
        rest = rest - hat @ rest
        leverage = np.clip(np.diag(hat), 0.0, 1 - 1e-9)
        others = (np.sum(rest**2) - rest**2 / (1 - leverage)) / (n - 3)
        student = np.abs(rest) / np.sqrt(np.maximum(others, 1e-12 * np.sum(rest**2) + 1e-24) * (1 - leverage))
        worst = int(student.argmax())
        off = abs(rest[worst]) * np.sqrt(variance[worst])
        if n * 2 * stats.t.sf(student[worst], n - 3) > OUTLIER_FALSE_ALARM_RATE or off < MIN_OUTLIER_FRACTION:
            break
        used[np.flatnonzero(used)[worst]] = False
    return used


def _average_noises(data: _Data, columns: Values) -> _Fit:
    """Average the weighted fits over the noise models of the loads."""
    y, latent = data.scaled_load, data.radius
    theta: Values = np.linalg.lstsq(data.design(latent, columns), y, rcond=None)[0].astype(np.float64)
    for _ in range(N_LATENT_ITERATIONS):
        design, slope = data.design(latent, columns), data.slope(latent, columns, theta)
        straight = y - slope * (data.radius - latent)
        own = (slope * data.radius_std) ** 2
        variances = _noise_variances(straight, design, theta, own)
        centres, covariances, logs = _weighted_fits(straight, design, variances)
        evidence = float(special.logsumexp(logs))
        weights = np.exp(logs - evidence)
        best = int(weights.argmax())
        theta = centres[best]
        moved = data.radius_std**2 * slope / variances[best] * (straight - design @ theta)
        latent = np.maximum(data.radius + moved, 0.5 * data.radius)
    return _Fit(centres, covariances, weights, variances[best], evidence)


def _noise_variances(y: Values, design: Values, theta: Values, own: Values) -> Values:
    """Variances of the scaled loads, one row per noise model, plus those due to the radii."""
    model = design @ theta
    freedom = max(len(y) - len(theta), 1)
    scatter = np.sqrt(np.sum((y - model) ** 2) / freedom)
    scatter = max(float(scatter), 1e-9 * float(np.abs(y).max()))
    share = CONSTANT_VARIANCE_SHARES[:, None, None]
    shape = share + (1 - share) * model**2
    # the same geometric mean over the loads for every shape, so that the scale is that of the residuals
    shape = shape / np.exp(np.mean(np.log(shape), axis=-1, keepdims=True))
    return ((NOISE_SCALES[:, None] * scatter) ** 2 * shape).reshape(-1, len(y)) + own


def _weighted_fits(y: Values, design: Values, variances: Values) -> tuple[Values, Values, Values]:
    """Linear fits for every noise model, their covariances and log weights (restricted likelihood)."""
    information = np.einsum("ni,mn,nj->mij", design, 1 / variances, design)
    covariances = np.linalg.inv(information)
    centres = np.einsum("mij,nj,mn->mi", covariances, design, y / variances)
    rest = y - centres @ design.T
    logs = -0.5 * (
        np.log(variances).sum(axis=1) + np.linalg.slogdet(information)[1] + (rest**2 / variances).sum(axis=1)
    )
    logs += np.repeat(np.log(SHARE_PRIORS), len(NOISE_SCALES))
    return centres, covariances, logs


def _draw(centres: Values, covariances: Values, weights: Values) -> Values:
    """Evenly spread draws (a Kronecker sequence) from a weighted mixture of normal distributions."""
    dimensions = centres.shape[1] + 1
    phi = 1.5
    for _ in range(60):  # x^{d+1} = x + 1: the generalised golden ratio
        phi = (1 + phi) ** (1 / (dimensions + 1))
    steps = (1 / phi) ** np.arange(1, dimensions + 1)
    uniform = (0.5 + np.arange(1, N_DRAWS + 1)[:, None] * steps) % 1
    cumulated = np.cumsum(weights)
    which = np.minimum(np.searchsorted(cumulated, uniform[:, 0] * cumulated[-1]), len(weights) - 1)
    normal = special.ndtri(np.clip(uniform[:, 1:], 1e-12, 1 - 1e-12))
    roots = np.linalg.cholesky(covariances)
    return centres[which] + np.einsum("nij,nj->ni", roots[which], normal)


def _correlation(first: Values, second: Values) -> float:
    """Rank correlation, robust against wide tails; 0 if one of the two does not vary."""
    if np.ptp(first) == 0 or np.ptp(second) == 0:
        return 0.0
    return float(stats.spearmanr(first, second).statistic)
