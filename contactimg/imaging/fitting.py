"""The `disk` method: fit of blurred disks, with the frame's own noise, blur and contrast, and its quality."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.detect import estimate_blur
from contactimg.imaging.disks import (
    CONTRAST,
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
from contactimg.imaging.dust import reject_disks
from contactimg.imaging.edge import PIXEL_VARIANCE, EdgeTable
from contactimg.imaging.halo import Halo, estimate_halo, remove_halo
from contactimg.imaging.light import BLOCK, BlockMeans, LightField, fit_light, side_of
from contactimg.imaging.noise import Noise, estimate_noise, measure_correlation, measure_slope
from contactimg.imaging.order import median
from contactimg.imaging.pixels import NO_MASK, Pixels
from contactimg.imaging.reference import Difference
from contactimg.imaging.rim import Rim, rim_table
from contactimg.imaging.separate import LOOSE, Assembly, assemble_disks, count_touching, unneeded
from contactimg.imaging.shared_optics import Known, Settled, SharedOptics, combine_errors, settle_optics
from contactimg.imaging.threshold import Contrast
from contactimg.tables import Flag
from contactimg.timings import stage

__all__ = ["Fitted", "fit_contacts"]

WIDEST_BLUR = 3.2  # px: wider blurs are measured on binned pixels ...
BINNED_BLUR = 1.6  # ... such that they are about this wide
QUANTISATION = 1e-3  # levels: the least noise that is believed ...
LEAST_NOISE = 5e-3  # ... and of the contrast: no edge is so round that residuals below that mean anything
UNTOUCHED = 1e-4  # of the contrast: blocks that contacts brighten by less are background
ENOUGH_BLOCKS = 0.05  # of the blocks
GAP = 2  # px: side of squares that are looked at where there are no such blocks ...
GAPS, SHADED = 0.05, 0.2  # ... those least brightened, as long as it is by less than that of the contrast
LEVELLED, LEVEL_ROUNDS = 3e-3, 8  # of the contrast: rest of the light that no fit feels
LONGEST, MOST_RISEN = 4.0, 0.5  # times the rest, and of the contrast: what is taken out at most
BLUR_STEP, BLURS_BELOW, BLURS_ABOVE = 1.1, 5, 5  # blurs tried about the guess when there is a rim
ATTEMPTS = 3
LEAST_SPREAD = 1e-4  # of the contrast
SAME_CONTRAST = 0.1  # change of ln contrast from which on disks are told apart again
HALO_SETTLED = 2e-3  # of the light
KNOWN_ROUNDS = 3  # of a halo that is known: each leaves a fifth of what the fit takes for edge
HALO_ROUNDS = 5  # the fit takes halo for edge at first; each round leaves a fifth of that
POOR_CHI_SQUARE = 1.5
FAINT = 10.0  # standard deviations of the light of a contact
CUT = 2.0  # blur widths: a rim closer to the border is cut


@dataclass(frozen=True, eq=False)
class Fitted:
    """The contacts of a frame, and what they share.

    Parameters
    ----------
    contacts : dict of arrays
        Columns x_px, y_px, radius_px, radius_std_px, contrast_shift_px, blur_shift_px, flags.
    rejected : dict of arrays
        Columns x_px, y_px, radius_px, reason.
    optics : SharedOptics
        Contrast and blur that the radii stand for.
    own : SharedOptics
        The same with the uncertainties that the frame alone would leave.
    smallest_px : float
        Radius of a contact that just stands out of the noise; NaN if that is not known.
    """

    contacts: dict[str, NDArray]
    rejected: dict[str, NDArray]
    optics: SharedOptics
    own: SharedOptics
    smallest_px: float = float("nan")


@stage("quality")
def fit_contacts(
    image: NDArray[np.float32],
    pixels: Pixels,
    difference: Difference,
    *,
    contrast: Contrast,
    noise: float,
    known: SharedOptics,
    film: Rim | None = None,
) -> Fitted:
    """Find the contacts of a frame and fit each by a blurred disk.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Difference image, contacts positive.
    pixels, difference
        Where they come from.
    contrast : Contrast
        To start from.
    noise : float
        Standard deviation of a background pixel.
    known : SharedOptics
        What is known of contrast and blur beforehand.
    film : Rim or None
        Bright rim around the contacts; None: the edge is sharp.

    Returns
    -------
    Fitted
    """
    guess = known.blur_px if np.isfinite(known.blur_px) else None
    blur = float(
        estimate_blur(image, contrast.plateau) if guess is None else np.hypot(guess, PIXEL_VARIANCE**0.5)
    )
    field = _Field.of(image, pixels, difference, int(blur / BINNED_BLUR) if blur > WIDEST_BLUR else 1)
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
    return _report(best or trial, pixels, image, difference, contrast)


@dataclass(frozen=True, eq=False)
class _Trial:
    """Disks fitted from one guess of the contrast; nothing is settled where there is no disk."""

    assembly: Assembly
    field: "_Field"
    fit: DiskFit
    halo: Halo | None
    settled: Settled | None


def _attempt(
    field: "_Field",
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
        field.image, field.weight, field.blocks, plateau=contrast.plateau, noise=first,
        brightness=field.brightness, blur=blur, free_blur=free_blur, table=table,
    )  # fmt: skip
    start, halo = assembly.fit, None
    if not len(start.disks):
        return _Trial(assembly, field, start, halo, None)
    means = BlockMeans(field.image, start.model)
    if film is None:
        field, start, halo, dropped = _without_halo(
            field, start, means, contrast, first, known=known, free_blur=free_blur
        )
        assembly = replace(assembly, dropped=np.vstack([assembly.dropped, dropped]))
        means = means if halo is None else BlockMeans(field.image, start.model)
    else:
        before = before.with_blur(start.blur)  # a rim has lengths of its own: its table holds for one blur
    field, start, contrast = _level(field, start, means, contrast, first, free_blur=free_blur, table=table)
    settled = _refine(
        field, start, contrast=contrast, noise=noise, gain=gain, before=before, spread=known.spread,
        free_blur=free_blur, table=table, anchor=anchor,
    )  # fmt: skip
    return _Trial(assembly, field, settled.fit, halo, settled)


def _report(
    trial: _Trial,
    pixels: Pixels,
    image: NDArray[np.float32],
    difference: Difference,
    contrast: Contrast,
) -> Fitted:
    """The tables of a trial, dirt sorted out."""
    field, contacts = trial.field, _tabulate(trial)
    disks = np.column_stack([contacts["x_px"], contacts["y_px"], contacts["radius_px"]])
    reasons = reject_disks(
        pixels, image, difference, disks, blur=trial.fit.blur * field.bin, contrast=contrast.plateau
    )
    bad = reasons != ""
    dropped = trial.assembly.dropped
    tried = np.column_stack([field.unbin(dropped[:, [X, Y]]), dropped[:, RADIUS] * field.bin])
    unneeded = np.full(len(tried), "not needed to explain the pixels")
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
    return Fitted(asserted, rejected, optics, own, trial.assembly.smallest * field.bin)


def _without_halo(
    field: "_Field",
    fit: DiskFit,
    means: BlockMeans,
    contrast: Contrast,
    noise: Noise,
    *,
    known: SharedOptics,
    free_blur: bool,
) -> tuple["_Field", DiskFit, Halo | None, NDArray[np.float64]]:
    """Take the wide part of the point spread function out of the image, in turn with the fit.

    Disks that stood for some of its light are dropped. Where contrast and blur are known, so is the halo:
    there is the one that is known, or none.
    """
    image, before, found = field.image, 0.0, None
    dropped = [np.empty((0, 3))]
    told = np.isfinite([known.contrast, known.blur_px]).all()
    for turn in range(HALO_ROUNDS):
        halo = (
            known.halo if told else estimate_halo(means, contrast=contrast.plateau, contacts=len(fit.disks))
        )
        if halo is None or (abs(halo.fraction - before) < HALO_SETTLED and turn >= told * KNOWN_ROUNDS):
            break
        before, found = halo.fraction, halo
        image = remove_halo(field.image, fit.model, halo)
        gone = unneeded(fit, contrast.plateau, last=True)
        gone &= not gone.all()
        dropped.append(fit.disks[gone, :3])
        fit = _fit_again(
            replace(field, image=image), fit, fit.disks[~gone], contrast, noise, free_blur=free_blur
        )
        means = BlockMeans(field.image, fit.model)
    return replace(field, image=image), fit, found, np.vstack(dropped)


def _fit_again(
    field: "_Field",
    fit: DiskFit,
    disks: NDArray[np.float64],
    contrast: Contrast,
    noise: Noise,
    *,
    free_blur: bool,
    table: EdgeTable | None = None,
) -> DiskFit:
    """Fit disks from where they are, with loosely bound contrasts."""
    n = len(disks)
    prior = Prior(np.full(n, contrast.plateau), np.full(n, LOOSE * contrast.plateau))
    return fit_disks(
        field.image, field.weight, disks, blur=fit.blur, noise=noise, prior=prior,
        brightness=field.brightness(disks), free_blur=free_blur, robust=False, table=table, iterations=4,
    )  # fmt: skip


def _blur_behind(rim: Rim, field: "_Field", contrast: Contrast, noise: Noise, guess: float) -> float:
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


def _misfit(rim: Rim, field: "_Field", contrast: Contrast, noise: Noise, blur: float) -> float:
    """Median chi-square of the contacts for one blur."""
    table = rim_table(rim, blur)
    assembly = assemble_disks(
        field.image, field.weight, field.blocks, plateau=contrast.plateau, noise=noise,
        brightness=field.brightness, blur=blur, free_blur=False, table=table, thorough=False,
    )  # fmt: skip
    return float(np.median(assembly.fit.chi_square)) if len(assembly.fit.disks) else 0.0


def _refine(
    field: "_Field",
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
        image, field.weight, start.disks, blur=start.blur, noise=model, prior=prior,
        brightness=brightness, free_blur=free_blur, iterations=5, table=table,
        drawing=Drawing.partly(image.shape, len(radius)),
    )  # fmt: skip
    inflation = correlation.rim_inflation(radius, fit.blur, noise=model, gain=gain)
    settled = settle_optics(
        image, field.weight, fit, noise=model, prior=prior, brightness=brightness, known=before,
        inflation=inflation, shown=shown, table=table,
    )  # fmt: skip
    fit = settled.fit
    # what the linear noise model gets wrong at the rim shows in all fits; what a single fit gets wrong, in
    # that one
    common = min(float(np.median(fit.chi_square)), 1.0) if len(radius) >= 10 else 1.0
    inflated = fit.std * np.sqrt(inflation * np.maximum(fit.chi_square, common))[:, None]
    return replace(settled, fit=fit.replace(std=inflated))


def _level(
    field: "_Field",
    fit: DiskFit,
    means: BlockMeans,
    contrast: Contrast,
    noise: Noise,
    *,
    free_blur: bool,
    table: EdgeTable | None,
) -> tuple["_Field", DiskFit, Contrast]:
    """Take the slow rest of the background out of the image, in turn with the fit as long as that matters.

    The light was fitted when the faint surroundings of contacts still counted as background; now they are
    known.
    """
    taken, before = 0.0, np.inf
    for _ in range(LEVEL_ROUNDS):
        slow = _rest_of_light(means, fit, field.image.shape)
        if slow is None:
            break
        rest = float(slow.coefficients[0, 0])
        # the fit takes a part of the rest for contrast and blur: a secant tells which
        factor = float(np.clip(taken / (before - rest), 1.0, LONGEST)) if taken and before != rest else 1.0
        taken, before = factor * rest, rest
        if taken > MOST_RISEN * contrast.plateau:
            break  # what the contacts would leave standing is no contact
        field = field.without_light(factor * slow.coefficients)
        if abs(taken) < LEVELLED * contrast.plateau:
            break
        contrast = replace(contrast, plateau=contrast.plateau - taken)
        fit = _fit_again(field, fit, fit.disks, contrast, noise, free_blur=free_blur, table=table)
        means = BlockMeans(field.image, fit.model)
    return field, fit, contrast


def _rest_of_light(means: BlockMeans, fit: DiskFit, shape: tuple[int, int]) -> LightField | None:
    """Slow field of what a fit leaves over where there is next to no contact; None if that is nowhere."""
    highest = float(np.max(fit.disks[:, CONTRAST], initial=1e-6))
    limit = UNTOUCHED * highest
    image, model = means(BLOCK)
    if np.mean(np.abs(model) < limit) < ENOUGH_BLOCKS:
        image, model = means(GAP)
        limit = max(limit, 1.01 * float(np.quantile(np.abs(model), GAPS)))
        if limit > SHADED * highest:
            return None
    dark = np.abs(model) < limit
    blocks = np.where(dark, image - model, np.float32(np.nan))
    spread = 1.4826 * median(np.abs(blocks[dark]))
    return fit_light(blocks, shape, start=0.0, spread=max(spread, QUANTISATION))


@dataclass(frozen=True, eq=False)
class _Field:
    """What the fit looks at: the difference image, binned where the blur is wide, and what belongs to it.

    ``light`` is the slow polynomial that was taken out of the image since.
    """

    image: NDArray[np.float32]
    weight: NDArray[np.uint8]
    saturated: NDArray[np.uint8]
    blocks: NDArray[np.bool_]
    illumination: NDArray[np.float32]
    bin: int
    light: NDArray[np.float64]

    @classmethod
    def of(cls, image: NDArray, pixels: Pixels, difference: Difference, bin_: int) -> "_Field":
        blocks = difference.light.background
        weight = NO_MASK if pixels.valid is None else pixels.valid
        saturated = pixels.saturated
        if saturated.shape == image.shape:
            usable = 1 - saturated
            weight = usable if weight is NO_MASK else weight * usable
        if bin_ > 1:
            rows, columns = max(image.shape[0] // bin_, 1), max(image.shape[1] // bin_, 1)
            side = side_of(blocks.shape, image.shape)
            weight, saturated = _binned_mask(weight, bin_, 0), _binned_mask(saturated, bin_, 1)
            image = cv2.resize(
                image[: rows * bin_, : columns * bin_], (columns, rows), interpolation=cv2.INTER_AREA
            )
            y = np.minimum(np.arange(-(-rows // side)) * bin_, blocks.shape[0] - 1)
            x = np.minimum(np.arange(-(-columns // side)) * bin_, blocks.shape[1] - 1)
            blocks = blocks[y][:, x]
        return cls(image, weight, saturated, blocks, difference.illumination, bin_, np.zeros((4, 4)))

    def without_light(self, coefficients: NDArray[np.float64]) -> "_Field":
        """The field with a slow polynomial taken out of its image."""
        if not coefficients.any():
            return self
        light = LightField(coefficients, self.blocks, 0.0)
        return replace(self, image=light.subtract_from(self.image), light=self.light + coefficients)

    def brightness(self, disks: NDArray) -> NDArray[np.float64]:
        """Relative illumination where the disks stand."""
        rows, columns = self.illumination.shape
        x = np.clip(disks[:, X] * self.bin / BLOCK, 0, columns - 1).astype(int)
        y = np.clip(disks[:, Y] * self.bin / BLOCK, 0, rows - 1).astype(int)
        return self.illumination[y, x].astype(float)

    def unbin(self, position: NDArray) -> NDArray[np.float64]:
        """Position in pixels of the frame."""
        return np.asarray(position * self.bin + (self.bin - 1) / 2)

    def touches(
        self, mask: NDArray[np.uint8], wanted: int, disks: NDArray, reach: NDArray
    ) -> NDArray[np.bool_]:
        """Disks within ``reach`` of which a pixel of the mask has the wanted value."""
        out = np.zeros(len(disks), np.bool_)
        if mask.shape != self.image.shape:
            return out
        source = (mask != wanted).astype(np.uint8)
        if source.all():
            return out
        distance = cv2.distanceTransform(source, cv2.DIST_L2, cv2.DIST_MASK_5)
        x = np.clip(np.rint(disks[:, X]), 0, mask.shape[1] - 1).astype(int)
        y = np.clip(np.rint(disks[:, Y]), 0, mask.shape[0] - 1).astype(int)
        return np.asarray(distance[y, x] < reach)


def _binned_mask(mask: NDArray[np.uint8], bin_: int, marked: int) -> NDArray[np.uint8]:
    """Mask of binned pixels: ``marked`` where one pixel of the bin is."""
    if mask.size == 1:
        return mask
    rows, columns = mask.shape[0] // bin_, mask.shape[1] // bin_
    bins = mask[: rows * bin_, : columns * bin_].reshape(rows, bin_, columns, bin_)
    return np.ascontiguousarray(bins.max(axis=(1, 3)) if marked else bins.min(axis=(1, 3)))


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
    holes = NO_MASK if field.weight is NO_MASK else field.weight | field.saturated
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
