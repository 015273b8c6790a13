"""Modulus and work of adhesion from the contact radii of a smooth sphere (JKR).

In the stiffness ``K`` and the adhesion ``S = sqrt(w K)`` the load read at the contact radius ``a`` is linear,

    P = H K a^3/R - A sqrt(6 pi) S a^{3/2} + zero + drift - P'(a) d,

``H`` and ``A`` being 1 on a half-space (`contactimg.mechanics.layer`). It is fitted by generalised
least squares with errors on both axes (`contactimg.analysis.linear_fit`). The zero takes part where the scene
states its uncertainty, as one more datum. A hysteresis, a drift or a shift ``d`` of the edge takes part where
an F test says that the frames need it. The noise of the loads, a constant part and one that grows with the
load, has the size of the residuals.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import special

from contactimg.analysis.estimates import COVERAGE, CoverageEstimate
from contactimg.analysis.linear_fit import ROUNDING, LinearFit, Points, fit_linear
from contactimg.analysis.load_cell import LoadCell
from contactimg.errors import InputError
from contactimg.mechanics.layer import layer_factors
from contactimg.plausibility import doubt_about, doubts_about_calibration, settle
from contactimg.pose.pairs import MAD_TO_STD, OUTLIER_SIGMA

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]

CONSTANT_SHARE = 0.2
"""Share of the noise variance, at the rms load, that does not grow with the load. Measured: with a fifth the
intervals hold the truth in 93-100 % of simulated series of 3 to 12 loads, whether the noise is in proportion
to each load or the same at all of them; with a twentieth in 90 % of some."""

MOST_LEVERAGE = 0.6
"""Largest leverage by which a residual is enlarged. Measured: coverage is the same as without a limit, and
intervals of three loads, or of five parameters from eight, are not several times too wide."""

FALSE_ALARM_RATE = 0.01
"""Probability that a departure, a shift of the edge or a zero is seen where there is none, and that of rivals
that are not fitted: they would add at most a tenth of the difference."""

OUTLIER_FALSE_ALARM_RATE, LEAST_OUTLIER = 1e-3, 1e-6
"""Probability that a series without outliers loses a frame; least residual of one over the rms load, below
which it is a rounding error."""

EXACT = 1e-18
"""Mean square of scaled residuals below which they are rounding errors, which no odds distinguish."""

DRAWS = 20000
"""Draws from the distribution of the parameters. Theory: they know a 95 % interval to 1 %."""

SLOPE_STEP = 1e-4
"""Relative step of the radius for the slope of the law."""

LAYER_RATIOS = (0.15, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 1.5)
"""Largest contact radius over the thicknesses that are tried. Chosen: the loads cannot tell a thicker one."""

LAYER_FALSE_ALARM_RATE = 0.05
"""Probability that a layer is suggested where there is none. Chosen: a hint costs a look at the sample; with
1 % five loads would need one that they fit a hundred times better."""

SETTLED_STD_PX = 0.1
"""Standard uncertainty up to which a shift of the edge that is not seen is worth stating. Chosen: 1 % of the
radius of a contact of 10 px."""

MIN_GROWTH_SIGMA = 1.5
"""Least slope of radius against load, in its standard errors. Chosen by hand; sensitivity not measured."""

LEAST_ELLIPSE_STD = 1e-4
"""Least uncertainty of an axis ratio, so that no frame outweighs all others. Chosen by hand."""

HYSTERESIS, ZERO_DRIFT, GAIN_DRIFT = "hysteresis of adhesion", "drift of the zero", "drift of the gain"


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
        Of the elastic layer, bonded to a rigid support; None for a half-space.
    """

    radius: float
    poisson_ratio: float
    radius_std: float = 0.0
    thickness: float | None = None


