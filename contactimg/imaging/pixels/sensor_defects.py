"""What the sensor adds to a frame by itself: gains of a colour mosaic, defective pixels and lines.

Both are found in the frame, or its reference, alone and taken out before anything else is measured.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.pixels import robust
from contactimg.imaging.pixels.masks import Mask, Values

MOSAIC_STEP = 0.01  # relative difference of the gains of a mosaic that is corrected. By hand


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
    every, largest = max(int(np.sqrt(image.size / robust.SAMPLE)), 1), float(worst.max())
    some = rest[::every, ::every]
    # By hand, from the median of nine pixels: shot noise of bright contacts is below.
    limit = 10.0 * robust.noise_std(some.astype(np.int16 if some.dtype == np.uint8 else np.float32))
    limit = min(max(limit, 0.02 * largest), largest)  # there may be no noise
    off = np.flatnonzero(worst > rest.dtype.type(limit))
    places, columns = np.nonzero(rest[off] > rest.dtype.type(limit))
    rows = off[places]
    if valid is not None:
        seen = valid[rows, columns] > 0
        rows, columns = rows[seen], columns[seen]
    # More is a texture. By hand: a transmission that flips bits spoils some in a hundred.
    if not 0 < len(rows) < 0.1 * image.size:
        return image, None
    (height, width), step = image.shape, np.arange(-1, 2)
    centre = np.clip(rows, 1, height - 2) * width + np.clip(columns, 1, width - 2)
    around = image.ravel()[centre[:, None] + (step[:, None] * width + step).ravel()].astype(np.float32)
    above = np.where(image[rows, columns] > middle[rows, columns], np.float32(1.0), np.float32(-1.0))
    ordered = np.sort(around * above[:, None], axis=1)
    # Two neighbours may be as far off: a line one pixel wide is no contact either.
    usual = ordered[:, -4]  # the largest but for these and the pixel itself
    off, spread = above * image[rows, columns] - usual, usual - ordered[:, 1]  # one may be off the other way
    # Theory: 2.4 for a point behind a blur of 0.75 px.
    defective = (off > limit) & (off > 6.0 * spread)
    if not defective.any():
        return image, None
    rows, columns = rows[defective], columns[defective]
    mask = np.zeros(image.shape, np.uint8)
    mask[rows, columns] = 1
    _close_lines(mask, rows, columns)
    _close_lines(mask.T, columns, rows)
    return np.where(mask > 0, middle, image), mask


def _close_lines(mask: NDArray[np.uint8], places: NDArray[np.intp], lines: NDArray[np.intp]) -> None:
    """Mark whole columns between their first and their last pixel, if most of these are marked.

    Where a defective column crosses the rim of a contact its neighbours differ as much as it does. ``places``
    and ``lines`` are the rows and columns of the marked pixels.
    """
    order = np.lexsort([places, lines])
    lines, start, count = np.unique(lines[order], return_index=True, return_counts=True)
    first, last = places[order[start]], places[order[start + count - 1]] + 1
    for k in np.flatnonzero((count < last - first) & (last - first < 2 * count)):
        mask[first[k] : last[k], lines[k]] = 1


def mosaic_gains(image: NDArray, valid: Mask = None) -> NDArray[np.float64] | None:
    """Relative gains of the four pixels of a colour mosaic, shape (2, 2); None for a plain sensor.

    Each is the median ratio of its pixels to the mean of their square of four, without holes. Where most
    pixels of a colour are black they tell none.
    """
    rows, columns = (size // 2 * 2 for size in image.shape)
    if not rows * columns:
        return None
    every = max(int(np.sqrt(rows * columns / 4 / robust.SAMPLE)), 1)

    def of_colours(pixels: NDArray) -> NDArray:
        phases = (pixels[y:rows:2, x:columns:2][::every, ::every] for y, x in np.ndindex(2, 2))
        return np.stack([phase.ravel() for phase in phases])

    phases = np.asarray(of_colours(image), np.float32)
    if valid is not None:
        phases = phases[:, of_colours(valid).all(axis=0)]
    if not phases.size:
        return None
    mean, levels = phases.mean(axis=0), phases.mean(axis=1)
    if np.ptp(levels) < 0.5 * MOSAIC_STEP * levels.mean():
        return None
    bright = mean > max(0.2 * robust.quantile(mean, 0.9), 1e-6)
    if np.count_nonzero(bright) < 1000:
        return None
    ratio = phases[:, bright] / mean[bright]
    gains = np.array([robust.median(part) for part in ratio], float)
    error = np.array([robust.robust_std(part) for part in ratio]) / np.sqrt(ratio.shape[1])
    if not gains.min() > 0.0:
        return None
    step = np.abs(gains - 1.0)
    # the median of whole numbers is known to half of one
    alike = np.max(step) < max(MOSAIC_STEP, 1.0 / robust.median(mean[bright]))
    return None if alike or np.max(step / (error + 1e-9)) < robust.SIGNIFICANT_SIGMA else gains.reshape(2, 2)


def divide_by_mosaic(image: NDArray, gains: NDArray[np.float64]) -> Values:
    """The image as a sensor of equal pixels would show it."""
    out = np.array(image, np.float32)
    for y, x in np.ndindex(2, 2):
        out[y::2, x::2] /= np.float32(gains[y, x])
    return out
