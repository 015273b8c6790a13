"""Frames as 8-bit PNG pictures."""

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.errors import FrameError

LIGHT_TOP = 1.25
"""Fraction of the contrast that is 255 in a picture of the light of the contacts."""


def picture(image: NDArray, stretch: tuple[float, float]) -> bytes:
    """A PNG of an image between two grey levels; pixels without a value are black."""
    low, high = stretch
    scaled = (np.asarray(image, np.float32) - np.float32(low)) * np.float32(255.0 / (high - low))
    grey = np.clip(np.nan_to_num(scaled, nan=0.0, posinf=255.0, neginf=0.0), 0.0, 255.0)
    ok, data = cv2.imencode(".png", np.rint(grey).astype(np.uint8), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not ok:
        raise FrameError("the picture cannot be encoded")
    return data.tobytes()
