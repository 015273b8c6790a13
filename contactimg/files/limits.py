"""The largest image that is read: what a header claims is checked before memory is taken."""

import os

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
