"""The fraction of the contrast at which pixels count as contact."""

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.errors import InputError
from contactimg.imaging.contrast.plateau import Contrast


def choose_threshold(image: NDArray[np.float32], contrast: Contrast, threshold: float | str | None) -> float:
    """The fraction to use: a number as given, 0.5 for None, Otsu's two-class optimum for ``"auto"``.

    Raises
    ------
    InputError
        If it is not a fraction between 0 and 1.
    """
    if threshold is None:
        return 0.5
    if isinstance(threshold, str):
        if threshold != "auto":
            raise InputError(f'threshold must be a fraction between 0 and 1 or "auto", got {threshold!r}')
        return _otsu(image, contrast.plateau)
    if not 0 < threshold < 1:
        raise InputError(f'threshold must be a fraction between 0 and 1 or "auto", got {threshold!r}')
    return float(threshold)


def _otsu(image: NDArray[np.float32], plateau: float) -> float:
    """Fraction of the plateau that separates background and contacts with least variance inside both."""
    if plateau <= 0:
        return 0.5
    scaled = np.clip(image * (200.0 / plateau), 0, 255).astype(np.uint8)
    level, _ = cv2.threshold(scaled, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    return float(np.clip((level + 0.5) / 200.0, 0.05, 0.95))
