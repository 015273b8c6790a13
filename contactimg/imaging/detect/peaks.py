"""Candidates for small contacts: peaks of the residuals after a matched filter."""

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.imaging.pixels.blocks import sample_background
from contactimg.imaging.pixels.masks import Values
from contactimg.imaging.pixels.robust import SOME, median, reach_std

FALSE_ALARM_SIGMA = 6.0
"""Height of a matched-filter peak above the noise that counts as detection. Normal noise has
``pixels/(2 width^2) (2 pi)^(-3/2) z exp(-z^2/2)`` maxima above z: 3e-3 in 1600 x 1200 pixels at 1.4 px."""


def least_peak(smooth: NDArray[np.float32], background: NDArray[np.bool_], rounding: float = 0.0) -> float:
    """Height from which a peak of a filtered image stands out of its noise.

    ``background`` are the blocks in which the noise is measured (`contactimg.imaging.pixels.blocks`), and
    ``rounding`` is the part of it that the pixels of a block share (`rounding_of_blocks`).
    """
    sample = sample_background(smooth, background, (7, 11))
    if len(sample) < SOME:
        sample = smooth[::5, ::7].ravel()
    middle = median(sample)
    return middle + FALSE_ALARM_SIGMA * max(reach_std(sample, middle), rounding)


def filter_residual(image: Values, model: Values, width: float) -> Values:
    """The residual of a model, after a Gaussian filter of a width (px): that of the blur."""
    taps = 2 * int(np.ceil(2.5 * width)) + 1
    residual = image - model
    blurred = cv2.GaussianBlur(residual, (taps, taps), width, dst=residual, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(blurred, np.float32)


def find_peaks(smooth: NDArray[np.float32], lowest: float, width: float) -> NDArray[np.float64]:
    """Peaks (x, y, height) of a filtered image above a height, no two within a width (px), largest first."""
    found = _peaks(smooth, np.flatnonzero(smooth.ravel() > np.float32(lowest)), int(np.ceil(width)))
    return found[np.argsort(-found[:, 2], kind="stable")]


@njit(cache=True)
def _peaks(image, places, half):
    """Pixels among ``places``, counted row by row, that are the largest of a square of that half width."""
    rows, columns = image.shape
    out = np.empty((len(places), 3))
    count = 0
    for place in places:
        y, x = place // columns, place % columns
        value = image[y, x]
        top = True
        for j in range(max(y - half, 0), min(y + half + 1, rows)):
            for i in range(max(x - half, 0), min(x + half + 1, columns)):
                if image[j, i] > value or (image[j, i] == value and (j < y or (j == y and i < x))):
                    top = False
                    break
            if not top:
                break
        if top:
            out[count, 0], out[count, 1], out[count, 2] = x, y, value
            count += 1
    return out[:count]
