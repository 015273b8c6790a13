"""Regions above a level, with what tells disks from bars and hairs."""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

LENGTH, SHORT = 6.0, 3.0  # half widths, px on top: a few small contacts that touch are shorter than that

FILLED = 0.42  # mean over largest distance from the rim: 1/3 for disks and squares, 1/2 for bars
LONG = 4.0  # disks of the largest width that fill the object: shorter ones may be anything
THIN = 1.6  # px: half width of a region whose distances from the rim are too coarse to tell


@dataclass(frozen=True, eq=False)
class Objects:
    """Regions above a level, with what tells contacts from other things.

    Parameters
    ----------
    labels : ndarray of int32, shape (rows, columns)
        Number of the object of each pixel, from 0; -1 outside.
    area : ndarray, shape (n,), px^2
    peak : ndarray, shape (n,)
        Largest value.
    long : ndarray of bool, shape (n,)
        Whether the shape is that of a bar or hair rather than of disks.
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


def find_objects(image: NDArray[np.float32], level: float) -> Objects:
    """Regions of an image above a level, joined by sides and corners.

    Examples
    --------
    >>> y, x = np.mgrid[0:40, 0:60]
    >>> bar, disk = np.abs(x - 50) < 4, np.hypot(x - 20, y - 20) < 9
    >>> find_objects((bar | disk).astype(np.float32), 0.5).long.tolist()
    [True, False]
    """
    mask = (image > level).astype(np.uint8)
    count, labels, stats, centroids = cv2.connectedComponentsWithStats(mask, connectivity=8)
    # what the border cuts goes on beyond it
    around = cv2.copyMakeBorder(mask, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    distance = cv2.distanceTransform(around, cv2.DIST_L2, cv2.DIST_MASK_5)[1:-1, 1:-1]
    widest, mean, peak = _inside(labels, np.minimum(distance, max(image.shape)), image, count)
    area = stats[:, cv2.CC_STAT_AREA].astype(float)
    # pixels lie up to half a pixel beyond the rim that distances count from
    half = np.maximum(widest - 0.5, 0.5)
    length = np.hypot(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT])
    filled = (mean - 0.5 > FILLED * half) | (half < THIN)
    long = filled & (area > LONG * np.pi * half**2) & (length > LENGTH * (half + SHORT))
    return Objects(labels - 1, area[1:], peak[1:], long[1:], half[1:], centroids[1:, 0], centroids[1:, 1])


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
