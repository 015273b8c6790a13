"""An image at half its resolution or less, where that is enough."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

SMALLEST_SIDE = 16  # rows or columns: a smaller image is not binned


@dataclass(frozen=True, eq=False)
class BinnedImage:
    """An image binned 2 x 2: a quarter of the pixels, with half the noise; or more coarsely.

    Parameters
    ----------
    image : ndarray of float32
        Means of ``step x step`` pixels.
    step : int
        2, or a larger power of it; 1 for a small image.
    """

    image: NDArray[np.float32]
    step: int

    @classmethod
    def of(cls, image: NDArray[np.float32]) -> "BinnedImage":
        """From an image at its full resolution."""
        rows, columns = image.shape
        if min(rows, columns) < SMALLEST_SIDE:
            return cls(image, 1)
        return cls(_half(image), 2)

    def coarser(self) -> "BinnedImage | None":
        """At half its resolution once more; None for a small image."""
        if self.step == 1 or min(self.image.shape) < SMALLEST_SIDE:
            return None
        return BinnedImage(_half(self.image), 2 * self.step)


def _half(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Means of 2 x 2 pixels."""
    rows, columns = image.shape
    half = cv2.resize(image, (columns // 2, rows // 2), interpolation=cv2.INTER_AREA)
    return np.asarray(half, np.float32)