@dataclass(frozen=True, eq=False)
class JkrSeries:
    """Loads and radii, and what is fitted to them.

    Parameters
    ----------
    load, radius, radius_std : ndarray, shape (n,), N and m
    zero_std : float, N
        Standard uncertainty of the zero of the loads; 0 for one that is not fitted.
    sphere : SmoothSphere
    branches : ndarray, shape (n, k)
        One column a work of adhesion: 1 where it acts.
    extra : ndarray, shape (n, m)
        What one unit of a drift, and one pixel of a shift of the edge, add to each load, N.
    """

    load: Values
    radius: Values
    radius_std: Values
    zero_std: float
    sphere: SmoothSphere
    branches: Values
    extra: Values

    @property
    def physical(self) -> int:
        """Number of parameters that are stiffness or adhesion."""
        return 1 + self.branches.shape[1]

    def part(self, used: Mask) -> "JkrSeries":
        """The series of some of the frames."""
        names = ("load", "radius", "radius_std", "branches", "extra")
        return replace(self, **{name: getattr(self, name)[used] for name in names})

    def with_column(self, column: Values) -> "JkrSeries":
        """The series with one more parameter, of which one unit adds so much to each load."""
        return replace(self, extra=np.column_stack([self.extra, column]))

    def terms(self, radius: Values) -> Values:
        """Load per unit of K/R, sqrt(6 pi) S, the extra parameters and the zero, shape (..., n, k)."""
        pressing, adhesive = np.ones((2, *radius.shape))
        layer = self.sphere.thickness
        if layer is not None:
            pressing, adhesive = layer_factors(radius / layer, poisson_ratio=self.sphere.poisson_ratio)
        physical, extra = self.physical, self.extra.shape[1]
        terms = np.ones((*radius.shape, physical + extra + int(self.zero_std > 0)))
        terms[..., 0] = pressing * radius**3
        terms[..., 1:physical] = -(adhesive * radius**1.5)[..., None] * self.branches
        terms[..., physical : physical + extra] = self.extra
        return terms

    def slopes(self, radius: Values) -> Values:
        """Derivatives of the terms by the radius."""
        step = SLOPE_STEP * radius
        above, below = self.terms(np.stack([radius + step, radius - step]))
        return np.asarray((above - below) / (2 * step)[:, None])

    def fit(self, *, scatter: float | None = None, prior: bool = True) -> LinearFit:
        """Generalised least squares; without the prior the zero is free.

        Parameters are in SI units. Weights and residuals are those of loads over their rms, and the last one
        that of the zero if it has a prior.
        """
        if prior and self.zero_std and len(self.load) <= self.terms(self.radius).shape[1]:
            return self._with_unknown_zero()
        scale = float(np.sqrt(np.mean(self.load**2))) or 1.0
        datum = int(prior and self.zero_std > 0)

        def basis(x: Values, order: int) -> Values:
            radius = np.maximum(x[: len(self.radius)], 0.5 * self.radius)
            terms = self.slopes(radius) if order else self.terms(radius)
            last = np.zeros((datum, terms.shape[1]))
            last[:, -1] = 1 - order
            return np.vstack([terms, last]) / scale

        y = self.load / scale
        noise = np.sqrt(CONSTANT_SHARE + (1 - CONSTANT_SHARE) * y**2)
        none = np.zeros(datum)
        points = Points(
            np.append(self.radius, none),
            np.append(y, none),
            x_std=np.append(self.radius_std, none),
            y_std=np.append(np.zeros(len(y)), none + self.zero_std / scale),
            spread=np.append(noise, none),
        )
        found = fit_linear(basis, points, scatter=scatter)
        # no variance less than what the residuals themselves say: HC3 (MacKinnon and White, J. Econometrics
        # 29 (1985) 305, doi:10.1016/0304-4076(85)90158-7) holds whatever the noise of each load is
        terms, stated = basis(np.append(self.radius, none), 0), found.covariance
        lever = stated @ (terms * found.weights[:, None]).T
        leverage = np.clip(np.einsum("nk,kn->n", terms, lever), 0.0, MOST_LEVERAGE)
        own = np.sum((lever * found.residuals / (1 - leverage)) ** 2, axis=1)
        wider = np.sqrt(np.maximum(own / np.maximum(np.diag(stated), np.finfo(float).tiny), 1.0))
        covariance = stated * np.outer(wider, wider)
        freedom = float(found.freedom)
        if datum:  # a zero counts as fitted as far as the loads narrow what is stated of it
            told = 1 - found.covariance[-1, -1] / self.zero_std**2
            freedom = max(freedom - max(told, 0.0), 1.0)
            covariance = covariance * found.freedom / freedom
        return replace(found, covariance=covariance, freedom=freedom)

    def _with_unknown_zero(self) -> LinearFit:
        """The fit of as many loads as parameters: they cannot tell the zero, which adds its uncertainty."""
        exact, moved = (
            replace(self, zero_std=0.0, load=self.load - zero).fit(scatter=0.0)
            for zero in (0.0, self.zero_std)
        )
        found = replace(self, zero_std=0.0).fit()
        change = np.append(moved.parameters - exact.parameters, self.zero_std)
        covariance = np.pad(found.covariance, (0, 1)) + np.outer(change, change)
        parameters = np.append(found.parameters, 0.0)
        return replace(found, parameters=parameters, covariance=covariance, known=change)

    def misfit(self) -> float:
        """Mean square of the residuals over the rms load and the shape of the noise."""
        return float(self.fit(scatter=1.0, prior=False).chi_square) / max(len(self.load), 1)


