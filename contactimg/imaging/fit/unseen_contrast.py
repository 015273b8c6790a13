"""Contrast and blur of a frame whose contacts are all about as small as the blur: their profile likelihood.

Of a contact of radius a behind a blur s, the light ``C a^2`` and the variance ``s^2 + a^2/4`` are seen
directly. Contrast and radius are told apart by the excess kurtosis ``-u^2`` alone,
``u = (a^2/4)/(s^2 + a^2/4)``: the likelihood of the contrast is a long, curved valley, in which Newton steps
lose their way and a covariance is too small on the side of small radii. The contrast is therefore stepped
from the brightest light to the largest contrast possible, with disks and blur fitted at each: the profile of
the likelihood gives the probability of each of them.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.fit.disks import FitControl, FittedDisks, fit_disks, render_disks
from contactimg.imaging.fit.problem import CONTRAST, RADIUS, ContrastPrior, FitProblem
from contactimg.imaging.pixels.robust import AGREEMENT_SIGMA, SIGNIFICANT_SIGMA, median
from contactimg.imaging.profile.limits import NEAR_BLUR_WIDTHS, POOR_CHI_SQUARE, ROUNDS

Values = NDArray[np.float64]

PLATEAU_STD_FRACTION = 0.02
"""Uncertainty of the plateau of wide contacts if edges are not those assumed. By hand."""
LARGEST_CONTRAST_RATIO = 10.0
"""Largest contrast over brightest light, without prior knowledge. By hand."""
KURTOSIS_STD = 0.03
"""Uncertainty of the excess kurtosis of the point spread function in one direction, which is assumed to be 0.
Chosen: noise cut off at the full scale of 8 bits changes a blurred disk by as much, defocus ten times."""
COARSE_STEPS, FINE_STEPS = 7, 4
"""Contrasts that are tried over the whole range, and then on both sides of the best, until the pixels do not
exclude more than so many. Accuracy."""
CENTRAL = (0.1587, 0.8413)  # shares of the probability at the ends of an interval of one standard deviation
CONTROL = FitControl(free_blur=True, iterations=15, tolerance=0.003)


@dataclass(frozen=True, eq=False)
class _Tried:
    """A contrast, the fit there, and its chi-square."""

    log_contrast: float
    fit: FittedDisks
    chi_square: float


def profile_contrast(
    problem: FitProblem, fit: FittedDisks, *, inflation: float
) -> tuple[FitProblem, FittedDisks, Values, Values]:
    """Find the most probable contrast of contacts that do not show it, and how well it is known.

    Parameters
    ----------
    problem : FitProblem
        The width of its prior is the spread of the contrasts.
    fit : FittedDisks
        Of this problem; at least one disk.
    inflation : float
        Factor of the variances for what the noise model leaves out.

    Returns
    -------
    problem : FitProblem
        At the maximum of the likelihood: the mean of its prior is the most probable contrast.
    fit : FittedDisks
        Disks and blur there.
    covariance : ndarray, shape (2, 2)
        Of (ln contrast, blur in px of the fit), narrow across its valley. Where disks do not fit, a contrast
        beyond what the frame shows is uncertain at least by how far it lies beyond.
    radius_shift : ndarray, shape (n,), px
        Uncertainty of each radius: its change at the farther end of the interval that holds the middle 68 %
        of the probability.
    """
    height = np.median(fit.disks[:, CONTRAST] * -np.expm1(-0.5 * (fit.disks[:, RADIUS] / fit.blur) ** 2))
    largest = max(problem.largest_contrast, float(height))
    low, high = np.log(height), np.log(min(largest, LARGEST_CONTRAST_RATIO * height))
    tries = _Tries(problem, fit, inflation)
    if high - low < PLATEAU_STD_FRACTION:
        return _conclude(tries, [tries.at(high, fit)], (low, high))
    found = tries.sweep(np.linspace(low + 0.1 * (high - low), high, COARSE_STEPS), fit)
    step = 0.9 * (high - low) / (COARSE_STEPS - 1)
    for _ in range(ROUNDS):
        best = min(found, key=lambda each: each.chi_square)
        if sum(each.chi_square < best.chi_square + AGREEMENT_SIGMA**2 for each in found) > FINE_STEPS:
            break  # the probability is smooth
        places = best.log_contrast + step * np.linspace(-1.0, 1.0, FINE_STEPS + 1)
        known = np.array([each.log_contrast for each in found])
        new = [x for x in places if low < x <= high and np.abs(known - x).min() > 0.1 * step]
        found += tries.sweep(np.array(new), best.fit)
        step *= 2.0 / FINE_STEPS
    return _conclude(tries, found, (low, high))


class _Tries:
    """Fits of one problem at several contrasts.

    Attributes
    ----------
    problem : FitProblem
    spread : float
        Relative, of the contrasts.
    pixels : ndarray of int
        At and beside the contacts, in the flattened image.
    variance : ndarray
        Of these pixels, larger where the first fit is bad.
    """

    def __init__(self, problem: FitProblem, fit: FittedDisks, inflation: float):
        self.problem, self.spread = problem, problem.prior.std / problem.prior.mean
        reach = 2 * int(np.ceil(NEAR_BLUR_WIDTHS * fit.blur)) + 1
        model = render_disks(fit.disks, fit.blur, problem.image.shape, profile=problem.profile)
        near = cv2.dilate((model > 0).view(np.uint8), np.ones((reach, reach), np.uint8))
        if problem.valid is not None:
            near[problem.valid == 0] = 0
        self.pixels = np.flatnonzero(near)
        height = np.clip(model.ravel()[self.pixels] / problem.prior.mean, 0.0, 1.0)
        scale = max(inflation * max(median(fit.chi_square), 1.0), 1.0)
        self.variance = scale * problem.noise.variance * problem.noise.at(height)

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
        most = problem.largest_contrast * (1.0 + SIGNIFICANT_SIGMA * self.spread)
        problem = replace(problem, largest_contrast=most)
        ratio = np.exp(log_contrast) / np.median(disks[:, CONTRAST])
        variance = start.blur**2 + 0.25 * float(np.median(disks[:, RADIUS])) ** 2
        disks[:, CONTRAST] *= ratio
        disks[:, RADIUS] /= np.sqrt(ratio)
        blur = np.sqrt(max(variance - 0.25 * float(np.median(disks[:, RADIUS])) ** 2, 0.1 * variance))
        fit = fit_disks(problem, disks, blur=float(blur), control=CONTROL, brightness=start.brightness)
        rest = problem.image.ravel()[self.pixels] - fit.model.ravel()[self.pixels]
        excess = (fit.disks[:, CONTRAST] / problem.contrast - 1.0) / self.spread
        chi_square = np.sum(rest.astype(float) ** 2 / self.variance) + np.sum(excess**2)
        return _Tried(log_contrast, fit, float(chi_square))


def _conclude(
    tries: _Tries, found: list[_Tried], limits: tuple[float, float]
) -> tuple[FitProblem, FittedDisks, Values, Values]:
    """The fit at the most probable contrast, and the uncertainties by the probability of all that were tried.

    A contrast is excluded by the pixels and, if the point spread function is a Gaussian, by the kurtosis: the
    variances of these two reasons add.
    """
    found = sorted(found, key=lambda each: each.log_contrast)
    k = min(range(len(found)), key=lambda i: found[i].chi_square)
    if 0 < k < len(found) - 1:
        x, chi_square = np.array([[each.log_contrast, each.chi_square] for each in found[k - 1 : k + 2]]).T
        curved, tilted, _ = np.polyfit(x - x[1], chi_square, 2)
        lowest = float(np.clip(x[1] - 0.5 * tilted / curved if curved > 0 else x[1], x[0], x[2]))
        found[k] = min(found[k], tries.at(lowest, found[k].fit), key=lambda each: each.chi_square)
    fit, problem = found[k].fit, tries.with_contrast(found[k].log_contrast)
    x, chi_square, blur = np.array([[each.log_contrast, each.chi_square, each.fit.blur] for each in found]).T
    radius = np.array([np.median(each.fit.disks[:, RADIUS]) for each in found])
    disk = 0.25 * radius**2
    kurtosis = (disk / (disk + blur**2)) ** 2  # of the median contact, without its sign
    decrease, difference = np.maximum(chi_square - chi_square[k], 0.0), (kurtosis - kurtosis[k]) ** 2
    allowed = difference + decrease * KURTOSIS_STD**2
    excess = np.divide(decrease * difference, allowed, out=np.zeros(len(x)), where=allowed > 0)
    ends = np.clip(np.concatenate([limits[:1], 0.5 * (x[1:] + x[:-1]), limits[1:]]), *limits)
    weight = np.exp(-0.5 * excess) * np.maximum(np.diff(ends), 1e-9)
    weight /= weight.sum()
    sides = np.interp(CENTRAL, np.append(0.0, np.cumsum(weight)), ends)
    relative = float(np.abs(np.interp(sides, x, radius) / radius[k] - 1.0).max())
    off = x - weight @ x
    slope = float(weight @ (off * blur) / max(weight @ off**2, 1e-12))  # of the blur, px
    std = max(float(np.sqrt(np.mean((sides - x[k]) ** 2))), PLATEAU_STD_FRACTION / 2.0)
    if float(np.median(fit.chi_square)) > POOR_CHI_SQUARE:
        std = max(std, float(np.log(problem.contrast / problem.shown_contrast)))
    covariance = std**2 * np.array([[1.0, slope], [slope, slope**2]])
    covariance[1, 1] += (1e-3 * fit.blur) ** 2
    return problem, fit, covariance, -max(relative, PLATEAU_STD_FRACTION / 4.0) * fit.disks[:, RADIUS]
