"""The lower envelope of the blocks of an image: it follows uneven light from gap to gap between contacts."""

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.illumination import Illumination, fit_illumination
from contactimg.imaging.pixels.blocks import BLOCK
from contactimg.imaging.pixels.robust import robust_std

# Constants without a stated origin were chosen by hand on rendered frames; their sensitivity is not measured.
WINDOW_FRACTION = 1.0 / 6.0  # of the longer side of the image: contacts wider than that count as background


def fit_envelope(blocks: NDArray[np.float32], shape: tuple[int, int]) -> Illumination:
    """Polynomial through the lower envelope of the blocks of an image of ``shape``; NaN = no data."""
    finite = np.isfinite(blocks)
    filled = np.where(finite, blocks, np.median(blocks[finite]) if finite.any() else 0.0)
    lower = envelope(filled, shape, cv2.MORPH_OPEN)
    middle = float(np.median(lower))
    scatter = 2.0 * robust_std(lower, centre=middle)
    return fit_illumination(np.where(finite, lower, np.nan), shape, level=middle, scatter=scatter)


def envelope(blocks: NDArray, shape: tuple[int, int], operation: int) -> NDArray[np.float32]:
    """Opening or closing of the blocks by a disk wider than the contacts."""
    side = window_side(shape)
    window = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    smooth = cv2.medianBlur(np.ascontiguousarray(blocks, np.float32), 3)
    result = cv2.morphologyEx(smooth, operation, window, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(result, np.float32)


def window_side(shape: tuple[int, int]) -> int:
    """Diameter of the window of the envelopes, in blocks; odd."""
    return max(int(max(shape) * WINDOW_FRACTION / BLOCK) | 1, 3)
