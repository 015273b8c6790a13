"""Power laws: one exponent over a range."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactimg.analysis.curve_fit import Points, fit_line
from contactimg.analysis.estimates import Estimate, jackknife_covariance, student_estimate
from contactimg.errors import InputError

Values = NDArray[np.float64]


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
    chi_square : float
    freedom : int
        Points minus two.
    n_points, n_places : int
        With two places or more the uncertainties come from leaving out one place at a time.
    confidence : float
        Of the intervals.
    zero : float
        What was taken off every x before the fit.
    here : Estimate or None
        The exponent with what the errors of the measurement alone leave open: of these very places, where the
        interval of ``exponent`` is that of the surface, whatever its places. None if not computed.
    another_surface : Estimate or None
        The exponent with the interval that holds the one of another surface of the same kind, of as many
        places. None if not computed.
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
    zero: float = 0.0
    here: Estimate | None = None
    another_surface: Estimate | None = None

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
        Place on the sample where each point was measured. Errors within one place may be correlated.
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
    logs, reference = logarithms(x, y, x_std, y_std, correlation)
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
        amplitude=exponential(offset),
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


def logarithms(
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
    """Line parameters with each place left out; None for one place or if only one x remains."""
    rests = [_part(logs, labels != place) for place in range(int(labels.max()) + 1)]
    if len(rests) < 2 or any(np.ptp(np.asarray(rest.x)) == 0 for rest in rests):
        return None
    return np.array([fit_line(rest).parameters for rest in rests])


def exponential(logarithm: Estimate, *, factor: float = 1.0) -> Estimate:
    """Exponential of an estimated logarithm, times a factor; limits may overflow to 0 and infinity."""
    with np.errstate(over="ignore"):
        value = factor * float(np.exp(logarithm.value))
        low, high = (factor * float(np.exp(limit)) for limit in (logarithm.low, logarithm.high))
    return Estimate(value, value * logarithm.std, low, high)
