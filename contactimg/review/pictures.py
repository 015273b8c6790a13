"""Frames as 8-bit PNG pictures, all with one grey stretch."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.errors import FrameError
from contactimg.files import FrameSource

QUANTILES = (0.005, 0.998)
"""Of the grey levels, shown black and white."""
SAMPLED_FRAMES, SAMPLE_SIDE = 8, 500
"""Frames, and pixels of each along a side, that the stretch is taken from. Chosen: a fraction of a second."""
LIGHT_TOP = 1.25
"""Fraction of the contrast that is 255 in a picture of the light of the contacts."""


def series_stretch(sources: Sequence[FrameSource]) -> tuple[float, float]:
    """Grey levels that are shown black and white in every frame of a series."""
    step = max(1, len(sources) // SAMPLED_FRAMES)
    levels = []
    for source in sources[::step]:
        try:
            image = source.read().image
        except FrameError:
            continue
        strides = [max(1, size // SAMPLE_SIDE) for size in image.shape]
        sample = image[:: strides[0], :: strides[1]].astype(float)
        sample = sample[np.isfinite(sample)]
        if sample.size:
            levels.append(np.quantile(sample, QUANTILES))
    if not levels:
        return 0.0, 255.0
    low, high = float(np.min(levels, axis=0)[0]), float(np.max(levels, axis=0)[1])
    return low, high if high > low else low + 1.0


def picture(image: NDArray, stretch: tuple[float, float]) -> bytes:
    """A PNG of an image between two grey levels; pixels without a value are black."""
    low, high = stretch
    scaled = (np.asarray(image, np.float32) - np.float32(low)) * np.float32(255.0 / (high - low))
    grey = np.clip(np.nan_to_num(scaled, nan=0.0, posinf=255.0, neginf=0.0), 0.0, 255.0)
    ok, data = cv2.imencode(".png", np.rint(grey).astype(np.uint8), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not ok:
        raise FrameError("the picture cannot be encoded")
    return data.tobytes()