@dataclass(frozen=True)
class EdgeShift:
    """The distance by which the edge of the contact seems to lie outside the true one.

    An edge that is soft to one side looks like that of a larger contact: one image does not tell, a series
    does. With the shift ``d`` the load is ``P(a) - P'(a) d``, and ``P'`` goes with the radius as no other
    part of the law does. A shift in proportion to the radius acts like an error of the pixel size and is not
    told.

    Parameters
    ----------
    shift : CoverageEstimate, px
        Positive where the contact seems too large.
    seen : bool
        Whether the data show that there is one.
    """

    shift: CoverageEstimate
    seen: bool

    @property
    def settled(self) -> bool:
        """Whether the shift is worth handing on."""
        return self.seen or self.shift.std < SETTLED_STD_PX


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
        What the load cell reads without load, as far as the data and what is stated of it tell; it is taken
        off the loads. None where nothing is stated of it.
    load_zero_seen : bool
        Whether the data show that it is off.
    departure, rival : str
        What makes unloading differ from loading, and what else may; empty if nothing does.
    drift : CoverageEstimate or None, N or relative
        Of the zero or of the gain over the series, where it is fitted.
    load_noise : float, N
        Root mean square of the loads' residuals, corrected for the fitted numbers.
    points : DataFrame
        One row a frame: load_N, radius_m, branch, fitted_N, residual_N, used.
    sphere : SmoothSphere
    load_cell : LoadCell
    edge : EdgeShift or None
        How far the edge seems to lie outside the true one; None where it was not looked for.
    zero_asked : float or None, N
        Zero that the loads, without a shift of the edge, ask for although none is stated.
    layer_asked : (float, float) or None
        Thickness (m) of a layer that they ask for although none is stated, and by how much it changes the
        modulus, relative.
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
    sphere: SmoothSphere
    load_cell: LoadCell
    edge: EdgeShift | None = None
    zero_asked: float | None = None
    layer_asked: tuple[float, float] | None = None

    def widened(self, other: "JkrCalibration", doubt: float) -> "JkrCalibration":
        """The calibration with the uncertainty that another of probability ``doubt`` adds."""
        wider = {}
        for name in ("young_modulus", "work_of_adhesion", "work_of_adhesion_unloading"):
            one, two = getattr(self, name), getattr(other, name) or other.work_of_adhesion
            wider[name] = one and one.widened(np.sqrt(doubt) * abs(two.value - one.value))
        return replace(self, **wider)


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
        How well its zero and its gain are known; default: a zero that is right, and a gain to 1 %.
    thickness : float, optional, m
        Of the elastic layer, bonded; default: a half-space.
    sphere_radius_std : float, m
        Standard uncertainty of the sphere's radius.
    pixel_size : float, optional, m
        Of the images that the radii come from, for the shift of their edges; default: it is not looked for.

    Returns
    -------
    JkrCalibration
        Intervals of 95 % from draws of the parameters: Student's distribution with the covariance of the fit,
        with the gain and the sphere's radius in proportion.

    Raises
    ------
    InputError
        If there are fewer than three different loads, none of them presses, or the radius does not grow with
        the load. For a length, or a result, that is no plausible one (`contactimg.plausibility`).

    Notes
    -----
    Outliers are removed one by one, each with a residual that chance exceeds in one series of a thousand. An
    error common to all radii, such as that of the pixel size, is not included.

    References
    ----------
    Johnson, Kendall, Roberts, Proc. R. Soc. A 324 (1971) 301, doi:10.1098/rspa.1971.0141, eq. (21).

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
    stated = {"[indenter] radius_m": sphere_radius, "poisson_ratio": poisson_ratio}
    stated |= {} if pixel_size is None else {"pixel_size_m": pixel_size}
    settle([doubt for name in stated for doubt in doubt_about(name, stated[name])], "calibrate_jkr")
    cell = LoadCell() if load_cell is None else load_cell
    sphere = SmoothSphere(sphere_radius, poisson_ratio, sphere_radius_std / sphere_radius, thickness)
    plain = _series(load, radius, radius_std, cell, sphere)
    check_loads(plain.load)
    _check_growth(plain.load, plain.radius)
    branch = classify_branches(plain.load)
    used = _without_outliers(plain)
    (departure, series, _), *rivals = _departures(plain, branch, used)
    own, edge, asked = series.part(used), None, None
    free = replace(own, zero_std=1.0)
    if pixel_size is not None:
        slope = series.slopes(series.radius) @ series.part(used).fit().parameters
        shifted = series.with_column(-pixel_size * slope)
        # one load more than a fit without a test needs
        if int(used.sum()) >= shifted.terms(shifted.radius).shape[1] + 2:
            fit, column = shifted.part(used).fit(), shifted.physical + series.extra.shape[1]
            values = np.append(fit.parameters[column], _draws(fit)[:, column])
            # a zero of the loads that is not stated has nearly the same effect
            nearer = own.zero_std > 0 or shifted.part(used).misfit() <= free.misfit()
            edge = EdgeShift(_from_draws(values), nearer and is_asked_for(own, shifted.part(used)))
            series = shifted if edge.seen else series
    found = _solved(series, used, branch, cell, departure)
    doubts = doubts_about_calibration(
        young_modulus=found.young_modulus.value,
        work_of_adhesion=found.work_of_adhesion.value,
        contact_over_radius=float(plain.radius.max()) / sphere_radius,
        scatter=found.load_noise / float(np.abs(found.points["load_N"]).max()),
    )
    settle(doubts, "the calibration")
    here = series.part(used)
    if not own.zero_std and is_asked_for(own, free):
        asked = float(free.fit(prior=False).parameters[-1])
    found = replace(found, edge=edge, zero_asked=asked)
    if thickness is None:
        thick = [float(here.radius.max()) / ratio for ratio in LAYER_RATIOS]
        layers = {one: replace(series, sphere=replace(sphere, thickness=one)) for one in thick}
        layer, layered = min(layers.items(), key=lambda one: one[1].part(used).misfit())
        if is_asked_for(here, layered.part(used), more=1, false_alarm_rate=LAYER_FALSE_ALARM_RATE):
            other = _solved(layered, used, branch, cell, departure).young_modulus.value
            found = replace(found, layer_asked=(layer, other / found.young_modulus.value - 1))
    for name, rival, doubt in rivals:
        found = replace(found.widened(_solved(rival, used, branch, cell, name), doubt), rival=name)
    return found


