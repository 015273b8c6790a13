"""Foreign objects: bars, hairs, scratches, bubbles, hot pixels, and grains brighter than the contacts.

A contact is a disk, and contacts that touch are a union of disks. In a union of disks most pixels lie near
the rim: their mean distance from it is a third of the largest, whereas along a bar of constant width it is
half. And all contacts of a frame are about equally bright.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from contactimg.imaging.background.difference_image import DifferenceImage
from contactimg.imaging.contrast.plateau import BRIGHTER_RATIO
from contactimg.imaging.pixels.binned_image import BinnedImage
from contactimg.imaging.pixels.frame_pair import Levels
from contactimg.imaging.pixels.masks import Mask
from contactimg.imaging.pixels.robust import robust_std
from contactimg.imaging.reject.detections import Columns
from contactimg.imaging.reject.reference_dust import find_reference_dust
from contactimg.imaging.detect.components import label_components
from contactimg.imaging.shapes.labelled_regions import (
    LENGTH_HALF_WIDTHS,
    LENGTH_MARGIN_PX,
    LabelledRegions,
    label_regions,
)
from contactimg.tables import Reason

LEVEL_FRACTION = 0.3
"""Level, as a fraction of the contrast, above which objects are looked for: a blurred hair does not reach
half the contrast along its whole length. Chosen by hand; sensitivity not measured."""
SPRAWL = 4.0
"""Squared diagonal of the bounding box over the area above which a region is no disk and no pair of disks.
Theory: 2.5 for a disk, 3.2 for two that touch."""
STREAK_HALF_WIDTH_PX = 1.0
"""Largest half width of a hot pixel or streak, binned px."""
HOT_NEIGHBOUR_FRACTION = 0.25
"""Brightness of the pixels on both sides relative to the highest pixel below which it is sharper than the
optics. Theory: ``exp(-1/(2 s^2))`` for a point behind a blur of 0.53 px, ``s^2 = 0.53^2 + 1/12``."""
FLAT_TOP_RATIO = np.float32(0.9)
"""Of the highest pixel, above which one is as high. Chosen: noise of a tenth of the contrast."""
FLAT_TOP_LEVELS = np.float32(2.0)
"""Height over the level at which objects are looked for, from which a contact may have a flat top: 0.6 of the
contrast. Chosen."""
FEW_PIXELS = 4
"""Binned pixels: a region of more is not a hot pixel, and so many bright ones make an object too bright."""
BRIGHT_AREA_FRACTION = 0.1
"""Fraction of its area that must be too bright, at least, for an object to be rejected. Chosen by hand."""
SPREAD_SIGMA, FEWEST_PEAKS = 3.0, 50
"""Standard deviations of the logarithm of the brightness beyond which an object is too bright, and objects
that give it. False-alarm rate 1e-3 (theory: normal deviates); theory: fifty give it to a tenth."""
MASK_MARGIN = 3
"""Binned pixels around an object that are masked with it: its blurred rim."""
BIN_PX = 2
"""Pixels that a binned pixel stands for, each way, where the highest pixel is looked for."""


@dataclass(frozen=True, eq=False)
class ForeignObjects:
    """Objects that are not contacts.

    Parameters
    ----------
    rejected : dict of arrays
        x_px, y_px, radius_px (of the disk of equal area), reason.
    mask : Mask
        1 on the objects and their blurred rims.
    """

    rejected: Columns
    mask: Mask


def find_foreign_objects(
    image: NDArray[np.float32],
    binned: BinnedImage,
    plateau: float,
    *,
    frame: Levels,
    difference: DifferenceImage,
) -> ForeignObjects:
    """Objects of a difference image that are not contacts.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Difference image, contacts positive, holes 0.
    binned : BinnedImage
        The same, binned.
    plateau : float
        Contrast of the contacts.
    frame : ndarray, shape (rows, columns)
        The frame itself.
    difference : DifferenceImage
        From which the image comes.
    """
    small = binned.image
    scale = np.array([image.shape[1] / small.shape[1], image.shape[0] / small.shape[0]])
    components = label_components(small, LEVEL_FRACTION * plateau)
    if not len(components):
        return NO_FOREIGN_OBJECTS
    disks = _equal_disks(scale, components["x"], components["y"], components["area"])
    dust = find_reference_dust(frame, image, difference, disks)
    sharp = _are_too_sharp(image, components, scale, plateau)
    too_bright = _too_bright_ratio(components) * plateau
    if not (dust.any() or sharp.any() or _any_suspicious(components, too_bright)):
        return NO_FOREIGN_OBJECTS
    regions = label_regions(small, LEVEL_FRACTION * plateau)
    number = regions.labels[components["peak_y"], components["peak_x"]]
    bright_pixels = regions.labels[small > too_bright]
    bright = np.bincount(bright_pixels, minlength=len(regions.area)) > np.maximum(
        FEW_PIXELS, BRIGHT_AREA_FRACTION * regions.area
    )
    conditions = {
        Reason.REFERENCE_DUST: _among(number[dust], regions),
        Reason.TOO_SHARP: _among(number[sharp], regions) & (regions.half_width <= STREAK_HALF_WIDTH_PX),
        Reason.TOO_BRIGHT: bright,
        Reason.LONG: regions.long,
    }
    reasons = np.select(list(conditions.values()), list(conditions), "")
    bad = np.flatnonzero(reasons != "")
    if not len(bad):
        return NO_FOREIGN_OBJECTS
    mask = np.isin(regions.labels, bad).astype(np.uint8)
    window = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * MASK_MARGIN + 1, 2 * MASK_MARGIN + 1))
    wide = cv2.resize(cv2.dilate(mask, window), image.shape[::-1], interpolation=cv2.INTER_NEAREST)
    disks = _equal_disks(scale, regions.x[bad], regions.y[bad], regions.area[bad])
    return ForeignObjects(_rejected(disks, reasons[bad]), np.asarray(wide, np.uint8))


def _equal_disks(scale: NDArray, x: NDArray, y: NDArray, area: NDArray) -> NDArray[np.float64]:
    """x, y and radius of the disk of equal area in px of the image, from binned ones."""
    places = np.column_stack([x, y]) * scale + (scale - 1) / 2
    return np.column_stack([places, np.sqrt(area * scale.prod() / np.pi)])


def _among(numbers: NDArray[np.int32], regions: LabelledRegions) -> NDArray[np.bool_]:
    """Mask of the regions with these numbers."""
    out = np.zeros(len(regions.area), np.bool_)
    out[numbers] = True
    return out


def _are_too_sharp(
    image: NDArray[np.float32], components: NDArray[np.void], scale: NDArray, plateau: float
) -> NDArray[np.bool_]:
    """Components whose highest pixel stands far above both its sides: hot pixels, cosmic-ray streaks."""
    out = np.zeros(len(components), np.bool_)
    # a hot pixel on a contact does not make the contact foreign: look at small and sprawling components only
    narrow = np.flatnonzero((components["area"] <= FEW_PIXELS) | _sprawl(components))
    x = (components["peak_x"][narrow] * scale[0]).astype(int)
    y = (components["peak_y"][narrow] * scale[1]).astype(int)
    out[narrow] = _stand_alone(image, x, y, np.float32(LEVEL_FRACTION * plateau))
    return out


@njit(cache=True)
def _stand_alone(image, x, y, level):
    """Whether the highest pixels near each place are above a level and far above the pixels on two sides.

    All that are about as high: one at the tip of a flat top stands alone, those inside do not.
    """
    rows, columns = image.shape
    out = np.zeros(len(x), np.bool_)
    for n in range(len(x)):
        top, bottom = max(y[n] - 1, 0), min(y[n] + BIN_PX + 1, rows)
        left, right = max(x[n] - 1, 0), min(x[n] + BIN_PX + 1, columns)
        highest = np.float32(-np.inf)
        for j in range(top, bottom):
            for i in range(left, right):
                highest = max(highest, image[j, i])
        out[n] = highest > level
        equal = FLAT_TOP_RATIO * highest if highest > FLAT_TOP_LEVELS * level else highest
        for j in range(top, bottom):
            for i in range(left, right):
                if image[j, i] >= equal:
                    out[n] &= _is_alone(image, j, i)
    return out


@njit(cache=True)
def _is_alone(image, row, column):
    """Whether a pixel is far above those on two opposite sides."""
    rows, columns = image.shape
    alone = False
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        before = image[max(row - dy, 0), min(max(column - dx, 0), columns - 1)]
        after = image[min(row + dy, rows - 1), min(max(column + dx, 0), columns - 1)]
        alone |= max(before, after) < HOT_NEIGHBOUR_FRACTION * image[row, column]
    return alone


def _too_bright_ratio(components: NDArray[np.void]) -> float:
    """Brightness over the plateau beyond which an object is none of many that differ in brightness anyway."""
    peaks = components["peak"][components["area"] > FEW_PIXELS]
    if len(peaks) < FEWEST_PEAKS:
        return BRIGHTER_RATIO
    return max(BRIGHTER_RATIO, float(np.exp(SPREAD_SIGMA * robust_std(np.log(peaks)))))


def _any_suspicious(components: NDArray[np.void], too_bright: float) -> bool:
    """Whether a component may be long or is too bright: a quick check that clears most frames."""
    shortest = LENGTH_HALF_WIDTHS * (0.5 + LENGTH_MARGIN_PX)
    extended = components[_squared_diagonal(components) > shortest**2]
    return bool(_sprawl(extended).any()) or bool((components["peak"] > too_bright).any())


def _squared_diagonal(components: NDArray[np.void]) -> NDArray[np.float64]:
    """Squared diagonal of the bounding boxes, px^2."""
    width = components["right"] - components["left"] + 1.0
    height = components["bottom"] - components["top"] + 1.0
    return np.asarray(width**2 + height**2)


def _sprawl(components: NDArray[np.void]) -> NDArray[np.bool_]:
    """Which components are no disk and no pair of disks."""
    large = components["area"] > FEW_PIXELS
    return np.asarray((_squared_diagonal(components) > SPRAWL * components["area"]) & large)


def _rejected(disks: NDArray[np.float64], reasons: NDArray[np.str_]) -> Columns:
    """Table of rejected candidates."""
    return {"x_px": disks[:, 0], "y_px": disks[:, 1], "radius_px": disks[:, 2], "reason": reasons}


NO_FOREIGN_OBJECTS = ForeignObjects(_rejected(np.empty((0, 3)), np.empty(0, np.str_)), None)
"""Every object may be a contact."""
