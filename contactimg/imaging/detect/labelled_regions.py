"""Label image of the regions above a level, with the measures that tell disks from bars and hairs."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit

LENGTH_HALF_WIDTHS, LENGTH_MARGIN_PX = 6.0, 3.0
"""A long region is longer than ``6 (half width + 3 px)``: longer than a few small contacts that touch. By
hand."""
BAR_DISTANCE_RATIO = 0.42
"""Mean over largest distance from the rim above which a region is a bar. Theory: 1/3 for disks and squares,
1/2 for bars."""
BAR_AREA_DISKS = 4.0
"""Least area of a long region in disks of its half width; the shape of shorter ones tells nothing. By
hand."""
THIN_HALF_WIDTH_PX = 1.6
"""Half width below which distances in whole pixels are too coarse for that ratio. Chosen by hand."""


@dataclass(frozen=True, eq=False)
class LabelledRegions:
    """Regions above a level, with the measures that tell contacts from other things.

    Parameters
    ----------
    labels : ndarray of int32, shape (rows, columns)
        Number of the region of each pixel, from 0; -1 outside.
    area : ndarray, shape (n,), px^2
    peak : ndarray, shape (n,)
        Largest value.
    long : ndarray of bool, shape (n,)
        Whether the region is a bar or hair rather than a disk or a group of disks.
    half_width : ndarray, shape (n,), px
        Radius of the largest disk inside.
    x, y : ndarray, shape (n,), px
        Centroids.
    """

    labels: NDArray[np.int32]
    area: NDArray[np.float64]
    peak: NDArray[np.float64]
    long: NDArray[np.bool_]
    half_width: NDArray[np.float64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]


def label_regions(image: NDArray[np.float32], level: float) -> LabelledRegions:
    """Regions of an image above a level, joined by sides and corners.

    Examples
    --------
    >>> y, x = np.mgrid[0:40, 0:60]
    >>> bar, disk = np.abs(x - 50) < 4, np.hypot(x - 20, y - 20) < 9
    >>> label_regions((bar | disk).astype(np.float32), 0.5).long.tolist()
    [True, False]
    """
    mask = (image > level).astype(np.uint8)
    count, labels, stats, centroids = cv2.connectedComponentsWithStats(mask, connectivity=8)
    # the border repeats: a region cut by it goes on beyond
    around = cv2.copyMakeBorder(mask, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    distance = cv2.distanceTransform(around, cv2.DIST_L2, cv2.DIST_MASK_5)[1:-1, 1:-1]
    widest, mean, peak = _inside(labels, np.minimum(distance, max(image.shape)), image, count)
    area = stats[:, cv2.CC_STAT_AREA].astype(float)
    # distances end at the first pixel outside, on average half a pixel beyond the rim
    half = np.maximum(widest - 0.5, 0.5)
    length = np.hypot(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT])
    bar = (mean - 0.5 > BAR_DISTANCE_RATIO * half) | (half < THIN_HALF_WIDTH_PX)
    long = bar & (area > BAR_AREA_DISKS * np.pi * half**2)
    long &= length > LENGTH_HALF_WIDTHS * (half + LENGTH_MARGIN_PX)
    x, y = np.asarray(centroids, float)[1:].T
    return LabelledRegions(
        np.asarray(labels, np.int32) - np.int32(1), area[1:], peak[1:], long[1:], half[1:], x, y
    )


@njit(cache=True)
def _inside(labels, distance, image, count):
    """Largest and mean distance to the rim, and brightest pixel, of each label but 0."""
    widest, total, peak = np.zeros(count), np.zeros(count), np.full(count, -np.inf)
    pixels = np.zeros(count)
    for row in range(labels.shape[0]):
        for column in range(labels.shape[1]):
            label = labels[row, column]
            if label:
                pixels[label] += 1.0
                total[label] += distance[row, column]
                widest[label] = max(widest[label], distance[row, column])
                peak[label] = max(peak[label], image[row, column])
    return widest, total / np.maximum(pixels, 1.0), peak
