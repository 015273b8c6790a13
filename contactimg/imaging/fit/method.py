"""The method "disk": a blurred disk for each contact, with what all share from the frame itself.

In turn: disks are assembled at a first contrast (`assemble`), halo and remaining background are
removed (`residual_light`), contrast and blur are settled (`shared_optics`), and the edge that all contacts
share is looked for: a plain one, one learned from the frame (`learned_edge`), or that of an air film
(`film_choice`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.detect.hand_edits import EditedDisks, HandEdit, edit_disks
from contactimg.imaging.detect.rim_blur import estimate_blur, widest_spot_blur
from contactimg.imaging.fit.assemble import assemble_disks
from contactimg.imaging.fit.disks import (
    SHARPEST_BLUR_PX,
    FitControl,
    FittedDisks,
    ModelImage,
    allow_for_coarse_rims,
    fit_disks,
    render_disks,
    wide_disks,
)
from contactimg.imaging.fit.film_choice import WeighedFilm, weigh_film
from contactimg.imaging.fit.learned_edge import EdgeFit, EdgeSearch, LearnedEdge
from contactimg.imaging.fit.problem import CONTRAST, RADIUS, FitProblem
from contactimg.imaging.fit.residual_light import remove_background, remove_halo
from contactimg.imaging.fit.shapes import NO_ELLIPSES, Ellipses, find_ellipses, made_round, poor_disks
from contactimg.imaging.fit.shared_optics import JointFit, OpticsPrior, contrast_prior, settle_optics
from contactimg.imaging.fit.shared_scores import with_plain_edges
from contactimg.imaging.foreground import Foreground
from contactimg.imaging.kernels.pairs import DEEPEST, overlapping
from contactimg.imaging.pixels.blocks import SignedImage
from contactimg.imaging.pixels.noise import Noise, NoiseCorrelation, estimate_noise, measure_correlation
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.profile.film_rim import FilmRim, FilmSetting, film_table
from contactimg.imaging.profile.limits import FEW, FEWEST, ITERATIONS, LEAST_NOISE_FRACTION, ROUGH_STD
from contactimg.imaging.profile.optics import Halo, KnownEdge


@dataclass(frozen=True, eq=False)
class FrameFit:
    """The disks of a frame, fitted with what they share.

    Parameters
    ----------
    problem : FitProblem
        As fitted in the end, without halo and remaining background.
    fit : FittedDisks
        In the end with all its disks in the model image.
    dropped : ndarray, shape (m, 3)
        x, y, radius (px) of disks that were tried and are not needed.
    smallest : float, px
        Radius of the smallest isolated disk that stands out of the noise.
    limited : bool
        Whether there were more candidates than are fitted.
    halo : Halo or None
    joint : JointFit or None
        Of contrast and blur; None if there is no disk.
    edited : EditedDisks or None
        Which disks were changed by hand; None if none was.
    edge : LearnedEdge or None
        That the contacts share.
    film : WeighedFilm or None
        What the rims say of an air film; None where none was looked for.
    ellipses : Ellipses
        Disks that stand for ellipses of equal area.
    ratio : float
        Contrast over background level; negative for dark contacts.
    known_edge : KnownEdge or None
        What a reference contact has told of the edge, px of the frame.
    contradicts_prior : bool
        Whether the frame shows another contrast or blur than was given with uncertainties.
    """

    problem: FitProblem
    fit: FittedDisks
    dropped: NDArray[np.float64]
    smallest: float
    limited: bool
    halo: Halo | None = None
    joint: JointFit | None = None
    edited: EditedDisks | None = None
    edge: LearnedEdge | None = None
    film: WeighedFilm | None = None
    ellipses: Ellipses = NO_ELLIPSES
    ratio: float = 0.0
    known_edge: KnownEdge | None = None
    contradicts_prior: bool = False

    @property
    def core_share(self) -> float:
        """Share of the fitted heights that an image with the halo shows across a rim."""
        return 1.0 if self.halo is None else 1.0 - self.halo.fraction


def measure_by_fit(
    foreground: Foreground, *, film: FilmSetting | None = None, edits: Sequence[HandEdit] = (),
    shape: str = "auto", linear: bool = False,
) -> FrameFit:  # fmt: skip
    """Find the contacts of a frame and fit a blurred disk to each.

    Parameters
    ----------
    foreground : Foreground
    film : FilmSetting or None
        Bright rim that the air film draws around the contacts; None: the edge is sharp.
    edits : sequence of HandEdit
        Corrections by hand to what was found; the changed disks are fitted with the others.
    shape : {"auto", "disk", "ellipse", "free"}
        "auto": an ellipse where no disk describes a contact; "ellipse": for every isolated contact.
    linear : bool
        Whether the camera is known to be linear.
    """
    frame = _Frame(foreground, film, edits, shape, linear=linear)
    best = frame.settle(frame.problem, frame.blur, frame.prior)
    if shape in ("auto", "ellipse"):
        best = frame.with_ellipses(best, everywhere=shape == "ellipse")
    plain, best = best, frame.with_edge(best)
    given = foreground.prior_optics
    # another edge than that of the other frames, or a film, may hide another blur
    film_taken = best.film is not None and best.film.verdict.taken
    joint = best.joint if given.edge is not None and given.edge.families else plain.joint
    contradicts = False
    if given.is_uncertain and joint is not None and not film_taken:
        contradicts = frame.prior.is_contradicted_by(joint)
    fit = _shown(best.fit, best.problem)
    return replace(best, fit=fit, known_edge=given.known_edge, contradicts_prior=contradicts)


class _Frame:
    """The quantities that all fits of a frame share.

    The problem, binned where the blur is wide, a first guess of the blur, and the priors.
    """

    def __init__(
        self, foreground: Foreground, film: FilmSetting | None, edits: Sequence[HandEdit], shape: str, *,
        linear: bool,
    ):  # fmt: skip
        self.foreground, self.film, self.edits, self.shape = foreground, film, edits, shape
        image, contrast = foreground.image, foreground.contrast.plateau
        given, self.linear = foreground.prior_optics.blur_px, linear
        self.free_blur = free = not np.isfinite(given)
        blur = estimate_blur(image, contrast) if free else float(np.hypot(given, PIXEL_VARIANCE**0.5))
        full = contrast > (1.0 - ROUGH_STD) * foreground.largest_contrast
        if free and full and not foreground.contrast.resolved:
            blur = min(blur, widest_spot_blur(image, contrast))  # no blur has made these spots fainter
        # Accuracy of the profile table: at least 1.6 binned pixels.
        binning = int(np.clip(blur // 1.6, 1, min(image.shape)))
        problem = FitProblem.of(foreground, binning=binning)
        noise = foreground.noise if binning == 1 else estimate_noise(problem.image, problem.background)
        noise = max(noise, LEAST_NOISE_FRACTION * contrast)
        self.blur = float(blur / binning if free else np.hypot(given / binning, PIXEL_VARIANCE**0.5))
        self.level = max(foreground.difference.level, 0.1 * contrast)  # by hand
        # shot noise, and texture that a contact makes brighter, go with the light
        self.problem = replace(problem, noise=Noise(noise**2, contrast / self.level))
        self.prior = OpticsPrior.of(foreground.prior_optics, self.problem, blur=self.blur)
        self.seen = foreground.seen
        if binning > 1 or noise > foreground.noise:
            self.seen = SignedImage(problem.image, noise, problem.valid, rounding=problem.rounding)

    def settle(
        self, problem: FitProblem, blur: float, prior: OpticsPrior, *, has_film: bool = False
    ) -> FrameFit:
        """Assemble disks at one contrast and fit them, with halo, background, contrast and blur.

        With a film, whose fringes look like one, no halo is looked for.
        """
        known, free = self.foreground.prior_optics, self.free_blur and not has_film
        found = assemble_disks(problem, self.seen, blur=blur, free_blur=free, shapes=self.shape)
        fit, dropped, edited, halo = found.fit, found.dropped, None, None
        problem = allow_for_coarse_rims(found.problem, fit, share=0.5)
        if self.edits and not len(fit.disks):
            fit, edited = fit_edited(problem, fit, self.edits)
        if not len(fit.disks):
            return FrameFit(problem, fit, dropped, found.smallest, found.limited, edited=edited)
        if not has_film:
            problem, fit, halo, vanished = remove_halo(problem, fit, prior_optics=known, free_blur=free)
            dropped = np.vstack([dropped, vanished])
        problem, fit = remove_background(problem, fit, free_blur=free)
        if self.edits and edited is None:
            fit, edited = fit_edited(problem, fit, self.edits)
        steps = 3 if found.limited else ITERATIONS  # by hand, for time
        joint = self.refine(problem, fit, prior, free_blur=free, steps=steps)
        if joint.fit.blur < SHARPEST_BLUR_PX < fit.blur:  # seen only now that the contrast has settled
            for _ in range(2):
                shown = _shown(joint.fit, problem)
                problem = allow_for_coarse_rims(problem, shown, share=0.5)
                joint = self.refine(problem, shown, prior, free_blur=free)
        return FrameFit(
            problem, joint.fit, dropped, found.smallest, found.limited, halo, joint, edited,
            ellipses=found.ellipses if len(joint.fit.disks) == len(found.fit.disks) else NO_ELLIPSES,
            ratio=max(self.foreground.sign * joint.contrast / self.level, -1.0),  # darkest is black
        )  # fmt: skip

    def refine(
        self, problem: FitProblem, fit: FittedDisks, optics_prior: OpticsPrior, *, free_blur: bool = False,
        steps: int = ITERATIONS, correlation: NoiseCorrelation | None = None,
    ) -> JointFit:  # fmt: skip
        """Last fit, with correlation of the noise and spread of the contrasts from the fit before.

        A known ``correlation`` is not measured again: then the fit needs no model image.
        """
        radius, image, noise = fit.disks[:, RADIUS], problem.image, problem.noise
        gain, known_spread = 1.0 + noise.slope, self.foreground.prior_optics.spread
        images, pixel_noise = (image, fit.model, problem.background), problem.pixel_noise
        correlation = correlation or measure_correlation(*images, noise=pixel_noise)
        shared = correlation.inflation(radius, fit.blur, noise=noise, gain=gain, rim=False)
        prior = contrast_prior(fit, problem, inflation=shared)
        seen = np.count_nonzero(wide_disks(fit)) >= FEWEST
        wide = prior.mean if seen else float("nan")
        if np.isfinite(known_spread) and not seen:
            spread = max(known_spread, 1e-4 * prior.mean)
            prior = replace(prior, std=spread, small_std=spread)
        prior = prior.at(min(prior.mean, problem.largest_contrast))
        problem = replace(problem, prior=prior)
        fit = fit_disks(
            problem, fit.disks, blur=fit.blur, control=FitControl(free_blur, iterations=5),
            start=ModelImage.over(fit.model, len(radius), complete=False),
        )  # fmt: skip
        inflation = correlation.inflation(radius, fit.blur, noise=noise, gain=gain, rim=True)
        joint = settle_optics(
            problem, fit, optics_prior, inflation=inflation, wide_contrast=wide, steps=steps
        )
        # a misfit common to all disks is due to the noise model; that of a single disk is its own. Pixels
        # coarser than the edge hide a part of what they add or take away: that a circle fits them well says
        # little
        chi_square = joint.fit.chi_square
        many = len(radius) >= FEW and not noise.rim
        common = min(float(np.median(chi_square)), 1.0) if many else 1.0
        factor = inflation * np.maximum(chi_square, common)
        fit = replace(joint.fit, std=joint.fit.std * np.sqrt(factor)[:, None])
        least = max(float(np.median(factor)), 1.0)
        return replace(joint, fit=fit, correlation=correlation, least_factor=least)

    def with_ellipses(self, plain: FrameFit, *, everywhere: bool) -> FrameFit:
        """The fit with ellipses where no disk describes a contact."""
        best = plain
        for _ in range(2):  # each leaves about a tenth of the error of the first. By hand
            if best.joint is None or self.problem.image.shape != best.problem.image.shape:
                break
            if not (everywhere or len(best.ellipses.rows) or len(poor_disks(best.fit))):
                break
            shown, optics = _shown(best.fit, best.problem), (best.joint.prior, best.joint.covariance)
            more = find_ellipses(best.problem, shown, *optics, everywhere=everywhere)
            rows = np.union1d(best.ellipses.rows, more.rows).astype(np.intp)
            if not len(rows):
                break
            original, _ = made_round(best.problem, shown, best.ellipses, -1.0)
            found = find_ellipses(original, shown, *optics, rows=rows, known=best.ellipses)
            problem, disks = made_round(original, shown, found)
            joint = self.refine(problem, replace(shown, disks=disks), self.prior)
            best = replace(best, problem=problem, fit=joint.fit, joint=joint, ellipses=found)
            if len(rows) < 0.1 * len(disks):  # few do not matter. By hand
                break
        return best

    def with_edge(self, plain: FrameFit) -> FrameFit:
        """The fit with the edge that describes the contacts best: plain, learned, or that of a film."""
        if plain.joint is None:
            return plain
        refine = partial(self.refine, correlation=plain.joint.correlation)
        given, linear = self.foreground.prior_optics, self.linear
        search = EdgeSearch(plain.problem, plain.joint, self.prior, plain.ratio, refine, given, linear)
        weighed = None
        learned = None if self.film is not None and self.film.asked == "on" else search.learn()
        if self.film is not None:
            weighed = weigh_film(search, self.film, learned.learned.families if learned else ())
            if weighed is not None and weighed.verdict.taken:
                return self._with_film(plain, search, weighed, self.film.rim)
        learned = learned or search.learn()
        return replace(
            plain, problem=learned.problem, fit=learned.joint.fit, joint=learned.joint, edge=learned.learned,
            film=weighed,
        )  # fmt: skip

    def _with_film(self, plain: FrameFit, search: EdgeSearch, weighed: WeighedFilm, rim: FilmRim) -> FrameFit:
        """Assemble the disks with the rim of a film, at the blur that the rims show.

        In the end the light of the film is subtracted from the image, and disks with a plain edge are fitted:
        all that follows sees contacts without a film.
        """
        rims = search.settle(search.start(replace(search.plain, film=rim).with_light(1.0)), ())
        edge, exact = rims.edge, self.prior.with_exact_blur(rims.edge.blur)
        with_rims = replace(self.problem, profile=film_table(rim, edge.blur), prior=plain.problem.prior)
        result = self.settle(with_rims, edge.blur, exact, has_film=True)
        if result.joint is None:
            return result
        image = with_plain_edges(result.problem.image, result.fit.disks, edge)
        problem = replace(result.problem, image=image, profile=self.problem.profile)
        joint = self.refine(problem, result.fit, exact)
        scores, _ = search.scores(rims)
        joint = search.with_uncertainties(EdgeFit(problem, joint, LearnedEdge(edge)), scores, rims.step)
        return replace(result, problem=problem, fit=joint.fit, joint=joint, film=weighed)


def _shown(fit: FittedDisks, problem: FitProblem) -> FittedDisks:
    """The fit with all its disks in the model image."""
    return replace(fit, model=render_disks(fit.disks, fit.blur, problem.image.shape, over=fit.model))


def fit_edited(
    problem: FitProblem, fit: FittedDisks, edits: Sequence[HandEdit]
) -> tuple[FittedDisks, EditedDisks]:
    """The fit after the corrections, and which of its disks they concern."""
    binning, offset = problem.binning, (problem.binning - 1) / 2 * np.array([1.0, 1.0, 0.0])
    places = fit.disks[:, :CONTRAST] * binning + offset
    image = problem.image if binning == 1 else np.kron(problem.image, np.ones((binning, binning), np.float32))
    edited = edit_disks(places, edits, image)
    new = (edited.places[edited.new] - offset) / binning
    if not len(new) and len(edited.source) == len(fit.disks):
        return fit, edited  # an excluded disk goes on explaining its light
    fresh = np.column_stack([new, np.full(len(new), problem.contrast)])
    disks = np.vstack([fit.disks[edited.source[~edited.new]], fresh])
    control = FitControl(free_blur=False, robust=False, iterations=ITERATIONS)
    fitted = fit_disks(problem, disks, blur=fit.blur, control=control)
    # parts that move into each other are one contact: the pixels do not show the correction
    lost = edited.vanished(np.flatnonzero(~overlapping(fitted.disks, DEEPEST)))
    if lost:
        fitted, edited = fit_edited(problem, fit, [edit for edit in edits if edit not in lost])
        edited.unmatched.extend(lost)
    return fitted, edited
