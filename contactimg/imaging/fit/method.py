"""The `disk` method: fit of blurred disks, with the frame's own noise, blur and contrast, and its quality."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.difference_image import DifferenceImage
from contactimg.imaging.contrast.noise import Noise, estimate_noise, measure_correlation, measure_slope
from contactimg.imaging.contrast.plateau import Contrast
from contactimg.imaging.fit.assemble import Assembly, assemble_disks
from contactimg.imaging.fit.disks import (
    ENOUGH,
    RADIUS,
    DiskFit,
    Drawing,
    Prior,
    X,
    Y,
    contrast_prior,
    fit_disks,
    wide_disks,
)
from contactimg.imaging.fit.problem import Field
from contactimg.imaging.fit.residual_light import level_out, without_halo
from contactimg.imaging.fit.shared_optics import Known, Settled, settle_optics
from contactimg.imaging.pixels.blocks import BlockMeans
from contactimg.imaging.pixels.frame_pair import FramePair
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE, EdgeTable
from contactimg.imaging.profile.film_rim import Rim, rim_table
from contactimg.imaging.profile.optics import Halo, SharedOptics, combine_errors
from contactimg.imaging.reject.detections import Detections
from contactimg.imaging.reject.foreground import Foreground
from contactimg.imaging.reject.implausible_disks import reject_disks
from contactimg.imaging.shapes.overlap import count_touching
from contactimg.imaging.shapes.rim_blur import estimate_blur
from contactimg.tables import Flag, Reason
from contactimg.timings import stage

WIDEST_BLUR = 3.2  # px: wider blurs are measured on binned pixels ...
BINNED_BLUR = 1.6  # ... such that they are about this wide
QUANTISATION = 1e-3  # levels: the least noise that is believed ...
LEAST_NOISE = 5e-3  # ... and of the contrast: no edge is so round that residuals below that mean anything
BLUR_STEP, BLURS_BELOW, BLURS_ABOVE = 1.1, 5, 5  # blurs tried about the guess when there is a rim
ATTEMPTS = 3
LEAST_SPREAD = 1e-4  # of the contrast
SAME_CONTRAST = 0.1  # change of ln contrast from which on disks are told apart again
POOR_CHI_SQUARE = 1.5
FAINT = 10.0  # standard deviations of the light of a contact
CUT = 2.0  # blur widths: a rim closer to the border is cut


@stage("quality")
def measure_by_fit(foreground: Foreground, difference: DifferenceImage, *, film: Rim | None) -> Detections:
    """Find the contacts of a frame and fit a blurred disk to each.

    Parameters
    ----------
    foreground : Foreground
    difference : DifferenceImage
        From which the foreground comes.
    film : Rim or None
        Bright rim that the air film draws around the contacts; None: the edge is sharp.

    Returns
    -------
    Detections
    """
    image, frame_pair, contrast = foreground.image, foreground.frame_pair, foreground.contrast
    noise, known = foreground.noise, foreground.prior_optics
    guess = known.blur_px if np.isfinite(known.blur_px) else None
    blur = float(
        estimate_blur(image, contrast.plateau) if guess is None else np.hypot(guess, PIXEL_VARIANCE**0.5)
    )
    field = Field.of(image, frame_pair, difference, int(blur / BINNED_BLUR) if blur > WIDEST_BLUR else 1)
    noise = noise if field.bin == 1 else estimate_noise(field.image, field.blocks)
    noise = max(noise, QUANTISATION, LEAST_NOISE * contrast.plateau)
    blur = blur / field.bin if guess is None else float(np.hypot(guess / field.bin, PIXEL_VARIANCE**0.5))
    free_blur = guess is None
    level = max(difference.level, 0.1 * contrast.plateau)
    before = Known.of(known, contrast=contrast.plateau, blur=blur, binning=field.bin)
    best: _Trial | None = None
    anchor = float("nan")
    for _ in range(ATTEMPTS):
        trial = _attempt(
            field, contrast=contrast, noise=noise, level=level, blur=blur, before=before,
            known=known, film=film, free_blur=free_blur, anchor=anchor,
        )  # fmt: skip
        if best is not None and 2 * len(trial.fit.disks) < len(best.fit.disks):
            break  # at a contrast at which most contacts vanish, the contacts are not disks
        best, found = trial, trial.settled
        if found is None or abs(np.log(found.contrast / contrast.plateau)) < SAME_CONTRAST:
            break
        # disks were told apart at another contrast: look again
        moved = abs(trial.field.light[0, 0]) > SAME_CONTRAST * contrast.plateau
        contrast, blur = replace(contrast, plateau=found.contrast), found.fit.blur
        anchor = found.shown
        free_blur = free_blur and (film is not None or moved)
        field = field.without_light(trial.field.light)
    return _report(best or trial, frame_pair, image, difference, contrast)


@dataclass(frozen=True, eq=False)
class _Trial:
    """Disks fitted from one guess of the contrast; nothing is settled where there is no disk."""

    assembly: Assembly
    field: Field
    fit: DiskFit
    halo: Halo | None
    settled: Settled | None


def _attempt(
    field: Field,
    *,
    contrast: Contrast,
    noise: float,
    level: float,
    blur: float,
    before: Known,
    known: SharedOptics,
    film: Rim | None,
    free_blur: bool,
    anchor: float,
) -> _Trial:
    """Tell the disks apart and fit them, with the frame's own noise, halo, contrast and blur."""
    gain = 1.0 + contrast.plateau / level
    first = Noise(noise**2, gain - 1.0)
    table = None
    if film is not None:
        blur = _blur_behind(film, field, contrast, first, blur) if free_blur else blur
        table, free_blur = rim_table(film, blur), False
    assembly = assemble_disks(
        field.image, field.valid, field.blocks, plateau=contrast.plateau, noise=first,
        brightness=field.brightness, blur=blur, free_blur=free_blur, table=table,
    )  # fmt: skip
    start, halo = assembly.fit, None
    if not len(start.disks):
        return _Trial(assembly, field, start, halo, None)
    means = BlockMeans(field.image, start.model)
    if film is None:
        field, start, halo, dropped = without_halo(
            field, start, means, contrast, first, known=known, free_blur=free_blur
        )
        assembly = replace(assembly, dropped=np.vstack([assembly.dropped, dropped]))
        means = means if halo is None else BlockMeans(field.image, start.model)
    else:
        before = before.with_blur(start.blur)  # a rim has lengths of its own: its table holds for one blur
    field, start, contrast = level_out(field, start, means, contrast, first, free_blur=free_blur, table=table)
    settled = _refine(
        field, start, contrast=contrast, noise=noise, gain=gain, before=before, spread=known.spread,
        free_blur=free_blur, table=table, anchor=anchor,
    )  # fmt: skip
    return _Trial(assembly, field, settled.fit, halo, settled)


