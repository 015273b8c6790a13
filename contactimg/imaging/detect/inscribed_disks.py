"""Candidates for contacts: disks inscribed in the regions above half height.

They include every contact that reaches half height, and both of two that touch. A disk with a radius below
1.18 blur widths does not reach it; such contacts are found as peaks of the residuals
(`contactimg.imaging.detect.peaks`).
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit

SMALLEST_INSCRIBED = 2.0
"""Least radius of a disk inscribed in a region, px: below, noise at the rim makes as large ones. By hand."""
SMALLEST_ROUND = 1.6
"""Least radius of a region that is round by itself, px. Chosen by hand."""
ROUND_MOMENT_EXCESS = 0.01
"""A region is round if its second moment exceeds that of a disk by less than this plus ``1/area`` (the part
of the pixels themselves), ..."""
ROUND_WIDTH_EXCESS_PX = 1.7
"""... and its sides exceed the diameter by less than this. Both chosen by hand; sensitivity not measured."""
LARGEST_HOLE_SHARE = 0.02
"""Area of a hole over that of the largest disk inscribed beside it up to which it is filled. By hand:
mottling. Theory: 0.05 for the gap between three equal disks that touch."""
ONE_SHAPE_LACK = 0.03
"""Share of its area that a region lacks against the ellipse of its second moments, below which it is one
contact. Theory: 0.105 for two equal disks that touch, 0.05 for one beside one of 0.3 of its radius, 0 for any
ellipse."""
CONVEX_SHARE, CONVEX_LACK = 0.955, 0.2
"""Share of its convex hull from which a region is convex, and lack of such a region that is one contact.
Theory: 0.94 for two equal disks that overlap by a fifth of their radius; a square lacks 0.045, a
triangle 0.17. By hand: pixels
and noise make 0.97."""
LARGEST_WHOLE_HOLES, LEAST_WHOLE_PX2 = 0.5, 24
"""Holes over the area of a region that may be one contact, and its least area (px^2). By hand: pixels make
smaller regions look like anything."""
PENETRATION = 0.7
"""Fraction of its radius inside a larger disk above which a disk is part of the larger one's rim. By hand."""
CELL_PX = 32.0
"""Side of the cells in which neighbours are looked up; it affects the time alone."""


