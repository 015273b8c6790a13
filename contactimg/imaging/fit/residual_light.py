"""What is taken out of a field in turn with the fit: scattered light, and the slow rest of the background.

Both were unknown when the light was fitted: the fit tells where contacts end, and only beyond can either be
seen; and with either in the image, the fit takes a part of it for edge, contrast or blur.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.illumination import Illumination, fit_illumination
from contactimg.imaging.contrast.noise import Noise
from contactimg.imaging.contrast.plateau import Contrast
from contactimg.imaging.fit.assemble import LOOSE, unneeded
from contactimg.imaging.fit.disks import CONTRAST, DiskFit, Prior, fit_disks
from contactimg.imaging.fit.halo import estimate_halo, remove_halo
from contactimg.imaging.fit.problem import Field
from contactimg.imaging.pixels.blocks import BLOCK, BlockMeans, block_means, side_of
from contactimg.imaging.pixels.robust import median
from contactimg.imaging.profile.blurred_disk import EdgeTable
from contactimg.imaging.profile.optics import Halo, SharedOptics

UNTOUCHED = 1e-4  # of the contrast: blocks that contacts brighten by less are background ...
ENOUGH = 0.05  # ... if they are so many of all
GAP = 2  # px: side of squares that are looked at where there are no such blocks ...
GAPS, SHADED = 0.05, 0.2  # ... those least brightened, as long as it is by less than that of the contrast
LEVELLED, LEVEL_ROUNDS = 3e-3, 8  # of the contrast: rest of the light that no fit feels
LONGEST, MOST_RISEN = 4.0, 0.5  # times the rest, and of the contrast: what is taken out at most
LEAST_SPREAD = 1e-3  # levels
HALO_SETTLED = 2e-3  # of the light
KNOWN_ROUNDS = 3  # of a halo that is known: each leaves a fifth of what the fit takes for edge
HALO_ROUNDS = 5  # the fit takes halo for edge at first; each round leaves a fifth of that


def without_halo(
    field: Field,
    fit: DiskFit,
    means: BlockMeans,
    contrast: Contrast,
    noise: Noise,
    *,
    known: SharedOptics,
    free_blur: bool,
) -> tuple[Field, DiskFit, Halo | None, NDArray[np.float64]]:
    """Take the wide part of the point spread function out of the image, in turn with the fit.

    Disks that stood for some of its light are dropped. Where contrast and blur are known, so is the halo:
    there is the one that is known, or none.

    Parameters
    ----------
    field, fit
        The image, and the disks fitted to it.
    means : BlockMeans
        Of both.
    contrast, noise
        To fit with.
    known : SharedOptics
        What was known before.
    free_blur : bool

    Returns
    -------
    field : Field
    fit : DiskFit
        To the image without halo.
    halo : Halo or None
    dropped : ndarray, shape (m, 3)
        Disks that are no longer needed.
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
    field: Field,
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
        field.image, field.valid, disks, blur=fit.blur, noise=noise, prior=prior,
        brightness=field.brightness(disks), free_blur=free_blur, robust=False, table=table, iterations=4,
    )  # fmt: skip


def level_out(
    field: Field,
    fit: DiskFit,
    means: BlockMeans,
    contrast: Contrast,
    noise: Noise,
    *,
    free_blur: bool,
    table: EdgeTable | None,
) -> tuple[Field, DiskFit, Contrast]:
    """Take the slow rest of the background out of the image; of a crowd, in turn with the fit.

    The light was fitted when the faint surroundings of contacts still counted as background; now they are
    known.

    Parameters
    ----------
    field, fit
        The image, and the disks fitted to it.
    means : BlockMeans
        Of both.
    contrast, noise, table
        To fit with.
    free_blur : bool

    Returns
    -------
    field : Field
    fit : DiskFit
    contrast : Contrast
        Above the new background.
    """
    taken, before = 0.0, np.inf
    crowded = side_of(field.blocks.shape, field.image.shape) < BLOCK  # else it is little, and once is enough
    for _ in range(LEVEL_ROUNDS):
        slow = _rest_of_light(means, fit, field)
        if slow is None:
            break
        rest = float(slow.coefficients[0, 0])
        # the fit takes a part of the rest for contrast and blur: a secant tells which
        factor = float(np.clip(taken / (before - rest), 1.0, LONGEST)) if taken and before != rest else 1.0
        taken, before = factor * rest, rest
        if taken > MOST_RISEN * contrast.plateau:
            break  # what the contacts would leave standing is no contact
        field = field.without_light(factor * slow.coefficients)
        if not crowded or abs(taken) < LEVELLED * contrast.plateau:
            break
        contrast = replace(contrast, plateau=contrast.plateau - taken)
        fit = _fit_again(field, fit, fit.disks, contrast, noise, free_blur=free_blur, table=table)
        means = BlockMeans(field.image, fit.model)
    return field, fit, contrast


def _rest_of_light(means: BlockMeans, fit: DiskFit, field: Field) -> Illumination | None:
    """Slow field of what a fit leaves over where there is next to no contact; None if that is nowhere."""
    highest = float(np.max(fit.disks[:, CONTRAST], initial=1e-6))
    side, limit = BLOCK, UNTOUCHED * highest
    image, model = means(side)
    if np.mean(np.abs(model) < limit) < ENOUGH:
        side = GAP
        image, model = means(side)
        limit = max(limit, 1.01 * float(np.quantile(np.abs(model), GAPS)))
        if limit > SHADED * highest:
            return None
    dark = np.abs(model) < limit
    if field.valid is not None:
        dark &= block_means(field.valid, side=side) == 1.0
    if not dark.any():
        return None
    blocks = np.where(dark, image - model, np.float32(np.nan))
    spread = 1.4826 * median(np.abs(blocks[dark]))
    return fit_illumination(blocks, field.image.shape, level=0.0, scatter=max(spread, LEAST_SPREAD))
