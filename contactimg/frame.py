"""One camera frame: pixels, name, and the level at which the sensor saturates."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.errors import FrameError


@dataclass(frozen=True, eq=False)
class Frame:
    """A grey-level image as the camera gave it.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Grey levels: uint8, uint16, float32 or float64. Non-finite pixels of a float image are holes.
    name : str
        File name with extension; a page of a stack is ``name[k]``, k from 0.
    full_scale : float or None
        Grey level at which the sensor saturates; None when unknown (float images).

    Raises
    ------
    FrameError
        If the image is not two-dimensional, is empty, or has another dtype.
    """

    image: NDArray
    name: str = ""
    full_scale: float | None = None

    def __post_init__(self) -> None:
        if self.image.ndim != 2 or self.image.size == 0:
            raise FrameError(
                f"{self.name or 'frame'}: an image must have two dimensions (rows, columns) "
                f"and at least one pixel, got shape {self.image.shape}"
            )
        if self.image.dtype not in (np.uint8, np.uint16, np.float32, np.float64):
            raise FrameError(
                f"{self.name or 'frame'}: pixels must be uint8, uint16, float32 or float64, "
                f"got {self.image.dtype}; convert the image first"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, columns = self.image.shape
        return rows, columns
