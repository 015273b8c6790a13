"""Contrast and blur of a frame whose contacts are all about as small as the blur: their profile likelihood.

Of a contact of radius a behind a blur s, the light ``C a^2`` and the variance ``s^2 + a^2/4`` are seen
directly. Contrast and radius are told apart by the excess kurtosis ``-u^2`` alone,
``u = (a^2/4)/(s^2 + a^2/4)``: the likelihood of the contrast is a long, curved valley, in which Newton steps
lose their way and a covariance is too small on the side of small radii. The contrast is therefore stepped
from the brightest light to the largest contrast possible, with disks and blur fitted at each: the profile of
the likelihood gives the contrast, and an interval that need not be symmetric.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import Akima1DInterpolator

from contactimg.imaging.fit.disks import FitControl, FittedDisks, ModelImage, fit_disks, render_disks
from contactimg.imaging.fit.problem import CONTRAST, RADIUS, ContrastPrior, FitProblem
from contactimg.imaging.pixels.robust import median

Values = NDArray[np.float64]

PLATEAU_STD_FRACTION = 0.02
"""Uncertainty of the plateau of wide contacts if edges are not those assumed. By hand."""
LARGEST_CONTRAST_RATIO = 10.0
"""Largest contrast over brightest light, without prior knowledge. By hand."""
COARSE_STEPS, FINE_STEPS = 7, 4
"""Contrasts that are tried over the whole range, and then in each half step about the best. Accuracy."""
FINE_ROUNDS = 5  # of halving that at most; accuracy: to 1/200 of the range
REACH_BLUR_WIDTHS = 2.0  # beyond the disks of the start, of the pixels that are compared; accuracy
NODES = 400  # of the integrals; accuracy
FEWEST_TRIED = 4  # contrasts that make a curve; theory: of third order
EDGE = 0.02  # ln contrast from an end of its range within which the range cuts an interval; accuracy
SMOOTH_RISE = 4.0  # of chi-square between neighbours, below which no contrast between them is tried; accuracy
SCATTER_SIGMA = 5.0
"""Standard deviations by which a contrast may exceed the limit of their mean. False-alarm rate: 6e-7."""
CONTROL = FitControl(free_blur=True, iterations=15, tolerance=0.003)


@dataclass(frozen=True, eq=False)
class ContrastProfile:
    """What contacts that do not show their contrast say of it.

    Parameters
    ----------
    problem : FitProblem
        At the most probable contrast.
    fit : FittedDisks
        Disks and blur there.
    log_std : float
        Uncertainty of the logarithm of the contrast.
    blur_slope : float
        Change of the blur, px, with that logarithm.
    radius_shift : ndarray, shape (n,), px
        Root mean square change of each radius over all contrasts.
    """

    problem: FitProblem
    fit: FittedDisks
    log_std: float
    blur_slope: float
    radius_shift: Values

    @property
    def contrast(self) -> float:
        """Most probable common contrast, grey levels."""
        return self.problem.prior.mean

    @property
    def covariance(self) -> Values:
        """Covariance of (ln contrast, blur in px of the fit), shape (2, 2), narrow across its valley."""
        beside = (1e-3 * self.fit.blur) ** 2
        slope = self.blur_slope
        return self.log_std**2 * np.array([[1.0, slope], [slope, slope**2]]) + np.diag([0.0, beside])


@dataclass(frozen=True, eq=False)
class _Tried:
    """A contrast, the fit there, and its chi-square."""

    log_contrast: float
    fit: FittedDisks
    chi_square: float

    @property
    def radius(self) -> float:
        return float(np.median(self.fit.disks[:, RADIUS]))

    @property
    def kurtosis(self) -> float:
        """Excess kurtosis of the median contact, without its sign."""
        disk = 0.25 * self.radius**2
        return float((disk / (disk + self.fit.blur**2)) ** 2)


def profile_contrast(
    problem: FitProblem, fit: FittedDisks, *, inflation: float, kurtosis_std: float
) -> ContrastProfile:
    """Find the most probable contrast of contacts that do not show it, and how well it is known.

    Parameters
    ----------
    problem : FitProblem
        The width of its prior is the spread of the contrasts.
    fit : FittedDisks
        Of this problem; at least one disk.
    inflation : float
        Factor of the variances for what the noise model leaves out.
    kurtosis_std : float
        Uncertainty of the excess kurtosis of the point spread function along one direction.

    Returns
    -------
    ContrastProfile
        At the maximum of the likelihood. The uncertainty of the radii is the farther end of the interval of
        one standard deviation, in which the kurtosis counts.
    """
    height = np.median(fit.disks[:, CONTRAST] * -np.expm1(-0.5 * (fit.disks[:, RADIUS] / fit.blur) ** 2))
    largest = max(problem.largest_contrast, float(height))
    low, high = np.log(height), np.log(min(largest, LARGEST_CONTRAST_RATIO * height))
    tries = _Tries.of(problem, fit, inflation)
    if high - low < PLATEAU_STD_FRACTION:
        return _conclude(tries, [tries.at(high, fit)], (low, high), kurtosis_std)
    found = tries.sweep(np.linspace(low + 0.1 * (high - low), high, COARSE_STEPS), fit)
    step = 0.9 * (high - low) / (COARSE_STEPS - 1)
    for _ in range(FINE_ROUNDS):
        best = min(found, key=lambda each: each.chi_square)
        smooth = sum(each.chi_square < best.chi_square + SMOOTH_RISE for each in found) > FEWEST_TRIED
        if smooth:
            break
        places = best.log_contrast + step * np.linspace(-1.0, 1.0, FINE_STEPS + 1)
        known = np.array([each.log_contrast for each in found])
        new = [x for x in places if low < x <= high and np.abs(known - x).min() > 0.1 * step]
        found += tries.sweep(np.array(new), best.fit)
        step *= 2.0 / FINE_STEPS
    found.sort(key=lambda each: each.log_contrast)
    return _conclude(tries, found, (low, high), kurtosis_std)


@dataclass(frozen=True, eq=False)
class _Tries:
    """Fits of one problem at several contrasts.

    Parameters
    ----------
    problem : FitProblem
    spread : float
        Relative, of the contrasts.
    pixels : ndarray of int
        At and beside the contacts, in the flattened image.
    variance : ndarray
        Of these pixels.
    """

    problem: FitProblem
    spread: float
    pixels: NDArray[np.intp]
    variance: Values

    @classmethod
    def of(cls, problem: FitProblem, fit: FittedDisks, inflation: float) -> "_Tries":
        """About a fit, with its variances, larger where it fits badly."""
        reach = 2 * int(np.ceil(REACH_BLUR_WIDTHS * fit.blur)) + 1
        model = render_disks(fit.disks, fit.blur, problem.image.shape, profile=problem.profile)
        near = cv2.dilate((model > 0).view(np.uint8), np.ones((reach, reach), np.uint8))
        if problem.valid is not None:
            near[problem.valid == 0] = 0
        pixels = np.flatnonzero(near)
        height = np.clip(model.ravel()[pixels] / problem.prior.mean, 0.0, 1.0)
        scale = max(inflation * max(median(fit.chi_square), 1.0), 1.0)
        variance = scale * problem.noise.variance * problem.noise.at(height)
        return cls(problem, problem.prior.std / problem.prior.mean, pixels, variance)

    def sweep(self, logs: Values, fit: FittedDisks) -> list[_Tried]:
        """Fits at several contrasts, each from that at the nearest contrast so far."""
        found: list[_Tried] = []
        at = np.log(np.median(fit.disks[:, CONTRAST]))
        for x in sorted(logs, key=lambda value: abs(value - at)):
            start = min(found, key=lambda each: abs(each.log_contrast - x)).fit if found else fit
            found.append(self.at(float(x), start))
        return found

    def with_contrast(self, log_contrast: float) -> FitProblem:
        """The problem with that contrast as its prior."""
        contrast = float(np.exp(log_contrast))
        prior = ContrastPrior(contrast, self.spread * contrast, self.spread * contrast)
        slope = self.problem.noise.slope * contrast / self.problem.prior.mean
        return replace(self.problem, prior=prior, noise=replace(self.problem.noise, slope=slope))

    def at(self, log_contrast: float, start: FittedDisks) -> _Tried:
        """The fit at one contrast, from a start in which light and variance of each disk are right.

        The limit of the contrasts holds for their mean: that of a single disk scatters about it by its noise.
        """
        disks, problem = start.disks.copy(), self.with_contrast(log_contrast)
        most = problem.largest_contrast * (1.0 + SCATTER_SIGMA * self.spread)
        problem = replace(problem, largest_contrast=most)
        ratio = np.exp(log_contrast) / np.median(disks[:, CONTRAST])
        variance = start.blur**2 + 0.25 * float(np.median(disks[:, RADIUS])) ** 2
        disks[:, CONTRAST] *= ratio
        disks[:, RADIUS] /= np.sqrt(ratio)
        narrow = 0.1 * variance
        blur = np.sqrt(max(variance - 0.25 * float(np.median(disks[:, RADIUS])) ** 2, narrow))
        fit = fit_disks(
            problem, disks, blur=float(blur), control=CONTROL, brightness=start.brightness,
            start=ModelImage.blank(problem.image.shape, len(disks), complete=True),
        )  # fmt: skip
        return _Tried(log_contrast, fit, self._chi_square(fit, float(np.exp(log_contrast))))

    def _chi_square(self, fit: FittedDisks, contrast: float) -> float:
        """Chi-square of the pixels and of the scatter of the contrasts."""
        rest = self.problem.image.ravel()[self.pixels] - fit.model.ravel()[self.pixels]
        excess = (fit.disks[:, CONTRAST] / contrast - 1.0) / self.spread
        return float(np.sum(rest.astype(float) ** 2 / self.variance) + np.sum(excess**2))


def _conclude(
    tries: _Tries, found: list[_Tried], limits: tuple[float, float], kurtosis_std: float
) -> ContrastProfile:
    """The fit at the most probable contrast, and its uncertainties."""
    best = min(found, key=lambda each: each.chi_square)
    if len(found) < FEWEST_TRIED:
        last = max(found, key=lambda each: each.log_contrast)
        interval, slope = np.array(limits), 0.0
        sides = np.exp(0.5 * (last.log_contrast - interval)) - 1.0
    else:
        curve = _Curve.through(found)
        at = curve.lowest_beside(best)
        last = tries.at(float(curve.x[at]), best.fit)
        if last.chi_square > best.chi_square:
            last, at = best, int(np.argmin(np.abs(curve.x - best.log_contrast)))
        inside = curve.within_one_std(at, kurtosis_std)
        interval, slope = curve.x[inside], float(np.polyfit(curve.x[inside], curve.blur[inside], 1)[0])
        sides = curve.radius[inside] / curve.radius[at] - 1.0
    low, high = np.abs(interval[[0, -1]] - last.log_contrast)
    cut = interval[0] <= limits[0] + EDGE or interval[-1] >= limits[1] - EDGE
    log_std = float(max(low, high) if cut else np.hypot(low, high) / np.sqrt(2.0))
    relative = max(float(np.abs(sides[[0, -1]]).max()), PLATEAU_STD_FRACTION / 4.0)
    return ContrastProfile(
        tries.with_contrast(last.log_contrast), last.fit, max(log_std, PLATEAU_STD_FRACTION / 2.0), slope,
        -relative * last.fit.disks[:, RADIUS],
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Curve:
    """Chi-square, kurtosis, radius and blur over the logarithm x of the contrast, and where it was tried."""

    x: Values
    chi_square: Values
    kurtosis: Values
    radius: Values
    blur: Values
    tried: Values

    @classmethod
    def through(cls, found: list[_Tried]) -> "_Curve":
        """Smooth through what was tried."""
        logs = np.array([each.log_contrast for each in found])
        columns = np.array([[each.chi_square, each.kurtosis, each.radius, each.fit.blur] for each in found])
        x = np.linspace(logs[0], logs[-1], NODES)
        chi_square, kurtosis, radius, blur = Akima1DInterpolator(logs, columns, method="makima")(x).T
        return cls(x, chi_square, kurtosis, radius, blur, tried=logs)

    def lowest_beside(self, best: _Tried) -> int:
        """Index of the lowest chi-square between the neighbours of the best contrast tried.

        Farther away, where fits may have gone astray, the curve dips between them.
        """
        k = int(np.searchsorted(self.tried, best.log_contrast))
        low, high = self.tried[max(k - 1, 0)], self.tried[min(k + 1, len(self.tried) - 1)]
        return int(np.argmin(np.where((self.x >= low) & (self.x <= high), self.chi_square, np.inf)))

    def within_one_std(self, at: int, kurtosis_std: float) -> NDArray[np.bool_]:
        """The contrasts that are not excluded by one standard deviation, about that at the index ``at``.

        It is excluded by pixels and, if the point spread function is a Gaussian, by the kurtosis: the
        variances of these two reasons add.
        """
        decrease = np.maximum(self.chi_square - self.chi_square[at], 0.0)
        difference = (self.kurtosis - self.kurtosis[at]) ** 2
        allowed = difference + decrease * kurtosis_std**2
        excluded = np.divide(decrease * difference, allowed, out=np.zeros(NODES), where=allowed > 0) > 1.0
        far = np.flatnonzero(excluded)
        first = int(far[far < at].max(initial=-1)) + 1
        last = int(far[far > at].min(initial=NODES)) - 1
        return (np.arange(NODES) >= min(first, at - 1)) & (np.arange(NODES) <= max(last, at + 1))
