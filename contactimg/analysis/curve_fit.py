"""Curves through points with errors on both axes: effective variances, and scatter that no error explains.

A point's distance from the curve ``f`` is weighed by ``s_y^2 + f'^2 s_x^2 - 2 f' cov(x, y) + s^2``. The
excess scatter ``s`` is zero if the stated errors explain the distances (chi-square at most the degrees of
freedom), and otherwise what makes them do so.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize

from contactimg.analysis.estimates import Estimate, student_estimate
from contactimg.errors import ConvergenceError, InputError

Values = NDArray[np.float64]

_ROUNDING = 1e-12
"""Of the size of y: distances below it are rounding errors."""


@dataclass(frozen=True, eq=False)
class Points:
    """Points with standard uncertainties on both axes.

    Parameters
    ----------
    x, y : array_like, shape (n,)
    x_std, y_std : array_like, shape (n,) or scalar
    correlation : array_like, shape (n,) or scalar
        Of the errors of x and y of a point.

    Raises
    ------
    InputError
        If a value is not finite, an uncertainty negative or a correlation outside -1..1.
    """

    x: ArrayLike
    y: ArrayLike
    x_std: ArrayLike = 0.0
    y_std: ArrayLike = 0.0
    correlation: ArrayLike = 0.0

    def __post_init__(self) -> None:
        x = np.atleast_1d(np.asarray(self.x, dtype=np.float64))
        for name in ("x", "y", "x_std", "y_std", "correlation"):
            values = np.broadcast_to(np.asarray(getattr(self, name), dtype=np.float64), x.shape)
            if not np.isfinite(values).all():
                raise InputError(f"the points of a fit must be finite, got {name} = {values.tolist()}")
            if name.endswith("std") and (values < 0).any():
                raise InputError(f"standard uncertainties must not be negative, got {name} = {values.min()}")
            object.__setattr__(self, name, values)
        if (np.abs(self.correlation) > 1 + 1e-9).any():
            raise InputError("a correlation lies between -1 and 1")

    def __len__(self) -> int:
        return len(np.asarray(self.x))

    def variance(self, slope: Values) -> Values:
        """Variance of a point's distance in y from a curve of this slope there."""
        x_part = slope * np.asarray(self.x_std)
        y_part = np.asarray(self.y_std)
        mixed = 2 * np.asarray(self.correlation) * x_part * y_part
        return np.maximum(x_part**2 + y_part**2 - mixed, 0.0)

    def adjusted(self, slope: Values, distance: Values, variance: Values) -> Values:
        """Most likely x of the points, given their distances from the curve."""
        x_std, y_std = np.asarray(self.x_std), np.asarray(self.y_std)
        pull = slope * x_std**2 - np.asarray(self.correlation) * x_std * y_std
        return np.asarray(self.x) + pull * distance / variance


@dataclass(frozen=True, eq=False)
class Curve:
    """A family of curves ``y = f(c, x)`` with parameters ``c``.

    Parameters
    ----------
    value : callable
        ``f(c, x)``, shape (n,).
    slope : callable
        ``df/dx``, shape (n,).
    gradient : callable
        ``df/dc``, shape (n, k).
    """

    value: Callable[[Values, Values], Values]
    slope: Callable[[Values, Values], Values]
    gradient: Callable[[Values, Values], Values]


_LINE = Curve(
    value=lambda c, x: c[0] + c[1] * x,
    slope=lambda c, x: np.full_like(x, c[1]),
    gradient=lambda _, x: np.column_stack([np.ones_like(x), x]),
)
_PROPORTIONAL = Curve(
    value=lambda c, x: c[0] * x,
    slope=lambda c, x: np.full_like(x, c[0]),
    gradient=lambda _, x: x[:, None],
)


@dataclass(frozen=True, eq=False)
class CurveFit:
    """A fitted curve.

    Parameters
    ----------
    parameters : ndarray, shape (k,)
    covariance : ndarray, shape (k, k)
        From the stated errors and the excess scatter.
    scatter : float
        Standard deviation in y that the stated errors do not explain.
    chi_square : float
        With the excess scatter in the weights.
    freedom : int
        Points minus parameters.
    """

    parameters: Values
    covariance: Values
    scatter: float
    chi_square: float
    freedom: int

    def estimate(self, index: int, *, confidence: float = 0.95) -> Estimate:
        """One parameter with its interval."""
        std = float(np.sqrt(max(self.covariance[index, index], 0.0)))
        value = float(self.parameters[index])
        return student_estimate(value, std, freedom=self.freedom, confidence=confidence)


def fit_curve(curve: Curve, points: Points, *, start: ArrayLike, scatter: float | None = None) -> CurveFit:
    """Fit a curve to points with errors on both axes.

    Parameters
    ----------
    curve : Curve
    points : Points
        As many as parameters, or more.
    start : array_like, shape (k,)
        Parameters to start from.
    scatter : float, optional
        Excess scatter in y; default: estimated.

    Returns
    -------
    CurveFit

    Raises
    ------
    InputError
        If there are fewer points than parameters.
    ConvergenceError
        If the least-squares solver stops before it converges.

    Notes
    -----
    For a straight line this is York's solution. The excess scatter is the estimate of Paule and Mandel.

    References
    ----------
    York et al., Am. J. Phys. 72 (2004) 367, doi:10.1119/1.1632486, eqs. (13); Paule, Mandel, J. Res. NBS 87
    (1982) 377, doi:10.6028/jres.087.022, eq. (4).
    """
    start = np.asarray(start, dtype=np.float64)
    freedom = len(points) - len(start)
    if freedom < 0:
        raise InputError(f"a fit of {len(start)} parameters needs as many points, got {len(points)}")
    fit = _Weighted(curve, points)
    if scatter is None:
        start = fit.parameters(start, flat=True)
        scatter = fit.excess(start, freedom)
    best = fit.parameters(start, extra=scatter**2)
    chi_square = float(np.sum(fit.residuals(best, scatter**2) ** 2))
    return CurveFit(best, fit.covariance(best, scatter**2), scatter, chi_square, freedom)


