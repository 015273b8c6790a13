"""Fit curves to points with errors on both axes, by effective variances and an excess scatter.

The residual of a point from the curve ``f`` has the variance ``s_y^2 + f'^2 s_x^2 - 2 f' cov(x, y) + s^2``.
The excess scatter ``s`` is zero if chi-square does not exceed the degrees of freedom without it; otherwise it
is chosen so that chi-square equals the degrees of freedom.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize

from contactimg.analysis.estimates import Estimate, student_estimate
from contactimg.errors import ConvergenceError, InputError

Values = NDArray[np.float64]

_ROUNDING_FRACTION = 1e-12
"""Residuals below this fraction of the largest y are rounding errors. Theory: some thousand times 2.2e-16."""


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
        """Variance of the residual in y from a curve of this slope."""
        x_part = slope * np.asarray(self.x_std)
        y_part = np.asarray(self.y_std)
        mixed = 2 * np.asarray(self.correlation) * x_part * y_part
        return np.maximum(x_part**2 + y_part**2 - mixed, 0.0)

    def adjusted(self, slope: Values, residual: Values, variance: Values) -> Values:
        """Most likely x of the points, given their residuals."""
        x_std, y_std = np.asarray(self.x_std), np.asarray(self.y_std)
        shift = slope * x_std**2 - np.asarray(self.correlation) * x_std * y_std
        return np.asarray(self.x) + shift * residual / variance


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
    """Weighted residuals of points from a curve."""

    def __init__(self, curve: Curve, points: Points) -> None:
        self.curve, self.points = curve, points
        self.x, self.y = np.asarray(points.x), np.asarray(points.y)
        self.floor = (_ROUNDING_FRACTION * (float(np.abs(self.y).max()) or 1.0)) ** 2

    def variance(self, parameters: Values, extra: float) -> Values:
        """Variance of each residual."""
        return self.points.variance(self.curve.slope(parameters, self.x)) + extra + self.floor

    def residuals(self, parameters: Values, extra: float) -> Values:
        """Residuals over their standard deviations."""
        return (self.y - self.curve.value(parameters, self.x)) / np.sqrt(self.variance(parameters, extra))

    def parameters(self, start: Values, *, extra: float = 0.0, flat: bool = False) -> Values:
        """Least-squares parameters; ``flat`` gives all points the same weight."""

        def weighted(parameters: Values) -> Values:
            return self.residuals(parameters, extra)

        def unweighted(parameters: Values) -> Values:
            return self.y - self.curve.value(parameters, self.x)

        fit = optimize.least_squares(unweighted if flat else weighted, start, method="lm", x_scale="jac")
        if fit.status <= 0:
            raise ConvergenceError(
                f"the fit of a curve did not converge in {fit.nfev} evaluations; "
                "leave out outliers or narrow the range"
            )
        return np.asarray(fit.x)

    def excess(self, start: Values, freedom: int) -> float:
        """Scatter for which chi-square equals the degrees of freedom; 0 if chi-square is smaller without."""
        if freedom == 0:
            return 0.0
        # with variance s^2 alone, chi-square of the unweighted fit is the freedom; more variance lowers it
        most = float(np.sum((self.y - self.curve.value(start, self.x)) ** 2)) / freedom

        def surplus(extra: float) -> float:
            best = self.parameters(start, extra=extra)
            return float(np.sum(self.residuals(best, extra) ** 2)) - freedom

        least = _ROUNDING_FRACTION * most
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
        # degenerate parameters get the covariance of least norm
        return np.asarray(np.linalg.pinv(information / unit, rcond=1e-12, hermitian=True) / unit)


def fit_line(points: Points, *, scatter: float | None = None) -> CurveFit:
    """Fit ``y = c0 + c1 x`` with errors on both axes.

    Parameters
    ----------
    points : Points
        At least two different x.
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
    if len(np.unique(x)) < 2:
        place = f" at {x[0]:g}" if len(x) else ""
        raise InputError(f"a line needs points at two or more different x, got {len(x)}{place}")

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
