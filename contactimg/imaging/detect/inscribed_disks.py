"""Candidates for contacts: disks inscribed in the regions above half height.

They include every contact that reaches half height, and both of two that touch. A disk with a radius below
1.18 blur widths does not reach it; such contacts are found as peaks of the residuals
(`contactimg.imaging.detect.peaks`).
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.imaging.detect.components import mask_of_component, sides_cut, window_of

SMALLEST_INSCRIBED = 2.0
"""Least radius of a disk inscribed in a region, px: below, noise at the rim makes as large ones, and a
contact is mostly rim. By hand."""
SMALLEST_PAIR_PX2 = 2.0 * np.pi * SMALLEST_INSCRIBED**2
"""Area of two such disks, below which a region has no shape (theory)."""
LARGEST_HOLE_SHARE = 0.02
"""Area of a hole over that of the largest disk inscribed beside it up to which it is filled. By hand:
mottling. Theory: 0.05 for the gap between three equal disks that touch."""
CONVEX_SHARE = 0.955
"""Share of its convex hull from which a region is convex. Theory: 0.94 for two equal disks that overlap by a
fifth of their radius; by hand: pixels and noise make 0.97. Convex ones lack no more than a triangle, 0.17."""
LEAST_CONVEX = 0.92
"""Share of its convex hull of a region that no disks describe, from which it is one contact. By hand: pixels
make 0.94 of a triangle of 30 px."""
LARGEST_WHOLE_HOLES = 0.5
"""Holes over the area of a region that may be one contact. By hand."""


def is_round(regions: NDArray[np.void], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Whether each region is one disk by its second moment, or too small to be anything else.

    A disk has the least second moment of all regions of its area: ``area^2/(2 pi)``. One that the border cuts
    is not round.
    """
    area = np.maximum(regions["area"], 1)
    excess = 2.0 * np.pi * regions["moment"] / area**2.0 - 1.0
    # By hand; theory: 0.03 for a disk beside one of a fifth of its radius, 1/area for the pixels.
    round_ones = excess < 0.01 + 1.0 / area
    # around the centre of an inscribed disk there is a whole square of pixels
    small = area < (2.0 * SMALLEST_INSCRIBED - 1.0) ** 2
    return ~np.any(sides_cut(regions, shape), axis=0) & (round_ones | small)


def disks_in_region(
    region: np.void, number: int | np.integer, runs: NDArray[np.int64], shape: tuple[int, ...]
) -> tuple[NDArray[np.float64], bool]:
    """Disks inscribed in a region, and whether it is one ellipse as a whole.

    The region is the component of that ``number`` in the ``runs`` of an image of this shape
    (`contactimg.imaging.detect.components.label_runs`).

    Holes that are small against the region, which noise or mottling makes, are filled. A region that is an
    ellipse, or nearly one and convex, when all its holes are is one contact, the disk of its area.
    """
    (rows, columns), corner = window_of(region)
    size = rows.stop - rows.start, columns.stop - columns.start
    own = mask_of_component(runs, number, (rows.start, columns.start), size)
    disks, whole = disks_in_mask(own, sides_cut(region, shape))
    if not len(disks):
        disks = np.array([[region["x"], region["y"], np.sqrt(region["area"] / np.pi)]]) - corner
    return disks + corner, whole


def disks_in_mask(own: NDArray[np.uint8], cut: Sequence[bool | NDArray]) -> tuple[NDArray[np.float64], bool]:
    """Disks inscribed in a mask as `disks_in_region` finds them, and whether it is one ellipse.

    ``cut`` marks the sides beyond which the region continues; no disk may fit into a small one.
    """
    holes = find_holes(own)
    disk = None if any(cut) else as_one_contact(fill(own, holes, LARGEST_WHOLE_HOLES * own.sum()), own)
    if disk is not None:
        return disk, True
    if np.isfinite(holes[1]).any():
        closed = cv2.copyMakeBorder(own, 1, 1, 1, 1, cv2.BORDER_CONSTANT)
        widest = float(cv2.distanceTransform(closed, cv2.DIST_L2, cv2.DIST_MASK_5).max())
        own = fill(own, holes, LARGEST_HOLE_SHARE * np.pi * widest**2)
    return inscribed_in(own, cut), False


