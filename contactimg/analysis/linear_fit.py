"""Least squares with errors on both axes for any law that is linear in its parameters.

The law is ``y = phi(x) c``: a straight line, a line through the origin, two lines that meet, JKR. A point's
residual ``r`` has the variance ``V = s_y^2 + f'^2 s_x^2 - 2 f' cov(x, y) + s^2`` with the law's slope ``f'``
there, and its most likely abscissa is ``X = x + (f' s_x^2 - cov(x, y)) r/V``. The parameters solve

    sum phi(X) r/V = 0,

repeated until they stay; for a straight line that is York's solution. The excess scatter ``s`` is zero if
chi-square does not exceed the degrees of freedom without it; otherwise it makes the two equal.

References
----------
York et al., Am. J. Phys. 72 (2004) 367, doi:10.1119/1.1632486, eqs. (13); Paule, Mandel, J. Res. NBS 87
(1982) 377, doi:10.6028/jres.087.022, eq. (4).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize

from contactimg.analysis.estimates import Estimate, student_estimate
from contactimg.errors import ConvergenceError, InputError

Values = NDArray[np.float64]

Basis = Callable[[Values, int], Values]
"""``x``, shape (..., n), and 0 or 1 -> the terms ``phi`` or their derivatives by x, shape (..., n, k)."""

ROUNDING = 1e-12
"""Differences of x, and residuals of y, below this fraction of the largest are rounding errors. Theory: some
thousand times 2.2e-16."""

MOST_PASSES, DAMPED_FROM, PASS_TOLERANCE = 300, 40, 1e-10
"""Passes of the solution, the pass from which steps are halved, so that none goes to and fro, and
the relative change of the fitted values at which it has converged. Measured: York's data need 30 passes."""


@dataclass(frozen=True, eq=False)
class Points:
    """Points with standard uncertainties on both axes.

    Parameters
    ----------
    x, y : array_like, shape (..., n)
        Leading axes hold several sets of points, each with its own fit.
    x_std, y_std : array_like
    correlation : array_like
        Of the errors of x and y of a point.
    weight : array_like
        How often a point counts.
    spread : array_like
        Size of the excess scatter of each point in units of that of the fit; 0 for points that have none.

    Raises
    ------
    InputError
        If a value is not finite, an uncertainty negative or a correlation outside -1..1, or their numbers
        differ.
    """

    x: ArrayLike
    y: ArrayLike
    x_std: ArrayLike = 0.0
    y_std: ArrayLike = 0.0
    correlation: ArrayLike = 0.0
    weight: ArrayLike = 1.0
    spread: ArrayLike = 1.0

    def __post_init__(self) -> None:
        names = ("x", "y", "x_std", "y_std", "correlation", "weight", "spread")
        given = [np.atleast_1d(np.asarray(getattr(self, name), float)) for name in names]
        try:
            values = np.broadcast_arrays(*given)
        except ValueError:
            shapes = ", ".join(f"{name} {one.shape}" for name, one in zip(names, given, strict=True))
            raise InputError(f"the points of a fit need as many x as y, got the shapes {shapes}") from None
        for name, value in zip(names, values, strict=True):
            if not np.isfinite(value).all():
                raise InputError(f"the points of a fit must be finite, got {name} = {value.tolist()}")
            if name.endswith("std") and (value < 0).any():
                raise InputError(f"standard uncertainties must not be negative, got {name} = {value.min()}")
            object.__setattr__(self, name, value)
        if (np.abs(self.correlation) > 1 + 1e-9).any():
            raise InputError("a correlation lies between -1 and 1")

    def __len__(self) -> int:
        return int(np.shape(self.x)[-1])

    def variance(self, slope: Values) -> Values:
        """Variance of the residual in y from a law of this slope."""
        x_part, y_part = slope * np.asarray(self.x_std), np.asarray(self.y_std)
        return np.maximum(x_part**2 + y_part**2 - 2 * np.asarray(self.correlation) * x_part * y_part, 0.0)


