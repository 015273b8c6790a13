"""What the sensor adds to a frame by itself: regions without light, gains of a colour mosaic, bad pixels.

All of it is found in the frame (and its reference) alone and taken out before anything else is measured.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.pixels.blocks import BLOCK, block_means
from contactimg.imaging.pixels.masks import Mask
from contactimg.imaging.pixels.robust import median, noise_std, quantile, robust_std

UNLIT_FRACTION = 0.15  # of the level of the lit blocks; by hand: a field stop transmits nothing
LEAST_LIT_SHARE = 0.15  # of the image; by hand: less is a contact, not a field of view
LEAST_CONVEXITY = 0.85  # area of the field of view over that of its convex hull; by hand
LEAST_UNLIT_BLOCKS = 12  # of one dark region at the border: a dark contact of 13 px radius has 8; by hand
UNLIT_MARGIN_PX = 5  # beyond the unlit pixels: the blurred edge of a stop; three blur widths of 1.5 px
MOSAIC_STEP = 0.01  # relative difference of the gains of a mosaic that is corrected; by hand
MOSAIC_SIGMA = 8.0  # the same in its standard error; false-alarm rate below 1e-14
SAMPLED = 20_000  # pixels that gains of a mosaic are read from; accuracy
DEFECT_SIGMA = 10.0  # from the median of nine pixels; by hand: shot noise of bright contacts is below
DEFECT_RATIO = 6.0  # of that to the range of the neighbours; theory: 2.4 for a point behind a blur of 0.75 px
DEFECT_COMPANIONS = 2  # neighbours that may be as far off: a line one pixel wide is no contact either
DEFECT_LEAST = 0.02  # of the largest such difference; accuracy, where there is no noise
MOST_DEFECTS_SHARE = 0.03  # of the pixels; by hand: what has more is a texture


def find_unlit(image: NDArray, valid: Mask) -> Mask:
    """Pixels (1) that no light reaches: outside a field stop, or in a black border; None if there are none.

    The lit part must be one convex region, as a field of view is: bright contacts on a black background are
    not.
    """
    means = block_means(image, valid)
    means = np.where(np.isfinite(means), means, 0.0)
    lit_level = quantile(means, 0.95)
    if not lit_level > 0 or quantile(means, 0.0) > UNLIT_FRACTION * lit_level:
        return None
    level = median(means[means > 0.5 * lit_level])
    dark = (means < UNLIT_FRACTION * level).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(dark, connectivity=4)
    border = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    kept = [k for k in border if k > 0 and stats[k, cv2.CC_STAT_AREA] >= LEAST_UNLIT_BLOCKS]
    if count < 2 or not kept:
        return None
    unlit = np.isin(labels, kept).astype(np.uint8)
    if not _is_field_of_view(1 - unlit):
        return None
    near = cv2.dilate(unlit, np.ones((3, 3), np.uint8)).repeat(BLOCK, 0).repeat(BLOCK, 1)
    smooth = cv2.blur(np.asarray(image, np.float32), (3, 3))
    inside = near[: image.shape[0], : image.shape[1]] > 0
    pixels = ((smooth < 0.5 * level) & inside).astype(np.uint8)
    pixels |= unlit.repeat(BLOCK, 0).repeat(BLOCK, 1)[: image.shape[0], : image.shape[1]]
    side = 2 * UNLIT_MARGIN_PX + 1
    return np.asarray(cv2.dilate(pixels, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))))


def _is_field_of_view(lit: NDArray[np.uint8]) -> bool:
    """Whether the lit blocks are one large convex region."""
    outlines, _ = cv2.findContours(lit, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = np.zeros_like(lit)
    largest = max(outlines, key=cv2.contourArea, default=None)
    if largest is None:
        return False
    cv2.drawContours(filled, [largest], -1, 1, cv2.FILLED)
    hull = np.zeros_like(lit)
    cv2.fillConvexPoly(hull, cv2.convexHull(largest), 1)
    area = int(filled.sum())
    if area < LEAST_LIT_SHARE * lit.size or area < LEAST_CONVEXITY * int(hull.sum()):
        return False
    return int((lit & filled).sum()) >= 0.9 * int(lit.sum())


def repair_defects(image: NDArray, valid: Mask) -> tuple[NDArray, Mask]:
    """The image without hot or dead pixels and lines one pixel wide, and where (1) they were, or None.

    No optics can have drawn such a pixel: it lies far above, or below, all but two of its neighbours, which
    differ little. The median of the nine takes its place.
    """
    if min(image.shape) < 3:
        return image, None
    middle = cv2.medianBlur(image, 3)
    rest = cv2.absdiff(image, middle)
    every = max(int(np.sqrt(image.size / SAMPLED)), 1)
    limit = DEFECT_SIGMA * noise_std(rest[::every, ::every].astype(np.float32))
    limit = max(limit, DEFECT_LEAST * float(rest.max()))
    far = np.flatnonzero(rest > np.float32(limit))
    if valid is not None:
        far = far[valid.ravel()[far] > 0]
    rows, columns = np.divmod(far, image.shape[1])
    if not 0 < len(rows) < MOST_DEFECTS_SHARE * image.size:
        return image, None
    height, width = image.shape
    around = [
        image[np.clip(rows + y, 0, height - 1), np.clip(columns + x, 0, width - 1)].astype(np.float32)
        for y in (-1, 0, 1)
        for x in (-1, 0, 1)
    ]
    above = np.where(image[rows, columns] > middle[rows, columns], np.float32(1.0), np.float32(-1.0))
    ordered = np.sort(np.array(around) * above, axis=0)
    usual = ordered[-2 - DEFECT_COMPANIONS]  # the largest but for the companions and the pixel itself
    off, spread = above * image[rows, columns] - usual, usual - ordered[1]  # one may be off the other way
    defective = (off > limit) & (off > DEFECT_RATIO * spread)
    if not defective.any():
        return image, None
    rows, columns = rows[defective], columns[defective]
    image, mask = image.copy(), np.zeros(image.shape, np.uint8)
    image[rows, columns], mask[rows, columns] = middle[rows, columns], 1
    return image, mask


def mosaic_gains(image: NDArray) -> NDArray[np.float64] | None:
    """Relative gains of the four pixels of a colour mosaic, shape (2, 2); None for a plain sensor.

    Each is the median ratio of its pixels to the mean of their square of four.
    """
    rows, columns = (size // 2 * 2 for size in image.shape)
    if not rows * columns:
        return None
    every = max(int(np.sqrt(rows * columns / 4 / SAMPLED)), 1)
    phases = np.stack(
        [
            np.asarray(image[y:rows:2, x:columns:2][::every, ::every], np.float32)
            for y in (0, 1)
            for x in (0, 1)
        ]
    )
    mean, levels = phases.mean(axis=0), phases.mean(axis=(1, 2))
    if np.ptp(levels) < 0.5 * MOSAIC_STEP * levels.mean():
        return None
    bright = mean > max(0.2 * quantile(mean, 0.9), 1e-6)
    if np.count_nonzero(bright) < 1000:
        return None
    ratio = phases[:, bright] / mean[bright]
    gains = np.array([median(part) for part in ratio], float)
    error = np.array([robust_std(part) for part in ratio]) / np.sqrt(ratio.shape[1])
    if (
        np.max(np.abs(gains - 1.0)) < MOSAIC_STEP
        or np.max(np.abs(gains - 1.0) / (error + 1e-9)) < MOSAIC_SIGMA
    ):
        return None
    return gains.reshape(2, 2)


def divide_by_mosaic(image: NDArray, gains: NDArray[np.float64]) -> NDArray[np.float32]:
    """The image as a sensor of equal pixels would show it."""
    out = np.array(image, np.float32)
    for y in (0, 1):
        for x in (0, 1):
            out[y::2, x::2] /= np.float32(gains[y, x])
    return out
