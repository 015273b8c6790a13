"""Removes the halo and what is left of the background from the image, in turn with the fit.

Both can be measured only away from contacts, and only the fit shows where contacts end. As long as either is
in the image, the fit takes part of it for edge, contrast or blur; hence the turns.

The halo is a second, wide part of the point spread function. With the frame M seen through the core alone and
the halo's Gaussian G, the frame is ``D = (1-f) M + f G*M``. Beyond the reach of the core only the halo is
left: there f and its width follow from least squares. M then follows from D minus the halo of the present M.
"""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import special

from contactimg.imaging.background.illumination import fit_illumination
from contactimg.imaging.fit.disks import (
    FitControl,
    FittedDisks,
    ModelImage,
    erase_disks,
    find_insignificant,
    fit_disks,
)
from contactimg.imaging.fit.problem import CONTRAST, ContrastPrior, FitProblem
from contactimg.imaging.pixels.blocks import BLOCK, block_means, side_of, to_pixels
from contactimg.imaging.pixels.robust import (
    FEWEST_VALUES,
    MAD_TO_STD,
    MANY,
    SIGNIFICANT_SIGMA,
    finite_values,
    median,
    quantile,
    robust_std,
)
from contactimg.imaging.profile.limits import FEWEST, LEAST_FRACTION, POOR_CHI_SQUARE, ROUNDS
from contactimg.imaging.profile.optics import Halo, SharedOptics

HALO_PARTS = 12
"""Parts of the image whose scatter gives the uncertainty, ... By hand."""
HALO_WIDTHS_PX = (3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 24.0)
"""Standard deviations tried. By hand."""
SETTLED_FRACTION = 2e-3
"""Change of halo (of the light) or remaining illumination (of the contrast) that ends the turns. Accuracy."""
BLOCK_PX = 2
"""Side of the block means on which halos, and the gaps of a crowd, are looked at, a power of 2. Accuracy."""
WIDE_PX = 3.0
"""Width of a Gaussian from which it is applied to means over 2 x 2 pixels. Accuracy: 1.4 % wider."""
LARGEST_LEFT = 0.5
"""Largest halo, of the light, and remaining illumination, of the contrast, that are removed. By hand: more
would be the point spread function itself, or contacts."""


def remove_halo(
    problem: FitProblem, fit: FittedDisks, *, prior_optics: SharedOptics, free_blur: bool
) -> tuple[FitProblem, FittedDisks, Halo | None, NDArray[np.float64]]:
    """Remove the wide part of the point spread function from the image, in turn with the fit.

    Disks that only described light of the halo are dropped. Where prior contrast and blur are given, the halo
    is that of the prior, or there is none.

    Parameters
    ----------
    problem : FitProblem
    fit : FittedDisks
        Of this problem.
    prior_optics : SharedOptics
    free_blur : bool

    Returns
    -------
    problem : FitProblem
        Without the halo.
    fit : FittedDisks
        Of that problem.
    halo : Halo or None
    dropped : ndarray, shape (m, 3)
        x, y, radius of the disks that were dropped.
    """
    image, fraction, removed, dropped = problem.image, 0.0, None, [np.empty((0, 3))]
    given = bool(np.isfinite([prior_optics.contrast, prior_optics.blur_px]).all())
    for _ in range(ROUNDS):
        halo = prior_optics.halo
        if not given:
            count = len(fit.disks)
            halo = estimate_halo(problem.image, fit.model, contrast=problem.contrast, contacts=count)
        if halo is None or (not given and abs(halo.fraction - fraction) < SETTLED_FRACTION):
            break
        fraction, removed = halo.fraction, halo
        image = subtract_halo(problem.image, fit.model, halo)
        insignificant = find_insignificant(fit, problem, final=True)
        insignificant &= not insignificant.all()
        dropped.append(fit.disks[insignificant, :3])
        fit = _refit(replace(problem, image=image), fit, ~insignificant, free_blur=free_blur)
    return replace(problem, image=image), fit, removed, np.vstack(dropped)


