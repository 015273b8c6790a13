"""Embed images and figures as data in the page, so that it needs no other file."""

import base64
import io
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from contactimg.errors import InputError

WEBP_QUALITY = 85
"""Quality of the compressed pictures, 0 to 100.

Chosen: outlines stay sharp, and a frame of 2 megapixels takes about half a megabyte.
"""


@dataclass(frozen=True)
class Picture:
    """An image in the page.

    Parameters
    ----------
    caption : str
        Plain text.
    source : str
        Data URI.
    """

    caption: str
    source: str


def embed_picture(path: Path, *, caption: str) -> Picture:
    """Embed a picture of a frame, compressed as WebP.

    Raises
    ------
    InputError
        If the file is no image that can be read.
    """
    buffer = io.BytesIO()
    try:
        with Image.open(path) as image:
            image.convert("RGB").save(buffer, "WEBP", quality=WEBP_QUALITY)
    except OSError as error:
        raise InputError(f"{path}: cannot be read as an image ({error})") from None
    return Picture(caption, data_uri("image/webp", buffer.getvalue()))


def embed_figure(path: Path, *, caption: str) -> Picture:
    """Embed a figure (PNG or SVG) unchanged."""
    kinds = {".png": "image/png", ".svg": "image/svg+xml"}
    try:
        return Picture(caption, data_uri(kinds[path.suffix], path.read_bytes()))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None


def data_uri(kind: str, content: bytes) -> str:
    """Content as a data URI."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"
