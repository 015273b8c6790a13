"""Embed images and figures as data in the page, so that it needs no other file."""

import base64
import io
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from contactimg.errors import InputError

JPEG_QUALITY = 82
"""Quality of the compressed pictures, 0 to 100.

Chosen: outlines stay sharp. JPEG, because browsers print it as it is and other formats without compression.
"""
LEAST_WIDTH_PX = 480
"""Pictures are not made narrower. Chosen: the screen of a phone."""
ATTEMPTS = 4


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


@dataclass(frozen=True)
class PictureEmbedder:
    """Embeds pictures of frames, each of a limited size.

    Parameters
    ----------
    most_bytes : int
        Of a picture; what exceeds it is made smaller, down to `LEAST_WIDTH_PX`.
    """

    most_bytes: int

    def embed(self, path: Path, *, caption: str) -> Picture:
        """Embed a picture, compressed as JPEG.

        Raises
        ------
        InputError
            If the file is no image that can be read.
        """
        try:
            with Image.open(path) as file:
                image = file.convert("RGB")
        except OSError as error:
            raise InputError(f"{path}: cannot be read as an image ({error})") from None
        return Picture(caption, data_uri("image/jpeg", self._compressed(image)))

    def _compressed(self, image: Image.Image) -> bytes:
        """The picture as JPEG, smaller if it takes too much."""
        width, content = image.width, _as_jpeg(image)
        for _ in range(ATTEMPTS):
            if len(content) <= self.most_bytes or width <= LEAST_WIDTH_PX:
                break
            width = max(LEAST_WIDTH_PX, int(0.95 * width * (self.most_bytes / len(content)) ** 0.5))
            height = round(image.height * width / image.width)
            content = _as_jpeg(image.resize((width, height), Image.Resampling.LANCZOS))
        return content


def _as_jpeg(image: Image.Image) -> bytes:
    """An image as JPEG with colours at full resolution, so that thin lines keep theirs."""
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=JPEG_QUALITY, subsampling=0, optimize=True)
    return buffer.getvalue()


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
