"""Rules of every decoder (the largest image, one grey level per pixel), and those of images that are no TIFF.

What a header claims is checked before memory is taken.

Stills hold one image each and are recognised by their first bytes. Norpix sequences (``.seq``, StreamPix) are
uncompressed and monochrome. Videos are read with OpenCV.
"""

import io
import os
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import imagecodecs
import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

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


# --- stills, Norpix sequences, videos

_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_SIZE = struct.Struct(">LL")  # at byte 16, in the chunk that every PNG begins with

# magic, name, version, header size, description, nine fields of the images, frame rate, eight to compression
_HEADER = struct.Struct("<L24sll512s9Ld8L")
_MAGIC = 0xFEED
_MONOCHROME = 100

_lock = threading.Lock()  # stderr belongs to the whole process

Image.MAX_IMAGE_PIXELS = None  # `check_size` has the limit


def read_still(path: Path, _index: int) -> Pixels:
    """Pixels as stored (an orientation tag is not applied), without transparency."""
    data = path.read_bytes()
    if data.startswith(_PNG):  # grey or red-green-blue, 8 or 16 bits; palettes are expanded
        check_size(*_PNG_SIZE.unpack(data[16:24].ljust(8, b"\0")))
        array = imagecodecs.png_decode(data)
        if array.ndim > 2:
            array = array[..., 0] if array.shape[2] <= 2 else array[..., :3]
    else:
        array = _decode_other(data)
    return Pixels(array, float(np.iinfo(array.dtype).max))


def _decode_other(data: bytes) -> NDArray:
    """Grey or red-green-blue of a JPEG or BMP, 8 bits."""
    try:
        with Image.open(io.BytesIO(data), formats=("JPEG", "BMP")) as image:
            check_size(*image.size)
            if image.mode not in ("1", "L", "P", "RGB", "RGBA"):
                raise UnsupportedPixelsError(f"colours of type {image.mode} are not supported")
            return np.asarray(image.convert("L" if image.mode in ("1", "L") else "RGB"))
    except UnidentifiedImageError:
        raise ValueError("the content is not that of a PNG, JPEG or BMP image") from None


@dataclass(frozen=True)
class _Layout:
    """Where the images of a sequence lie and how their pixels are stored."""

    rows: int
    columns: int
    dtype: np.dtype
    full_scale: float
    first: int
    step: int
    count: int


def list_norpix(path: Path) -> range:
    """Numbers of the images that the header announces."""
    return range(_read_layout(path).count)


def read_norpix(path: Path, index: int) -> Pixels:
    """Image number ``index``, from 0."""
    layout = _read_layout(path)
    pixels = layout.rows * layout.columns
    offset = layout.first + index * layout.step
    missing = offset + pixels * layout.dtype.itemsize - path.stat().st_size
    if missing > 0:
        raise ValueError(f"the file is truncated: {missing} bytes are missing")
    array = np.fromfile(path, layout.dtype, pixels, offset=offset)
    return Pixels(
        array.reshape(layout.rows, layout.columns).astype(array.dtype.newbyteorder("=")), layout.full_scale
    )


def _read_layout(path: Path) -> _Layout:
    """Read the header and check that the images are of a kind that can be read."""
    with path.open("rb") as file:
        head = file.read(_HEADER.size)
    if len(head) < _HEADER.size:
        raise ValueError("the file is too short for the header of a Norpix sequence")
    magic, _, version, _, _, *fields = _HEADER.unpack(head)
    if magic != _MAGIC:
        raise ValueError("the content is not that of a Norpix sequence")
    columns, rows, bits, used_bits, image_bytes, kind, count, _, step = fields[:9]
    _check_kind(kind, bits, fields[-1])
    # from version 5 on the images begin on a sector of 8192 bytes, before at 1024
    first = 8192 if version >= 5 else 1024
    check_size(columns, rows)
    if step <= 0 or used_bits > bits or image_bytes < rows * columns * bits // 8:
        raise ValueError("the header of the Norpix sequence contradicts itself")
    held = max((path.stat().st_size - first) // step, 0)
    # 0: a recording that was not closed properly; one number beyond the end stands for all that are lost
    count = min(count, held + 1) if count else held
    dtype = np.dtype(f"<u{bits // 8}")
    return _Layout(rows, columns, dtype, float(2 ** (used_bits or bits) - 1), first, step, count)


def _check_kind(kind: int, bits: int, compression: int) -> None:
    """Raise unless the images are monochrome, 8 or 16 bits, uncompressed."""
    if compression != 0:
        raise UnsupportedPixelsError(
            "compressed Norpix sequences are not supported; export it uncompressed or as TIFF"
        )
    if kind != _MONOCHROME or bits not in (8, 16):
        raise UnsupportedPixelsError(
            "only monochrome Norpix sequences of 8 or 16 bits are supported, "
            f"got image format {kind} of {bits} bits"
        )


def list_video(path: Path) -> range:
    """Numbers of the images; they are counted if the container does not state their number."""
    with _opened_video(path) as video:
        count = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
        if count > 0:
            return range(min(count, path.stat().st_size))  # an image takes a byte or more
        count = 0
        while video.grab():
            count += 1
        return range(count)


def read_video(path: Path, index: int) -> Pixels:
    """Image number ``index``, from 0, in red, green and blue."""
    with _opened_video(path) as video:
        check_size(int(video.get(cv2.CAP_PROP_FRAME_WIDTH)), int(video.get(cv2.CAP_PROP_FRAME_HEIGHT)))
        if index:
            video.set(cv2.CAP_PROP_POS_FRAMES, index)
        read, image = video.read()
    if not read:
        raise ValueError("the video is truncated or damaged at this image")
    if image.ndim == 3:
        image = image[..., ::-1]
    return Pixels(image, 255.0)


@contextmanager
def _opened_video(path: Path) -> Iterator[cv2.VideoCapture]:
    """The open video."""
    with _quiet():
        video = cv2.VideoCapture(str(path))
        try:
            if not video.isOpened():
                raise ValueError("the content is not that of a video that OpenCV can decode")
            yield video
        finally:
            video.release()


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress stderr, to which OpenCV and FFmpeg write directly."""
    with _lock, Path(os.devnull).open("wb") as nowhere:
        stderr = os.dup(2)
        os.dup2(nowhere.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
