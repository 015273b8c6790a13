"""An image in larger pixels, where half the resolution is enough."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

FEW = 16  # rows or columns of an image that is not made coarser


@dataclass(frozen=True, eq=False)
class BinnedImage:
    """An image in larger pixels: a quarter as many, with half the noise.

    Parameters
    ----------
    image : ndarray of float32
        Means of ``step x step`` pixels.
    step : int
        2; 1 for an image with few pixels.
    """

    image: NDArray[np.float32]
    step: int

    @classmethod
    def of(cls, image: NDArray[np.float32]) -> "BinnedImage":
        """From an image at its own resolution."""
        rows, columns = image.shape
        if min(rows, columns) < FEW:
            return cls(image, 1)
        return cls(cv2.resize(image, (columns // 2, rows // 2), interpolation=cv2.INTER_AREA), 2)
