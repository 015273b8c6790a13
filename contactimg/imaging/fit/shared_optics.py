"""Contrast and blur common to all contacts of a frame: their most probable values, and their uncertainties.

A disk has a centre, a radius and a contrast of its own, p. Contrasts scatter about a common value C with a
known spread, and the blur s is common. With N the normal matrix of p (its prior included) and B its cross
terms with q = (ln C, s), the Fisher information of the frame on q and the response of each disk to q are

    J = sum (K - B' N^-1 B),        dp/dq = -N^-1 B,

K being the terms of q alone. A wide contact shows its contrast, which increases J. A small contact shows
only its total light: its radius goes as C^(-1/2), and it says little about C. Many small ones together still
may. The maximum of the likelihood over q is found by Newton steps with J, with a fit of the disks in
between. Prior knowledge of q enters as a normal prior. Where all contacts are about as small as the blur,
steps of the contrast over its whole range take their place (`contactimg.imaging.fit.unseen_contrast`).

Contrasts form a hierarchy: contacts whose plateau agrees with that of most share one contrast with the spread
that they show; one whose plateau disagrees by 5 standard deviations has its own; one too small to show its
plateau has that of the frame, with the spread of all.
"""

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.fit import unseen_contrast
from contactimg.imaging.fit.disks import (
    NARROWEST_BLUR_PX,
    FitControl,
    FittedDisks,
    ModelImage,
    fit_disks,
    wide_disks,
)
from contactimg.imaging.fit.problem import CONTRAST, RADIUS, ContrastPrior, FitProblem
from contactimg.imaging.fit.shared_scores import SharedScores
from contactimg.imaging.pixels.noise import NoiseCorrelation
from contactimg.imaging.pixels.robust import AGREEMENT_SIGMA, MAD_TO_STD, SIGNIFICANT_SIGMA
from contactimg.imaging.profile import limits
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.profile.optics import SharedOptics

SPREAD_FRACTION = 0.03
"""Spread of the contrasts where too few contacts are wide, and least departure of an odd contrast. By hand:
less moves the radius of a small contact by 1.5 %."""
LEAST_BLUR_PX = 0.1
"""Blur at which its uncertainty is taken where it is narrower. Accuracy: keeps that finite, as edges as sharp
as the pixels have a blur of 0."""
CONTROL = FitControl(free_blur=False, iterations=6, tolerance=0.003)


@dataclass(frozen=True, eq=False)
class JointFit:
    """Disks at the most probable common contrast and blur.

    Parameters
    ----------
    fit : FittedDisks
    contrast, spread : float
        Common contrast, and spread of the contrasts about it, grey levels.
    covariance : ndarray, shape (2, 2)
        Of (ln contrast, blur in px of the fit, pixel included), prior knowledge included.
    own_covariance : ndarray, shape (2, 2)
        The same from this frame alone, as far as it determines anything.
    radius_shifts : ndarray, shape (n, 2)
        Change of each radius (px) by one standard uncertainty of the contrast, with the correlated change of
        the blur, and by one of the remaining uncertainty of the blur: two independent errors common to all
        disks.
    prior : ContrastPrior
        Of the contrasts, with those contacts that have their own.
    alone : ndarray, shape (2,)
        ln contrast and blur (px of the fit, pixel included) that this frame alone shows, to first order.
    correlation : NoiseCorrelation
        Of the noise that neighbouring pixels share.
    least_factor : float
        Factor of the variances of most disks, for this noise and their misfit.
    """

    fit: FittedDisks
    contrast: float
    spread: float
    covariance: NDArray[np.float64]
    own_covariance: NDArray[np.float64]
    radius_shifts: NDArray[np.float64]
    prior: ContrastPrior
    alone: NDArray[np.float64]
    correlation: NoiseCorrelation = field(default_factory=NoiseCorrelation.independent)
    least_factor: float = 1.0

    def optics(self, covariance: NDArray[np.float64], *, binning: int) -> SharedOptics:
        """Contrast and blur with a given covariance, in pixels of the frame."""
        sigma = np.sqrt(max(self.fit.blur**2 - PIXEL_VARIANCE, 0.0))
        std = np.sqrt(np.diag(covariance))
        return SharedOptics(
            contrast=self.contrast,
            contrast_std=self.contrast * float(std[0]),
            spread=self.spread,
            blur_px=float(sigma) * binning,
            blur_std_px=float(std[1] * self.fit.blur / max(sigma, LEAST_BLUR_PX)) * binning,
            correlation=float(covariance[0, 1] / (std[0] * std[1])),
        )