def _solved(
    series: JkrSeries, used: Mask, branch: NDArray[np.str_], cell: LoadCell, departure: str
) -> JkrCalibration:
    """The physical quantities from the draws of the fit of a series."""
    fit, sphere = series.part(used).fit(), series.sphere
    draws = np.vstack([fit.parameters, _draws(fit)])  # the first row is the estimate itself
    gain, bend = np.random.default_rng(1).standard_normal((2, len(draws)))
    gain, bend = np.append(0.0, cell.gain_std * gain[1:]), np.append(0.0, sphere.radius_std * bend[1:])
    K = draws[:, 0] * sphere.radius
    E = 0.75 * (1 - sphere.poisson_ratio**2) * K
    w = np.maximum(draws[:, 1 : series.physical], 0.0) ** 2 / (6 * np.pi * K[:, None])
    E, w = E * (1 + gain) * (1 + bend), w * ((1 + gain) * (1 - bend))[:, None]
    zero = draws[:, -1] if series.zero_std else np.zeros(2)
    varies = np.ptp(E) > 0 and np.ptp(w[:, 0]) > 0
    fitted = series.terms(series.radius) @ fit.parameters
    rest = series.load - fitted
    columns = {"load_N": series.load, "radius_m": series.radius, "branch": branch, "fitted_N": fitted}
    ranks = pd.DataFrame({"E": E, "w": w[:, 0]}).rank()
    return JkrCalibration(
        young_modulus=_from_draws(E),
        work_of_adhesion=_from_draws(w[:, 0]),
        work_of_adhesion_unloading=_from_draws(w[:, 1]) if w.shape[1] > 1 else None,
        correlation=float(np.corrcoef(ranks.T)[0, 1]) if varies else 0.0,
        load_zero=_from_draws(zero) if series.zero_std else None,
        load_zero_seen=bool(min((zero <= 0).mean(), (zero >= 0).mean()) < FALSE_ALARM_RATE / 2),
        departure=departure,
        rival="",
        drift=_from_draws(draws[:, series.physical]) if departure in (ZERO_DRIFT, GAIN_DRIFT) else None,
        load_noise=float(np.sqrt(np.sum(rest[used] ** 2) / max(int(used.sum()) - len(fit.parameters), 1))),
        points=pd.DataFrame(columns | {"residual_N": rest, "used": used}),
        sphere=sphere,
        load_cell=cell,
    )


