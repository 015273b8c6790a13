"""Which contacts call for another shape than a disk: the part of the ladder that every frame pays for."""

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.fit.quality import FittedDetections, FrameFit
from contactimg.imaging.fit.settings import FEWEST_COMMON_CHI_SQUARE, LARGEST_USUAL_CHI_SQUARE
from contactimg.imaging.kernels.quadrupole import screen_quadrupoles
from contactimg.imaging.reject.scratches import find_chains
from contactimg.imaging.detect.overlap import find_overlaps
from contactimg.tables import Flag

FALSE_CLIMB = 1e-4
"""Probability that a disk in normal noise is called an ellipse. False-alarm rate."""
LEAST_SIGNIFICANCE = -2.0 * np.log(FALSE_CLIMB)
"""Of an ellipticity. Theory: chi-square of two degrees of freedom exceeds x with probability exp(-x/2)."""
LARGEST_SCORE_SCALE = 5.0
"""Largest median score, over that of noise, that is ascribed to noise that pixels share. Chosen."""
NORMAL_MEDIAN = 2.0 * np.log(2.0)
"""Median of chi-square of two degrees of freedom. Theory."""
CALL_SIGMA = 5.0
"""Excess of the mean squared residual, in its standard deviations, from which on a contact calls. False-alarm
rate: 3e-7 for normal noise."""
UNEVEN_SHARE = 0.01
"""Mean squared deviation inside a contact, over its squared contrast, from which on a contact calls: a hole
in a hundredth of its area. Chosen: dirt is less."""
UNEVEN_RATIO = 3.0
"""The same over the usual one of the frame. Chosen."""
OVERLAP_BLUR_WIDTHS, OVERLAP_SHARE = 0.8, 0.3
"""Overlap of two disks, and over the smaller radius, from which on they may be one contact: solids touch, but
cannot overlap. Chosen: covers of bones, stars and triangles overlap by 0.34 to 0.9 of a radius,
touching contacts and beads seldom by more than 0.13."""


def find_calls(detections: FittedDetections, frame_fit: FrameFit) -> tuple[NDArray[np.bool_], float]:
    """Which contacts call for another shape, and the usual score of an elongation over that of noise."""
    rows, flags = detections.rows, detections.contacts["flags"]
    fit, problem = frame_fit.fit, frame_fit.problem
    called = (flags & int(Flag.POOR_FIT)) != 0
    usual = usual_chi_square(fit.chi_square)
    called |= fit.chi_square[rows] > usual * (
        1.0 + CALL_SIGMA * np.sqrt(2.0 / np.maximum(fit.pixels[rows], 1))
    )
    score, inside = np.empty((2, len(fit.disks)))
    noise = np.array([problem.noise.variance, problem.noise.slope])
    screen_quadrupoles(problem.image, fit.disks, fit.blur, noise, score, inside)
    with np.errstate(invalid="ignore"):
        scale = _usual(score, NORMAL_MEDIAN, LARGEST_SCORE_SCALE)
        called |= score[rows] > LEAST_SIGNIFICANCE * scale
        least = UNEVEN_SHARE * problem.contrast**2 / (noise[0] * (1.0 + noise[1]))
        called |= inside[rows] > np.maximum(least, UNEVEN_RATIO * _usual(inside, 1.0, np.inf))
    other = _overlapping(fit.disks, fit.blur)
    for chain in find_chains(problem.image, fit.disks, blur_px=fit.blur):
        other[chain] = True
    return called | other[rows], scale


def _usual(values: NDArray, median: float, most: float) -> float:
    """Median of values over that of noise, between 1 and ``most``; 1 for few values."""
    known = values[np.isfinite(values)]
    if len(known) < FEWEST_COMMON_CHI_SQUARE:
        return 1.0
    return float(np.clip(np.median(known) / median, 1.0, most))


def usual_chi_square(chi_square: NDArray) -> float:
    """Mean squared residual that is ascribed to the noise model, not to the contacts."""
    if len(chi_square) < FEWEST_COMMON_CHI_SQUARE:
        return 1.0
    return float(np.clip(np.median(chi_square), 1.0, LARGEST_USUAL_CHI_SQUARE))


def _overlapping(disks: NDArray, blur: float) -> NDArray[np.bool_]:
    """Disks that overlap another one deeper than touching contacts may seem to."""
    out = np.zeros(len(disks), np.bool_)
    out[find_overlaps(disks, OVERLAP_BLUR_WIDTHS * blur, OVERLAP_SHARE).ravel()] = True
    return out
