"""What is no contact whatever its brightness: bars, hairs and scratches.

A contact is a disk, and contacts that touch are a union of disks. A bar is longer than any group of its half
width, and its pixels lie half as far from its rim as those of a disk. A hair or scratch may cross contacts:
it is what is left of a region without its wide parts, many times longer than wide, however it is bent. Both
are masked before contrast and contacts are learned; but where most of what stands out are wide bars, these
are the contacts of ridges. Hot pixels and lines one pixel wide are gone by then
(`contactimg.imaging.pixels.sensor_defects.repair_defects`).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.detect.components import label_components, window_of
from contactimg.imaging.detect.inscribed_disks import fill, find_holes
from contactimg.imaging.detect.peaks import FALSE_ALARM_SIGMA
from contactimg.imaging.detect.rim_blur import DEFAULT_BLUR_PX
from contactimg.imaging.pixels.blocks import SignedImage, to_pixels
from contactimg.imaging.pixels.masks import Mask, Values
from contactimg.imaging.profile.limits import CLEAR_BLUR_WIDTHS, SQUARE_PX
from contactimg.tables import Reason

LINE_WIDTH_PX = 9
"""Width below which a part of a region is thin, at the level of `find_foreign`. By hand: a line of 4 px
behind a blur of 1.5 px."""
SMALLEST_LINE = 15
"""Squares in the diagonal of a region, and in a thin part, of lines: slivers of rims have fewer. By hand."""
MARGIN = round(CLEAR_BLUR_WIDTHS * DEFAULT_BLUR_PX / SQUARE_PX)
"""Squares around an object that are masked with it: its blurred rim."""


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


def find_foreign(seen: SignedImage, plateau: float) -> Foreign:
    """Objects of a difference image that are no contacts.

    Parameters
    ----------
    seen : SignedImage
    plateau : float
        Contrast of the contacts.

    Examples
    --------
    >>> y, x = np.mgrid[0:80, 0:120]
    >>> bar, disk = np.abs(x - 100) < 6, np.hypot(x - 40, y - 40) < 18
    >>> found = find_foreign(SignedImage((bar | disk).astype(np.float32), 0.0), 1.0)
    >>> found.rejected["reason"].tolist(), found.rejected["x_px"].tolist(), int(found.mask[40, 40])
    (['long: neither a disk nor a group of disks'], [99.5], 0)
    """
    image, (squares, _) = seen.image, seen.squares(SQUARE_PX)
    # By hand: a blurred hair does not reach half of the contrast along its whole length.
    level = max(0.3 * plateau, FALSE_ALARM_SIGMA * seen.noise / SQUARE_PX)
    components = label_components(squares, level)
    width = components["right"] - components["left"] + 1.0
    diagonal = width**2 + (components["bottom"] - components["top"] + 1.0) ** 2  # squared
    # Theory: the squared diagonal is 2.5 of the area for a disk, 3.2 for two that touch.
    sprawling = components[diagonal > np.maximum(4.0 * components["area"], SMALLEST_LINE**2)]
    total, windows = float(components["area"].sum()), [window_of(one, 2 * MARGIN)[0] for one in sprawling]
    # clusters of contacts sprawl as well: most frames need no more than a look at each of them
    if sum(squares[box].size for box in windows) < squares.size:
        pixels = (tuple(slice(SQUARE_PX * at.start, SQUARE_PX * at.stop) for at in box) for box in windows)
        places = zip(pixels, windows, strict=True)
        looks = (_find(image[pixel], squares[box], level, total) for pixel, box in places)
        if not any(found is not None for found in looks):
            return NONE
    return _find(image, squares, level, total) or NONE


def _find(image: Values, squares: Values, level: float, total: float) -> "Foreign | None":
    """The objects of an image, or of a window of it; None if there is none.

    ``total`` is the area of all that stands out, in squares.
    """
    bars = label_regions(squares > level)
    ridges = bars.long & (bars.half_width > 0.5 * LINE_WIDTH_PX / SQUARE_PX)
    if bars.area[ridges].sum() < 0.5 * total:
        ridges[:] = False
    possible = np.flatnonzero(bars.long & ~ridges)
    long = possible[[_stays_long(squares, bars.labels == k) for k in possible]]
    bar = np.isin(bars.labels, long)
    mask = to_pixels(_widened(bar, MARGIN), image.shape, side=SQUARE_PX)
    lines = _lines(np.where(mask > 0, np.float32(0.0), image), (squares > level) & ~bar, level)
    slender = np.where(lines.area > SQUARE_PX**2 * SMALLEST_LINE, lines.length / lines.half_width, 0.0)
    # Theory: seven contacts in a row make 11. By hand: the rims of contacts with holes make 8, those of pairs
    # and crowds 5, rings of 15 px 12. Contacts cut a line into pieces: where there is one, half is enough.
    line = np.flatnonzero(slender > (5.5 if (slender > 11.0).any() else 11.0))
    smooth = np.asarray(cv2.blur(image, (3, 3)), np.float32) if len(line) else image
    line = line[[_stays_thin(smooth, lines.labels == k) for k in line]]
    if not len(long) + len(line):
        return None
    if len(line):
        mask = np.maximum(mask, _widened(np.isin(lines.labels, line), SQUARE_PX * MARGIN))
    middle = 0.5 * (SQUARE_PX - 1)
    rejected = {
        "x_px": np.append(SQUARE_PX * bars.x[long] + middle, lines.x[line]),
        "y_px": np.append(SQUARE_PX * bars.y[long] + middle, lines.y[line]),
        "radius_px": np.sqrt(np.append(SQUARE_PX**2 * bars.area[long], lines.area[line]) / np.pi),
        "reason": np.full(len(long) + len(line), Reason.LONG.value, object),
    }
    return Foreign(rejected, mask)


def _widened(mask: NDArray[np.bool_], margin: int) -> NDArray[np.uint8]:
    """The pixels of a mask and those up to a margin from them."""
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * margin + 1,) * 2)
    return np.asarray(cv2.dilate(mask.astype(np.uint8), disk), np.uint8)


def _at_own_half(image: NDArray[np.float32], own: NDArray[np.bool_]) -> tuple[NDArray, NDArray[np.bool_]]:
    """Mark the pixels about a region above half of its own height, and those of the region, in one window.

    Noise tears a faint contact at the level of the others, but not there.
    """
    box = tuple(slice(max(int(at.min()) - MARGIN, 0), int(at.max()) + MARGIN + 1) for at in np.nonzero(own))
    return image[box] > 0.5 * float(np.median(image[own])), own[box]


def _stays_long(squares: NDArray[np.float32], own: NDArray[np.bool_]) -> bool:
    """Whether a region is long at half of its own height too."""
    above, own = _at_own_half(squares, own)
    regions = label_regions(above)
    return bool(regions.long[np.argmax(np.bincount(regions.labels[own & above]))])


def _stays_thin(image: NDArray[np.float32], own: NDArray[np.bool_]) -> bool:
    """Whether most of a thin part is thin at half of its own height too."""
    above, own = _at_own_half(image, own)
    return bool(np.mean(_thin_parts(above.astype(np.uint8), LINE_WIDTH_PX)[own]) > 0.5)


def _lines(image: NDArray[np.float32], squares: NDArray[np.bool_], level: float) -> "LabelledRegions":
    """The thin parts of the regions above a level; ``squares`` shows whether there may be lines."""
    thin = _thin_parts(squares.astype(np.uint8), LINE_WIDTH_PX // SQUARE_PX + 1)
    areas = cv2.connectedComponentsWithStats(thin, connectivity=8)[2][1:, cv2.CC_STAT_AREA]
    if not (areas > SMALLEST_LINE).any():
        return label_regions(np.zeros((1, 1), np.bool_))
    above = (cv2.blur(image, (3, 3)) > level).astype(np.uint8)
    above = fill(above, find_holes(above), LINE_WIDTH_PX**2)  # a contact with a hole is no ring of a hair
    return label_regions(_thin_parts(above, LINE_WIDTH_PX) > 0)


def _thin_parts(mask: NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    """The parts of a mask into which no disk of a width fits."""
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    return mask & (1 - np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, disk), np.uint8))


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
    length : ndarray, shape (n,), px
        Along a region of that half width everywhere.
    x, y : ndarray, shape (n,), px
        Centroids.
    """

    labels: NDArray[np.int32]
    area: NDArray[np.float64]
    long: NDArray[np.bool_]
    half_width: NDArray[np.float64]
    length: NDArray[np.float64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]