def _series(
    load: ArrayLike, radius: ArrayLike, radius_std: ArrayLike, cell: LoadCell, sphere: SmoothSphere
) -> JkrSeries:
    P, a = np.atleast_1d(np.asarray(load, float)), np.atleast_1d(np.asarray(radius, float))
    std = np.asarray(radius_std, float)
    if P.ndim != 1 or P.shape != a.shape or std.shape not in ((), a.shape):
        shapes = f"got shapes {P.shape}, {a.shape} and {std.shape}"
        raise InputError(f"one radius a load is needed, and one uncertainty or one each, {shapes}")
    std = np.broadcast_to(std, a.shape)
    numbers = np.concatenate([P, a, std])
    if not (np.isfinite(numbers).all() and (a > 0).all() and (std >= 0).all()):
        raise InputError("loads must be finite, radii positive and their uncertainties not negative")
    return JkrSeries(P, a, std, cell.zero_std, sphere, np.ones((P.size, 1)), np.ones((P.size, 0)))


def _draws(fit: LinearFit) -> Values:
    """Draws of the parameters, with positive stiffness; always the same.

    From Student's distribution, an error of known size from the normal one.
    """
    rng = np.random.default_rng(0)
    known = np.zeros(len(fit.parameters)) if fit.known is None else fit.known
    shown = fit.covariance - np.outer(known, known)
    size = np.sqrt(np.maximum(np.diag(shown), np.finfo(float).tiny))
    root = np.linalg.cholesky(shown / np.outer(size, size) + ROUNDING * np.eye(len(size)))
    normal = rng.standard_normal((DRAWS, len(size))) @ root.T * size
    freedom = max(fit.freedom, 1)
    draws = fit.parameters + normal * np.sqrt(freedom / rng.chisquare(freedom, DRAWS))[:, None]
    draws += rng.standard_normal((DRAWS, 1)) * known
    return draws[draws[:, 0] > 0]


def _from_draws(values: Values) -> CoverageEstimate:
    """The first of the values with the central 95 % interval of the others."""
    low, high = np.quantile(values[1:], [0.5 - COVERAGE / 2, 0.5 + COVERAGE / 2]).tolist()
    return CoverageEstimate.of_interval(float(values[0]), low, high)


def is_asked_for(
    plain: JkrSeries, larger: JkrSeries, *, more: int = 0, false_alarm_rate: float = FALSE_ALARM_RATE
) -> bool:
    """Whether the loads need what the larger series has, by an F test with the noise that it leaves.

    ``more`` of its parameters are not terms.
    """
    freedom = len(larger.load) - larger.terms(larger.radius).shape[1] - more
    if freedom < 1:
        return False
    fit = larger.fit()
    gain = float(plain.fit(scatter=fit.scatter).chi_square - fit.chi_square)
    return bool(special.fdtrc(1, freedom, gain) < false_alarm_rate)


