"""Likelihood of the rims of isolated contacts under an edge: contacts, contrast and blur at its maximum.

Each rim has a radius, a contrast and a background of its own; the common contrast C and the blur s are
shared. The maximum over all of them is found by Gauss-Newton steps on the pixels about the contacts alone
(`contactimg.imaging.fit.edge_scores`), so that several edges can be compared at little cost.

Residuals are needed at the nodes of radial profiles only: with models m and n of the same rims and the sums
S of their residuals, the difference of chi-square is ``sum w (n - m)(S_m + S_n)``.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.fit.edge_scores import (
    CLIP_SIGMA,
    FINE_STEPS_PER_BLUR,
    LEAST_CLIP_FRACTION,
    LOCAL_BACKGROUND_FRACTION,
    NEIGHBOUR_BLUR_WIDTHS,
    STEPS_PER_BLUR,
    Edge,
    EdgeScores,
    Placement,
)
from contactimg.imaging.fit.problem import CONTRAST, RADIUS, FitProblem
from contactimg.imaging.fit.shared_optics import OpticsPrior
from contactimg.imaging.kernels.radial_sums import sum_residuals
from contactimg.imaging.pixels.masks import for_kernel
from contactimg.imaging.pixels.robust import robust_std
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.profile.edge_shape import PlacedDisks

Values = NDArray[np.float64]

MOST_STEPS = 12  # of Gauss and Newton; accuracy
SETTLED_SIGMA = (
    0.05  # step of contrast and blur, in their uncertainties, at which they have settled; accuracy
)
LONGEST_BLUR_STEP = 0.2  # relative; accuracy
MODEL_ERROR = 3e-4
"""Error of the height of an edge, of the contrast, that all rims share. Chosen: pixels that are not points
make 1e-4 at a blur of 1.4 px, and no lens has a Gaussian point spread function."""
OUTLIER_SIGMA = 4.0
"""Standard deviations from the median at which a rim counts no more. False-alarm rate 6e-5 (theory)."""
OPTICS = np.array([0, 1])
"""Places of ln C and s among the shared quantities."""


@dataclass(frozen=True, eq=False)
class RimFit:
    """Rims of isolated contacts at the maximum of their likelihood.

    Parameters
    ----------
    edge : Edge
    problem : FitProblem
        Its prior has the common contrast found.
    disks : ndarray, shape (n, 4)
        x, y, radius (px), contrast.
    background : ndarray, shape (n,)
        About each.
    covariance : ndarray, shape (2, 2)
        Of (ln C, s), prior knowledge included.
    own_covariance : ndarray, shape (2, 2)
        The same without.
    chosen : ndarray of int, shape (n,)
        Which of the contacts asked for these are.
    """

    edge: Edge
    problem: FitProblem
    disks: Values
    background: Values
    covariance: Values
    own_covariance: Values
    chosen: NDArray[np.int64]

    def profile(self, disks: PlacedDisks) -> Values:
        """Brightness over contrast at the nodes of other disks about the same centres."""
        return self.edge.profile(replace(disks, radius=self.disks[:, [RADIUS]]))

    def part(self, chosen: NDArray[np.int64]) -> "RimFit":
        """The part of those contacts asked for that are among ``chosen``."""
        held = np.isin(self.chosen, chosen)
        return replace(
            self, disks=self.disks[held], background=self.background[held], chosen=self.chosen[held]
        )


def fit_rims(
    problem: FitProblem,
    disks: Values,
    *,
    blur: float,
    edge_at: Callable[[float], Edge],
    optics_prior: OpticsPrior,
    placement: Placement,
) -> RimFit:
    """Find the maximum of the likelihood of isolated rims.

    Parameters
    ----------
    problem : FitProblem
        The mean of its prior is the contrast to start from.
    disks : ndarray, shape (n, 4)
        To start from; centres stay.
    blur : float, px
        To start from, pixel included.
    edge_at : callable
        The edge at a blur.
    optics_prior : OpticsPrior
        Of (ln C, s).
    placement : Placement
    """
    chosen, spread = np.arange(len(disks)), problem.prior.std / problem.prior.mean
    background = np.zeros(len(disks))
    for _ in range(MOST_STEPS):
        edge = edge_at(blur)
        scores = EdgeScores.of(problem, disks, edge, placement)
        disks, chosen = disks[scores.kept], chosen[scores.kept]
        if not len(disks):
            break
        step, covariance, own_covariance = _shared_step(scores, problem, blur, optics_prior)
        own = scores.own_step + scores.own_response[:, :, OPTICS] @ step
        disks = disks.copy()
        radius, contrast = disks[:, RADIUS], disks[:, CONTRAST]
        disks[:, RADIUS] = np.clip(radius + own[:, 1], 0.6 * radius, 1.5 * radius)
        disks[:, CONTRAST] = np.clip(contrast + own[:, 0], 0.5 * contrast, 2.0 * contrast)
        background, blur = own[:, 2], blur + float(step[1])
        common = problem.prior.mean * float(np.exp(step[0]))
        problem = replace(problem, prior=replace(problem.prior, mean=common, std=spread * common))
        far = float(np.max(np.abs(own[:, 1]) / scores.radius_std))
        if step @ np.linalg.solve(covariance, step) < SETTLED_SIGMA**2 and far < 0.5:
            break
    if not len(disks):
        covariance = own_covariance = np.asarray(np.linalg.inv(optics_prior.information))
        return RimFit(edge_at(blur), problem, disks, np.zeros(0), covariance, own_covariance, chosen)
    return RimFit(edge_at(blur), problem, disks, background, covariance, own_covariance, chosen)


def _shared_step(
    scores: EdgeScores, problem: FitProblem, blur: float, prior: OpticsPrior
) -> tuple[Values, Values, Values]:
    """Step of (ln C, s), its covariance, and that without prior knowledge.

    Where there are contacts enough, their scatter gives the variance, whatever the noise.
    """
    away = prior.mean - np.array([np.log(problem.prior.mean), blur])
    posterior = scores.step(OPTICS, (prior.information @ away, prior.information))
    own = scores.step(OPTICS, (np.zeros(2), 1e-9 * prior.information))
    most = min(problem.largest_contrast, problem.shown_contrast)
    bounds = np.array([np.log(most / problem.prior.mean), LONGEST_BLUR_STEP * blur])
    step = np.array([min(posterior.delta[0], bounds[0]), np.clip(posterior.delta[1], -bounds[1], bounds[1])])
    step[1] = max(step[1], PIXEL_VARIANCE**0.5 - blur)
    return step, posterior.covariance, own.covariance


@dataclass(frozen=True, eq=False)
class RimRatios:
    """Log-likelihood of rims under one edge minus that under another.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Outliers drawn in to `OUTLIER_SIGMA`.
    model_error : ndarray, shape (n,)
        By how much an error of `MODEL_ERROR` in the height of the edge may change each.
    """

    values: Values
    model_error: Values

    @classmethod
    def of(cls, values: Values, model_error: Values) -> "RimRatios":
        """The sums of the ratios of rims; those without a value are left out."""
        kept = np.isfinite(values)
        values, model_error = values[kept], model_error[kept]
        if len(values):
            middle = float(np.median(values))
            far = OUTLIER_SIGMA * robust_std(values - middle)
            values = np.clip(values, middle - far, middle + far)
        return cls(values, model_error)

    @property
    def total(self) -> float:
        """The ratio of all rims together."""
        return float(self.values.sum())

    @property
    def std(self) -> float:
        """Standard uncertainty of the total: scatter of the rims, and the error of the model."""
        n = len(self.values)
        scatter = float(np.std(self.values, ddof=1) * np.sqrt(n)) if n > 1 else float("nan")
        return float(np.hypot(scatter, self.model_error.sum()))


def compare_rims(first: RimFit, second: RimFit, placement: Placement) -> RimRatios:
    """Compare two edges: log-likelihood under the first minus that under the second, at their maxima.

    Both on the same pixels, weighted alike.

    Parameters
    ----------
    first, second : RimFit
        Of the same contacts.
    placement : Placement
    """
    common = np.intersect1d(first.chosen, second.chosen)
    first, second = first.part(common), second.part(common)
    if not len(common):
        return RimRatios(np.zeros(0), np.zeros(0))
    blur, problem = max(first.edge.blur, second.edge.blur), second.problem
    fine, nodes = (
        placement.place(second.disks, blur=blur, per_blur=k) for k in (FINE_STEPS_PER_BLUR, STEPS_PER_BLUR)
    )
    clip = max(CLIP_SIGMA * problem.pixel_noise, LEAST_CLIP_FRACTION * problem.contrast)
    levels, sums = [], []
    for fit in (first, second):
        sums.append(
            sum_residuals(
                problem.image, for_kernel(problem.valid), fit.disks, nodes.inner, fit.profile(fine.disks),
                (fine.step, nodes.step), nodes.count, clip,
            )
        )  # fmt: skip
        levels.append(fit.disks[:, [CONTRAST]] * fit.profile(nodes.disks))
    variance = problem.noise.variance / problem.brightness_at(second.disks)[:, None]
    slope = problem.noise.slope / second.disks[:, [CONTRAST]]
    weight = 1.0 / (variance * (1.0 + slope * np.clip(levels[1], 0.0, None)))
    pixels = np.sum(weight * (levels[1] - levels[0]) * (sums[0] + sums[1]), axis=1)
    own = [
        _own_terms(fit, weight, rest, nodes.areas) for fit, rest in zip((first, second), sums, strict=True)
    ]
    weight = weight * nodes.areas
    apart = np.sum(
        weight * (levels[1] - levels[0] + (second.background - first.background)[:, None]) ** 2, axis=1
    )
    about = np.abs(nodes.disks.distance - nodes.disks.radius) < NEIGHBOUR_BLUR_WIDTHS * blur
    error = MODEL_ERROR * second.disks[:, CONTRAST] * np.sqrt(np.sum(weight * about, axis=1))
    return RimRatios.of(own[0] - own[1] - 0.5 * pixels, np.sqrt(apart) * error)


def _own_terms(fit: RimFit, weight: Values, rest: Values, areas: Values) -> Values:
    """Part of the log-likelihood of each rim by its background and by the prior of its contrast."""
    prior, b = fit.problem.prior, fit.background
    loose = 1.0 / (LOCAL_BACKGROUND_FRACTION * prior.mean) ** 2
    gain = b * np.sum(weight * rest, axis=1) - 0.5 * b**2 * (np.sum(weight * areas, axis=1) + loose)
    return np.asarray(gain - 0.5 * ((fit.disks[:, CONTRAST] - prior.mean) / prior.std) ** 2)