def as_one_contact(
    mask: NDArray[np.uint8], bare: NDArray[np.uint8], convex: float = CONVEX_SHARE
) -> NDArray[np.float64] | None:
    """The disk of equal area of a region that is an ellipse, or nearly one and convex; else None.

    ``bare`` is the region with its holes: many of them are the gaps of a packing.
    """
    moments = cv2.moments(mask, binaryImage=True)
    area = moments["m00"]
    if area < SMALLEST_PAIR_PX2:  # pixels make smaller regions look like anything
        return None
    xx, yy, xy = (moments[name] / area for name in ("mu20", "mu02", "mu11"))
    spread = (xx + 1 / 12) * (yy + 1 / 12) - xy**2
    lack = 1.0 - area / (4.0 * np.pi * np.sqrt(max(spread, 1e-9)))
    # Theory: 0 for any ellipse, 0.105 for two equal disks that touch, 0.05 for one beside one of 0.3 of it.
    if lack > 0.03 and share_of_hull(mask, float(bare.sum())) < convex:
        return None
    return np.array([[moments["m10"] / area, moments["m01"] / area, np.sqrt(area / np.pi)]])


def share_of_hull(mask: NDArray[np.uint8], area: float) -> float:
    """An area over the number of pixels in the convex hull of a region."""
    outlines = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]
    hull = np.zeros_like(mask)
    cv2.fillConvexPoly(hull, cv2.convexHull(np.vstack(outlines)), 1)
    return float(area / np.count_nonzero(hull))


def find_holes(mask: NDArray[np.uint8]) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Number of the gap that each pixel belongs to, and area of each gap if it is a hole, else infinite."""
    if len(cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)[0]) == 1:  # most have none
        return np.zeros(mask.shape, np.int32), np.array([np.inf])
    _, labels, stats, _ = cv2.connectedComponentsWithStats(1 - mask, connectivity=4)
    x, y, width, height, area = stats.T
    enclosed = (x > 0) & (y > 0) & (x + width < mask.shape[1]) & (y + height < mask.shape[0])
    enclosed[0] = False  # the mask itself
    return np.asarray(labels, np.int32), np.where(enclosed, area, np.inf)


def fill(
    mask: NDArray[np.uint8], holes: tuple[NDArray[np.int32], NDArray[np.float64]], largest: float
) -> NDArray[np.uint8]:
    """The mask with its holes up to an area filled."""
    labels, areas = holes
    small = areas <= largest
    return mask | small[labels] if small.any() else mask


def inscribed_in(mask: NDArray[np.uint8], cut: Sequence[bool | NDArray]) -> NDArray[np.float64]:
    """Disks (x, y, radius) inscribed in a mask, largest first; none if nothing bounds them.

    ``cut`` marks the sides beyond which the mask continues.
    """
    # a contact cut by the border continues: repeat the border instead of closing it
    closed = np.asarray(cv2.copyMakeBorder(mask, 1, 1, 1, 1, cv2.BORDER_REPLICATE), np.uint8)
    for side, goes_on in zip((closed[0], closed[-1], closed[:, 0], closed[:, -1]), cut, strict=True):
        side[:] = side if goes_on else 0
    if closed.all():
        return np.empty((0, 3))
    distance = cv2.distanceTransform(closed, cv2.DIST_L2, cv2.DIST_MASK_5)[1:-1, 1:-1]
    top = (distance >= SMALLEST_INSCRIBED) & (distance >= cv2.dilate(distance, np.ones((3, 3), np.uint8)))
    y, x = np.nonzero(top)
    # distances end at the centre of the first pixel outside, on average 0.4 px beyond the rim
    summits = np.column_stack([x, y, distance[top]])
    return _select(summits[np.argsort(-summits[:, 2], kind="stable")])


@njit(cache=True)
def _select(summits):
    """Choose disks that do not lie inside one another, largest first."""
    kept, count = np.empty(summits.shape), 0
    for x, y, r in summits:
        for k in range(count):
            dx, dy = x - kept[k, 0], y - kept[k, 1]
            # By hand: a disk that lies to 0.7 of its radius in a larger one is part of that one's rim.
            limit = kept[k, 2] + (1.0 - 0.7) * r
            if dx * dx + dy * dy < limit * limit:
                break
        else:
            kept[count, 0], kept[count, 1], kept[count, 2] = x, y, r
            count += 1
    return kept[:count]
