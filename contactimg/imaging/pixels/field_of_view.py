"""Where a frame shows the sample: not outside a field stop, in a black border or in a margin.

All of it is found in the frame, or its reference, alone and left out before anything else is measured.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.pixels.blocks import BLOCK, block_means, to_pixels
from contactimg.imaging.pixels.masks import Flags, Mask
from contactimg.imaging.pixels.robust import median, quantile

# Of the level of the lit blocks: a field stop transmits nothing. Of the image: less light is a contact, not a
# field of view, which falls short of its convex hull by less. By hand.
UNLIT_FRACTION = 0.15
LIT_SHARE = 0.95  # of the blocks that are no brighter than those that are lit in any case. By hand
LEAST_UNLIT_BLOCKS = 12  # of one dark region at the border. By hand: a dark contact of 13 px radius has 8
# Width of a square about an unlit block between which there is light again, and how much of that further
# inside: in vignetted corners there is less. By hand: beside a stop there is 0.93 and more.
STOP_EDGE_BLOCKS, STOP_LIGHT = (5, 7), 0.7
EDGE_REACH_PX = 5  # of the blurred edge of a stop or of a contact: 3.5 blur widths of the usual optics


def find_unlit(image: NDArray, valid: Mask) -> Mask:
    """Pixels (1) that no light reaches: outside a field stop, or in a black border; None if there are none.

    The lit part must be one convex region, as a field of view is: bright contacts on a black background are
    not.
    """
    some = image[BLOCK // 2 :: BLOCK, BLOCK // 2 :: BLOCK]  # each unlit block has one of these pixels
    lit_pixel = quantile(some, LIT_SHARE) if valid is None and some.size else np.inf
    if np.count_nonzero(some < 0.5 * lit_pixel) < LEAST_UNLIT_BLOCKS:
        return None
    means = block_means(image, valid)
    means = np.where(np.isfinite(means), means, 0.0)
    lit_level = quantile(means, LIT_SHARE)
    if not lit_level > 0 or means.min() > UNLIT_FRACTION * lit_level:
        return None
    unlit = _at_border(means < UNLIT_FRACTION * median(means[means > 0.5 * lit_level]))
    if not unlit.any():
        return None
    inner, outer = (cv2.dilate(unlit, np.ones((size, size), np.uint8)) for size in STOP_EDGE_BLOCKS)
    beside, inside = means[outer > inner], means[outer == 0]
    if not (_is_field_of_view(1 - unlit) and inside.size):
        return None
    level = median(inside)  # that of the background, unless contacts cover half of it
    if beside.size and median(beside) < STOP_LIGHT * level:
        return None
    return _pixels_of(unlit, cv2.blur(np.asarray(image, np.float32), (3, 3)) < 0.5 * level, EDGE_REACH_PX)


def find_margin(image: NDArray, valid: Mask, full_scale: float) -> Mask:
    """Pixels (1) of a margin of one level around a convex region, as of a figure on a page; None without one.

    The margin reaches all four sides of the image. Its pixels, apart from holes, are at full scale, or at one
    grey level while noise makes those of the region differ.
    """
    corners = np.array([0, 0, -1, -1]), np.array([0, -1, 0, -1])
    seen = image[corners] if valid is None else image[corners][valid[corners] > 0]
    level = min(float(seen.max()), full_scale) if seen.size else full_scale
    if not level > 0.0 or (np.minimum(seen, np.float32(level)) != np.float32(level)).any():
        return None
    drawn = image >= full_scale if level >= full_scale else image == np.float32(level)
    if not drawn.any():
        return None
    holes_too = drawn if valid is None else drawn | (valid == 0)
    margin = _at_border(block_means(holes_too.astype(np.float32)) == 1.0)
    sides = (margin[0], margin[-1], margin[:, 0], margin[:, -1])
    if not all(side.any() for side in sides) or not _is_field_of_view(1 - margin):
        return None
    # without noise the background of a wide contact looks like a margin
    inside = to_pixels(1 - margin, image.shape)[:, 1:] > 0
    if level < full_scale and 2 * np.count_nonzero(inside & (np.diff(image) == 0)) > np.count_nonzero(inside):
        return None
    return _pixels_of(margin, holes_too, 2)  # blurred by enlarging or compression. By hand


def _at_border(blocks: Flags) -> NDArray[np.uint8]:
    """Mark the blocks that are connected with the border of the image, without small regions."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(blocks.astype(np.uint8), connectivity=4)
    border = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    large = stats[border, cv2.CC_STAT_AREA] >= LEAST_UNLIT_BLOCKS
    return np.isin(labels, border[large & (border > 0)]).astype(np.uint8)


def _pixels_of(blocks: NDArray[np.uint8], alike: Flags, reach: int) -> NDArray[np.uint8]:
    """The pixels of some blocks, those beside them that are alike, and all that their edge reaches (px)."""
    near = cv2.dilate(blocks, np.ones((3, 3), np.uint8))
    own, near = (to_pixels(part, alike.shape) for part in (blocks, near))
    ellipse = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    return np.asarray(cv2.dilate(own | (near & alike.astype(np.uint8)), ellipse), np.uint8)


def _is_field_of_view(lit: NDArray[np.uint8]) -> bool:
    """Whether the lit blocks are one large convex region."""
    outlines, _ = cv2.findContours(lit, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not outlines:
        return False
    largest = max(outlines, key=cv2.contourArea)
    filled, hull = np.zeros_like(lit), np.zeros_like(lit)
    cv2.drawContours(filled, [largest], -1, 1, cv2.FILLED)
    cv2.fillConvexPoly(hull, cv2.convexHull(largest), 1)
    area = int(filled.sum())
    large = area >= UNLIT_FRACTION * lit.size and area >= (1.0 - UNLIT_FRACTION) * int(hull.sum())
    return large and int((lit & filled).sum()) >= 0.9 * int(lit.sum())