@dataclass(frozen=True, eq=False)
class OpticsPrior:
    """Normal prior of (ln contrast, blur in px of the fit, pixel included).

    Parameters
    ----------
    mean : ndarray, shape (2,)
    information : ndarray, shape (2, 2)
        Inverse of the covariance.
    """

    mean: NDArray[np.float64]
    information: NDArray[np.float64]

    @classmethod
    def of(cls, optics: SharedOptics, start: FitProblem, *, blur: float) -> "OpticsPrior":
        """The prior from prior optics, for the problem to start from.

        Where the optics are not known, the contrast of the problem is the brightest light in the image, which
        blur may have reduced by up to `LARGEST_CONTRAST_RATIO` (uniform in the logarithm), as far as the grey
        levels go, and ``blur`` is a guess.
        """
        contrast, binning = start.contrast, start.binning
        largest = min(max(start.largest_contrast / contrast, 1.0), unseen_contrast.LARGEST_CONTRAST_RATIO)
        ratio = max(float(np.log(largest)), unseen_contrast.PLATEAU_STD_FRACTION)
        given = np.isfinite([optics.contrast, optics.blur_px])
        mean = np.array([np.log(contrast) + 0.5 * ratio, blur])
        # By hand: the guess of the blur is right to a factor of 2.
        std = np.array([ratio / np.sqrt(12.0), 0.5 * blur])
        if given[0]:
            mean[0] = np.log(optics.contrast)
            std[0] = max(optics.contrast_relative_std, limits.NEGLIGIBLE_FRACTION)
        if given[1]:
            mean[1] = np.hypot(optics.blur_px / binning, np.sqrt(PIXEL_VARIANCE))
            slope = max(optics.blur_px / binning, LEAST_BLUR_PX) / (binning * mean[1])
            std[1] = max(optics.blur_std_px * slope, limits.NEGLIGIBLE_FRACTION * mean[1])
        correlation = np.eye(2)
        if given.all():
            correlation[0, 1] = correlation[1, 0] = optics.correlation
        return cls(mean, np.asarray(np.linalg.inv(correlation * np.outer(std, std)), float))

    def score(self, contrast: float, blur: float) -> NDArray[np.float64]:
        """Derivative of the logarithm of its probability, shape (2,)."""
        return np.asarray(self.information @ (self.mean - np.array([np.log(contrast), blur])))

    def is_contradicted_by(self, joint: "JointFit") -> bool:
        """Whether the frame alone shows its contrast, and another contrast or blur."""
        away, own = joint.alone - self.mean, joint.own_covariance
        excess = away @ np.linalg.solve(own + np.linalg.inv(self.information), away)
        return bool(own[0, 0] < limits.RESOLVED**2 and excess > limits.TWO_SIGNIFICANT)

    def with_exact_blur(self, blur: float) -> "OpticsPrior":
        """The prior with a blur that is held fixed."""
        information = np.diag([self.information[0, 0], 1.0 / (limits.NEGLIGIBLE_FRACTION * blur) ** 2])
        return OpticsPrior(np.array([self.mean[0], blur]), information)


