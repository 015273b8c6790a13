"""One region of pixels for each summit: what stands out of the base, divided along the valleys."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.morphology import local_maxima, reconstruction
from skimage.segmentation import watershed

from contactimg.summits.base import Base

Values = NDArray[np.float64]
Labels = NDArray[np.intp]

SMOOTHING_PX = 1.0
"""Standard deviation of the Gaussian before summits are looked for, px. Chosen: it leaves caps of three
pixels and takes two thirds of white noise away; positions and radii come from the heights as measured."""

MEDIAN_OF_25 = 0.25
"""Standard deviation of the median of 25 normal numbers over theirs. Theory: sqrt(pi/2/25)."""

NOISE_SIGMAS = 6.0
"""How far a summit must rise above the valley to its neighbour and above the base, in standard deviations of
the smoothed noise. Theory: of 10^7 pixels none does by chance."""


@dataclass(frozen=True)
class Regions:
    """Regions of the summits.

    Parameters
    ----------
    labels : ndarray of int, shape (rows, columns)
        Number of the region, from 1; 0 outside all of them.
    count : int
        Number of regions.
    smoothed : ndarray, m
        Heights above the base, without spikes and with less noise; holes are filled from around them.
    """

    labels: Labels
    count: int
    smoothed: Values


def divide(heights: Values, base: Base, *, least_height: float) -> Regions:
    """Divide what stands out of the base into regions with one summit each.

    Parameters
    ----------
    heights : ndarray, m
        Above the base; NaN where nothing was measured.
    base : Base
    least_height : float, m
        Lower summits are left out.

    Returns
    -------
    Regions
    """
    smoothed = _smooth(heights)
    rise = NOISE_SIGMAS * max(_noise_left(smoothed, base), 1e-9 * float(np.ptp(smoothed)))
    raised = np.maximum(smoothed, 0.0)
    flooded = reconstruction(np.maximum(smoothed - rise, 0.0), raised)
    tops = local_maxima(flooded) & (flooded > max(0.0, least_height - rise))
    markers, count = ndimage.label(tops, structure=np.ones((3, 3)))
    labels = watershed(-smoothed, markers, mask=smoothed > rise)
    return Regions(labels.astype(np.intp), int(count), smoothed)


def _smooth(heights: Values) -> Values:
    """Heights without spikes and with less noise; holes are filled from the nearest pixel."""
    missing = ~np.isfinite(heights)
    filled = heights
    if missing.any():
        nearest = ndimage.distance_transform_edt(missing, return_distances=False, return_indices=True)
        filled = heights[tuple(nearest)]
    scale = float(np.abs(filled).max()) or 1.0
    median = cv2.medianBlur((filled / scale).astype(np.float32), 5).astype(np.float64) * scale
    smoothed: Values = ndimage.gaussian_filter(median, SMOOTHING_PX, mode="nearest")
    return smoothed


def _noise_left(smoothed: Values, base: Base) -> float:
    """Standard deviation of the smoothed noise: that of the heights below the base, where there is one."""
    below = -smoothed[smoothed < 0]
    if base.seen and below.size:
        return 1.4826 * float(np.median(below))
    return MEDIAN_OF_25 * base.noise
