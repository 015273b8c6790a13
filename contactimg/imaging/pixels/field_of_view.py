"""What the sensor adds to a frame by itself: regions without light, gains of a colour mosaic, bad pixels.

All of it is found in the frame (and its reference) alone and taken out before anything else is measured.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.pixels.blocks import BLOCK, block_means, to_pixels
from contactimg.imaging.pixels.masks import Flags, Mask, Values
from contactimg.imaging.pixels.robust import (
    SAMPLE,
    SIGNIFICANT_SIGMA,
    median,
    noise_std,
    quantile,
    robust_std,
)

# Of the level of the lit blocks: a field stop transmits nothing. Of the image: less light is a contact, not a
# field of view, which falls short of its convex hull by less. By hand.
UNLIT_FRACTION = 0.15
LIT_SHARE = 0.95  # of the blocks that are no brighter than those that are lit in any case. By hand
LEAST_UNLIT_BLOCKS = 12  # of one dark region at the border. By hand: a dark contact of 13 px radius has 8
# Width of a square about an unlit block between which there is light again, and how much of that further
# inside: in vignetted corners there is less. By hand: beside a stop there is 0.93 and more.
STOP_EDGE_BLOCKS, STOP_LIGHT = (5, 7), 0.7
EDGE_REACH_PX = 5  # of the blurred edge of a stop or of a contact: 3.5 blur widths of the usual optics
DRAWN_EDGE_PX = 2  # of the edge of a margin, which enlarging or compression may have blurred. By hand
MOSAIC_STEP = 0.01  # relative difference of the gains of a mosaic that is corrected. By hand
DEFECT_SIGMA = 10.0  # from the median of nine pixels. By hand: shot noise of bright contacts is below
DEFECT_RATIO = 6.0  # of that to the range of the neighbours. Theory: 2.4 for a point behind a blur of 0.75 px
DEFECT_COMPANIONS = 2  # neighbours that may be as far off: a line one pixel wide is no contact either
# Least difference from the median, of the largest, where there is no noise; and share of the pixels that may
# be defective: what has more is a texture. By hand: a transmission that flips bits spoils some in a hundred.
LEAST_DEFECT, MOST_DEFECTS = 0.02, 0.1


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


def find_margin(image: NDArray, full_scale: float) -> Mask:
    """Pixels (1) of a white margin around one convex region, as of a figure on a page; None if there is none.

    The margin is at full scale and reaches all four sides of the image.
    """
    if not (image[[0, 0, -1, -1], [0, -1, 0, -1]] >= full_scale).all():
        return None
    margin = _at_border(block_means((image >= full_scale).astype(np.float32)) == 1.0)
    sides = (margin[0], margin[-1], margin[:, 0], margin[:, -1])
    if not all(side.any() for side in sides) or not _is_field_of_view(1 - margin):
        return None
    return _pixels_of(margin, image >= full_scale, DRAWN_EDGE_PX)


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


def repair_defects(image: NDArray, valid: Mask) -> tuple[NDArray, Mask]:
    """The image without hot or dead pixels and lines one pixel wide, and where (1) they were, or None.

    No optics can have drawn such a pixel: it lies far above, or below, all but two of its neighbours, which
    differ little. The median of the nine takes its place.
    """
    if min(image.shape) < 3:
        return image, None
    middle = cv2.medianBlur(image, 3)
    rest = cv2.absdiff(image, middle)
    worst = rest.max(axis=1)
    every, largest = max(int(np.sqrt(image.size / SAMPLE)), 1), float(worst.max())
    limit = DEFECT_SIGMA * noise_std(rest[::every, ::every].astype(np.float32))
    limit = min(max(limit, LEAST_DEFECT * largest), largest)
    some = np.flatnonzero(worst > rest.dtype.type(limit))
    places, columns = np.nonzero(rest[some] > rest.dtype.type(limit))
    rows = some[places]
    if valid is not None:
        seen = valid[rows, columns] > 0
        rows, columns = rows[seen], columns[seen]
    if not 0 < len(rows) < MOST_DEFECTS * image.size:
        return image, None
    (height, width), step = image.shape, np.arange(-1, 2)
    centre = np.clip(rows, 1, height - 2) * width + np.clip(columns, 1, width - 2)
    around = image.ravel()[centre[:, None] + (step[:, None] * width + step).ravel()].astype(np.float32)
    above = np.where(image[rows, columns] > middle[rows, columns], np.float32(1.0), np.float32(-1.0))
    ordered = np.sort(around * above[:, None], axis=1)
    usual = ordered[:, -2 - DEFECT_COMPANIONS]  # the largest but for the companions and the pixel itself
    off, spread = above * image[rows, columns] - usual, usual - ordered[:, 1]  # one may be off the other way
    defective = (off > limit) & (off > DEFECT_RATIO * spread)
    if not defective.any():
        return image, None
    mask = np.zeros(image.shape, np.uint8)
    mask[rows[defective], columns[defective]] = 1
    _close_lines(mask)
    _close_lines(mask.T)
    return np.where(mask > 0, middle, image), mask


def _close_lines(mask: NDArray[np.uint8]) -> None:
    """Mark whole columns between their first and their last pixel, if most of these are marked.

    Where a defective column crosses the rim of a contact its neighbours differ as much as it does.
    """
    first, last = mask.argmax(axis=0), len(mask) - mask[::-1].argmax(axis=0)
    for k in np.flatnonzero(2 * mask.sum(axis=0, dtype=np.int64) > last - first):
        mask[first[k] : last[k], k] = 1


def mosaic_gains(image: NDArray, valid: Mask = None) -> NDArray[np.float64] | None:
    """Relative gains of the four pixels of a colour mosaic, shape (2, 2); None for a plain sensor.

    Each is the median ratio of its pixels to the mean of their square of four, without holes. Where most
    pixels of a colour are black they tell none.
    """
    rows, columns = (size // 2 * 2 for size in image.shape)
    if not rows * columns:
        return None
    every = max(int(np.sqrt(rows * columns / 4 / SAMPLE)), 1)

    def of_colours(pixels: NDArray) -> NDArray:
        return np.stack(
            [pixels[y:rows:2, x:columns:2][::every, ::every].ravel() for y, x in np.ndindex(2, 2)]
        )

    phases = np.asarray(of_colours(image), np.float32)
    if valid is not None:
        phases = phases[:, of_colours(valid).all(axis=0)]
    if not phases.size:
        return None
    mean, levels = phases.mean(axis=0), phases.mean(axis=1)
    if np.ptp(levels) < 0.5 * MOSAIC_STEP * levels.mean():
        return None
    bright = mean > max(0.2 * quantile(mean, 0.9), 1e-6)
    if np.count_nonzero(bright) < 1000:
        return None
    ratio = phases[:, bright] / mean[bright]
    gains = np.array([median(part) for part in ratio], float)
    error = np.array([robust_std(part) for part in ratio]) / np.sqrt(ratio.shape[1])
    if not gains.min() > 0.0:
        return None
    step = np.abs(gains - 1.0)
    # the median of whole numbers is known to half of one
    alike = np.max(step) < max(MOSAIC_STEP, 1.0 / median(mean[bright]))
    return None if alike or np.max(step / (error + 1e-9)) < SIGNIFICANT_SIGMA else gains.reshape(2, 2)


def divide_by_mosaic(image: NDArray, gains: NDArray[np.float64]) -> Values:
    """The image as a sensor of equal pixels would show it."""
    out = np.array(image, np.float32)
    for y, x in np.ndindex(2, 2):
        out[y::2, x::2] /= np.float32(gains[y, x])
    return out
