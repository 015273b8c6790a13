"""Broken power laws: two exponents and the break where they meet."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from contactimg.analysis.curve_fit import Curve, CurveFit, Points, fit_curve, fit_line
from contactimg.analysis.estimates import Estimate
from contactimg.analysis.power_laws import PowerLaw, exponential, fit_power_law, logarithms
from contactimg.errors import InputError

Values = NDArray[np.float64]

_MIN_POINTS_PER_SIDE = 3
"""Fewest points on each side of a break. Theory: two fix a line, one more leaves a degree of freedom."""

_MIN_RANGE_FRACTION = 0.1
"""Least share of the range of ln x on each side of a break. Chosen by hand; sensitivity not measured."""

_N_BREAKS = 60
"""Number of breaks tried over the range. Chosen by hand; the best one is refined."""

_N_REWEIGHTINGS = 6
"""Number of times the weights are updated with a break held fixed; they converge by a factor of about ten
each."""


@dataclass(frozen=True)
class BrokenLaw:
    """Two power laws that meet at a break.

    Parameters
    ----------
    low_exponent, high_exponent : Estimate
        Below and above the break.
    break_x : Estimate
        Where they meet; the interval extends to 0 or infinity where the points do not bound it.
    break_y : float
        y at the break.
    single : PowerLaw
        A single law through the same points.
    p_value : float
        Probability that points on a single law show at least this improvement in chi-square with a break.
    low, high : float
        Range of x that was fitted.
    scatter : float
        Relative scatter of y that the stated errors do not explain.
    chi_square : float
    freedom : int
        Points minus four.
    n_points : int
    confidence : float
        Of the intervals.
    """

    low_exponent: Estimate
    high_exponent: Estimate
    break_x: Estimate
    break_y: float
    single: PowerLaw
    p_value: float
    low: float
    high: float
    scatter: float
    chi_square: float
    freedom: int
    n_points: int
    confidence: float

    @property
    def supported(self) -> bool:
        """Whether a break is significant at the confidence of the intervals."""
        return bool(self.p_value < 1 - self.confidence)

    def value(self, x: ArrayLike) -> Values:
        """The law at x."""
        ratio = np.asarray(x, dtype=np.float64) / self.break_x.value
        exponent = np.where(ratio < 1, self.low_exponent.value, self.high_exponent.value)
        return self.break_y * ratio**exponent


def fit_broken_law(
    x: ArrayLike,
    y: ArrayLike,
    *,
    x_std: ArrayLike = 0.0,
    y_std: ArrayLike = 0.0,
    correlation: ArrayLike = 0.0,
    confidence: float = 0.95,
) -> BrokenLaw:
    """Fit two power laws and the break between them to points with errors on both axes.

    Parameters
    ----------
    x, y : array_like, shape (n,)
        Positive; seven points at least, at six different x.
    x_std, y_std : array_like, shape (n,) or scalar
        Standard uncertainties, in the units of x and y.
    correlation : array_like, shape (n,) or scalar
        Of the errors of x and y of a point.
    confidence : float
        Of the intervals.

    Returns
    -------
    BrokenLaw

    Raises
    ------
    InputError
        If a value is not positive or there are too few points, altogether or at one end.

    Notes
    -----
    ``ln y = c + m (ln x - u)``, ``m`` the one exponent below ``u`` and the other above, continuous at ``u``.
    Sixty breaks, with at least three points and a tenth of the range on either side, are tried with one
    excess scatter, and the best is refined. The interval of the break is the range where chi-square stays
    below ``1 + t^2/(n - 4)`` times its minimum (a profile likelihood, not symmetric), or below its minimum
    plus ``t^2`` if the minimum is below the degrees of freedom. Exponents have Student's intervals.
    ``p_value`` is Davies' bound for a parameter, the break, that exists only under the alternative
    hypothesis.

    References
    ----------
    Davies, Biometrika 74 (1987) 33, doi:10.1093/biomet/74.1.33, eq. (3.4).

    Examples
    --------
    >>> x = np.geomspace(1.0, 1e4, 17)
    >>> law = fit_broken_law(x, np.where(x < 50, (x / 50) ** 0.8, (x / 50) ** 0.4), y_std=1e-3 * x**0.4)
    >>> [round(e.value, 3) for e in (law.low_exponent, law.high_exponent, law.break_x)], law.supported
    ([0.8, 0.4, 50.0], True)
    """
    logs, reference = logarithms(x, y, x_std, y_std, correlation)
    u = np.asarray(logs.x)
    fewest = 2 * _MIN_POINTS_PER_SIDE
    if len(logs) < fewest + 1 or len(np.unique(u)) < fewest:
        raise InputError(
            f"two power laws need {fewest + 1} points or more at {fewest} or more different x, "
            f"got {len(logs)} at {len(np.unique(u))}"
        )
    single = fit_power_law(x, y, x_std=x_std, y_std=y_std, correlation=correlation, confidence=confidence)
    search = _BreakSearch(logs)
    best = search.best
    return BrokenLaw(
        low_exponent=best.estimate(1, confidence=confidence),
        high_exponent=best.estimate(2, confidence=confidence),
        break_x=exponential(search.place(confidence), factor=reference),
        break_y=float(np.exp(best.parameters[0])),
        single=single,
        p_value=search.p_value(),
        low=reference * float(np.exp(u.min())),
        high=reference * float(np.exp(u.max())),
        scatter=best.scatter,
        chi_square=best.chi_square,
        freedom=best.freedom,
        n_points=len(logs),
        confidence=confidence,
    )


_BROKEN = Curve(
    value=lambda c, u: c[0] + np.where(u < c[3], c[1], c[2]) * (u - c[3]),
    slope=lambda c, u: np.where(u < c[3], c[1], c[2]),
    gradient=lambda c, u: np.column_stack([_hinge(c[3], u), -np.where(u < c[3], c[1], c[2])]),
)


def _hinge(place: float, u: Values) -> Values:
    """Derivatives of two lines that meet at a break by their common value there and by their slopes."""
    away = u - place
    return np.column_stack([np.ones_like(u), np.minimum(away, 0.0), np.maximum(away, 0.0)])


def _fixed_break(place: float) -> Curve:
    """Two lines that meet at a fixed break."""
    return Curve(
        value=lambda c, u: _hinge(place, u) @ c,
        slope=lambda c, u: np.where(u < place, c[1], c[2]),
        gradient=lambda _, u: _hinge(place, u),
    )


class _BreakSearch:
    """Grid search for the break over the range of the points, and the best fit.

    The parameters of ``best`` are the value at the break, the slopes below and above, and the break;
    ``profile`` is the least chi-square with the break fixed at each of ``breaks``, with the excess scatter of
    ``best``.
    """

    def __init__(self, logs: Points) -> None:
        self.logs = logs
        u = np.unique(np.asarray(logs.x))
        margin = _MIN_RANGE_FRACTION * (u[-1] - u[0])
        ends = max(u[_MIN_POINTS_PER_SIDE - 1], u[0] + margin), min(u[-_MIN_POINTS_PER_SIDE], u[-1] - margin)
        if ends[0] > ends[1]:
            raise InputError(
                f"two power laws need {_MIN_POINTS_PER_SIDE} points in either part of the range; "
                "the points crowd at one end"
            )
        self.breaks = np.linspace(*ends, _N_BREAKS)
        flat = Points(logs.x, logs.y, y_std=1.0)
        first = min(
            (self._fit_fixed_break(place, flat, 0.0) for place in self.breaks), key=lambda fit: fit[1]
        )
        self.best = self._refined(first[0])
        self.profile = self._profile()
        lowest = int(np.argmin(self.profile))
        if self.profile[lowest] < self.best.chi_square:  # with the weights another break is better
            start = self._fit_fixed_break(self.breaks[lowest], self.logs, self.best.scatter)[0]
            self.best = self._refined(start)
            self.profile = self._profile()

    def _fit_fixed_break(self, place: float, points: Points, scatter: float) -> tuple[Values, float]:
        """Parameters and chi-square with the break fixed; weights from the slopes of the last pass."""
        basis, y = _hinge(place, np.asarray(points.x)), np.asarray(points.y)
        below = np.asarray(points.x) < place
        weights = np.ones_like(y)
        for _ in range(_N_REWEIGHTINGS):
            weighted = basis * (weights**2)[:, None]
            c = np.linalg.solve(weighted.T @ basis, weighted.T @ y)
            variance = points.variance(np.where(below, c[1], c[2])) + scatter**2
            weights = 1 / np.sqrt(np.maximum(variance, np.finfo(float).tiny))
        return np.append(c, place), float(np.sum(((y - basis @ c) * weights) ** 2))

    def _refined(self, start: Values) -> CurveFit:
        """Fit with the break free, or fixed at its start if it would leave the range of the breaks tried."""
        free = fit_curve(_BROKEN, self.logs, start=start)
        if self.breaks[0] <= free.parameters[3] <= self.breaks[-1]:
            return free
        held = fit_curve(_fixed_break(start[3]), self.logs, start=start[:3])
        covariance = np.pad(held.covariance, (0, 1))
        return CurveFit(
            np.append(held.parameters, start[3]), covariance, held.scatter, held.chi_square, held.freedom - 1
        )

    def _profile(self) -> Values:
        """Least chi-square at each break."""
        return np.array(
            [self._fit_fixed_break(place, self.logs, self.best.scatter)[1] for place in self.breaks]
        )

    def place(self, confidence: float) -> Estimate:
        """The break with its profile-likelihood interval."""
        quantile = float(stats.t.ppf((1 + confidence) / 2, max(self.best.freedom, 1)))
        unit = max(self.best.chi_square / max(self.best.freedom, 1), 1.0)
        within = self.breaks[self.profile <= self.best.chi_square + unit * quantile**2]
        value, step = float(self.best.parameters[3]), float(self.breaks[1] - self.breaks[0])
        low, high = min([value, *within]) - step, max([value, *within]) + step
        return Estimate(
            value,
            float(np.sqrt(self.best.covariance[3, 3])),
            low if low > self.breaks[0] else -np.inf,
            high if high < self.breaks[-1] else np.inf,
        )

    def p_value(self) -> float:
        """Davies' bound on the probability of this improvement in chi-square without a break."""
        line = fit_line(self.logs, scatter=self.best.scatter).chi_square
        gain = np.maximum(line - self.profile, 0.0)
        variation = float(np.sum(np.abs(np.diff(np.sqrt(gain)))))
        most = float(gain.max())
        bound = float(stats.chi2.sf(most, 1)) + variation * np.exp(-most / 2) / np.sqrt(2 * np.pi)
        return min(bound, 1.0)
