"""The fit behind `contactimg.calibration.jkr`: linear in what is sought, averaged over what is not known.

With ``x`` the contact radius the load read is

    P = H K x^3/R - A sqrt(6 pi) S x^{3/2} + zero + drift,

``H`` and ``A`` being 1 on a half-space (`contactimg.mechanics.layer_contact`). The zero has a prior
distribution (`contactimg.analysis.load_cell`). The noise of the loads is unknown: it is modelled as a
constant part plus a part proportional to the load, and the fits for many amplitudes of the two, and for the
widths of the zero's prior, are averaged, each weighted by its restricted likelihood. For few data the average
has the wide tails of Student's distribution.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special, stats

from contactimg.analysis.load_cell import ZERO_SCALES, ZERO_WEIGHTS
from contactimg.mechanics.layer_contact import layer_factors

Values = NDArray[np.float64]

CONSTANT_VARIANCE_SHARES = np.array([1.0, 0.1, 0.003])
"""Shares of the noise variance, at the rms load, that do not grow with the load. Chosen by hand; sensitivity
not measured."""
SHARE_PRIORS = np.array([0.5, 0.25, 0.25])
"""Prior weights of these shares. Chosen: a noisy zero is as likely as a noisy scale."""
NOISE_SCALES = np.geomspace(0.03, 1e4, 160)
"""Noise in units of the scatter of the residuals. Theory: the likelihood vanishes below, and the part above
is 1e-4 of Student's tail at one degree of freedom."""
EXPECTED_NOISE = 1e-3
"""Noise, over the rms load, below which small residuals are taken for chance: the prior of the noise is flat
in its logarithm above and proportional to it below. Chosen: repeatability that data sheets of load cells
state; without it, intervals from five loads hold the truth in 87 % of the series instead of 95 %."""
N_DRAWS = 20000
"""Number of draws from the distribution of the parameters. Chosen by hand; sensitivity not measured."""
N_LATENT_ITERATIONS = 4
"""Number of iterations of the latent radii. Chosen by hand; sensitivity not measured."""
MIN_OUTLIER_FRACTION = 1e-6
"""Least residual of an outlier relative to the rms load: below it residuals are rounding errors. Chosen by
hand."""
OUTLIER_FALSE_ALARM_RATE = 1e-3
"""False-alarm rate: probability that a series without outliers loses a frame."""
EXACT_CHI_SQUARE = 1e-18
"""Chi-square of scaled loads below which residuals are rounding errors."""
SLOPE_STEP = 1e-4
"""Relative step of the radius for the slope of the law."""


@dataclass(frozen=True, eq=False)
class JkrSeries:
    """Loads and radii with the scales that make the fit one of numbers of order one.

    Parameters
    ----------
    load, radius, radius_std : ndarray, shape (n,), N and m
    load_scale, radius_scale : float, N and m
    zero_std : float, N
        Standard uncertainty of the zero of the loads; 0 for one that is exact.
    thickness : float or None, m
        Of the elastic layer.
    branches : ndarray, shape (n, k)
        One column a work of adhesion: 1 where it acts.
    drift : ndarray, shape (n, 0 or 1), N per unit
        What one unit of a drift adds to each load, where one is fitted.
    edge : ndarray or None, shape (n,), N per px
        What one pixel of a shift of the edge (`contactimg.calibration.jkr_edge`) adds, where it is fitted.
    """

    load: Values
    radius: Values
    radius_std: Values
    load_scale: float
    radius_scale: float
    zero_std: float
    thickness: float | None
    branches: Values
    drift: Values
    edge: Values | None = None

    @property
    def scaled_load(self) -> Values:
        """The loads over their scale."""
        return self.load / self.load_scale

    @property
    def physical(self) -> int:
        """Number of columns without prior: stiffness and adhesion."""
        return 1 + self.branches.shape[1]

    def part(self, used: NDArray[np.bool_]) -> "JkrSeries":
        """Some of the frames."""
        names = ("load", "radius", "radius_std", "branches", "drift")
        edge = None if self.edge is None else self.edge[used]
        return replace(self, edge=edge, **{name: getattr(self, name)[used] for name in names})

    def design(self, radius: Values) -> Values:
        """Scaled load per unit of the stiffness, of the adhesion, of a drift, the edge and the zero."""
        x = radius / self.radius_scale
        pressing, adhesive = (1.0, 1.0) if self.thickness is None else layer_factors(radius / self.thickness)
        zero = np.ones((len(x), int(self.zero_std > 0)))
        edge = np.zeros((len(x), 0)) if self.edge is None else self.edge[:, None] / self.load_scale
        return np.column_stack(
            [
                pressing * x**3,
                -(adhesive * x**1.5)[:, None] * self.branches,
                self.drift / self.load_scale,
                edge,
                zero,
            ]
        )

    def slope(self, radius: Values, theta: Values) -> Values:
        """Derivative of the scaled load by the radius, 1/m."""
        up, down = (self.design(radius * (1 + sign * SLOPE_STEP)) @ theta for sign in (1, -1))
        return np.asarray((up - down) / (2 * SLOPE_STEP * radius))


