"""One camera frame: pixels, name, and the level at which the sensor saturates."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactimg.errors import FrameError


def as_pixels(image: ArrayLike) -> NDArray:
    """Grey levels as an array of this machine's byte order; masked pixels are NaN.

    Examples
    --------
    >>> as_pixels(np.ma.masked_equal(np.array([[1, 2]], np.uint8), 2)).tolist()
    [[1.0, nan]]
    """
    if np.ma.is_masked(image):
        image = np.ma.filled(np.ma.asarray(image).astype(float), np.nan)
    pixels = np.asarray(image)
    return pixels.astype(pixels.dtype.newbyteorder("="), copy=False)


def full_scale_of_type(image: ArrayLike) -> float | None:
    """The highest grey level of unsigned integers, of masked ones as well; None for other numbers."""
    dtype = np.asarray(image).dtype
    return float(np.iinfo(dtype).max) if dtype.kind == "u" else None


@dataclass(frozen=True, eq=False)
class Frame:
    """A grey-level image as the camera gave it.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Grey levels: uint8, uint16, float32 or float64, of any byte order. Non-finite pixels of a float image
        and masked ones of a masked array are holes.
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
        object.__setattr__(self, "image", as_pixels(self.image))
        if self.image.ndim != 2 or self.image.size == 0:
            raise FrameError(
                f"{self.name or 'frame'}: an image must have two dimensions (rows, columns) "
                f"and at least one pixel, got shape {self.image.shape}; contactimg.read_frames reads files"
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
