"""The fraction of the contrast at which pixels count as contact."""

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.errors import InputError
from contactimg.imaging.detect.candidates import Contrast

DEFAULT_FRACTION = 0.5
"""Threshold where none is given: half height, where the radius of a wide disk depends least on its blur."""
OTSU_LEVELS = 200.0
"""Grey levels of 8 bits between background and plateau."""
OTSU_RANGE = (0.05, 0.95)
"""Range of the automatic threshold: outside it noise makes contacts or takes them away."""


def choose_threshold(image: NDArray[np.float32], contrast: Contrast, threshold: float | str | None) -> float:
    """The fraction to use: a number as given, `DEFAULT_FRACTION` for None, Otsu's for ``"auto"``.

    Raises
    ------
    InputError
        If it is not a fraction between 0 and 1.
    """
    if threshold is None:
        return DEFAULT_FRACTION
    if isinstance(threshold, str):
        if threshold != "auto":
            raise InputError(f'threshold must be a fraction between 0 and 1 or "auto", got {threshold!r}')
        return _otsu(image, contrast.plateau)
    if not 0 < threshold < 1:
        raise InputError(f'threshold must be a fraction between 0 and 1 or "auto", got {threshold!r}')
    return float(threshold)


def _otsu(image: NDArray[np.float32], plateau: float) -> float:
    """Fraction of the plateau that separates two classes of pixels with least variance inside both (Otsu).

    N. Otsu, doi:10.1109/TSMC.1979.4310076.
    """
    if plateau <= 0:
        return DEFAULT_FRACTION
    scaled = np.clip(image * (OTSU_LEVELS / plateau), 0, 255).astype(np.uint8)
    level, _ = cv2.threshold(scaled, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    return float(np.clip((level + 0.5) / OTSU_LEVELS, *OTSU_RANGE))