def _report(
    trial: _Trial,
    frame_pair: FramePair,
    image: NDArray[np.float32],
    difference: DifferenceImage,
    contrast: Contrast,
) -> Detections:
    """The tables of a trial, dirt sorted out."""
    field, contacts = trial.field, _tabulate(trial)
    disks = np.column_stack([contacts["x_px"], contacts["y_px"], contacts["radius_px"]])
    reasons = reject_disks(
        frame_pair, image, difference, disks, blur=trial.fit.blur * field.bin, contrast=contrast.plateau
    )
    bad = reasons != ""
    dropped = trial.assembly.dropped
    tried = np.column_stack([field.unbin(dropped[:, [X, Y]]), dropped[:, RADIUS] * field.bin])
    unneeded = np.full(len(tried), Reason.UNNECESSARY)
    rejected = dict(zip(("x_px", "y_px", "radius_px"), np.vstack([tried, disks[bad]]).T, strict=True))
    rejected["reason"] = np.append(unneeded, reasons[bad])
    if trial.settled is None:
        optics = own = SharedOptics(contrast.plateau, np.nan, np.nan, trial.fit.blur * field.bin, np.nan)
    else:
        optics, own = (
            replace(trial.settled.optics(covariance, binning=field.bin), halo=trial.halo)
            for covariance in (trial.settled.covariance, trial.settled.own)
        )
    asserted = {name: values[~bad] for name, values in contacts.items()}
    return Detections(asserted, rejected, optics, own, trial.assembly.smallest * field.bin)


def _blur_behind(rim: Rim, field: Field, contrast: Contrast, noise: Noise, guess: float) -> float:
    """Blur for which contacts with a rim fit best.

    A rim has lengths of its own, so its table holds for one blur; and too sharp an edge can pass for a
    sharper blur, so the whole range is looked at, then a parabola laid through the best three.
    """
    middle = round(float(np.log(guess) / np.log(BLUR_STEP)))
    blurs = BLUR_STEP ** np.arange(middle - BLURS_BELOW, middle + BLURS_ABOVE + 1.0)
    misfit = np.array([_misfit(rim, field, contrast, noise, float(blur)) for blur in blurs])
    best = int(np.clip(np.argmin(misfit), 1, len(blurs) - 2))
    left, centre, right = misfit[best - 1 : best + 2]
    bend = left - 2.0 * centre + right
    shift = float(np.clip(0.5 * (left - right) / bend, -1.0, 1.0)) if bend > 0 else 0.0
    return float(blurs[best] * BLUR_STEP**shift)


