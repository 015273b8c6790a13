"""Power laws: one exponent over a range, or two that meet; straight lines through the logarithms."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize, special

from contactimg.analysis.estimates import Estimate, student_estimate
from contactimg.analysis.linear_fit import Points, fit_line, fit_linear, least_chi_square, two_lines
from contactimg.errors import InputError

Values = NDArray[np.float64]

POINTS_PER_SIDE = 3
"""Fewest points on each side of a break. Theory: two fix a line, one more leaves a degree of freedom."""


@dataclass(frozen=True)
class PowerLaw:
    """``y = amplitude (x/reference)^exponent``.

    Parameters
    ----------
    exponent, amplitude : Estimate
        The amplitude is y at ``reference``.
    reference : float
        Geometric mean of x, where amplitude and exponent are nearly uncorrelated.
    low, high : float
        Range of x that was fitted.
    scatter : float
        Relative scatter of y that the stated errors do not explain.
    n_points, n_places : int
    confidence : float
        Of the intervals.
    zero : float
        What was taken off every x before the fit.
    """

    exponent: Estimate
    amplitude: Estimate
    reference: float
    low: float
    high: float
    scatter: float
    n_points: int
    n_places: int
    confidence: float
    zero: float = 0.0

    def value(self, x: ArrayLike) -> Values:
        """The value of the law at x."""
        ratio = np.asarray(x, dtype=np.float64) / self.reference
        return self.amplitude.value * ratio**self.exponent.value


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
        Probability that points on a single law seem to break at least as much.
    """

    low_exponent: Estimate
    high_exponent: Estimate
    break_x: Estimate
    break_y: float
    single: PowerLaw
    p_value: float

    @property
    def supported(self) -> bool:
        """Whether a break is significant at the confidence of the intervals."""
        return bool(self.p_value < 1 - self.single.confidence)

    def value(self, x: ArrayLike) -> Values:
        """The value of the law at x."""
        ratio = np.asarray(x, dtype=np.float64) / self.break_x.value
        exponent = np.where(ratio < 1, self.low_exponent.value, self.high_exponent.value)
        return self.break_y * ratio**exponent


