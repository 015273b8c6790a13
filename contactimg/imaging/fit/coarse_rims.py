"""Rims that pixels cannot follow: what sharp edges differ from the profile counts as noise of the rim.

Where the blur is narrower than a pixel, a pixel of the rim depends on how the edge crosses it; in a binary
image it is even 0 or 1. The misfit of the rims shows how large that is. It is expressed as the standard
deviation of the place of the edge in a pixel, which is at most that of a place anywhere in it.
"""

from dataclasses import replace

import numpy as np

from contactimg.imaging.fit.disks import FittedDisks
from contactimg.imaging.fit.problem import FitProblem
from contactimg.imaging.pixels.robust import MAD_TO_STD, quantile
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE

SHARPEST_BLUR_PX = 0.75
"""Blur, pixel included, below which a misfit at the rims is that of coarse pixels, not of the edge. By hand:
the edge then rises within 1.5 px."""
RIM_BAND = (0.2, 0.8)
"""Fractions of the contrast between which a pixel is at the rim. By hand."""
RIM_SAMPLE_PIXELS = 250_000
"""Pixels of an image that are looked at. Accuracy: a thousand at rims give their scatter to 4 %."""
FEWEST_RIM_PIXELS = 10
"""Pixels at rims that give their scatter. By hand: half the rim of one contact of 2 px."""
USUAL_CHI_SQUARE = 2.0
"""Largest chi-square of the rims ascribed to the noise model. By hand."""
QUANTILES_TO_STD = {0.25: 1.0 / 0.3186, 0.5: MAD_TO_STD}
"""Standard deviation of normal deviates over quantiles of their size: ``1/Phi^-1(1/2 + share/2)``."""


def allow_for_coarse_rims(problem: FitProblem, fit: FittedDisks, *, share: float = 0.25) -> FitProblem:
    """The problem with the noise of its rims as large as their misfit.

    Parameters
    ----------
    problem : FitProblem
    fit : FittedDisks
        Of this problem, with all its disks in the model image.
    share : float
        Quantile of the residuals that decides, 0.25 or 0.5: the lower one, so that rims of disks still to be
        told apart hardly count.

    Notes
    -----
    Behind a blur s the places of the edge in neighbouring pixels are averaged: their variance is at most that
    of a place anywhere in a pixel, 1/12 px^2, times ``int g^2 = 1/(2 sqrt(pi) s)``.
    """
    plain = replace(problem.noise, rim=0.0)
    if fit.blur > SHARPEST_BLUR_PX or not len(problem.profile.powers):  # a film blurs its rim by itself
        return replace(problem, noise=plain)
    every = max(int(np.sqrt(problem.image.size / RIM_SAMPLE_PIXELS)), 1)
    height, image = fit.model[::every] / problem.contrast, problem.image[::every]
    rim = (height > RIM_BAND[0]) & (height < RIM_BAND[1])
    if problem.valid is not None:
        rim &= problem.valid[::every] > 0
    if np.count_nonzero(rim) < FEWEST_RIM_PIXELS:
        return problem
    scatter = (image[rim] - fit.model[::every][rim]) ** 2 / (plain.variance * plain.at(height[rim]))
    excess = QUANTILES_TO_STD[share] ** 2 * quantile(scatter, share)
    if excess < USUAL_CHI_SQUARE:
        return replace(problem, noise=plain)
    slope = problem.contrast / (fit.blur * np.sqrt(2.0 * np.pi))
    most = PIXEL_VARIANCE / max(2.0 * np.sqrt(np.pi) * fit.blur, 1.0) * slope**2 / plain.variance
    return replace(problem, noise=replace(plain, rim=float(min((excess - 1.0) * plain.at(0.5), most))))
