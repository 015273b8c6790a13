"""Rules of every decoder of images: the largest image that is read, and one grey level per pixel.

What a header claims is checked before memory is taken.
"""

import os
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contactimg.errors import InputError

MAX_PIXELS = 200_000_000
"""Largest image in pixels: 1.6 GB in double precision, twelve times a camera of 16 megapixels. Chosen: it
stops headers that lie and decompression bombs; the environment variable `MAX_PIXELS_VARIABLE` replaces it."""

MAX_PIXELS_VARIABLE = "CONTACTIMG_MAX_PIXELS"
"""Environment variable with the largest number of pixels of an image."""


class ImageTooLargeError(ValueError):
    """An image beyond the limit."""


def max_pixels() -> int:
    """The largest number of pixels of an image.

    Raises
    ------
    InputError
        If the environment variable holds no positive whole number.
    """
    stated = os.environ.get(MAX_PIXELS_VARIABLE)
    if stated is None:
        return MAX_PIXELS
    try:
        number = float(stated)
    except ValueError:
        number = 0.0
    if not (number >= 1 and number.is_integer()):
        raise InputError(f"{MAX_PIXELS_VARIABLE} must be a whole number of pixels, got {stated!r}")
    return int(number)


def check_size(columns: int, rows: int, samples: int = 1) -> None:
    """Raise if an image, or one of its tiles, would be too large.

    Parameters
    ----------
    columns, rows : int
        Size in pixels.
    samples : int
        Channels; more than four count as pixels.

    Raises
    ------
    ImageTooLargeError
        With the size and how to raise the limit.
    """
    pixels, most = int(columns) * int(rows) * max(1, int(samples) // 4), max_pixels()
    if pixels > most:
        raise ImageTooLargeError(
            f"its header says {int(columns)} x {int(rows)} pixels, more than {most}; "
            f"if that is right, set {MAX_PIXELS_VARIABLE}"
        )


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
