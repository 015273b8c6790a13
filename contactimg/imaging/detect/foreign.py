"""What is no contact whatever its brightness: bars, hairs and scratches.

A contact is a disk, and contacts that touch are a union of disks. A bar is longer than any group of its half
width, and its pixels lie half as far from its rim as those of a disk. It is masked before contrast and
contacts are learned. Hot pixels and lines one pixel wide are gone by then
(`contactimg.imaging.pixels.field_of_view.repair_defects`).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.imaging.detect.components import label_components
from contactimg.imaging.pixels.blocks import block_means
from contactimg.imaging.pixels.masks import Mask
from contactimg.tables import Reason

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
SIDE = 2
"""Side of the squares whose means are labelled, px."""
LEVEL_FRACTION = 0.3
"""Level, as a fraction of the contrast, above which objects are looked for. By hand: a blurred hair does not
reach half of the contrast along its whole length."""
SEEN_SIGMA = 6.0
"""Height of a pixel, or of a square, over its noise above which it is an object. False-alarm rate 1e-9."""
SPRAWL = 4.0
"""Squared diagonal of the bounding box over the area above which a region is no disk and no pair of disks.
Theory: 2.5 for a disk, 3.2 for two that touch."""
MARGIN = 3
"""Squares around an object that are masked with it: its blurred rim. By hand: four blur widths of 1.5 px."""


@dataclass(frozen=True, eq=False)
class Foreign:
    """Objects that are no contacts.

    Parameters
    ----------
    rejected : dict of arrays
        x_px, y_px, radius_px (of the disk of equal area), reason.
    mask : Mask
        1 on the objects and their blurred rims; None where there is none.
    """

    rejected: dict[str, NDArray]
    mask: Mask


def find_foreign(image: NDArray[np.float32], plateau: float, noise: float, valid: Mask = None) -> Foreign:
    """Objects of a difference image that are no contacts.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Contacts positive.
    plateau : float
        Contrast of the contacts.
    noise : float
        Standard deviation of a background pixel.
    valid : Mask
        0 for pixels without a value.

    Examples
    --------
    >>> y, x = np.mgrid[0:80, 0:120]
    >>> bar, disk = np.abs(x - 100) < 6, np.hypot(x - 40, y - 40) < 18
    >>> found = find_foreign((bar | disk).astype(np.float32), 1.0, 0.0)
    >>> found.rejected["reason"].tolist(), found.rejected["x_px"].tolist(), int(found.mask[40, 40])
    (['long: neither a disk nor a group of disks'], [99.5], 0)
    """
    level = max(LEVEL_FRACTION * plateau, SEEN_SIGMA * noise / SIDE)
    squares = np.nan_to_num(block_means(image, valid, side=SIDE), copy=False)
    components = label_components(squares, level)
    if not _may_be_long(components).any():
        return NONE
    regions = label_regions(squares, level)
    bad = np.flatnonzero(regions.long)
    if not len(bad):
        return NONE
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * MARGIN + 1, 2 * MARGIN + 1))
    mask = cv2.dilate(np.isin(regions.labels, bad).astype(np.uint8), around)
    wide = mask.repeat(SIDE, axis=0).repeat(SIDE, axis=1)[: image.shape[0], : image.shape[1]]
    middle = 0.5 * (SIDE - 1)
    return Foreign(
        {
            "x_px": SIDE * regions.x[bad] + middle,
            "y_px": SIDE * regions.y[bad] + middle,
            "radius_px": SIDE * np.sqrt(regions.area[bad] / np.pi),
            "reason": np.full(len(bad), Reason.LONG.value, object),
        },
        np.ascontiguousarray(wide),
    )


def _squared_diagonal(components: NDArray[np.void]) -> NDArray[np.float64]:
    """Squared diagonal of the bounding boxes."""
    width = components["right"] - components["left"] + 1.0
    height = components["bottom"] - components["top"] + 1.0
    return np.asarray(width**2 + height**2)


def _sprawls(components: NDArray[np.void]) -> NDArray[np.bool_]:
    """The components that are no disk and no pair of disks."""
    return np.asarray(_squared_diagonal(components) > SPRAWL * components["area"])


def _may_be_long(components: NDArray[np.void]) -> NDArray[np.bool_]:
    """The components that may be long: a quick check that clears most frames."""
    shortest = LENGTH_HALF_WIDTHS * (0.5 + LENGTH_MARGIN_PX)
    return _sprawls(components) & (_squared_diagonal(components) > shortest**2)


NONE = Foreign({name: np.empty(0) for name in ("x_px", "y_px", "radius_px", "reason")}, None)
"""Every object may be a contact."""


@dataclass(frozen=True, eq=False)
class LabelledRegions:
    """Regions above a level, with the measures that tell contacts from other things.

    Parameters
    ----------
    labels : ndarray of int32, shape (rows, columns)
        Number of the region of each pixel, from 0; -1 outside.
    area : ndarray, shape (n,), px^2
    long : ndarray of bool, shape (n,)
        Whether the region is a bar or hair rather than a disk or a group of disks.
    half_width : ndarray, shape (n,), px
        Radius of the largest disk inside.
    x, y : ndarray, shape (n,), px
        Centroids.
    """

    labels: NDArray[np.int32]
    area: NDArray[np.float64]
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
    widest, mean = _inside(labels, np.minimum(distance, max(image.shape)), count)
    area = stats[:, cv2.CC_STAT_AREA].astype(float)
    # distances end at the first pixel outside, on average half a pixel beyond the rim
    half = np.maximum(widest - 0.5, 0.5)
    length = np.hypot(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT])
    bar = (mean - 0.5 > BAR_DISTANCE_RATIO * half) | (half < THIN_HALF_WIDTH_PX)
    long = bar & (area > BAR_AREA_DISKS * np.pi * half**2)
    long &= length > LENGTH_HALF_WIDTHS * (half + LENGTH_MARGIN_PX)
    x, y = np.asarray(centroids, float)[1:].T
    return LabelledRegions(np.asarray(labels, np.int32) - np.int32(1), area[1:], long[1:], half[1:], x, y)


@njit(cache=True)
def _inside(labels, distance, count):
    """Largest and mean distance to the rim of each label but 0."""
    widest, total, pixels = np.zeros(count), np.zeros(count), np.zeros(count)
    for row in range(labels.shape[0]):
        for column in range(labels.shape[1]):
            label = labels[row, column]
            if label:
                pixels[label] += 1.0
                total[label] += distance[row, column]
                widest[label] = max(widest[label], distance[row, column])
    return widest, total / np.maximum(pixels, 1.0)