def _departures(
    series: JkrSeries, branch: NDArray[np.str_], used: Mask
) -> Sequence[tuple[str, JkrSeries, float]]:
    """The likeliest departure that the order of the loads shows, and the next if it is not unlikely.

    Each has its name, the series with it and its probability; loads that do not return to where they were
    show none.
    """
    apart = np.column_stack([branch == "loading", branch == "unloading"]).astype(float)
    counts, steps = apart[used].sum(axis=0), np.diff(series.load[used])
    candidates: dict[str, JkrSeries] = {}
    if counts.min() >= 2 and counts.sum() == used.sum():
        candidates[HYSTERESIS] = replace(series, branches=apart)
    if (steps > 0).any() and (steps < 0).any():
        time = np.linspace(-0.5, 0.5, len(series.load))  # a drift is its change over the series
        candidates[ZERO_DRIFT] = series.with_column(time)
        candidates[GAIN_DRIFT] = series.with_column(time * series.load)
    here = series.part(used)
    asked = [
        (max(one.part(used).misfit(), EXACT), name, one)
        for name, one in candidates.items()
        if is_asked_for(here, one.part(used))
    ]
    # likelihoods maximised over the noise
    first, *others = sorted(asked, key=lambda one: one[0])[:2] or [(1.0, "", series)]
    odds = (first[0] / others[0][0]) ** (used.sum() / 2) if others else 0.0
    doubt = float(odds / (1 + odds))
    found = [(first[1], first[2], 1 - doubt), *((name, one, doubt) for _, name, one in others)]
    return found[: 1 + (doubt > FALSE_ALARM_RATE)]


