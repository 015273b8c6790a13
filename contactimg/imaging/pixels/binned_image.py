"""An image at half its resolution, where that is enough."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

SMALLEST_SIDE = 16  # rows or columns: a smaller image is not binned


@dataclass(frozen=True, eq=False)
class BinnedImage:
    """An image binned 2 x 2: a quarter of the pixels, with half the noise.

    Parameters
    ----------
    image : ndarray of float32
        Means of ``step x step`` pixels.
    step : int
        2; 1 for a small image.
    """

    image: NDArray[np.float32]
    step: int

    @classmethod
    def of(cls, image: NDArray[np.float32]) -> "BinnedImage":
        """From an image at its full resolution."""
        rows, columns = image.shape
        if min(rows, columns) < SMALLEST_SIDE:
            return cls(image, 1)
        half = cv2.resize(image, (columns // 2, rows // 2), interpolation=cv2.INTER_AREA)
        return cls(np.asarray(half, np.float32), 2)
