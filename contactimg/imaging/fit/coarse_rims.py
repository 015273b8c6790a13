"""Rims that pixels cannot follow: what sharp edges differ from the profile counts as noise of the rim.

Where the blur is narrower than a pixel, a pixel of the rim depends on how the edge crosses it; in a binary
image it is even 0 or 1. Sharpening and compression leave ringing of the same size. The misfit of the rims
shows how large that is. It is expressed as the standard deviation of the place of the edge in a pixel, which
is at most that of a place anywhere in it.
"""

from dataclasses import replace

import cv2
import numpy as np

from contactimg.compiled import njit
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
from contactimg.imaging.pixels.masks import for_kernel
from contactimg.imaging.pixels.robust import MAD_TO_STD, noise_std, quantile
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE

QUANTILES_TO_STD = {0.25: 1.0 / 0.3186, 0.5: MAD_TO_STD}
"""Standard deviation of normal deviates over quantiles of their size: ``1/Phi^-1(1/2 + share/2)``."""

FIRST_LOOK, FIRST_LOOK_PIXELS = 4, 2000
"""A first look takes a row in so many, and decides with so many pixels at rims: for time."""
CLEARLY_USUAL_CHI_SQUARE = 1.4
"""Chi-square of a first look that needs no second one. Theory: the lower quartile of 2,000 normal deviates
gives it to 8 %; 2.0 then looks like that in one frame of 10,000."""
BESIDE_PIXELS = 40_000
"""Pixels of the blocks beside contacts that are looked at. Theory: half of them give the noise to 0.6 %."""
RUN = 32  # pixels of a row that are passed over together where there is no contact; for time


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
    every = max(int(np.sqrt(problem.image.size / RIM_SAMPLE_PIXELS)), 1)
    excess, count = _excess(problem, fit, plain, every * FIRST_LOOK, share)
    if count < FIRST_LOOK_PIXELS or excess > CLEARLY_USUAL_CHI_SQUARE:
        excess, count = _excess(problem, fit, plain, every, share)
    if count < FEWEST_RIM_PIXELS:
        return problem
    if excess < LARGEST_USUAL_CHI_SQUARE:
        return replace(problem, noise=plain)
    slope = problem.contrast / (fit.blur * np.sqrt(2.0 * np.pi))
    most = PIXEL_VARIANCE / max(2.0 * np.sqrt(np.pi) * fit.blur, 1.0) * slope**2 / plain.variance
    return replace(problem, noise=replace(plain, rim=float(min((excess - 1.0) * plain.at(0.5), most))))


def _excess(
    problem: FitProblem, fit: FittedDisks, noise: Noise, every: int, share: float
) -> tuple[float, int]:
    """Chi-square of the pixels at rims in every so many rows, from a quantile, and their number."""
    height, residual = _rim_pixels(
        problem.image, fit.model, for_kernel(problem.valid), every, np.float32(problem.contrast),
        np.array(RIM_BAND, np.float32),
    )  # fmt: skip
    if not len(height):
        return 0.0, 0
    scatter = residual**2 / (noise.variance * noise.at(height))
    return QUANTILES_TO_STD[share] ** 2 * quantile(scatter, share), len(height)


def noise_near_contacts(problem: FitProblem, fit: FittedDisks) -> float:
    """Noise of the background beside the contacts over that far from them; 1 if it is not clearly larger.

    Compression and sharpening spoil the neighbourhood of edges, which is what the fit uses.
    """
    if len(fit.disks) < FEWEST_WIDE_DISKS:
        return 1.0
    side = max(side_of(problem.background.shape, problem.image.shape), BLOCK)
    lit = block_means(fit.model, side=side) > 0
    beside = cv2.dilate(lit.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    every = int(np.sqrt(np.count_nonzero(beside) * side**2 / BESIDE_PIXELS))
    sample = _pixels_beside(
        problem.image, fit.model, for_kernel(problem.valid), beside, (side, min(max(every, 1), side)),
        float(CORE_END_FRACTION * problem.contrast),
    )  # fmt: skip
    if len(sample) < LEAST_PIXELS:
        return 1.0
    ratio = noise_std(sample) / problem.pixel_noise
    return ratio if ratio > RINGING_RATIO else 1.0


def rim_noise(noise: Noise) -> float:
    """Standard deviation of a pixel at half height, in grey levels."""
    return float(np.sqrt(noise.variance * noise.at(0.5)))


@njit(cache=True)
def _rim_pixels(image, model, valid, every, contrast, band):
    """Height over the contrast within a band, and residual, of the pixels at rims in every so many rows."""
    rows, columns = image.shape
    size, count = (rows + every - 1) // every * columns, 0
    height, residual = np.empty(size, np.float32), np.empty(size, np.float32)
    masked = valid.shape == image.shape
    for i in range(0, rows, every):
        for start in range(0, columns, RUN):
            stop = min(start + RUN, columns)
            if not _largest(model[i, start:stop]) > 0.0:
                continue
            for j in range(start, stop):
                p = model[i, j] / contrast
                if band[0] < p < band[1] and not (masked and valid[i, j] == 0):
                    height[count], residual[count] = p, image[i, j] - model[i, j]
                    count += 1
    return height[:count], residual[:count]


@njit(cache=True, fastmath=True, forceinline=True)
def _largest(values):
    """The largest of some contiguous values, or 0; apart, so that it compiles to vector instructions."""
    largest = np.float32(0.0)
    for k in range(len(values)):
        largest = max(largest, values[k])
    return largest


@njit(cache=True)
def _pixels_beside(image, model, valid, blocks, steps, limit):
    """Pixels of marked blocks where the model is below a limit; steps: side of the blocks, of the sample."""
    side, every = steps
    sample, count = np.empty(np.count_nonzero(blocks) * (-(-side // every)) ** 2, np.float32), 0
    masked = valid.shape == image.shape
    for row, column in zip(*np.nonzero(blocks)):  # noqa: B905 -- not in compiled code
        for i in range(row * side, min((row + 1) * side, image.shape[0]), every):
            for j in range(column * side, min((column + 1) * side, image.shape[1]), every):
                if model[i, j] < limit and not (masked and valid[i, j] == 0):
                    sample[count] = image[i, j]
                    count += 1
    return sample[:count]