def settle_optics(
    problem: FitProblem, fit: FittedDisks, optics_prior: OpticsPrior, *, inflation: NDArray[np.float64],
    wide_contrast: float, steps: int = limits.ITERATIONS,
) -> JointFit:  # fmt: skip
    """Find the most probable common contrast and blur of an image, and the disks with them.

    Parameters
    ----------
    problem : FitProblem
        The mean of its prior is the contrast to start from, the width its spread.
    fit : FittedDisks
        Of this problem; at least one disk.
    optics_prior : OpticsPrior
    inflation : ndarray, shape (n,)
        Factor of the variances for what the noise model leaves out.
    wide_contrast : float
        Contrast that the wide contacts show; NaN if there are none.
    steps : int
        Newton steps at most.

    Returns
    -------
    JointFit
        A fit with contrast and blur right to a fraction of their uncertainties stays as it is. Where no
        contact shows its contrast, or Newton's steps lead small contacts to a worse fit, see
        `contactimg.imaging.fit.unseen_contrast`.
    """
    newton = partial(_newton, optics_prior=optics_prior, inflation=inflation, wide_contrast=wide_contrast)
    joint, few, lost = None, steps < limits.ITERATIONS, False
    if few or not _is_unseen(problem, fit, optics_prior):
        joint = newton(problem, fit, steps=steps)
        worse = np.median(joint.fit.chi_square) > limits.POOR_CHI_SQUARE * np.median(fit.chi_square)
        lost = bool(worse) and _is_unseen(problem, fit, optics_prior, limits.SHOWN_BLUR_WIDTHS)
        if not lost:
            problem, fit = replace(problem, prior=joint.prior), joint.fit
    if joint is None or (not few and (lost or _is_unseen(problem, fit, optics_prior))):
        typical = float(np.median(inflation))
        problem, fit, covariance, shift = unseen_contrast.profile_contrast(problem, fit, inflation=typical)
        prior, shifts = problem.prior, np.column_stack([shift, np.zeros(len(shift))])
        alone = np.array([np.log(prior.mean), fit.blur])
        return JointFit(fit, prior.mean, prior.std, covariance, covariance, shifts, prior, alone)
    if joint.contrast > problem.shown_contrast:
        prior = problem.prior.at(problem.shown_contrast)
        return newton(replace(problem, prior=prior, largest_contrast=problem.shown_contrast), fit)
    return joint


def _newton(
    problem: FitProblem, fit: FittedDisks, *, optics_prior: OpticsPrior, inflation: NDArray[np.float64],
    wide_contrast: float, steps: int = limits.ITERATIONS,
) -> JointFit:  # fmt: skip
    """Newton steps of contrast and blur with fits of the disks in between, see `settle_optics`."""
    most = problem.largest_contrast
    contrast = min(problem.prior.mean, most)
    prior = problem.prior.at(contrast)
    noise_slope, least_factor = problem.noise.slope / contrast, max(float(np.median(inflation)), 1.0)
    last_step = np.zeros(2)
    for remaining in reversed(range(steps)):
        scores = disk_scores(fit, prior, least_factor)
        gradient, own = _with_plateau(scores, float(np.log(wide_contrast / contrast)))
        here, by_itself = np.array([np.log(contrast), fit.blur]), gradient
        covariance = np.asarray(np.linalg.inv(own + optics_prior.information), float)
        step = covariance @ (gradient + optics_prior.score(contrast, fit.blur))
        low, high = [-np.inf, NARROWEST_BLUR_PX - fit.blur], [np.log(most / contrast), np.inf]
        for k in (0, 1):  # where one ends at its bound, the other follows
            step = step + (np.clip(step[k], low[k], high[k]) - step[k]) * covariance[:, k] / covariance[k, k]
        step = np.clip(step, low, high)
        if not remaining or not _is_worth_a_fit(step, fit, scores, covariance):
            break
        step *= 0.5 if step @ last_step < 0 else 1.0
        longest = limits.LONGEST_STEP * np.array([1.0, fit.blur])
        last_step = step = np.clip(step, -longest, longest)
        contrast, blur = contrast * float(np.exp(step[0])), fit.blur + float(step[1])
        prior = prior.at(contrast)
        small = 0.003  # accuracy: a linear step errs by its square
        if abs(step[0]) < small and abs(step[1]) < small * blur:
            change = scores.response @ step
            # a disk of which the pixels say next to nothing would go anywhere
            size = np.abs(fit.disks[:, RADIUS:])
            far = np.any(np.abs(change[:, RADIUS:]) > limits.ROUGH_STD * size, axis=1)
            fit = replace(fit, disks=fit.disks + np.where(far[:, None], 0.0, change), blur=blur)
            break
        stepped = replace(problem, noise=replace(problem.noise, slope=noise_slope * contrast), prior=prior)
        disks, radius = fit.disks.copy(), fit.disks[:, RADIUS]
        disks[:, RADIUS] = np.maximum(radius + scores.response[:, RADIUS] @ step, 0.3 * radius)
        disks[:, CONTRAST] *= np.exp(step[0])
        fit = fit_disks(
            stepped, disks, blur=blur, control=CONTROL, brightness=fit.brightness,
            start=ModelImage.over(fit.model, len(fit.disks), complete=False),
        )  # fmt: skip
    # where the frame determines nothing, its own covariance stays finite
    least_information = np.diag(1e-6 / np.array([1.0, fit.blur]) ** 2)
    own_covariance = np.asarray(np.linalg.inv(own + least_information), float) + _of_kurtosis(fit)
    covariance = np.asarray(np.linalg.inv(np.linalg.inv(own_covariance) + optics_prior.information), float)
    return JointFit(
        fit, contrast, prior.std, covariance, own_covariance,
        radius_shifts=scores.response[:, RADIUS] @ np.linalg.cholesky(covariance), prior=prior,
        alone=here + own_covariance @ by_itself,
    )  # fmt: skip


