"""Candidates for small contacts: peaks of the residuals after a matched filter."""

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.imaging.pixels.blocks import sample_background
from contactimg.imaging.pixels.robust import median, reach_std

FALSE_ALARM_SIGMA = 6.0
"""Height of a matched-filter peak above the noise that counts as detection. Normal noise has
``pixels/(2 width^2) (2 pi)^(-3/2) z exp(-z^2/2)`` maxima above z: 3e-3 in 1600 x 1200 pixels at 1.4 px."""


def find_peaks(
    image: NDArray[np.float32],
    model: NDArray[np.float32],
    *,
    width: float,
    height: float,
    background: NDArray[np.bool_],
) -> tuple[NDArray[np.float64], float]:
    """Find the peaks of the residuals after a matched filter.

    Parameters
    ----------
    image, model : ndarray, shape (rows, columns)
        Difference image, and the disks fitted so far.
    width : float, px
        Standard deviation of the Gaussian filter: that of the blur.
    height : float
        Least height of a peak, grey levels, in however quiet a background.
    background : ndarray of bool
        Background blocks, see `contactimg.imaging.pixels.blocks`, where the noise of the filtered image is
        measured.

    Returns
    -------
    peaks : ndarray, shape (n, 3)
        x, y, height of the filtered peak (grey levels); largest first.
    lowest : float
        Least height of a peak that was used, grey levels.
    """
    smooth = _smooth(image, model, width)
    sample = sample_background(smooth, background, (7, 11))
    if len(sample) < 50:
        sample = smooth[::5, ::7].ravel()
    middle = median(sample)
    lowest = max(middle + FALSE_ALARM_SIGMA * reach_std(sample, middle), height)
    return _sorted_peaks(smooth, lowest, width), lowest


def find_peaks_near(
    image: NDArray[np.float32], model: NDArray[np.float32], disks: NDArray, *, width: float, lowest: float
) -> NDArray[np.float64]:
    """Find the peaks of the residuals in windows around some disks, see `find_peaks`."""
    found = [np.empty((0, 3))]
    for x, y, a in disks[:, :3]:
        reach = int(np.ceil(a + 6.0 * width))
        x0, y0 = max(round(x) - reach, 0), max(round(y) - reach, 0)
        part = (slice(y0, max(round(y) + reach + 1, 0)), slice(x0, max(round(x) + reach + 1, 0)))
        if image[part].size:
            found.append(
                _sorted_peaks(_smooth(image[part], model[part], width), lowest, width)
                + np.array([x0, y0, 0.0])
            )
    return np.unique(np.vstack(found), axis=0)


def _smooth(image: NDArray[np.float32], model: NDArray[np.float32], width: float) -> NDArray[np.float32]:
    """Residuals after a Gaussian filter."""
    taps = 2 * int(np.ceil(2.5 * width)) + 1
    residual = image - model
    blurred = cv2.GaussianBlur(residual, (taps, taps), width, dst=residual, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(blurred, np.float32)


def _sorted_peaks(smooth: NDArray[np.float32], lowest: float, width: float) -> NDArray[np.float64]:
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
