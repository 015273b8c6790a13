"""What stands out of a frame and is no contact: bars, hairs, scratches, bubbles, grains of other brightness.

A contact is a disk, and contacts that touch are a union of disks. In a union of disks most pixels lie near
the rim: the mean of their distance from it is a third of the largest, whereas along a bar of constant width
it is half. And all contacts of a frame are about equally bright.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from contactimg.imaging.background.difference_image import DifferenceImage
from contactimg.imaging.contrast.plateau import BRIGHTER
from contactimg.imaging.pixels.binned_image import BinnedImage
from contactimg.imaging.pixels.frame_pair import Levels
from contactimg.imaging.pixels.masks import Mask
from contactimg.imaging.reject.dirt import absent_in_frame
from contactimg.imaging.shapes.components import label_components
from contactimg.imaging.shapes.objects import LENGTH, SHORT, Objects, find_objects
from contactimg.tables import Reason

SPRAWLING = 4.0  # squared diagonal of the bounding box over the area: 2.5 for a disk, 3.2 for two that touch
NARROW = 1.0  # px: half width of a streak
SKIRT = 3  # coarse pixels of blur about an object
LEVEL = 0.3  # of the contrast: blurred hairs do not reach half of it all along
COARSE = 2  # px
HOT = 0.25  # of the highest pixel: no optics let its neighbours on both sides be darker
REASONS = [Reason.REFERENCE_DUST, Reason.TOO_SHARP, Reason.TOO_BRIGHT, Reason.LONG]
BRIGHT_PIXELS = 4  # coarse pixels


@dataclass(frozen=True, eq=False)
class ForeignObjects:
    """Objects that are no contacts.

    Parameters
    ----------
    rejected : dict of arrays
        x_px, y_px, radius_px (of the disk of equal area), reason.
    mask : Mask
        1 on them and their blurred rims.
    """

    rejected: dict[str, NDArray]
    mask: Mask


def find_foreign_objects(
    image: NDArray[np.float32],
    coarse: BinnedImage,
    plateau: float,
    *,
    frame: Levels,
    difference: DifferenceImage,
) -> ForeignObjects:
    """Objects of a difference image that are no contacts.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Difference image, contacts positive, holes 0.
    coarse : BinnedImage
        The same.
    plateau : float
        Contrast of the contacts.
    frame : ndarray, shape (rows, columns)
        The frame itself.
    difference : DifferenceImage
        Where the image comes from.
    """
    small = coarse.image
    scale = np.array([image.shape[1] / small.shape[1], image.shape[0] / small.shape[0]])
    regions = label_components(small, LEVEL * plateau)
    if not len(regions):
        return NO_FOREIGN_OBJECTS
    disks = _full(scale, regions["x"], regions["y"], regions["area"])
    absent = absent_in_frame(frame, image, difference, disks)
    sharp = _too_sharp(image, regions, scale, plateau)
    if not (absent.any() or sharp.any() or _suspicious(regions, plateau)):
        return NO_FOREIGN_OBJECTS
    found = find_objects(small, LEVEL * plateau)
    number = found.labels[regions["peak_y"], regions["peak_x"]]
    bright = np.bincount(found.labels[small > BRIGHTER * plateau], minlength=len(found.area)) > np.maximum(
        BRIGHT_PIXELS, 0.1 * found.area
    )
    thin = found.half_width <= NARROW
    conditions = [_among(number[absent], found), _among(number[sharp], found) & thin, bright, found.long]
    reasons = np.select(conditions, REASONS, "")
    bad = np.flatnonzero(reasons != "")
    if not len(bad):
        return NO_FOREIGN_OBJECTS
    mask = np.isin(found.labels, bad).astype(np.uint8)
    mask = cv2.dilate(mask, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * SKIRT + 1, 2 * SKIRT + 1)))
    mask = cv2.resize(mask, image.shape[::-1], interpolation=cv2.INTER_NEAREST)
    places = _full(scale, found.x[bad], found.y[bad], found.area[bad])
    return ForeignObjects(_rows(places, reasons[bad]), np.asarray(mask))


def _full(scale: NDArray, x: NDArray, y: NDArray, area: NDArray) -> NDArray[np.float64]:
    """x, y, radius of equal area in pixels of the image, from coarse ones."""
    places = np.column_stack([x, y]) * scale + (scale - 1) / 2
    return np.column_stack([places, np.sqrt(area * scale.prod() / np.pi)])


def _among(numbers: NDArray[np.int32], found: Objects) -> NDArray[np.bool_]:
    """Which objects have one of some numbers."""
    out = np.zeros(len(found.area), np.bool_)
    out[numbers] = True
    return out


def _too_sharp(
    image: NDArray[np.float32], regions: NDArray[np.void], scale: NDArray, plateau: float
) -> NDArray[np.bool_]:
    """Regions whose highest pixel stands far above both its sides: hot pixels, cosmic streaks."""
    out = np.zeros(len(regions), np.bool_)
    # a contact is not one the less for a hot pixel on it
    narrow = np.flatnonzero((regions["area"] <= BRIGHT_PIXELS) | _sprawling(regions))
    x = (regions["peak_x"][narrow] * scale[0]).astype(int)
    y = (regions["peak_y"][narrow] * scale[1]).astype(int)
    out[narrow] = _stand_alone(image, x, y, np.float32(LEVEL * plateau))
    return out


@njit(cache=True)
def _stand_alone(image, x, y, level):
    """Whether the highest pixel near each place is above a level and far above its two sides."""
    rows, columns = image.shape
    out = np.zeros(len(x), np.bool_)
    for n in range(len(x)):
        value, row, column = np.float32(-np.inf), 0, 0
        for j in range(max(y[n] - 1, 0), min(y[n] + COARSE + 1, rows)):
            for i in range(max(x[n] - 1, 0), min(x[n] + COARSE + 1, columns)):
                if image[j, i] > value:
                    value, row, column = image[j, i], j, i
        if not value > level:
            continue
        for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
            before = image[max(row - dy, 0), min(max(column - dx, 0), columns - 1)]
            after = image[min(row + dy, rows - 1), min(max(column + dx, 0), columns - 1)]
            out[n] |= max(before, after) < HOT * value
    return out


def _suspicious(regions: NDArray[np.void], plateau: float) -> bool:
    """Whether a region may be long or is too bright: the quick look that most frames end with."""
    extended = regions[_square(regions) > (LENGTH * (0.5 + SHORT)) ** 2]
    return bool(_sprawling(extended).any()) or bool((regions["peak"] > BRIGHTER * plateau).any())


def _square(regions: NDArray[np.void]) -> NDArray[np.float64]:
    """Squared diagonal of the bounding boxes."""
    wide, high = regions["right"] - regions["left"] + 1.0, regions["bottom"] - regions["top"] + 1.0
    return np.asarray(wide**2 + high**2)


def _sprawling(regions: NDArray[np.void]) -> NDArray[np.bool_]:
    """Regions that are no disk and no pair of disks."""
    return np.asarray((_square(regions) > SPRAWLING * regions["area"]) & (regions["area"] > BRIGHT_PIXELS))


def _rows(places: NDArray[np.float64], reasons: NDArray[np.str_]) -> dict[str, NDArray]:
    return {"x_px": places[:, 0], "y_px": places[:, 1], "radius_px": places[:, 2], "reason": reasons}


NO_FOREIGN_OBJECTS = ForeignObjects(_rows(np.empty((0, 3)), np.empty(0, np.str_)), None)
"""Every object may be a contact."""