@dataclass(frozen=True, eq=False)
class LinearFit:
    """A fitted law.

    Parameters
    ----------
    parameters : ndarray, shape (..., k)
    covariance : ndarray, shape (..., k, k)
        From the stated errors and the excess scatter.
    weights : ndarray, shape (..., n)
        One over the variance of each residual.
    residuals : ndarray, shape (..., n)
    scatter : float
        Standard deviation in y that the stated errors do not explain.
    freedom : float
        Points minus parameters.
    known : ndarray, shape (k,), or None
        Change of the parameters by one standard deviation of an error of known size, which the covariance
        contains and the freedom does not concern.
    """

    parameters: Values
    covariance: Values
    weights: Values
    residuals: Values
    scatter: float
    freedom: float
    known: Values | None = None

    @property
    def chi_square(self) -> Values:
        """Weighted sum of the squares of the residuals, shape (...)."""
        return np.asarray(np.sum(self.weights * self.residuals**2, axis=-1))

    def estimate(self, index: int, *, confidence: float = 0.95) -> Estimate:
        """One parameter with its interval."""
        std = float(np.sqrt(max(self.covariance[index, index], 0.0)))
        value = float(self.parameters[index])
        return student_estimate(value, std, freedom=self.freedom, confidence=confidence)


def fit_linear(basis: Basis, points: Points, *, scatter: float | None = None) -> LinearFit:
    """Fit a law that is linear in its parameters.

    Parameters
    ----------
    basis : callable
        The terms of the law.
    points : Points
        As many as parameters, or more. Several sets need a stated scatter.
    scatter : float, optional
        Excess scatter in y; default: estimated.

    Raises
    ------
    InputError
        If there are fewer points than parameters.
    ConvergenceError
        If the parameters do not settle.
    """
    count = basis(np.asarray(points.x), 0).shape[-1]
    freedom = len(points) - count
    if freedom < 0:
        raise InputError(f"a fit of {count} parameters needs as many points, got {len(points)}")
    if scatter is None:
        scatter = _excess_scatter(basis, points, freedom)
    parameters, instrument, weights, residuals, moving = _settle(basis, points, scatter)
    if moving.any():
        raise ConvergenceError(
            f"the fit of a law did not converge in {MOST_PASSES} passes; "
            "leave out outliers or narrow the range"
        )
    information = np.swapaxes(instrument * weights[..., None], -1, -2) @ instrument
    unit = np.sqrt(np.maximum(np.diagonal(information, axis1=-2, axis2=-1), np.finfo(float).tiny))
    unit = unit[..., None] * unit[..., None, :]
    # degenerate parameters get the covariance of least norm
    covariance = np.linalg.pinv(information / unit, rcond=1e-12, hermitian=True) / unit
    return LinearFit(parameters, covariance, weights, residuals, scatter, freedom)


def _excess_scatter(basis: Basis, points: Points, freedom: int) -> float:
    """The scatter with which chi-square is the freedom; 0 if it does not exceed the freedom without any."""
    start: Values | None = None

    @cache  # the root is sought between two values that are known before
    def surplus(extra: float) -> float:
        nonlocal start  # of the next trial; one that has not settled still bounds the scatter
        parameters, _, weights, residuals, moving = _settle(basis, points, extra**0.5, start)
        start = None if moving.any() else parameters
        return float(np.sum(weights * residuals**2)) - freedom

    stated = np.asarray(points.spread) == 0
    plain = replace(points, x_std=0.0, y_std=np.where(stated, points.y_std, 0.0))
    most = float(least_chi_square(basis, plain, scatter=1.0)) / max(freedom, 1)
    if freedom == 0 or surplus(0.0) <= 0 or most <= _floor(points):
        return 0.0
    # with the variance `most` alone, chi-square of that fit is the freedom; more variance lowers it
    if surplus(4 * most) >= 0:
        return 2 * most**0.5
    return float(optimize.brentq(surplus, 0.0, 4 * most, xtol=1e-8 * most)) ** 0.5


def _floor(points: Points) -> float:
    """Variance of rounding errors."""
    return (ROUNDING * (float(np.abs(points.y).max()) or 1.0)) ** 2


def solve_moments(instrument: Values, terms: Values, y: Values, weights: Values) -> Values:
    """Parameters for which the weighted residuals do not vary with the instruments: ``sum w psi r = 0``.

    Of parameters that the points do not tell apart, those of least norm.
    """
    weighted = np.swapaxes(instrument * weights[..., None], -1, -2)
    matrix, side = weighted @ terms, weighted @ y[..., None]
    try:
        return np.asarray(np.linalg.solve(matrix, side)[..., 0])
    except np.linalg.LinAlgError:
        matrix = np.where(np.isfinite(matrix), matrix, 0.0)  # of sets that diverge beside others
        return np.asarray((np.linalg.pinv(matrix) @ side)[..., 0])