def fit_power_law(
    x: ArrayLike,
    y: ArrayLike,
    *,
    x_std: ArrayLike = 0.0,
    y_std: ArrayLike = 0.0,
    correlation: ArrayLike = 0.0,
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
    A straight line through the logarithms (`contactimg.analysis.linear_fit`), with relative errors as theirs:
    good for relative errors up to some 20 %. The interval is Student's with n - 2 degrees of freedom, and
    infinite for two points.

    Examples
    --------
    >>> law = fit_power_law([1.0, 2.0, 4.0, 8.0], [3.0, 6.1, 11.9, 24.1])
    >>> round(law.exponent.value, 3), bool(law.exponent.low < 1 < law.exponent.high)
    (0.998, True)
    """
    logs, reference = logarithms(x, y, x_std, y_std, correlation)
    fit = fit_line(logs)
    offset, exponent = (fit.estimate(k, confidence=confidence) for k in (0, 1))
    amplitude, ends = exponential(offset), (float(np.min(x)), float(np.max(x)))
    return PowerLaw(exponent, amplitude, reference, *ends, fit.scatter, len(logs), 1, confidence)


def logarithms(
    x: ArrayLike, y: ArrayLike, x_std: ArrayLike, y_std: ArrayLike, correlation: ArrayLike = 0.0
) -> tuple[Points, float]:
    """Logarithms of the points, x over its geometric mean, and that mean."""
    x, y = (np.atleast_1d(np.asarray(values, dtype=np.float64)) for values in (x, y))
    for name, values in (("x", x), ("y", y)):
        if not (values > 0).all():
            raise InputError(f"a power law needs positive points, got {name} = {values.min()}; leave it out")
    reference = float(np.exp(np.mean(np.log(x)))) if len(x) else 1.0
    relative = np.asarray(x_std, dtype=np.float64) / x, np.asarray(y_std, dtype=np.float64) / y
    return Points(np.log(x / reference), np.log(y), *relative, correlation), reference


def exponential(logarithm: Estimate, *, factor: float = 1.0) -> Estimate:
    """Exponential of an estimated logarithm, times a factor; limits may overflow to 0 and infinity."""
    with np.errstate(over="ignore"):
        value = factor * float(np.exp(logarithm.value))
        low, high = (factor * float(np.exp(limit)) for limit in (logarithm.low, logarithm.high))
    return Estimate(value, value * logarithm.std, low, high)


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
    ``ln y = c + m (ln x - u)``, ``m`` the one exponent below ``u`` and the other above, continuous at ``u``:
    the same fit with the terms of two lines that meet at each of sixty breaks, of which the best one is
    refined. Exponents and the logarithm of the break have Student's intervals; that of the break is open
    where it reaches the end of those tried. ``p_value`` is Davies' bound for a parameter, the break, that
    exists only under the alternative hypothesis.

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
    logs, _ = logarithms(x, y, x_std, y_std, correlation)
    u = np.asarray(logs.x)
    breaks = break_places(u)
    single = fit_power_law(x, y, x_std=x_std, y_std=y_std, correlation=correlation, confidence=confidence)

    def misfit(places: Values, scatter: float) -> Values:
        """Chi-square; infinite where the points on one side do not decide on an exponent."""
        with np.errstate(over="ignore", invalid="ignore"):
            return least_chi_square(two_lines(np.reshape(places, (-1, 1))), logs, scatter=scatter)

    first = float(breaks[misfit(breaks, 0.0).argmin()])
    scatter = fit_linear(two_lines(first), logs).scatter
    profile = misfit(breaks, scatter)
    best = int(profile.argmin())
    near = breaks[max(best - 1, 0)], breaks[min(best + 1, len(breaks) - 1)]
    refined = optimize.minimize_scalar(
        lambda place: float(misfit(place, scatter)[0]), bounds=near, method="bounded", options={"xatol": 1e-9}
    )
    place = float(refined.x if refined.fun <= profile[best] else breaks[best])
    terms = two_lines(place)
    found = fit_linear(terms, logs, scatter=scatter)
    gradient = np.column_stack([terms(u, 0), -terms(u, 1) @ found.parameters])
    stds = np.sqrt(np.diag(np.linalg.pinv((gradient * found.weights[:, None]).T @ gradient, hermitian=True)))
    gain = np.maximum(float(fit_line(logs, scatter=scatter).chi_square) - profile, 0.0)
    lines = [
        student_estimate(float(value), float(std), freedom=len(logs) - 4, confidence=confidence)
        for value, std in zip([*found.parameters[1:], place], stds[1:], strict=True)
    ]
    return broken_law(single, lines, gain, breaks, level=float(found.parameters[0]))


def broken_law(
    single: PowerLaw, lines: Sequence[Estimate], gain: Values, breaks: Values, *, level: float
) -> BrokenLaw:
    """The law of two lines through the logarithms of points.

    ``lines`` are their slopes and the place where they meet, at the height ``level``; ``gain`` is that in
    chi-square at each of the ``breaks`` tried. The interval of the place is open at the ends of these;
    without support it is anywhere.
    """
    below, above, place = lines
    # Davies' bound on the chance of as large a gain at any of the breaks tried where there is none
    variation, most = float(np.sum(np.abs(np.diff(np.sqrt(gain))))), float(gain.max())
    chance = float(special.chdtrc(1, most)) + variation * np.exp(-most / 2) / np.sqrt(2 * np.pi)
    p_value = min(float(chance), 1.0)
    supported = p_value < 1 - single.confidence
    low = place.low if supported and place.low > breaks[0] else -np.inf
    high = place.high if supported and place.high < breaks[-1] else np.inf
    break_x = exponential(replace(place, low=low, high=high), factor=single.reference)
    return BrokenLaw(below, above, break_x, float(np.exp(level)), single, p_value)


def break_places(x: Values) -> Values:
    """Breaks to try between points, with enough of them and of their range on either side."""
    places = np.unique(x)
    fewest = 2 * POINTS_PER_SIDE
    if x.size < fewest + 1 or places.size < fewest:
        raise InputError(
            f"two power laws need {fewest + 1} points or more at {fewest} or more different x, "
            f"got {x.size} at {places.size}"
        )
    margin = 0.1 * (places[-1] - places[0])  # by hand; sensitivity not measured
    low = max(places[POINTS_PER_SIDE - 1], places[0] + margin)
    high = min(places[-POINTS_PER_SIDE], places[-1] - margin)
    if low > high:
        raise InputError(
            f"two power laws need {POINTS_PER_SIDE} points in either part of the range; "
            "the points crowd at one end"
        )
    return np.linspace(low, high, 60)  # by hand; the best one is refined