def _without_outliers(series: JkrSeries) -> Mask:
    """Mask of the frames to use: outliers from the fit to all others are removed one by one."""
    used = np.ones(len(series.load), bool)
    for _ in range(len(used) // 4):
        n = int(used.sum())
        if n < 5 or len(np.unique(series.load[used])) < 4:
            break
        student, off, freedom = _deleted_residuals(series.part(used))
        worst = int(student.argmax())
        chance = n * 2 * special.stdtr(freedom, -student[worst])
        if chance > OUTLIER_FALSE_ALARM_RATE or off[worst] < LEAST_OUTLIER:
            break
        used[np.flatnonzero(used)[worst]] = False
    return used


def _deleted_residuals(series: JkrSeries) -> tuple[Values, Values, int]:
    """Residual of each frame from the fit to the others over its standard error; its size; the freedom."""
    n, fit = len(series.load), series.fit()
    terms = series.terms(series.radius)
    if series.zero_std:  # what is stated of the zero is one more datum
        terms = np.vstack([terms, np.append(np.zeros(terms.shape[1] - 1), 1.0)])
    weighted = terms / np.abs(terms).max(axis=0) * np.sqrt(fit.weights[:, None])
    leverage = np.clip(np.diag(weighted @ np.linalg.pinv(weighted)), 0.0, 1 - 1e-9)
    rest, freedom = fit.residuals * np.sqrt(fit.weights), max(len(terms) - terms.shape[1] - 1, 1)
    others = (np.sum(rest**2) - rest**2 / (1 - leverage)) / freedom
    floor = 1e-12 * np.sum(rest**2) + 1e-24
    student = np.abs(rest) / np.sqrt(np.maximum(others, floor) * (1 - leverage))
    return student[:n], np.abs(fit.residuals[:n]), freedom


def classify_branches(load: ArrayLike) -> NDArray[np.str_]:
    """Classify each load as loading or unloading.

    Parameters
    ----------
    load : array_like, shape (n,), N
        In the order in which they were applied.

    Returns
    -------
    ndarray of str, shape (n,)
        "loading" up to the largest load and "unloading" after it, if the loads rise to it and then fall
        monotonically; empty for any other order.

    Examples
    --------
    >>> classify_branches([0.1, 0.2, 0.5, 0.2, -0.01])
    array(['loading', 'loading', 'loading', 'unloading', 'unloading'], dtype='<U9')
    >>> classify_branches([0.2, 0.1, 0.5])
    array(['', '', ''], dtype='<U9')
    """
    P = np.asarray(load, float)
    branch = np.full(P.shape, "", "<U9")
    top = int(P.argmax()) if P.size else 0
    if np.all(np.diff(P[: top + 1]) >= 0) and np.all(np.diff(P[top:]) <= 0):
        branch[:] = "unloading"
        if top > 0 or P.size == 1:
            branch[: top + 1] = "loading"
    return branch


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
    (slope, _), covariance = np.polyfit(load, radius, 1, cov=True)
    noise = float(np.sqrt(covariance[0, 0]))
    pairs = np.sign(np.subtract.outer(load, load)) * np.sign(np.subtract.outer(radius, radius))
    grows = slope > 0 and pairs.sum() > 0  # Kendall's rank correlation
    if not grows or slope < MIN_GROWTH_SIGMA * noise or np.ptp(radius) < 1e-9 * radius.max():
        raise InputError(
            "the contact radius does not grow with the load "
            f"({1e6 * slope:.3g} +- {1e6 * noise:.2g} um/N); "
            "check that frames and loads belong together and that the frames show the contact"
        )


# --- the circles of a series


def mean_axis_ratio(table: pd.DataFrame) -> tuple[float, float]:
    """Larger over smaller axis of the mean of the contacts' ellipses, and its standard uncertainty.

    Parameters
    ----------
    table : DataFrame
        Columns of `contactimg.tables.CIRCLES`; each ellipse is weighted by its uncertainty.

    Returns
    -------
    float, float
        1 and 0 if no frame tells. Under a lens of unequal curvature the ellipse is the same at all loads. The
        uncertainty includes the scatter between frames.
    """
    good = table[np.isfinite(table["axis_ratio"])]
    if good.empty:
        return 1.0, 0.0
    excess, own = good["axis_ratio"].to_numpy(float) - 1, good["axis_ratio_std"].to_numpy(float)
    vectors = excess * np.exp(2j * good["angle_rad"].to_numpy(float))
    weight = 1 / np.maximum(own, LEAST_ELLIPSE_STD) ** 2
    mean = complex(weight @ vectors / weight.sum())
    n = len(good)
    scatter = float(np.sqrt(weight @ np.abs(vectors - mean) ** 2 / weight.sum() / max(2 * (n - 1), 1)))
    return 1 + abs(mean), float(np.hypot(1 / np.sqrt(weight.sum()), scatter))


def mean_centre(table: pd.DataFrame) -> tuple[CoverageEstimate, CoverageEstimate, bool]:
    """Centre of the apparent contact over all frames of a series, and whether it moves with the sample.

    Parameters
    ----------
    table : DataFrame
        Columns of `contactimg.tables.CIRCLES`.

    Returns
    -------
    CoverageEstimate, CoverageEstimate, px
        Its x and y, in the pixels of the reference where the contact moves with the sample, else in those of
        the frames: whichever centres scatter less.
    bool

    Notes
    -----
    Weighted by the uncertainties of the circles; outlying centres have less weight. The uncertainty includes
    the scatter of the centres.
    """
    good = table[np.isfinite(table["x_px"])]
    still = good[["x_px", "y_px"]].to_numpy(float)
    shift = good[["shift_x_px", "shift_y_px"]].fillna(0.0).to_numpy(float)
    own = good["centre_std_px"].to_numpy(float)
    candidates = []
    for points, moves in ((still, False), (still - shift, True)):
        median = np.median(points, axis=0)
        variance = own**2 + (MAD_TO_STD * float(np.median(np.abs(points - median)))) ** 2
        far = np.sum((points - median) ** 2, axis=1) / np.maximum(variance, 1e-12)
        weight = 1 / np.maximum(variance, 1e-12) / (1 + far / OUTLIER_SIGMA**2)
        candidates.append((weight @ points / weight.sum(), float(np.sqrt(1 / weight.sum())), moves))
    middle, std, moves = min(candidates, key=lambda candidate: candidate[1])
    x, y = (CoverageEstimate.of_normal(float(place), std) for place in middle)
    return x, y, moves and bool(shift.any())
