"""Convert decoded pixels to one grey level per pixel, in a dtype of `Frame`."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

LUMA = np.array([0.299, 0.587, 0.114])
"""Weights of red, green and blue: ITU-R BT.601, as in OpenCV.

Their sum is 1, so grey stored as colour is kept.
"""

# stored dtype -> smallest dtype of a Frame that holds every value exactly
_EXACT = {
    "uint8": "uint8",
    "uint16": "uint16",
    "float32": "float32",
    "float64": "float64",
    "int8": "float32",
    "int16": "float32",
    "float16": "float32",
    "int32": "float64",
    "uint32": "float64",
}


class UnsupportedPixelsError(ValueError):
    """Pixels that cannot be converted to grey levels."""


class Pixels(NamedTuple):
    """The result of a decoder: grey (rows, columns) or colour (rows, columns, 3), and the full scale."""

    array: NDArray
    full_scale: float | None


def to_grey(array: NDArray) -> NDArray:
    """Convert to one grey level per pixel, ``0.299 R + 0.587 G + 0.114 B``, unrounded.

    Parameters
    ----------
    array : ndarray, shape (rows, columns) or (rows, columns, 3)
        Grey levels, or red, green and blue.

    Returns
    -------
    ndarray, shape (rows, columns)
        uint8, uint16, float32 or float64, whichever holds the values exactly; colour gives float32 (float64
        from 32-bit and 64-bit channels).

    Raises
    ------
    UnsupportedPixelsError
        If the dtype or the number of channels has no grey level.

    Examples
    --------
    >>> to_grey(np.full((1, 2, 3), 200, np.uint8))
    array([[200., 200.]], dtype=float32)
    """
    if str(array.dtype) not in _EXACT:
        raise UnsupportedPixelsError(f"pixels of type {array.dtype} are not supported")
    exact = np.dtype(_EXACT[str(array.dtype)])
    if array.ndim == 2:
        return np.ascontiguousarray(array, dtype=exact)
    if array.ndim != 3 or array.shape[2] != 3:
        raise UnsupportedPixelsError(f"an image of shape {array.shape} is neither grey nor red-green-blue")
    wide = np.float64 if exact.itemsize > 4 else np.float32
    return np.ascontiguousarray(array @ LUMA, dtype=wide)
