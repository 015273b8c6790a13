"""Rims that pixels cannot follow: what sharp edges differ from the profile counts as noise of the rim.

Where the blur is narrower than a pixel, a pixel of the rim depends on how the edge crosses it; in a binary
image it is even 0 or 1. Sharpening and compression leave ringing of the same size. The misfit of the rims
shows how large that is. It is expressed as the standard deviation of the place of the edge in a pixel, which
is at most that of a place anywhere in it.
"""

from dataclasses import replace

import cv2
import numpy as np

from contactimg.imaging.contrast.noise import LEAST_PIXELS, Noise
from contactimg.imaging.fit.disks import FittedDisks
from contactimg.imaging.fit.problem import FitProblem
from contactimg.imaging.fit.settings import (
    CORE_END_FRACTION,
    FEWEST_RIM_PIXELS,
    FEWEST_WIDE_DISKS,
    LARGEST_USUAL_CHI_SQUARE,
    RIM_BAND,
    RIM_SAMPLE_PIXELS,
    RINGING_RATIO,
)
from contactimg.imaging.pixels.blocks import BLOCK, block_means, side_of
from contactimg.imaging.pixels.robust import MAD_TO_STD, noise_std, quantile
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE

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
    if not len(problem.profile.powers):  # a film blurs its rim by itself
        return problem
    rows = slice(None, None, max(int(np.sqrt(problem.image.size / RIM_SAMPLE_PIXELS)), 1))
    height = fit.model[rows] / np.float32(problem.contrast)
    rim = (height > RIM_BAND[0]) & (height < RIM_BAND[1])
    if problem.valid is not None:
        rim &= problem.valid[rows] > 0
    if np.count_nonzero(rim) < FEWEST_RIM_PIXELS:
        return problem
    residual = problem.image[rows][rim] - fit.model[rows][rim]
    scatter = residual**2 / (plain.variance * plain.at(height[rim]))
    excess = QUANTILES_TO_STD[share] ** 2 * quantile(scatter, share)
    if excess < LARGEST_USUAL_CHI_SQUARE:
        return replace(problem, noise=plain)
    slope = problem.contrast / (fit.blur * np.sqrt(2.0 * np.pi))
    most = PIXEL_VARIANCE / max(2.0 * np.sqrt(np.pi) * fit.blur, 1.0) * slope**2 / plain.variance
    return replace(problem, noise=replace(plain, rim=float(min((excess - 1.0) * plain.at(0.5), most))))


def noise_near_contacts(problem: FitProblem, fit: FittedDisks) -> float:
    """Noise of the background beside the contacts over that far from them; 1 if it is not clearly larger.

    Compression and sharpening spoil the neighbourhood of edges, which is what the fit uses.
    """
    if len(fit.disks) < FEWEST_WIDE_DISKS:
        return 1.0
    side = max(side_of(problem.background.shape, problem.image.shape), BLOCK)
    lit = block_means(fit.model, side=side) > 0
    beside = cv2.dilate(lit.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    every = max(int(np.sqrt(problem.image.size / RIM_SAMPLE_PIXELS)), 1)
    rows, columns = (np.arange(0, size, every) for size in problem.image.shape)
    sample = beside[rows // side][:, columns // side]
    sample &= fit.model[::every, ::every] < CORE_END_FRACTION * problem.contrast
    if problem.valid is not None:
        sample &= problem.valid[::every, ::every] > 0
    if np.count_nonzero(sample) < LEAST_PIXELS:
        return 1.0
    ratio = noise_std(problem.image[::every, ::every][sample]) / problem.pixel_noise
    return ratio if ratio > RINGING_RATIO else 1.0


def rim_noise(noise: Noise) -> float:
    """Standard deviation of a pixel at half height, in grey levels."""
    return float(np.sqrt(noise.variance * noise.at(0.5)))
