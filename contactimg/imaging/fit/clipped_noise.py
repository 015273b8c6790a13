"""Background at the end of the grey levels: its noise is cut off there, and with it the foot of each edge.

On a white background at the full scale of the sensor the noise of a pixel can make it darker only, so that it
appears darker in the mean than it is; at the edge of a contact it does not, and a black contact appears
brighter than it is. The image is corrected for that with the levels that the fitted contacts give, and the
noise of the rims is that of a pixel that is not cut off.

For a level L, normal noise of standard deviation s and the full scale F the mean grey level is
``L - s g((F - L)/s)`` with ``g(t) = phi(t) - t (1 - Phi(t))``.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from contactimg.imaging.fit.disks import FitControl, FittedDisks, ModelImage, fit_disks
from contactimg.imaging.fit.problem import RADIUS, FitProblem
from contactimg.imaging.fit.settings import SIGNIFICANT_LIGHT_SIGMA
from contactimg.imaging.pixels.frame_pair import CutOff
from contactimg.imaging.pixels.robust import quantile

LEAST_SHARE, LARGEST_SHARE = 0.02, 0.98
"""Share of the background pixels at the end of the grey levels. Chosen: fewer lose nothing (theory: a mean of
0.4 % of the noise); if more are there, no noise is seen."""
FOOT_FRACTION = 0.01
"""Of the contrast, up to which a pixel belongs to the background. Chosen."""
FEWEST_PIXELS = 100  # of the background; theory: their share at the end is then known to 0.05
LEAST_DISTANCE = 1e-3  # of two quantiles, standard deviations; keeps a noise of 0 finite
ROUNDS = 2  # of correcting with the contrast found; accuracy
ONE_STD = float(ndtr(1.0))  # quantile one standard deviation from the mean


def restore_clipped_noise(
    problem: FitProblem, fit: FittedDisks, cut_off: CutOff | None, *, free_blur: bool
) -> tuple[FitProblem, FittedDisks]:
    """Problem and fit without what the end of the grey levels does to the edges.

    Parameters
    ----------
    problem : FitProblem
    fit : FittedDisks
        Of it, with all its disks in the model image.
    cut_off : CutOff or None
        End of the grey levels at the background; None if the background is not near it.
    free_blur : bool
        Whether the fit determines the blur.
    """
    if cut_off is None or cut_off.pixels.shape != problem.image.shape:
        return problem, fit
    background = fit.model < FOOT_FRACTION * problem.contrast
    if problem.valid is not None:
        background &= problem.valid > 0
    pixels, at_end = problem.image[background], cut_off.pixels[background] > 0
    share = float(np.mean(at_end)) if len(pixels) > FEWEST_PIXELS else 0.0
    if not LEAST_SHARE < share < LARGEST_SHARE:
        return problem, fit
    end = -float(ndtri(share))  # of the grey levels, in standard deviations above the background
    # levels from half a step below one are rounded to it
    high = quantile(pixels, ONE_STD)
    below = float(np.clip(np.mean(pixels < high + 0.5 * cut_off.step), ONE_STD, 1.0 - 1.0 / len(pixels)))
    width = max(high - float(np.median(pixels[at_end])), 0.0)
    noise = max(width / max(end + float(ndtri(below)), LEAST_DISTANCE), problem.pixel_noise)
    end += 0.5 * cut_off.step / noise
    room = cut_off.span - end * noise
    # a mean background below the end of the levels makes no contrast larger than their range
    seen = replace(problem, largest_contrast=min(room, cut_off.span)).with_noise(noise**2)
    disks = _significant(fit, noise / problem.pixel_noise)
    for _ in range(ROUNDS):
        height = np.clip(fit.model, 0.0, room) / noise
        lost = _lost(end) - _lost(end + height) + _lost(room / noise - height)
        image = problem.image + np.asarray(noise * lost - float(pixels.mean()), np.float32)
        seen = replace(seen, image=image)
        fit = fit_disks(
            seen, disks, blur=fit.blur, control=FitControl(free_blur, iterations=5),
            start=ModelImage.blank(image.shape, len(disks), complete=True),
        )  # fmt: skip
        disks = fit.disks
    return seen, fit


def _significant(fit: FittedDisks, ratio: float) -> NDArray[np.float64]:
    """The disks whose light is significant in a noise that is larger by a ratio; all if none is."""
    kept = fit.disks[:, RADIUS] >= 2.0 * SIGNIFICANT_LIGHT_SIGMA * ratio * fit.std[:, RADIUS]
    return fit.disks[kept] if kept.any() else fit.disks


def _lost(distance: NDArray | float) -> NDArray[np.float64]:
    """Mean of the noise that is cut off at a distance from the mean, both in standard deviations."""
    t = np.asarray(distance, float)
    return np.asarray(np.exp(-0.5 * t**2) / np.sqrt(2.0 * np.pi) - t * ndtr(-t))
