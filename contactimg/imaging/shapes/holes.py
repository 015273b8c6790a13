"""Holes in a group of pixels."""

import cv2
from numpy.typing import NDArray


def hole_areas(pixels: NDArray) -> list[float]:
    """The areas that the inner contours of pixels enclose, px^2.

    Parameters
    ----------
    pixels : ndarray, shape (rows, columns)
        Set where it is not 0.

    Examples
    --------
    >>> import numpy as np
    >>> ring = np.ones((7, 7), np.uint8)
    >>> ring[2:5, 2:5] = 0
    >>> hole_areas(ring), hole_areas(np.zeros((3, 3)))
    ([14.0], [])
    """
    contours, levels = cv2.findContours(pixels.astype("uint8"), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    if levels is None:
        return []
    return [cv2.contourArea(line) for line, level in zip(contours, levels[0], strict=True) if level[3] >= 0]