@dataclass(frozen=True, eq=False)
class JkrFit:
    """The fits for every noise model with their weights.

    ``variance`` is that of the most likely one, ``evidence`` the logarithm of their summed likelihoods. The
    covariances are for the draws: the amplitude and the
    growth of the noise are estimated from the same residuals, which costs two degrees of freedom (without
    this, 90 % of the intervals contain the truth for noise proportional to the load).
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
        draws = _draw(self.centres, self.covariances, self.weights)
        return draws[draws[:, 0] > 0]


def average_noises(series: JkrSeries) -> JkrFit:
    """Average the weighted fits over the noise models of the loads and the widths of the zero's prior.

    Parameters
    ----------
    series : JkrSeries
        At least as many frames as columns without prior.
    """
    y, latent = series.scaled_load, series.radius
    theta = _penalised(series)
    for _ in range(N_LATENT_ITERATIONS):
        design, slope = series.design(latent), series.slope(latent, theta)
        straight = y - slope * (series.radius - latent)
        own = (slope * series.radius_std) ** 2
        scales, variances = _noise_variances(series, straight - design @ theta, design @ theta, own)
        fit = _weighted_fits(series, straight, design, variances, scales / (scales + EXPECTED_NOISE))
        best = int(fit.weights.argmax())
        theta, variance = fit.centres[best], fit.variance
        moved = series.radius_std**2 * slope / variance * (straight - design @ theta)
        latent = np.maximum(series.radius + moved, 0.5 * series.radius)
    return fit


def _penalised(series: JkrSeries) -> Values:
    """Least squares with the zero's prior as one more datum, its weight that of the plain fit's scatter."""
    design = series.design(series.radius)
    plain = design[:, : series.physical]
    first = np.linalg.lstsq(plain, series.scaled_load, rcond=None)[0]
    if not series.zero_std:
        return np.asarray(np.linalg.lstsq(design, series.scaled_load, rcond=None)[0])
    scatter = float(np.sqrt(np.mean((series.scaled_load - plain @ first) ** 2)))
    row = np.zeros(design.shape[1])
    row[-1] = scatter / (series.zero_std / series.load_scale)
    rows, data = np.vstack([design, row]), np.append(series.scaled_load, 0.0)
    return np.asarray(np.linalg.lstsq(rows, data, rcond=None)[0])


def _noise_variances(series: JkrSeries, rest: Values, model: Values, own: Values) -> tuple[Values, Values]:
    """Noise of each model at the rms load; variances of the scaled loads, with those due to the radii."""
    freedom = max(len(model) - series.physical, 1)
    scatter = max(float(np.sqrt(np.sum(rest**2) / freedom)), 1e-9 * float(np.abs(series.scaled_load).max()))
    share = CONSTANT_VARIANCE_SHARES[:, None, None]
    shape = share + (1 - share) * model**2
    # the same geometric mean over the loads for every shape, so that the scale is that of the residuals
    level = np.exp(-0.5 * np.mean(np.log(shape), axis=-1))
    scales = np.asarray(NOISE_SCALES * scatter * level)  # every shape is 1 at the rms load
    variances = scales[..., None] ** 2 * shape
    return scales.ravel(), np.asarray(variances.reshape(-1, len(model)) + own)


def _weighted_fits(
    series: JkrSeries, y: Values, design: Values, variances: Values, expected: Values
) -> JkrFit:
    """Linear fits for every noise model and every width of the zero's prior, with their weights."""
    information = np.einsum("ni,mn,nj->mij", design, 1 / variances, design)
    moment = np.einsum("mn,nj->mj", y / variances, design)
    prior_logs = np.log(expected) + np.repeat(np.log(SHARE_PRIORS), len(NOISE_SCALES))
    noise_logs = np.log(variances).sum(axis=1) - 2 * prior_logs
    widths = ZERO_SCALES * series.zero_std / series.load_scale if series.zero_std else np.array([np.inf])
    centres, covariances, logs = [], [], []
    for width, weight in zip(widths, ZERO_WEIGHTS, strict=False):
        prior = np.zeros(information.shape[1:])
        prior[-1, -1] = width**-2
        narrowed = information + prior
        centre = np.linalg.solve(narrowed, moment[..., None])[..., 0]
        rest = y - centre @ design.T
        chi = (rest**2 / variances).sum(axis=1) + centre[:, -1] ** 2 * width**-2
        spread = 2 * np.log(width) if series.zero_std else 0.0
        logs.append(np.log(weight) - 0.5 * (noise_logs + np.linalg.slogdet(narrowed)[1] + chi + spread))
        centres.append(centre)
        # a zero counts as fitted as far as the data narrow its prior
        told = 1 - np.linalg.inv(narrowed)[:, -1, -1] * width**-2 if series.zero_std else 0.0
        freedom = np.maximum(len(y) - design.shape[1] + int(series.zero_std > 0) - told, 1.0)
        share = np.broadcast_to(freedom / (freedom + 2), len(variances))[:, None, None]
        covariances.append(np.linalg.inv(information * share + prior))
    joined = np.concatenate(logs)
    evidence = float(special.logsumexp(joined))
    weights = np.exp(joined - evidence)
    best = variances[int(weights.argmax()) % len(variances)]
    return JkrFit(np.concatenate(centres), np.concatenate(covariances), weights, best, evidence)


