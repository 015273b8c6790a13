"""Background and brightness of a crowded frame without reference, from the envelopes of its grey levels.

Where contacts cover most of a frame and the light is uneven, no single slow field runs through what little
background there is. The opening of the block means by a window wider than the contacts follows it from gap to
gap; the closing by the same window follows the tops of the contacts.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.pixels.blocks import BLOCK

WINDOW = 1.0 / 6.0  # of the longer side of the image: contacts wider than that count as background
DIMMEST = 0.3  # of the usual height: where the contacts are darker, they are outside the field of view
SMOOTHING = 0.15  # of the window


def flatten_crowd(image: NDArray[np.float32], blocks: NDArray[np.float32]) -> NDArray[np.float32]:
    """Image of bright contacts minus its lower envelope, brought to the same height everywhere.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Grey levels, contacts brighter than what lies between.
    blocks : ndarray
        Its block means, without holes.

    Returns
    -------
    ndarray
        Zero between the contacts; contacts have about the median contrast of the frame.
    """
    side = max(int(max(image.shape) * WINDOW / BLOCK) | 1, 3)
    window = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    blocks = cv2.medianBlur(np.ascontiguousarray(blocks, np.float32), 3)
    low = _smooth(cv2.morphologyEx(blocks, cv2.MORPH_OPEN, window, borderType=cv2.BORDER_REPLICATE), side)
    high = _smooth(cv2.morphologyEx(blocks, cv2.MORPH_CLOSE, window, borderType=cv2.BORDER_REPLICATE), side)
    height = high - low
    usual = max(float(np.median(height[height >= 0.5 * height.max()])), 1e-6)
    gain = usual / np.maximum(height, DIMMEST * usual)
    size = (blocks.shape[1] * BLOCK, blocks.shape[0] * BLOCK)
    full = [
        cv2.resize(field.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) for field in (low, gain)
    ]
    rows, columns = image.shape
    return np.asarray((image - full[0][:rows, :columns]) * full[1][:rows, :columns])


def _smooth(field: NDArray[np.float32], side: int) -> NDArray[np.float32]:
    return cv2.GaussianBlur(field, (0, 0), SMOOTHING * side, borderType=cv2.BORDER_REPLICATE)