def least_chi_square(basis: Basis, points: Points, *, scatter: float) -> Values:
    """Chi-square of the fit with a given scatter; infinite where it does not settle."""
    _, _, weights, residuals, moving = _settle(basis, points, scatter)
    return np.where(moving, np.inf, np.sum(weights * residuals**2, axis=-1))


def _settle(
    basis: Basis, points: Points, scatter: float, start: Values | None = None
) -> tuple[Values, Values, Values, Values, NDArray[np.bool_]]:
    """Parameters with a given excess scatter, the terms at the likely x, the weights and the residuals.

    Last comes which sets of points have not settled; ``start`` are parameters to start from.
    """
    x, y, often = np.asarray(points.x), np.asarray(points.y), np.asarray(points.weight)
    x_std = np.asarray(points.x_std)
    # the most likely x lies farther from the one that was read once in 16,000 points; without a limit a point
    # far off may move others to and fro
    mixed, farthest = np.asarray(points.correlation) * x_std * points.y_std, 4.0 * x_std
    terms, derivatives = basis(x, 0), basis(x, 1)
    excess = (scatter * np.asarray(points.spread)) ** 2 + _floor(points)
    settled = PASS_TOLERANCE * (float(np.abs(y).max()) or 1.0)
    fitted = np.zeros_like(y)
    parameters = solve_moments(terms, terms, y, often) if start is None else start
    for count in range(MOST_PASSES):
        slope = (derivatives @ parameters[..., None])[..., 0]
        before, fitted = fitted, (terms @ parameters[..., None])[..., 0]
        weights = 1 / (points.variance(slope) + excess)
        shift = (slope * x_std**2 - mixed) * (y - fitted) * weights
        instrument = basis(x + np.clip(shift, -farthest, farthest), 0)
        moving = ~(np.abs(fitted - before).max(axis=-1) < settled)
        if not moving.any():
            break
        step = solve_moments(instrument, terms, y, often * weights) - parameters
        parameters = parameters + (step if count < DAMPED_FROM else step / 2)
    return parameters, instrument, often * weights, y - fitted, np.asarray(moving)


def line(x: Values, order: int) -> Values:
    """The terms 1 and x of a straight line, or their derivatives."""
    return np.stack([np.zeros_like(x), np.ones_like(x)] if order else [np.ones_like(x), x], -1)


def proportion(x: Values, order: int) -> Values:
    """The term x of a line through the origin, or its derivative."""
    return (np.ones_like(x) if order else x)[..., None]


def two_lines(place: float | Values) -> Basis:
    """The terms of two lines that meet at a place: their value there, and the slopes below and above.

    Places of shape (..., 1) make several sets of points, one for each.
    """

    def terms(x: Values, order: int) -> Values:
        away = x - place
        if order:
            return np.stack([np.zeros_like(away), away < 0, away >= 0], axis=-1)
        return np.stack([np.ones_like(away), np.minimum(away, 0), np.maximum(away, 0)], axis=-1)

    return terms


def fit_line(points: Points, *, scatter: float | None = None) -> LinearFit:
    """Fit ``y = c0 + c1 x`` with errors on both axes.

    Parameters
    ----------
    points : Points
        At least two different x.
    scatter : float, optional
        Excess scatter in y; default: estimated.

    Raises
    ------
    InputError
        If all x are equal, but for rounding.

    Examples
    --------
    >>> fit = fit_line(Points([0.0, 1.0, 2.0], [1.0, 3.1, 4.9], x_std=0.05, y_std=0.1))
    >>> round(float(fit.parameters[1]), 2), fit.scatter
    (1.95, 0.0)
    """
    x = np.asarray(points.x)
    if x.shape[-1] < 2 or (np.ptp(x, axis=-1) <= ROUNDING * np.abs(x).max(axis=-1)).any():
        place = f" at {x.flat[0]:g}" if x.size else ""
        raise InputError(f"a line needs points at two or more different x, got {x.shape[-1]}{place}")
    return fit_linear(line, points, scatter=scatter)


def fit_proportional(points: Points, *, scatter: float | None = None) -> LinearFit:
    """Fit ``y = c x`` with errors on both axes.

    Parameters
    ----------
    points : Points
        One x at least that is not zero.
    scatter : float, optional
        Excess scatter in y, the same at every x; default: estimated.

    Raises
    ------
    InputError
        If every x is zero.

    Examples
    --------
    >>> float(fit_proportional(Points([1.0, 2.0], [2.0, 4.0])).parameters[0])
    2.0
    """
    if not np.any(points.x):
        raise InputError("a line through the origin needs a point away from it")
    return fit_linear(proportion, points, scatter=scatter)
