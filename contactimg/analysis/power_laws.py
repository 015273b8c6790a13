"""Power laws: one exponent over a range, or two with the place where they meet."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from contactimg.analysis.curve_fit import Curve, CurveFit, Points, fit_curve, fit_line
from contactimg.analysis.estimates import Estimate, jackknife_covariance, student_estimate
from contactimg.errors import InputError

__all__ = ["BrokenLaw", "PowerLaw", "fit_broken_law", "fit_power_law"]

Values = NDArray[np.float64]

_LEAST = 3
"""Points on each side of a break, so that each exponent has one to spare."""

_BREAKS = 60
"""Breaks tried over the range."""


@dataclass(frozen=True)
class PowerLaw:
    """``y = amplitude (x/reference)^exponent``.

    Parameters
    ----------
    exponent, amplitude : Estimate
        The amplitude is y at ``reference``.
    reference : float
        Geometric mean of x: there the amplitude and the exponent hardly depend on each other.
    low, high : float
        Range of x that was fitted.
    scatter : float
        Relative scatter of y that the stated errors do not explain.
    chi_square : float
    freedom : int
        Points minus two.
    n_points, n_places : int
        With two places or more the uncertainties come from leaving out one place at a time.
    confidence : float
        Of the intervals.
    """

    exponent: Estimate
    amplitude: Estimate
    reference: float
    low: float
    high: float
    scatter: float
    chi_square: float
    freedom: int
    n_points: int
    n_places: int
    confidence: float

    def value(self, x: ArrayLike) -> Values:
        """The law at x."""
        return self.amplitude.value * (np.asarray(x, dtype=np.float64) / self.reference) ** (
            self.exponent.value
        )


def fit_power_law(
    x: ArrayLike,
    y: ArrayLike,
    *,
    x_std: ArrayLike = 0.0,
    y_std: ArrayLike = 0.0,
    correlation: ArrayLike = 0.0,
    places: Sequence[Hashable] | None = None,
    confidence: float = 0.95,
) -> PowerLaw:
    """Fit a power law to points with errors on both axes.

    Parameters
    ----------
    x, y : array_like, shape (n,)
        Positive; two different x at least.
    x_std, y_std : array_like, shape (n,) or scalar
        Standard uncertainties, in the units of x and y.
    correlation : array_like, shape (n,) or scalar
        Of the errors of x and y of a point.
    places : sequence, shape (n,), optional
        Where on the sample each point was measured. Errors of the points of one place may hang together.
    confidence : float
        Of the intervals.

    Returns
    -------
    PowerLaw

    Raises
    ------
    InputError
        If a value is not positive, or all x are equal.

    Notes
    -----
    A straight line through the logarithms (`contactimg.analysis.curve_fit.fit_curve`), with relative errors
    as theirs: good for relative errors up to some 20 %. With one place the interval is Student's with n - 2
    degrees of freedom, and infinite for two points; with N places it has N - 1.

    Examples
    --------
    >>> law = fit_power_law([1.0, 2.0, 4.0, 8.0], [3.0, 6.1, 11.9, 24.1])
    >>> round(law.exponent.value, 3), bool(law.exponent.low < 1 < law.exponent.high)
    (0.998, True)
    """
    logs, reference = _logarithms(x, y, x_std, y_std, correlation)
    fit = fit_line(logs)
    exponent, offset = fit.estimate(1, confidence=confidence), fit.estimate(0, confidence=confidence)
    labels = np.zeros(len(logs), int) if places is None else _numbered(places, len(logs))
    n_places = int(labels.max()) + 1
    without = _line_without(logs, labels)
    if without is not None:
        std = np.sqrt(np.diag(jackknife_covariance(without)))
        offset, exponent = (
            student_estimate(float(value), float(s), freedom=n_places - 1, confidence=confidence)
            for value, s in zip(fit.parameters, std, strict=True)
        )
    x = np.asarray(x, dtype=np.float64)
    return PowerLaw(
        exponent=exponent,
        amplitude=_exponential(offset),
        reference=reference,
        low=float(x.min()),
        high=float(x.max()),
        scatter=fit.scatter,
        chi_square=fit.chi_square,
        freedom=fit.freedom,
        n_points=len(logs),
        n_places=n_places,
        confidence=confidence,
    )


def _logarithms(
    x: ArrayLike, y: ArrayLike, x_std: ArrayLike, y_std: ArrayLike, correlation: ArrayLike
) -> tuple[Points, float]:
    """Logarithms of the points, x over its geometric mean, and that mean."""
    x, y = (np.atleast_1d(np.asarray(values, dtype=np.float64)) for values in (x, y))
    for name, values in (("x", x), ("y", y)):
        if not (values > 0).all():
            raise InputError(f"a power law needs positive points, got {name} = {values.min()}; leave it out")
    reference = float(np.exp(np.mean(np.log(x)))) if len(x) else 1.0
    relative = np.asarray(x_std, dtype=np.float64) / x, np.asarray(y_std, dtype=np.float64) / y
    return Points(np.log(x / reference), np.log(y), *relative, correlation), reference


def _numbered(places: Sequence[Hashable], count: int) -> NDArray[np.intp]:
    """Numbers from 0 for the places of the points."""
    if len(places) != count:
        raise InputError(f"each of the {count} points needs its place, got {len(places)}")
    names = list(dict.fromkeys(places))
    return np.array([names.index(place) for place in places])


def _part(points: Points, keep: NDArray[np.bool_]) -> Points:
    """Some of the points."""
    names = ("x", "y", "x_std", "y_std", "correlation")
    return Points(*(np.asarray(getattr(points, name))[keep] for name in names))


def _line_without(logs: Points, labels: NDArray[np.intp]) -> Values | None:
    """Parameters of the line without each place; None for one place, or if a rest has one x only."""
    rests = [_part(logs, labels != place) for place in range(int(labels.max()) + 1)]
    if len(rests) < 2 or any(np.ptp(np.asarray(rest.x)) == 0 for rest in rests):
        return None
    return np.array([fit_line(rest).parameters for rest in rests])


def _exponential(logarithm: Estimate, *, factor: float = 1.0) -> Estimate:
    """The number with this logarithm, times a factor; limits beyond the floats are 0 and infinity."""
    with np.errstate(over="ignore"):
        value = factor * float(np.exp(logarithm.value))
        low, high = (factor * float(np.exp(limit)) for limit in (logarithm.low, logarithm.high))
    return Estimate(value, value * logarithm.std, low, high)


@dataclass(frozen=True)
class BrokenLaw:
    """Two power laws that meet at a break.

    Parameters
    ----------
    low_exponent, high_exponent : Estimate
        Below and above the break.
    break_x : Estimate
        Where they meet; the interval reaches to 0 or infinity if the points do not bound it on that side.
    break_y : float
        y there.
    single : PowerLaw
        One law through the same points.
    p_value : float
        Probability that points on one law would gain as much from a break, at any place, as these do.
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
        """Whether the points call for a break, at the confidence of the intervals."""
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
        If a value is not positive or there are too few points.

    Notes
    -----
    ``ln y = c + m (ln x - u)``, ``m`` the one exponent below ``u`` and the other above, continuous at ``u``.
    Sixty breaks over the range, with three points or more on either side, are tried with one excess scatter;
    the best is refined. The interval of the break is where chi-square stays below its minimum times
    ``1 + t^2/(n - 4)`` (a profile likelihood, not symmetric); with chi-square below its degrees of freedom,
    below its minimum plus ``t^2``. Exponents have Student's intervals. ``p_value`` is Davies' bound for
    a break that exists under one of the two hypotheses only.

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
    logs, reference = _logarithms(x, y, x_std, y_std, correlation)
    u = np.asarray(logs.x)
    if len(logs) < 2 * _LEAST + 1 or len(np.unique(u)) < 2 * _LEAST:
        raise InputError(
            f"two power laws need {2 * _LEAST + 1} points at {2 * _LEAST} different x at least, "
            f"got {len(logs)} at {len(np.unique(u))}"
        )
    single = fit_power_law(x, y, x_std=x_std, y_std=y_std, correlation=correlation, confidence=confidence)
    search = _BreakSearch(logs)
    best = search.best
    return BrokenLaw(
        low_exponent=best.estimate(1, confidence=confidence),
        high_exponent=best.estimate(2, confidence=confidence),
        break_x=_exponential(search.place(confidence), factor=reference),
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
    """Derivatives of two lines that meet at a place by their common value and their slopes."""
    away = u - place
    return np.column_stack([np.ones_like(u), np.minimum(away, 0.0), np.maximum(away, 0.0)])


def _held(place: float) -> Curve:
    """Two lines that meet at a given place."""
    return Curve(
        value=lambda c, u: _hinge(place, u) @ c,
        slope=lambda c, u: np.where(u < place, c[1], c[2]),
        gradient=lambda _, u: _hinge(place, u),
    )


class _BreakSearch:
    """Breaks tried over the range of the points, and the best one.

    ``best`` has the parameters value at the break, slopes below and above, and place; ``profile`` is the
    least chi-square with the break held at each of ``breaks``, all with the excess scatter of ``best``.
    """

    def __init__(self, logs: Points) -> None:
        self.logs = logs
        u = np.unique(np.asarray(logs.x))
        self.breaks = np.linspace(u[_LEAST - 1], u[-_LEAST], _BREAKS)
        flat = Points(logs.x, logs.y, y_std=1.0)
        first = min((self._fit(place, flat, 0.0) for place in self.breaks), key=lambda fit: fit.chi_square)
        self.best = self._refined(first)
        self.profile = self._profile()
        lowest = int(np.argmin(self.profile))
        if self.profile[lowest] < self.best.chi_square:  # the weights prefer another break than flat ones
            self.best = self._refined(self._fit(self.breaks[lowest], self.logs, self.best.scatter))
            self.profile = self._profile()

    def _fit(self, place: float, points: Points, scatter: float) -> CurveFit:
        """The lines with the break held; the place is added to the parameters."""
        u, y = np.asarray(points.x), np.asarray(points.y)
        start = np.linalg.lstsq(_hinge(place, u), y)[0]
        fit = fit_curve(_held(place), points, start=start, scatter=scatter)
        return replace(fit, parameters=np.append(fit.parameters, place))

    def _refined(self, fit: CurveFit) -> CurveFit:
        """The lines with the break free; held where it is if it would leave the breaks that are tried."""
        free = fit_curve(_BROKEN, self.logs, start=fit.parameters)
        if self.breaks[0] <= free.parameters[3] <= self.breaks[-1]:
            return free
        held = fit_curve(_held(fit.parameters[3]), self.logs, start=fit.parameters[:3])
        covariance = np.pad(held.covariance, (0, 1))
        return CurveFit(
            np.append(held.parameters, fit.parameters[3]),
            covariance,
            held.scatter,
            held.chi_square,
            held.freedom - 1,
        )

    def _profile(self) -> Values:
        """Least chi-square at each break."""
        return np.array([self._fit(place, self.logs, self.best.scatter).chi_square for place in self.breaks])

    def place(self, confidence: float) -> Estimate:
        """The break, with the interval over which chi-square stays low."""
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
        """Davies' bound on the probability of this gain by a break that is not there."""
        line = fit_line(self.logs, scatter=self.best.scatter).chi_square
        gain = np.maximum(line - self.profile, 0.0)
        variation = float(np.sum(np.abs(np.diff(np.sqrt(gain)))))
        most = float(gain.max())
        bound = float(stats.chi2.sf(most, 1)) + variation * np.exp(-most / 2) / np.sqrt(2 * np.pi)
        return min(bound, 1.0)