def is_round(regions: NDArray[np.void], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Whether each region is a disk by its second moment and its sides, and not cut by the border.

    A disk has the least second moment of all regions of its area: ``area^2/(2 pi)``.
    """
    radius = np.sqrt(regions["area"] / np.pi)
    longest = np.maximum(regions["right"] - regions["left"], regions["bottom"] - regions["top"]) + 1
    cut = (
        (regions["left"] == 0) | (regions["right"] == shape[1] - 1)
        | (regions["top"] == 0) | (regions["bottom"] == shape[0] - 1)
    )  # fmt: skip
    excess = 2.0 * np.pi * regions["moment"] / np.maximum(regions["area"], 1) ** 2.0 - 1.0
    return (
        ~cut
        & (radius > SMALLEST_ROUND)
        & (excess < ROUND_MOMENT_EXCESS + 1.0 / np.maximum(regions["area"], 1))
        & (longest < 2.0 * radius + ROUND_WIDTH_EXCESS_PX)
    )


def disks_in_region(
    region: np.void, image: NDArray[np.float32], level: float
) -> tuple[NDArray[np.float64], bool]:
    """Disks inscribed in one region above a level, and whether it is one ellipse as a whole.

    Holes that are small against the region, which noise or mottling makes, are filled. A region that is an
    ellipse, or nearly one and convex, when all its holes are is one contact, the disk of its area.
    """
    top, bottom, left, right = (int(region[name]) for name in ("top", "bottom", "left", "right"))
    above = (image[top : bottom + 1, left : right + 1] > level).astype(np.uint8)
    labels = cv2.connectedComponents(above, connectivity=8)[1]
    own = (labels == labels[region["peak_y"] - top, region["peak_x"] - left]).astype(np.uint8)
    cut = (top == 0, bottom == image.shape[0] - 1, left == 0, right == image.shape[1] - 1)
    corner = np.array([left, top, 0.0])
    if not any(cut):
        whole = own.copy()
        fill_small_holes(whole, LARGEST_WHOLE_HOLES * float(region["area"]))
        disk = as_one_contact(whole, own)
        if disk is not None:
            return disk + corner, True
    widest = float(cv2.distanceTransform(np.pad(own, 1), cv2.DIST_L2, cv2.DIST_MASK_5).max())
    fill_small_holes(own, LARGEST_HOLE_SHARE * np.pi * widest**2)
    disks = _inscribed(own, cut)
    if not len(disks):
        disks = np.array([[region["x"] - left, region["y"] - top, np.sqrt(region["area"] / np.pi)]])
    return disks + corner, False


def as_one_contact(
    mask: NDArray[np.uint8], bare: NDArray[np.uint8], convex: float = CONVEX_SHARE
) -> NDArray[np.float64] | None:
    """The disk of equal area of a region that is an ellipse, or nearly one and convex; else None.

    ``bare`` is the region with its holes: many of them are the gaps of a packing.
    """
    moments = cv2.moments(mask, binaryImage=True)
    area = moments["m00"]
    if area <= LEAST_WHOLE_PX2:
        return None
    spread = (moments["mu20"] / area + 1 / 12) * (moments["mu02"] / area + 1 / 12) - (
        moments["mu11"] / area
    ) ** 2
    lack = 1.0 - area / (4.0 * np.pi * np.sqrt(max(spread, 1e-9)))
    if lack > CONVEX_LACK or (lack > ONE_SHAPE_LACK and _share_of_hull(mask, float(bare.sum())) < convex):
        return None
    return np.array([[moments["m10"] / area, moments["m01"] / area, np.sqrt(area / np.pi)]])


def _share_of_hull(mask: NDArray[np.uint8], area: float) -> float:
    """An area over the number of pixels in the convex hull of a region."""
    outlines = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    hull = np.zeros_like(mask)
    cv2.fillConvexPoly(hull, cv2.convexHull(np.vstack(outlines)), 1)
    return float(area / np.count_nonzero(hull))


def fill_small_holes(mask: NDArray[np.uint8], largest: float) -> None:
    """Fill the holes of a region up to an area, in place."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(1 - mask, connectivity=4)
    rows, columns = mask.shape
    for k in range(1, count):
        x, y, width, height, area = stats[k]
        inside = x > 0 and y > 0 and x + width < columns and y + height < rows
        if inside and area <= largest:
            mask[labels == k] = 1


def _inscribed(mask: NDArray[np.uint8], cut: tuple[bool, bool, bool, bool]) -> NDArray[np.float64]:
    """Disks inscribed in a mask, largest first; ``cut`` marks the sides beyond which the mask continues."""
    # a contact cut by the border continues: repeat the border instead of closing it
    closed = cv2.copyMakeBorder(mask, 1, 1, 1, 1, cv2.BORDER_CONSTANT)
    for side, rim, inside in zip(cut, _rims(closed, 0), _rims(closed, 1), strict=True):
        if side:
            rim[:] = inside
    if closed.all():
        return np.empty((0, 3))  # nothing bounds a disk
    distance = cv2.distanceTransform(closed, cv2.DIST_L2, cv2.DIST_MASK_5)[1:-1, 1:-1]
    return select_inscribed(distance)


def _rims(array: NDArray, depth: int) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Rows and columns so far inside the four sides of an array."""
    return array[depth], array[-1 - depth], array[:, depth], array[:, -1 - depth]


@njit(cache=True)
def select_inscribed(distance):
    """Disks (x, y, radius) from the distances of pixels to the rim, largest first."""
    summits = _summits(distance, SMALLEST_INSCRIBED)
    return _select(summits[np.argsort(-summits[:, 2], kind="mergesort")])


@njit(cache=True)
def _summits(distance, smallest):
    """Local maxima (x, y, value) of the distance transform."""
    rows, columns = distance.shape
    out = np.empty((1024, 3))
    count = 0
    for y in range(rows):
        for x in range(columns):
            d = distance[y, x]
            if d < smallest:
                continue
            top = True
            for j in range(max(y - 1, 0), min(y + 2, rows)):
                for i in range(max(x - 1, 0), min(x + 2, columns)):
                    if distance[j, i] > d:
                        top = False
                        break
                if not top:
                    break
            if not top:
                continue
            if count == len(out):
                grown = np.empty((2 * count, 3))
                grown[:count] = out
                out = grown
            # distances end at the centre of the first pixel outside, on average 0.4 px beyond the rim
            out[count, 0], out[count, 1], out[count, 2] = x, y, d
            count += 1
    return out[:count]


@njit(cache=True)
def _select(summits):
    """Choose disks that do not lie inside one another, largest first, in linear time by a grid of cells."""
    n = len(summits)
    kept = np.empty((n, 3))
    if n == 0:
        return kept
    wide = int(summits[:, 0].max() // CELL_PX) + 1
    high = int(summits[:, 1].max() // CELL_PX) + 1
    head = np.full((high, wide), -1, np.int64)
    capacity = 4 * n + 64
    follow, owner = np.empty(capacity, np.int64), np.empty(capacity, np.int64)
    count = links = 0
    for k in range(n):
        x, y, r = summits[k]
        free = True
        q = head[int(y // CELL_PX), int(x // CELL_PX)]
        while q >= 0:
            other = kept[owner[q]]
            dx, dy = x - other[0], y - other[1]
            limit = other[2] + (1.0 - PENETRATION) * r
            if dx * dx + dy * dy < limit * limit:
                free = False
                break
            q = follow[q]
        if not free:
            continue
        kept[count] = summits[k]
        # later disks are no larger, so this one matters to centres within its radius plus a part of it
        reach = (2.0 - PENETRATION) * r
        for j in range(max(int((y - reach) // CELL_PX), 0), min(int((y + reach) // CELL_PX) + 1, high)):
            for i in range(max(int((x - reach) // CELL_PX), 0), min(int((x + reach) // CELL_PX) + 1, wide)):
                if links == capacity:
                    follow = np.append(follow, np.empty(capacity, np.int64))
                    owner = np.append(owner, np.empty(capacity, np.int64))
                    capacity *= 2
                follow[links], owner[links] = head[j, i], count
                head[j, i] = links
                links += 1
        count += 1
    return kept[:count]