def _refit(problem: FitProblem, fit: FittedDisks, kept: NDArray[np.bool_], *, free_blur: bool) -> FittedDisks:
    """Fit some of the disks of a fit, whose model image is overwritten, again."""
    control = FitControl(free_blur, robust=False, iterations=4)
    erase_disks(problem, fit, ~kept)
    start = ModelImage(fit.model, np.ones(int(np.count_nonzero(kept)), np.bool_))
    return fit_disks(problem, fit.disks[kept], blur=fit.blur, control=control, start=start)


def remove_background(
    problem: FitProblem, fit: FittedDisks, *, free_blur: bool
) -> tuple[FitProblem, FittedDisks]:
    """Remove what is left of the background, now that the fit shows where contacts end.

    In a crowd, and in a frame of few blocks, that is a slow field in the gaps, removed in turn with the fit.
    Elsewhere it is the faint light of contacts in the blocks that the light was fitted to: the median of the
    residual where no contact is, if it is significant.

    Parameters
    ----------
    problem : FitProblem
    fit : FittedDisks
        Of this problem.
    free_blur : bool

    Returns
    -------
    problem : FitProblem
        Without it, with the contrast above the new background.
    fit : FittedDisks
        Of that problem.
    """
    # small background blocks are the sign of a crowd; few of them tell a level, and no slope
    few = np.count_nonzero(problem.background) < 2 * FEWEST_VALUES and fit.usual_chi_square < POOR_CHI_SQUARE
    if side_of(problem.background.shape, problem.image.shape) >= BLOCK and not few:
        if (gaps := _gaps(problem, fit, BLOCK)) is not None:
            values = finite_values(gaps)
            # compression may have rounded all blocks alike
            rest, std = median(values), np.hypot(robust_std(values) / np.sqrt(values.size), problem.rounding)
            if abs(rest) > SIGNIFICANT_SIGMA * std:
                problem = replace(problem, image=problem.image - np.float32(rest))
        return problem, fit
    removed, last = 0.0, np.inf
    for _ in range(ROUNDS):
        gaps = _gaps(problem, fit, BLOCK_PX)
        if gaps is None:
            break
        spread, least = MAD_TO_STD * median(np.abs(finite_values(gaps))), LEAST_FRACTION * problem.contrast
        illumination = fit_illumination(
            gaps, problem.image.shape, level=0.0, scatter=max(spread, least), least_scatter=least
        )
        rest = float(illumination.coefficients[0, 0])
        # the fit takes part of the remainder for contrast and blur: a secant step accounts for that
        secant = removed / (last - rest) if removed and last != rest else 1.0
        factor = float(np.clip(secant, 1.0, 4.0))  # longest step by hand
        removed, last = factor * rest, rest
        if removed > LARGEST_LEFT * problem.contrast:
            break
        left = replace(illumination, coefficients=factor * illumination.coefficients)
        problem = replace(problem, image=left.subtract_from(problem.image))
        if abs(removed) < SETTLED_FRACTION * problem.contrast:
            break
        prior = ContrastPrior.loose(problem.contrast - removed, problem.prior.odd)
        problem = replace(problem, prior=prior)
        fit = _refit(problem, fit, np.ones(len(fit.disks), np.bool_), free_blur=free_blur)
    return problem, fit


def _gaps(problem: FitProblem, fit: FittedDisks, side: int) -> NDArray[np.float32] | None:
    """Means of the residual over the squares (px) with the least light of contacts, NaN in others.

    None where contacts leave no such square.
    """
    image, model = (block_means(part, side=side) for part in (problem.image, fit.model))
    light = np.abs(model)
    dark = light == 0.0  # in most frames these are enough
    share = 0.05  # of the blocks, by hand
    limit = 1.01 * quantile(light, share) if np.count_nonzero(dark) < share * dark.size else 0.0
    if limit > 0.2 * float(np.max(fit.disks[:, CONTRAST], initial=1e-6)):  # no gaps. By hand
        return None
    dark |= light <= limit
    if problem.valid is not None:
        dark &= block_means(problem.valid, side=side) == 1.0
    return np.where(dark, image - model, np.float32(np.nan)) if dark.any() else None


