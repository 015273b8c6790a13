"""The method "disk": a blurred disk for each contact; noise, halo, contrast and blur from the frame itself.

The order of the steps is that of `_attempt`. Disks are detected at an assumed contrast; if the fit then finds
another one, they are detected anew.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from contactimg.imaging.background.difference_image import DifferenceImage
from contactimg.imaging.contrast.noise import Noise, estimate_noise, measure_correlation
from contactimg.imaging.fit.by_hand import fit_edited
from contactimg.imaging.fit.clipped_noise import restore_clipped_noise
from contactimg.imaging.fit.coarse_rims import allow_for_coarse_rims
from contactimg.imaging.fit.disks import (
    FitControl,
    FittedDisks,
    ModelImage,
    contrast_prior,
    fit_disks,
    wide_disks,
)
from contactimg.imaging.fit.edge_profile import learn_edge
from contactimg.imaging.fit.edge_scores import Edge, EdgeScores, Placement
from contactimg.imaging.fit.film_choice import FilmTrial, WeighedFilm, film_makes_contrast
from contactimg.imaging.fit.film_edge import FilmEdge
from contactimg.imaging.fit.number_of_disks import assemble_disks
from contactimg.imaging.fit.problem import RADIUS, ContrastPrior, FitProblem
from contactimg.imaging.fit.quality import FittedDetections, FrameFit, report_contacts
from contactimg.imaging.fit.residual_light import remove_halo, remove_illumination
from contactimg.imaging.fit.settings import (
    BINNED_BLUR_PX,
    CONTRAST_CHANGE_LOG,
    DARKEST_RATIO,
    FEWEST_COMMON_CHI_SQUARE,
    FEWEST_WIDE_DISKS,
    FULL_CONTRAST_RATIO,
    LEAST_LEVEL_FRACTION,
    LEAST_NOISE_FRACTION,
    LEAST_NOISE_LEVELS,
    LEAST_SPREAD_FRACTION,
    LOST_DISKS_RATIO,
    MOST_ATTEMPTS,
    PASSES_OF_ATTEMPT,
    WIDEST_UNBINNED_BLUR_PX,
)
from contactimg.imaging.fit.shared_optics import JointFit, OpticsPrior, hides_contrast, settle_optics
from contactimg.imaging.fit.work import TooMuchWork
from contactimg.imaging.pixels.blocks import BlockMeans
from contactimg.imaging.pixels.frame_pair import CutOff
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.profile.film_rim import FilmSetting
from contactimg.imaging.profile.film_tables import film_table
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.imaging.reject.foreground import Foreground
from contactimg.imaging.shapes.hand_edits import HandEdit
from contactimg.imaging.shapes.rim_blur import estimate_blur, widest_spot_blur
from contactimg.timings import stage


@dataclass(frozen=True, eq=False)
class FirstDisks:
    """Disks detected and fitted at the first contrast, with a plain edge: what any attempt begins with.

    Parameters
    ----------
    start : _Start
    fit : FrameFit
    """

    start: "_Start"
    fit: FrameFit

    @classmethod
    @stage("quality")
    def of(
        cls, foreground: Foreground, difference: DifferenceImage, edits: Sequence[HandEdit] = ()
    ) -> "FirstDisks":
        """Of a frame."""
        start = _first_start(foreground, difference)
        given = _Given.of(foreground, difference, start, edits)
        start = start.at_level(given.level)
        return cls(start, _settle(start, given, given.optics_prior))

    def detections(self, foreground: Foreground, difference: DifferenceImage) -> FittedDetections:
        """Contacts as these disks."""
        return report_contacts(self.fit, foreground, difference, contrast=self.start.contrast)

    def again(self) -> "FirstDisks":
        """The same with the work done so far, on which another measurement counts for itself."""
        work = replace(self.fit.problem.work)
        start = replace(self.start, problem=replace(self.start.problem, work=work))
        return FirstDisks(start, replace(self.fit, problem=replace(self.fit.problem, work=work)))


@stage("quality")
def measure_by_fit(
    foreground: Foreground,
    difference: DifferenceImage,
    *,
    film: FilmSetting | None,
    edits: Sequence[HandEdit] = (),
    learns_edge: bool = True,
    first: FirstDisks | None = None,
) -> FittedDetections:
    """Find the contacts of a frame and fit a blurred disk to each.

    Parameters
    ----------
    foreground : Foreground
    difference : DifferenceImage
        From which the foreground comes.
    film : FilmSetting or None
        Bright rim that the air film draws around the contacts; None: the edge is sharp.
    edits : sequence of HandEdit
        Corrections by hand to what was found; the changed disks are fitted with the others.
    learns_edge : bool
        Whether another edge than a plain one is taken; else nor is that of other frames.
    first : FirstDisks or None
        Of this frame, where they are known.

    Returns
    -------
    FittedDetections
    """
    first = FirstDisks.of(foreground, difference, edits) if first is None else first.again()
    start, plain = first.start, first.fit
    given = _Given.of(foreground, difference, start, edits, film=film, learns_edge=learns_edge)
    best: FrameFit | None = None
    for _ in range(MOST_ATTEMPTS):
        if best is not None:
            plain = _settle(start, given, given.optics_prior)
        attempt = _attempt(start, given, plain)
        if best is not None:
            # a contrast at which most contacts vanish is wrong; small ones are faint at any
            ratio = 1.0 if hides_contrast(best.fit) else LOST_DISKS_RATIO
            if ratio * len(attempt.fit.disks) < len(best.fit.disks):
                break
        best, joint = attempt, attempt.joint
        if joint is None or not start.problem.work.suffices_for(PASSES_OF_ATTEMPT):
            break
        if abs(np.log(joint.contrast / start.contrast)) < CONTRAST_CHANGE_LOG:
            break
        start = _next_start(start, best, joint).at_level(given.level)
    result = replace(best or attempt, known_edge=given.prior_optics.known_edge)
    return report_contacts(result, foreground, difference, contrast=start.contrast)


@dataclass(frozen=True, eq=False)
class _Given:
    """What is given for all attempts.

    Parameters
    ----------
    prior_optics : SharedOptics
    optics_prior : OpticsPrior
        The same as the normal prior of the fit.
    level : float
        Background level, grey levels.
    sign : int
        1 for contacts brighter than the background, else -1.
    film : FilmSetting or None
    edits : sequence of HandEdit
    cut_off : CutOff or None
        End of the grey levels at the background.
    learns_edge : bool
        Whether another edge than a plain one is looked for.
    """

    prior_optics: SharedOptics
    optics_prior: OpticsPrior
    level: float
    sign: int
    film: FilmSetting | None
    edits: Sequence[HandEdit]
    cut_off: CutOff | None
    learns_edge: bool

    @classmethod
    def of(
        cls, foreground: Foreground, difference: DifferenceImage, start: "_Start", edits: Sequence[HandEdit],
        *, film: FilmSetting | None = None, learns_edge: bool = True,
    ) -> "_Given":  # fmt: skip
        """For a frame and its first start."""
        return cls(
            foreground.prior_optics,
            OpticsPrior.of(foreground.prior_optics, start.problem, blur=start.blur),
            max(difference.level, LEAST_LEVEL_FRACTION * start.contrast),
            foreground.sign,
            film,
            edits,
            foreground.frame_pair.cut_off(foreground.sign),
            learns_edge,
        )


@dataclass(frozen=True, eq=False)
class _Start:
    """Where an attempt starts.

    Parameters
    ----------
    problem : FitProblem
    blur : float, px
        Standard deviation, pixel included.
    free_blur : bool
    wide_contrast : float
        Contrast of the wide contacts in the attempt before; NaN if there are none.
    """

    problem: FitProblem
    blur: float
    free_blur: bool
    wide_contrast: float = float("nan")

    @property
    def contrast(self) -> float:
        """At which disks are detected."""
        return self.problem.contrast

    def at_level(self, level: float) -> "_Start":
        """With the noise of contacts brighter by the contrast than a background of this level."""
        noise = Noise(self.problem.noise.variance, (1.0 + self.contrast / level) - 1.0)
        return replace(self, problem=replace(self.problem, noise=noise))


def _first_start(foreground: Foreground, difference: DifferenceImage) -> _Start:
    """The problem, binned where the blur is wide, and a first guess of the blur."""
    image, contrast = foreground.image, foreground.contrast.plateau
    given_blur = foreground.prior_optics.blur_px
    free_blur = not np.isfinite(given_blur)
    blur = estimate_blur(image, contrast) if free_blur else float(np.hypot(given_blur, PIXEL_VARIANCE**0.5))
    full = contrast > FULL_CONTRAST_RATIO * foreground.largest_contrast
    if free_blur and full and not foreground.contrast.resolved:
        blur = min(blur, widest_spot_blur(image, contrast))  # no blur has made these spots fainter
    binning = int(blur / BINNED_BLUR_PX) if blur > WIDEST_UNBINNED_BLUR_PX else 1
    problem = FitProblem.of(foreground, difference, binning=binning)
    noise = foreground.noise if binning == 1 else estimate_noise(problem.image, problem.background)
    noise = max(noise, LEAST_NOISE_LEVELS, LEAST_NOISE_FRACTION * contrast)
    blur = blur / binning if free_blur else np.hypot(given_blur / binning, PIXEL_VARIANCE**0.5)
    return _Start(replace(problem, noise=Noise(noise**2)), float(blur), free_blur)


def _next_start(start: _Start, result: FrameFit, joint: JointFit) -> _Start:
    """At the contrast and blur found, without the illumination found."""
    removed = result.problem.removed_background - start.problem.removed_background
    moved = abs(removed[0, 0]) > CONTRAST_CHANGE_LOG * start.contrast
    plain_edge = result.edge is None or not result.edge.families  # else the blur goes with that edge
    return _Start(
        start.problem.without_background(removed).with_contrast(joint.contrast),
        joint.fit.blur,
        start.free_blur and (result.has_film or bool(moved) or not plain_edge),
        joint.wide_contrast,
    )


def _attempt(start: _Start, given: _Given, plain: FrameFit) -> FrameFit:
    """The disks detected at one contrast with the edge that they show, or as they are for want of work."""
    try:
        return _with_edge(start, given, plain)
    except TooMuchWork:
        plain.problem.work.unfinished_fits += 1
        return plain


def _with_edge(start: _Start, given: _Given, plain: FrameFit) -> FrameFit:
    """Look for a film about the disks detected at one contrast, else for another edge."""
    problem = start.problem
    if plain.joint is None:
        return plain
    prior, spread = given.optics_prior, given.prior_optics.spread
    ratio = max(given.sign * plain.joint.contrast / given.level, DARKEST_RATIO)

    def refine(problem: FitProblem, fit: FittedDisks, prior: OpticsPrior) -> JointFit:
        if fit.model is plain.fit.model:  # which a fit overwrites, and another attempt may begin with
            fit = replace(fit, model=fit.model.copy())
        return _refine(replace(start, problem=problem, free_blur=False), fit, prior, spread)

    trial, weighed = None, None
    if given.film is not None:
        placement = Placement(problem.image.shape, ratio)
        likely = film_makes_contrast(given.film.rim, ratio)
        trial = FilmTrial(plain.problem, plain.joint, prior, placement, given.film, likely)
        weighed = trial.weigh()
    if weighed is not None and weighed.verdict.taken and given.film is not None and given.film.asked == "on":
        return _with_film(start, given, weighed)
    learned = learn_edge(
        plain.problem, plain.joint, prior, ratio=ratio, refine=refine,
        given=given.prior_optics if given.learns_edge else replace(given.prior_optics, edge=None),
        new_families=given.learns_edge,
    )  # fmt: skip
    if trial is not None and weighed is not None and learned.learned.families:
        weighed = trial.against(weighed, learned)
    if weighed is not None and weighed.verdict.taken:
        return _with_film(start, given, weighed)
    return replace(
        plain, problem=learned.problem, fit=learned.joint.fit, joint=learned.joint, edge=learned.learned,
        film=weighed, ratio=ratio, lent_edge=given.prior_optics.edge,
    )  # fmt: skip


def _with_film(start: _Start, given: _Given, weighed: WeighedFilm) -> FrameFit:
    """Detect the disks and fit them with the rim of a film, at the blur that the rims show.

    In the end the light of the film is subtracted from the image, and disks with a plain edge are fitted: all
    that follows sees contacts without a film.
    """
    edge, film = weighed.film.edge, weighed.film
    exact, spread = given.optics_prior.with_exact_blur(edge.blur), given.prior_optics.spread
    start = replace(start, blur=edge.blur, free_blur=False)
    with_rims = replace(start.problem, profile=film_table(weighed.rim, edge.blur))
    result = _settle(replace(start, problem=with_rims), given, exact, has_film=True)
    if result.joint is None or not isinstance(edge, FilmEdge):
        return result
    image = edge.without_film(result.problem.image, result.fit.disks)
    problem = replace(result.problem, image=image, profile=start.problem.profile)
    joint = _refine(replace(start, problem=problem), result.fit, exact, spread)
    disks, placement = (
        joint.fit.disks,
        Placement(image.shape, max(given.sign * joint.contrast / given.level, DARKEST_RATIO)),
    )
    known = replace(problem, prior=ContrastPrior(joint.contrast, joint.spread))
    rims, plain = (
        EdgeScores.expected(known, disks, each, placement) for each in (edge, Edge.plain(edge.blur))
    )
    own = joint.fit.std * np.maximum(rims.radius_std / plain.radius_std, 1.0)[:, None]
    shifts = rims.response[:, :2] @ np.linalg.cholesky(film.covariance)
    joint = replace(
        joint, fit=replace(joint.fit, std=own), covariance=film.covariance,
        own_covariance=film.own_covariance, radius_shifts=shifts,
    )  # fmt: skip
    return replace(result, problem=problem, fit=joint.fit, joint=joint, film=weighed)


def _settle(start: _Start, given: _Given, prior: OpticsPrior, *, has_film: bool = False) -> FrameFit:
    """Detect the disks at one contrast and fit them; none where that would take too much work."""
    try:
        return _settled(start, given, prior, has_film=has_film)
    except TooMuchWork:
        work = start.problem.work
        work.refused = True
        nothing = np.empty((0, 4))
        fit = fit_disks(
            start.problem, nothing, blur=start.blur, control=FitControl(free_blur=False, iterations=1)
        )
        return FrameFit(start.problem, fit, nothing[:, :3], float("nan"), None, None)


def _settled(start: _Start, given: _Given, prior: OpticsPrior, *, has_film: bool) -> FrameFit:
    """Detect the disks at one contrast and fit them, with noise, halo, illumination, contrast and blur.

    With a film, whose fringes look like one, no halo is looked for.
    """
    problem, free_blur = start.problem, start.free_blur
    detected = assemble_disks(problem, blur=start.blur, free_blur=free_blur)
    fit, halo, dropped = detected.fit, None, detected.dropped
    problem, edited = allow_for_coarse_rims(detected.problem, fit, share=0.5), None
    if given.edits and not len(fit.disks):
        fit, edited = fit_edited(problem, fit, given.edits)
    if not len(fit.disks):
        return FrameFit(problem, fit, dropped, detected.smallest, None, None, edited)
    problem, fit = restore_clipped_noise(problem, fit, given.cut_off, free_blur=free_blur)
    means = BlockMeans(problem.image, fit.model)
    if not has_film:
        problem, fit, halo, vanished = remove_halo(
            problem, fit, means, prior_optics=given.prior_optics, free_blur=free_blur
        )
        dropped = np.vstack([dropped, vanished])
        means = means if halo is None else BlockMeans(problem.image, fit.model)
    problem, fit = remove_illumination(problem, fit, means, free_blur=free_blur)
    if given.edits and edited is None:
        fit, edited = fit_edited(problem, fit, given.edits)
    joint = _refine(replace(start, problem=problem), fit, prior, given.prior_optics.spread)
    return FrameFit(problem, joint.fit, dropped, detected.smallest, halo, joint, edited)


def _refine(start: _Start, fit: FittedDisks, optics_prior: OpticsPrior, spread: float) -> JointFit:
    """Last fit, with correlation of the noise, contrast and spread of the contrasts from the fit before."""
    problem, radius = start.problem, fit.disks[:, RADIUS]
    image, noise, gain = problem.image, problem.noise, 1.0 + problem.noise.slope
    correlation = measure_correlation(image, fit.model, problem.background, noise=problem.pixel_noise)
    shared = correlation.plateau_inflation(radius, fit.blur, noise=noise, gain=gain)
    prior = contrast_prior(fit, default=problem.contrast, inflation=shared)
    wide = prior.mean if np.count_nonzero(wide_disks(fit)) >= FEWEST_WIDE_DISKS else start.wide_contrast
    if np.isfinite(spread):
        prior = ContrastPrior(prior.mean, max(spread, LEAST_SPREAD_FRACTION * prior.mean))
    prior = replace(prior, mean=min(prior.mean, problem.largest_contrast))
    problem = replace(problem, prior=prior)
    fit = fit_disks(
        problem, fit.disks, blur=fit.blur, control=FitControl(start.free_blur, iterations=5),
        start=ModelImage.over(fit.model, len(radius), complete=False),
    )  # fmt: skip
    inflation = correlation.rim_inflation(radius, fit.blur, noise=noise, gain=gain)
    joint = settle_optics(problem, fit, optics_prior, inflation=inflation, wide_contrast=wide)
    # a misfit common to all disks is due to the noise model; that of a single disk is its own. Pixels coarser
    # than the edge hide a part of what they add or take away: that a circle fits them well says little
    chi_square, many = joint.fit.chi_square, len(radius) >= FEWEST_COMMON_CHI_SQUARE and not noise.rim
    common = min(float(np.median(chi_square)), 1.0) if many else 1.0
    std = joint.fit.std * np.sqrt(inflation * np.maximum(chi_square, common))[:, None]
    return replace(joint, fit=replace(joint.fit, std=std), correlation=correlation)
