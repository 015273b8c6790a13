"""Background of a frame without reference, from itself, and whether its contacts are bright or dark.

The lower envelope of the block means (an opening by a window wider than the contacts) follows uneven light
from gap to gap; a polynomial through it flattens the frame, and the most common level of what is left is the
background. Seen the other way up, the frame would show a net between disks, not disks: that tells the
polarity.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.crowd_envelope import WINDOW, flatten_crowd
from contactimg.imaging.background.difference_image import DifferenceImage
from contactimg.imaging.background.illumination import Illumination, background_mode, fit_illumination
from contactimg.imaging.contrast.noise import estimate_noise
from contactimg.imaging.contrast.plateau import measure_contrast
from contactimg.imaging.pixels.binned_image import BinnedImage
from contactimg.imaging.pixels.blocks import BLOCK, block_means
from contactimg.imaging.pixels.masks import Mask
from contactimg.imaging.shapes.labelled_regions import label_regions

CROWDED = 0.5  # of the blocks: with less background, contacts hide what one slow field would have to follow
LEAST_LIGHT = 0.2  # of the usual light: where the background is darker, it is not divided by
GAP = 0.15  # of the height of the contacts: blocks darker than that lie between them


def estimate_background(
    frame: NDArray[np.float32], *, valid: Mask = None, dark: bool = False
) -> DifferenceImage:
    """Frame minus a slow background fitted to the frame itself.

    Parameters
    ----------
    frame : ndarray, shape (rows, columns)
        Grey levels; holes filled with anything finite.
    valid : ndarray of uint8 or None
        0 at holes.
    dark : bool
        Whether the contacts are darker than the background.

    Returns
    -------
    DifferenceImage
        Texture and dirt stay in it.

    Examples
    --------
    >>> y, x = np.mgrid[0:160, 0:240]
    >>> frame = (50 + 0.2 * x + 30 * (np.hypot(x - 80, y - 70) < 12)).astype(np.float32)
    >>> found = estimate_background(frame).image
    >>> bool(np.abs(found[70, 80] - 30) < 1), bool(np.abs(found[20, 200]) < 1)
    (True, True)
    """
    sign = np.float32(-1.0 if dark else 1.0)
    blocks = sign * block_means(frame, valid)
    slow = _fit_envelope(blocks, frame.shape)
    rest = blocks - slow.at_blocks(blocks.shape, frame.shape)
    start, spread = background_mode(rest, background_is="lowest")
    light = fit_illumination(rest, frame.shape, start=start, spread=spread)
    light = Illumination(sign * (slow.coefficients + light.coefficients), light.background, light.spread)
    level = float(np.median(np.abs(blocks[light.background]))) if light.background.any() else abs(start)
    ones = np.ones_like(blocks)
    if np.mean(light.background) > CROWDED or not np.isfinite(blocks).all():
        return _level_out(frame, light, level, np.isfinite(blocks))
    image = sign * flatten_crowd(sign * frame, blocks)
    gaps = np.abs(block_means(image)) < GAP * np.percentile(np.abs(image[::8, ::8]), 90)
    return DifferenceImage(image, level, ones, Illumination(light.coefficients, gaps, light.spread), None)


def estimate_either_background(
    frame: NDArray[np.float32], *, valid: Mask = None
) -> tuple[DifferenceImage, int]:
    """The background for contacts of unknown polarity, and the sign that makes them positive.

    Both are tried; what then stands out is more like disks for one of them.
    """
    both = [(estimate_background(frame, valid=valid, dark=dark), -1 if dark else 1) for dark in (False, True)]
    return max(both, key=lambda one: _roundness(one[0], one[1], valid))


def _level_out(frame: NDArray, light: Illumination, level: float, seen: NDArray[np.bool_]) -> DifferenceImage:
    """Frame minus background, contacts brought to the same height: they transmit a fraction of the light."""
    at_blocks = light.at_blocks(seen.shape, frame.shape)
    field = light.rows(np.arange(frame.shape[0]), frame.shape)
    image = frame - field
    if (
        not at_blocks.min() >= LEAST_LIGHT * level > 0
    ):  # a background that was subtracted before, or hardly any light
        return DifferenceImage(image, level, np.ones(seen.shape, np.float32), light, None)
    image *= np.float32(level) / np.maximum(field, np.float32(0.5 * LEAST_LIGHT * level))
    return DifferenceImage(image, level, (at_blocks / level).astype(np.float32), light, None)


def _fit_envelope(blocks: NDArray[np.float32], shape: tuple[int, int]) -> Illumination:
    """Polynomial through the lower envelope of the blocks."""
    side = max(int(max(shape) * WINDOW / BLOCK) | 1, 3)
    window = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    finite = np.isfinite(blocks)
    filled = np.where(finite, blocks, np.median(blocks[finite]) if finite.any() else 0.0)
    calm = cv2.medianBlur(filled.astype(np.float32), 3)
    low = cv2.morphologyEx(calm, cv2.MORPH_OPEN, window, borderType=cv2.BORDER_REPLICATE)
    middle = float(np.median(low))
    spread = 2.0 * 1.4826 * float(np.median(np.abs(low - middle)))
    return fit_illumination(np.where(finite, low, np.nan), shape, start=middle, spread=spread)


def _roundness(difference: DifferenceImage, sign: int, valid: Mask) -> float:
    """Share of the area that stands out which lies in the largest disks that fit its parts."""
    image = difference.image * np.float32(sign)
    if valid is not None:
        image = np.where(valid > 0, image, np.float32(0.0))
    contrast = measure_contrast(
        BinnedImage.of(image), estimate_noise(image, difference.illumination.background)
    )
    if contrast.plateau <= 0.0:
        return 0.0
    found = label_regions(image, 0.5 * contrast.plateau)
    total = float(found.area.sum())
    return float(np.minimum(np.pi * found.half_width**2, found.area).sum()) / total if total else 0.0