def estimate_halo(
    image: NDArray[np.float32], model: NDArray[np.float32], *, contrast: float, contacts: int
) -> Halo | None:
    """Halo of a frame, or None if it has no significant one.

    Parameters
    ----------
    image, model : ndarray, shape (rows, columns)
        Difference image, and the disks fitted with the core of the point spread function.
    contrast : float
        Of the contacts, grey levels.
    contacts : int
        Number of contacts; fewer than three determine no halo.
    """
    parts = min(contacts, HALO_PARTS)
    if parts < FEWEST:
        return None
    # a quick look at larger blocks suffices for most frames
    if _best_halo((image, model), contrast, 2 * BLOCK_PX, HALO_WIDTHS_PX[::3], parts=parts) is None:
        return None
    return _best_halo((image, model), contrast, BLOCK_PX, HALO_WIDTHS_PX, parts=parts)


def _best_halo(
    images: tuple[NDArray, NDArray], contrast: float, side: int, widths: tuple[float, ...], *, parts: int
) -> Halo | None:
    """The halo, of those of some widths, that explains most of the block means of a side."""
    image, core = (block_means(part, side=side) for part in images)
    some = (slice(None, None, max(int(np.sqrt(core.size / MANY)), 1)),) * 2
    dark = np.abs(core[some]) < 5e-4 * contrast  # only the halo is left. Accuracy
    if np.count_nonzero(dark) < 20 * HALO_PARTS:
        return None
    data, halos = image[some][dark], [_blurred(core, width / side)[some][dark] for width in widths]
    fits = [_fit_slope(data, halo) for halo in halos]
    best = int(np.argmin([residual for _, residual in fits]))
    fraction = fits[best][0]
    if fraction < 0.01:  # of the light. Accuracy
        return None
    scatter = _slope_std(data, halos[best], fraction, parts)
    if fraction < -special.stdtrit(parts - 1, 3e-6) * scatter:  # false alarms per frame
        return None
    return Halo(min(fraction, LARGEST_LEFT), widths[best])


def subtract_halo(image: NDArray[np.float32], model: NDArray[np.float32], halo: Halo) -> NDArray[np.float32]:
    """The image as the core of the point spread function alone would show it."""
    wide = np.float32(halo.fraction) * _blurred(model, halo.sigma_px)
    return np.asarray((image - wide) / np.float32(1.0 - halo.fraction))


def _blurred(core: NDArray[np.float32], width: float) -> NDArray[np.float32]:
    """Through a Gaussian of a width in pixels, a wide one in blocks of pixels; the border repeats."""
    if width >= WIDE_PX:
        coarse = _blurred(block_means(core, side=2), 0.5 * width)
        return to_pixels(coarse, core.shape, side=2, interpolation=cv2.INTER_CUBIC)
    return np.asarray(cv2.GaussianBlur(core, (0, 0), width, borderType=cv2.BORDER_REPLICATE), np.float32)


def _fit_slope(data: NDArray, wide: NDArray) -> tuple[float, float]:
    """Slope of the data against the halo, and the residual sum of squares."""
    x, y = wide - wide.mean(dtype=float), data - data.mean(dtype=float)
    # no product of vectors, which would wake the threads of a library
    power, common, squares = (float(np.sum(u * v)) for u, v in ((x, x), (x, y), (y, y)))
    slope = common / power if power > 1e-9 * len(x) else 0.0
    return slope, squares - slope * common


def _slope_std(data: NDArray, wide: NDArray, slope: float, parts: int) -> float:
    """Standard uncertainty of the slope.

    Neighbouring pixels share noise, so it comes from the scatter between parts of the image, each with the
    same share of the information on the slope.
    """
    x = wide - wide.mean(dtype=float)
    information = np.cumsum(x * x)
    if not information[-1] > 0.0:
        return np.inf
    part = np.minimum((parts * information / information[-1]).astype(int), parts - 1)
    scores = np.bincount(part, x * (data - data.mean(dtype=float) - slope * x))
    return float(np.sqrt(scores @ scores) / information[-1])