def _misfit(rim: Rim, field: Field, contrast: Contrast, noise: Noise, blur: float) -> float:
    """Median chi-square of the contacts for one blur."""
    table = rim_table(rim, blur)
    assembly = assemble_disks(
        field.image, field.valid, field.blocks, plateau=contrast.plateau, noise=noise,
        brightness=field.brightness, blur=blur, free_blur=False, table=table, thorough=False,
    )  # fmt: skip
    return float(np.median(assembly.fit.chi_square)) if len(assembly.fit.disks) else 0.0


def _refine(
    field: Field,
    start: DiskFit,
    *,
    contrast: Contrast,
    noise: float,
    gain: float,
    before: Known,
    spread: float,
    free_blur: bool,
    table: EdgeTable | None,
    anchor: float,
) -> Settled:
    """Last fit, with noise, background, contrast and spread of contrasts as the first one shows them."""
    image = field.image
    slope = measure_slope(
        image, start.model, contrast=contrast.plateau, variance=noise**2, default=gain - 1.0
    )
    model = Noise(noise**2, slope)
    correlation = measure_correlation(image, start.model, field.blocks, noise=noise)
    radius = start.disks[:, RADIUS]
    shared = correlation.plateau_inflation(radius, start.blur, noise=model, gain=gain)
    prior = contrast_prior(start, plateau=contrast.plateau, inflation=shared)
    shown = float(prior.mean[0]) if np.count_nonzero(wide_disks(start)) >= ENOUGH else anchor
    if np.isfinite(spread):
        prior = Prior(prior.mean, np.maximum(spread, LEAST_SPREAD * prior.mean))
    brightness = field.brightness(start.disks)
    fit = fit_disks(
        image, field.valid, start.disks, blur=start.blur, noise=model, prior=prior,
        brightness=brightness, free_blur=free_blur, iterations=5, table=table,
        drawing=Drawing.partly(image.shape, len(radius)),
    )  # fmt: skip
    inflation = correlation.rim_inflation(radius, fit.blur, noise=model, gain=gain)
    settled = settle_optics(
        image, field.valid, fit, noise=model, prior=prior, brightness=brightness, known=before,
        inflation=inflation, shown=shown, table=table,
    )  # fmt: skip
    fit = settled.fit
    # what the linear noise model gets wrong at the rim shows in all fits; what a single fit gets wrong, in
    # that one
    common = min(float(np.median(fit.chi_square)), 1.0) if len(radius) >= 10 else 1.0
    inflated = fit.std * np.sqrt(inflation * np.maximum(fit.chi_square, common))[:, None]
    return replace(settled, fit=fit.replace(std=inflated))


def _tabulate(trial: _Trial) -> dict[str, NDArray]:
    """Columns of a table of the disks in pixels of the frame, with flags; from top to bottom."""
    field, fit, settled = trial.field, trial.fit, trial.settled
    disks, std = fit.disks, fit.std[:, RADIUS]
    modes = np.zeros((0, 2)) if settled is None else settled.modes
    rows, columns = field.image.shape
    reach = disks[:, RADIUS] + CUT * fit.blur
    gap = np.minimum.reduce(
        [disks[:, X] + 0.5, columns - 0.5 - disks[:, X], disks[:, Y] + 0.5, rows - 0.5 - disks[:, Y]]
    )
    light = disks[:, RADIUS] / (2 * std)
    holes = field.valid if field.valid is None or field.saturated is None else field.valid | field.saturated
    conditions = {
        Flag.EDGE: (gap < reach) | field.touches(holes, 0, disks, reach),
        Flag.MERGED: count_touching(disks, fit.blur) > 0,
        Flag.SATURATED: field.touches(field.saturated, 1, disks, disks[:, RADIUS]),
        Flag.TOO_SMALL: disks[:, RADIUS] - combine_errors(std, modes) < fit.blur,
        Flag.POOR_FIT: fit.chi_square > POOR_CHI_SQUARE,
        Flag.LOW_SIGNAL: light < FAINT,
    }
    flags = np.zeros(len(disks), np.int64)
    for flag, holds in conditions.items():
        flags |= np.where(holds, int(flag), 0)
    contacts = {
        "x_px": field.unbin(disks[:, X]),
        "y_px": field.unbin(disks[:, Y]),
        "radius_px": disks[:, RADIUS] * field.bin,
        "radius_std_px": combine_errors(std, modes) * field.bin,
        "contrast_shift_px": modes[:, 0] * field.bin,
        "blur_shift_px": modes[:, 1] * field.bin,
        "flags": flags,
    }
    finite = np.isfinite(np.stack(list(contacts.values()))).all(axis=0)
    seen = np.flatnonzero(finite & (gap > -disks[:, RADIUS]) & (light > 2.0))
    order = seen[np.lexsort([contacts["x_px"][seen], contacts["y_px"][seen]])]
    return {name: values[order] for name, values in contacts.items()}