def _is_unseen(
    problem: FitProblem, fit: FittedDisks, prior: OpticsPrior, widest: float = limits.NEAR_BLUR_WIDTHS
) -> bool:
    """Whether no contact is wider than that in blur widths, and nothing else tells contrast and blur."""
    std = np.sqrt(np.diag(np.linalg.inv(prior.information))) / np.array([1.0, prior.mean[1]])
    # Of ln C and the blur, from which the prior is a guess that small contacts need not be drawn to. By hand:
    # a guess has 0.5 of the blur, a pooled series 0.1 and less.
    free = bool((std >= np.array([0.05, 0.4])).all()) and bool(len(problem.profile.powers))
    lit = len(fit.disks) > 0 and float(np.median(fit.disks[:, CONTRAST])) > 0.0
    return free and lit and _widest(fit) <= widest * fit.blur


def _widest(fit: FittedDisks) -> float:
    """Radius that a few contacts reach, or those that make half of the area: specks hide no wide contact."""
    radius = np.sort(fit.disks[:, RADIUS])[::-1]
    half = int(np.searchsorted(np.cumsum(radius**2), 0.5 * np.sum(radius**2)))
    return float(radius[min(limits.FEWEST - 1, half)])


def _of_kurtosis(fit: FittedDisks) -> NDArray[np.float64]:
    """Covariance of (ln contrast, blur) by a point spread function known to `KURTOSIS_STD`.

    Of a contact that does not show its plateau, the light ``C a^2`` and the variance ``s^2 + a^2/4`` are seen
    directly; contrast and radius are told apart by the excess kurtosis ``-(q/(1+q))^2`` alone,
    ``q = a^2/(4 s^2)``. An error k of it, which the point spread function has if it is no Gaussian, changes
    ``ln a`` by ``k (1+q)^2/(4 q^2)``, to first order in q.
    """
    widest, blur = _widest(fit), fit.blur
    q = max((widest / blur) ** 2 / 4.0, 0.05)  # keeps the uncertainty finite
    mode = unseen_contrast.KURTOSIS_STD * (1.0 + 1.0 / q) ** 2 / 4.0 * np.array([2.0, q * blur])
    return np.outer(mode, mode) * (widest <= limits.NEAR_BLUR_WIDTHS * blur)


def _is_worth_a_fit(step: NDArray, fit: FittedDisks, scores: SharedScores, covariance: NDArray) -> bool:
    """Whether a step changes the sum of a^3 by more than a fraction of its uncertainty."""
    weights = 3.0 * fit.disks[:, RADIUS] ** 2
    slope = weights @ scores.response[:, RADIUS]
    variance = slope @ covariance @ slope + np.sum((weights * fit.std[:, RADIUS]) ** 2)
    return bool((slope @ step) ** 2 > limits.SETTLED_SIGMA**2 * variance)