def _draw(centres: Values, covariances: Values, weights: Values) -> Values:
    """Evenly spread draws (a Kronecker sequence) from a weighted mixture of normal distributions."""
    uniform = even_draws(centres.shape[1] + 1)
    cumulated = np.cumsum(weights)
    which = np.minimum(np.searchsorted(cumulated, uniform[:, 0] * cumulated[-1]), len(weights) - 1)
    normal = special.ndtri(uniform[:, 1:])
    roots = np.linalg.cholesky(covariances)
    return centres[which] + np.einsum("nij,nj->ni", roots[which], normal)


def even_draws(dimensions: int) -> Values:
    """`N_DRAWS` points spread evenly over the unit cube (a Kronecker sequence)."""
    phi = 1.5
    for _ in range(60):  # x^{d+1} = x + 1: the generalised golden ratio
        phi = (1 + phi) ** (1 / (dimensions + 1))
    steps = (1 / phi) ** np.arange(1, dimensions + 1)
    uniform = (0.5 + np.arange(1, N_DRAWS + 1)[:, None] * steps) % 1
    return np.asarray(np.clip(uniform, 1e-12, 1 - 1e-12))


def least_squares(series: JkrSeries) -> float:
    """Chi-square of the scaled residuals for noise with a constant and a growing part, the zero free."""
    weight = 1 / np.sqrt(0.05 + series.scaled_load**2)
    design = series.design(series.radius) * weight[:, None]
    theta = np.linalg.lstsq(design, series.scaled_load * weight, rcond=None)[0]
    return float(np.sum((series.scaled_load * weight - design @ theta) ** 2))


def without_outliers(series: JkrSeries) -> NDArray[np.bool_]:
    """Mask of the frames to use: outliers from the fit to all others are removed one by one.

    Parameters
    ----------
    series : JkrSeries
        Its zero counts as one more datum.
    """
    used = np.ones(len(series.load), bool)
    for _ in range(len(used) // 4):
        n = int(used.sum())
        if n < 5 or len(np.unique(series.load[used])) < 4:
            break
        student, off = _deleted_residuals(series.part(used))
        worst = int(student.argmax())
        chance = n * 2 * stats.t.sf(student[worst], n - series.physical - 1)
        if chance > OUTLIER_FALSE_ALARM_RATE or off[worst] < MIN_OUTLIER_FRACTION:
            break
        used[np.flatnonzero(used)[worst]] = False
    return used


def _deleted_residuals(series: JkrSeries) -> tuple[Values, Values]:
    """Residual of each frame from the fit to the others over its standard error, and its size."""
    n, design, y = len(series.load), series.design(series.radius), series.scaled_load
    variance = average_noises(series).variance
    if series.zero_std:
        prior = np.zeros(design.shape[1])
        prior[-1] = 1.0
        design, y = np.vstack([design, prior]), np.append(y, 0.0)
        variance = np.append(variance, (series.zero_std / series.load_scale) ** 2)
    weighted = design / np.sqrt(variance)[:, None]
    hat = weighted @ np.linalg.pinv(weighted)
    rest = y / np.sqrt(variance)
    rest = rest - hat @ rest
    leverage = np.clip(np.diag(hat), 0.0, 1 - 1e-9)
    others = (np.sum(rest**2) - rest**2 / (1 - leverage)) / (n - series.physical - 1)
    floor = 1e-12 * np.sum(rest**2) + 1e-24
    student = np.abs(rest) / np.sqrt(np.maximum(others, floor) * (1 - leverage))
    return student[:n], np.abs(rest[:n]) * np.sqrt(variance[:n])