def label_regions(mask: NDArray[np.bool_]) -> LabelledRegions:
    """Regions of a mask, joined by sides and corners.

    Examples
    --------
    >>> y, x = np.mgrid[0:40, 0:60]
    >>> bar, disk = np.abs(x - 50) < 4, np.hypot(x - 20, y - 20) < 9
    >>> label_regions(bar | disk).long.tolist()
    [True, False]
    """
    pixels = mask.astype(np.uint8)
    count, labels, stats, centroids = cv2.connectedComponentsWithStats(pixels, connectivity=8)
    # the border repeats: a region cut by it goes on beyond
    around = cv2.copyMakeBorder(pixels, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    distance = cv2.distanceTransform(around, cv2.DIST_L2, cv2.DIST_MASK_5)[1:-1, 1:-1]
    area, inside = stats[:, cv2.CC_STAT_AREA].astype(float), labels > 0
    own, distance, widest = (
        np.asarray(labels[inside], np.int64),
        np.minimum(distance[inside], max(mask.shape)),
        np.zeros(count),
    )
    np.maximum.at(widest, own, distance)
    mean = np.bincount(own, distance, minlength=count) / area
    # distances end at the first pixel outside, on average half a pixel beyond the rim
    half = np.maximum(widest - 0.5, 0.5)
    extent = np.hypot(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT])
    # Theory: the mean distance from the rim is 1/3 of the largest for disks and squares, 1/2 for bars.
    # By hand: for regions narrower than 1.6 px, distances in whole pixels are too coarse for the ratio.
    bar = (mean - 0.5 > 0.42 * half) | (half < 1.6)
    long = bar & (extent > 6.0 * (half + 3.0))  # px: longer than a few small contacts that touch. By hand
    x, y = np.asarray(centroids, float)[1:].T
    labels = np.asarray(labels, np.int32) - np.int32(1)
    return LabelledRegions(labels, area[1:], long[1:], half[1:], (0.5 * area / half)[1:], x, y)
