"""Read PNG, JPEG and BMP, one image per file, recognised by the first bytes."""

import io
import struct
from pathlib import Path

import imagecodecs
import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from contactimg.files.grey import Pixels, UnsupportedPixelsError
from contactimg.files.limits import check_size

_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_SIZE = struct.Struct(">LL")  # at byte 16, in the chunk that every PNG begins with

Image.MAX_IMAGE_PIXELS = None  # `check_size` has the limit


def list_images(path: Path) -> range:  # noqa: ARG001 (every decoder has the same two functions)
    """Image 0 only: these formats hold one image."""
    return range(1)


def read_image(path: Path, index: int) -> Pixels:  # noqa: ARG001
    """Pixels as stored (an orientation tag is not applied), without transparency."""
    data = path.read_bytes()
    array = _decode_png(data) if data.startswith(_PNG) else _decode_other(data)
    return Pixels(array, float(np.iinfo(array.dtype).max))


def _decode_png(data: bytes) -> NDArray:
    """Grey or red-green-blue of a PNG, 8 or 16 bits; palettes are expanded."""
    check_size(*_PNG_SIZE.unpack(data[16:24].ljust(8, b"\0")))
    array = imagecodecs.png_decode(data)
    if array.ndim == 2:
        return array
    return array[..., 0] if array.shape[2] <= 2 else array[..., :3]


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