class _Weighted:
    """Weighted distances of points from a curve."""

    def __init__(self, curve: Curve, points: Points) -> None:
        self.curve, self.points = curve, points
        self.x, self.y = np.asarray(points.x), np.asarray(points.y)
        self.floor = (_ROUNDING * (float(np.abs(self.y).max()) or 1.0)) ** 2

    def variance(self, parameters: Values, extra: float) -> Values:
        """Variance of each distance."""
        return self.points.variance(self.curve.slope(parameters, self.x)) + extra + self.floor

    def residuals(self, parameters: Values, extra: float) -> Values:
        """Distances over their standard deviations."""
        return (self.y - self.curve.value(parameters, self.x)) / np.sqrt(self.variance(parameters, extra))

    def parameters(self, start: Values, *, extra: float = 0.0, flat: bool = False) -> Values:
        """Parameters of the least sum of squares; ``flat`` weighs all points alike."""

        def weighed(parameters: Values) -> Values:
            return self.residuals(parameters, extra)

        def alike(parameters: Values) -> Values:
            return self.y - self.curve.value(parameters, self.x)

        fit = optimize.least_squares(alike if flat else weighed, start, method="lm", x_scale="jac")
        if fit.status <= 0:
            raise ConvergenceError(
                f"the fit of a curve did not converge in {fit.nfev} evaluations; "
                "leave out points far from the others or narrow the range"
            )
        return np.asarray(fit.x)

    def excess(self, start: Values, freedom: int) -> float:
        """Scatter with which chi-square equals the degrees of freedom; 0 if it is smaller without."""
        if freedom == 0:
            return 0.0
        # weighed by s^2 alone, chi-square at the flat fit is the freedom; more variance only lowers it
        most = float(np.sum((self.y - self.curve.value(start, self.x)) ** 2)) / freedom

        def surplus(extra: float) -> float:
            best = self.parameters(start, extra=extra)
            return float(np.sum(self.residuals(best, extra) ** 2)) - freedom

        least = _ROUNDING * most
        if most <= self.floor or surplus(least) <= 0:
            return 0.0
        if surplus(most) >= 0:
            return float(np.sqrt(most))
        return float(np.sqrt(optimize.brentq(surplus, least, most, xtol=1e-6 * most)))

    def covariance(self, parameters: Values, extra: float) -> Values:
        """Inverse of the information, at the most likely x of each point."""
        slope = self.curve.slope(parameters, self.x)
        variance = self.variance(parameters, extra)
        x = self.points.adjusted(slope, self.y - self.curve.value(parameters, self.x), variance)
        gradient = self.curve.gradient(parameters, x)
        information = (gradient / variance[:, None]).T @ gradient
        size = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
        unit = np.outer(size, size)
        # parameters that the points cannot tell apart get the smallest covariance that fits
        return np.asarray(np.linalg.pinv(information / unit, rcond=1e-12, hermitian=True) / unit)


def fit_line(points: Points, *, scatter: float | None = None) -> CurveFit:
    """Fit ``y = c0 + c1 x`` with errors on both axes.

    Parameters
    ----------
    points : Points
        Two different x at least.
    scatter : float, optional
        Excess scatter in y; default: estimated.

    Returns
    -------
    CurveFit
        Parameters ``c0, c1``.

    Raises
    ------
    InputError
        If all x are equal.

    Examples
    --------
    >>> fit = fit_line(Points([0.0, 1.0, 2.0], [1.0, 3.1, 4.9], x_std=0.05, y_std=0.1))
    >>> round(float(fit.parameters[1]), 2), fit.scatter
    (1.95, 0.0)
    """
    x, y = np.asarray(points.x), np.asarray(points.y)
    if np.ptp(x) == 0:
        raise InputError(f"a line needs points at two different x at least, got {len(x)} at {x[0]:g}")

    first = (y[np.argmax(x)] - y[np.argmin(x)]) / np.ptp(x)
    start = np.array([float(np.mean(y - first * x)), float(first)])
    return fit_curve(_LINE, points, start=start, scatter=scatter)


def fit_proportional(points: Points, *, scatter: float | None = None) -> CurveFit:
    """Fit ``y = c x`` with errors on both axes.

    Parameters
    ----------
    points : Points
        One x at least that is not zero.
    scatter : float, optional
        Excess scatter in y, the same at every x; default: estimated.

    Returns
    -------
    CurveFit
        Parameter ``c``.

    Raises
    ------
    InputError
        If every x is zero.

    Examples
    --------
    >>> float(fit_proportional(Points([1.0, 2.0], [2.0, 4.0])).parameters[0])
    2.0
    """
    x, y = np.asarray(points.x), np.asarray(points.y)
    if not np.any(x):
        raise InputError("a line through the origin needs a point away from it")
    return fit_curve(_PROPORTIONAL, points, start=[float(x @ y / (x @ x))], scatter=scatter)