def disk_scores(fit: FittedDisks, prior: ContrastPrior, least_factor: float = 1.0) -> SharedScores:
    """Scores on (ln contrast, blur) from the last normal equations of a fit with this prior.

    Own are x, y, radius and contrast. A contact with a contrast of its own says nothing about the common one.
    """
    mean, std = prior.of_disks(fit.disks, fit.blur)
    pull = np.where(prior.is_odd(fit.disks) >= 0, 0.0, prior.mean / std**2)
    normal, n = fit.information[:, :4, :4].copy(), len(fit.disks)
    # a disk outside the image or under a mask has no information: keep its matrix regular
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(4)
    cross, information = np.zeros((n, 4, 2)), np.zeros((n, 2, 2))
    cross[:, CONTRAST, 0], cross[:, :, 1] = -pull, fit.information[:, :4, 4]
    information[:, 0, 0], information[:, 1, 1] = pull * prior.mean, fit.information[:, 4, 4]
    score = np.stack([pull * (fit.disks[:, CONTRAST] - mean), fit.blur_score], axis=-1)
    scores = SharedScores.eliminated(normal, np.zeros((n, 4)), cross, score, information, least_factor)
    # a disk that had another prior when it was fitted may be left with less than nothing
    values, vectors = np.linalg.eigh(scores.information)
    information = (vectors * np.maximum(values, 0.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    return replace(scores, information=information)


def _with_plateau(scores: SharedScores, plateau_offset: float) -> tuple[NDArray, NDArray]:
    """Score and information of all disks, with variances as large as the disks disagree.

    Where they disagree, edges are not those assumed. The plateau of wide contacts does not depend on the
    edges: it then enters as a datum, ``plateau_offset`` being the logarithm of its ratio to the contrast.
    """
    score, information, factor, _ = scores.total(np.array([0, 1]))
    weight = max(1.0 - limits.USUAL_CHI_SQUARE / factor, 0.0) / unseen_contrast.PLATEAU_STD_FRACTION**2
    datum = weight * np.array([1.0, 0.0]) if np.isfinite(plateau_offset) else np.zeros(2)
    return score / factor + datum * np.nan_to_num(plateau_offset), information / factor + np.diag(datum)


def as_common_error(modes: NDArray, radius: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Independent errors of all radii as one with the same effect on the sum of areas, and what each leaves.

    Parameters
    ----------
    modes : ndarray, shape (n, k), px
        Change of each radius by one standard uncertainty of each error.
    radius : ndarray, shape (n,), px
    """
    along = modes.T @ radius
    common = modes @ along / max(float(np.linalg.norm(along)), 1e-30)
    return common, np.sqrt(np.maximum(np.sum(modes**2, axis=1) - common**2, 0.0))


def contrast_prior(fit: FittedDisks, problem: FitProblem, *, inflation: NDArray[np.float64]) -> ContrastPrior:
    """Prior of the contrasts from what the wide contacts of a frame show.

    Parameters
    ----------
    fit : FittedDisks
        With a loose prior.
    problem : FitProblem
        Its contrast is assumed, with the spread `SPREAD_FRACTION`, if fewer than three contacts are
        wide, or most of them have less than half of it.
    inflation : ndarray, shape (n,)
        Factor of the variance of each contrast for noise that neighbouring pixels share.
    """
    wide, default = wide_disks(fit), problem.contrast
    values, stds = fit.disks[wide, CONTRAST], fit.std[wide, CONTRAST] * np.sqrt(inflation[wide])
    # a few faint ones that happen to fit well do not stand for contacts of another shape
    if len(values) < limits.FEWEST or float(np.median(values)) < 0.5 * default:
        spread = SPREAD_FRACTION * default
        return ContrastPrior(default, spread, spread, problem.prior.odd)
    middle = float(np.median(values))
    excess = (MAD_TO_STD * float(np.median(np.abs(values - middle)))) ** 2
    for _ in range(limits.ROUNDS):
        limit = np.maximum(SIGNIFICANT_SIGMA * np.sqrt(excess + stds**2), SPREAD_FRACTION * middle)
        usual = np.abs(values - middle) < limit
        if np.count_nonzero(usual) < limits.FEWEST:
            usual = np.ones(len(values), np.bool_)
            break
        expected = float(np.mean(stds[usual] ** 2))
        excess = float(np.var(values[usual])) - expected
        # a variance of n values is known to sqrt(2/n)
        excess *= excess > AGREEMENT_SIGMA * expected * np.sqrt(2.0 / np.count_nonzero(usual))
        middle = float(np.average(values[usual], weights=1.0 / (stds[usual] ** 2 + excess)))
    weights = 1.0 / (stds[usual] ** 2 + excess)
    std = float(np.sqrt(excess + 1.0 / weights.sum() + (limits.NEGLIGIBLE_FRACTION * middle) ** 2))
    small = float(np.hypot(std, np.sqrt(np.mean(np.where(usual, 0.0, values - middle) ** 2))))
    return ContrastPrior(middle, std, small, fit.disks[np.flatnonzero(wide)[~usual]])
