"""Pixels of one image of a file: TIFF, stills, Norpix sequences and videos; and TIFF written losslessly.

What a header claims is checked before memory is taken. Stills hold one image each and are recognised by their
first bytes. Norpix sequences (``.seq``, StreamPix) are uncompressed and monochrome. Videos are read with
OpenCV.
"""

import io
import logging
import math
import os
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from itertools import islice, takewhile
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import imagecodecs
import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from contactimg.engine.progress import holding
from contactimg.files.atomic import replacing
from contactimg.files.tables import METRES
from contactimg.frame import Frame
from contactimg.scene.sections import MAX_PIXELS


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
    ValueError
        With the size.
    """
    if int(columns) * int(rows) * max(1, int(samples) // 4) > MAX_PIXELS:
        raise ValueError(
            f"its header says {int(columns)} x {int(rows)} pixels, more than {MAX_PIXELS}; "
            "if that is right, cut it into parts"
        )


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
    ValueError
        If the dtype has no grey level.

    Examples
    --------
    >>> to_grey(np.full((1, 2, 3), 200, np.uint8))
    array([[200., 200.]], dtype=float32)
    """
    types = [kind for kind in (np.uint8, np.uint16, np.float32, np.float64) if np.can_cast(array.dtype, kind)]
    if not types or array.dtype in (np.bool_, np.int64, np.uint64):  # which are not exact, or no grey levels
        raise ValueError(f"pixels of type {array.dtype} are not supported")
    exact = np.dtype(types[0])
    if array.ndim == 2:
        return np.ascontiguousarray(array, dtype=exact)
    wide = np.float64 if exact.itemsize > 4 else np.float32
    # ITU-R BT.601, as in OpenCV; the sum of the weights is 1, so grey stored as colour is kept
    return np.ascontiguousarray(array @ np.array([0.299, 0.587, 0.114]), dtype=wide)


# --- stills, Norpix sequences, videos

# magic, name, version, header size, description, nine fields of the images, frame rate, eight to compression
_HEADER = struct.Struct("<L24sll512s9Ld8L")
_lock = threading.Lock()  # stderr belongs to the whole process

Image.MAX_IMAGE_PIXELS = None  # `check_size` has the limit


def read_still(path: Path, _index: int) -> Pixels:
    """Pixels as stored (an orientation tag is not applied), without transparency."""
    data = path.read_bytes()
    try:
        with Image.open(io.BytesIO(data), formats=("PNG", "JPEG", "BMP")) as image:
            check_size(*image.size)
            if image.format == "PNG":  # Pillow would cut 16 bits of red, green and blue to 8
                array = imagecodecs.png_decode(data)
            elif image.mode in ("1", "L", "P", "RGB", "RGBA"):
                array = np.asarray(image.convert("L" if image.mode in ("1", "L") else "RGB"))
            else:
                raise ValueError(f"colours of type {image.mode} are not supported")
    except UnidentifiedImageError:
        raise ValueError("the content is not that of a PNG, JPEG or BMP image") from None
    if array.ndim > 2:
        array = array[..., 0] if array.shape[2] <= 2 else array[..., :3]
    return Pixels(array, float(np.iinfo(array.dtype).max))


def list_norpix(path: Path) -> range:
    """Numbers of the images that the header announces."""
    return range(len(_read_header(path)[0]))


def read_norpix(path: Path, index: int) -> Pixels:
    """Image number ``index``, from 0."""
    offsets, shape, dtype, full_scale = _read_header(path)
    pixels, offset = math.prod(shape), offsets[index]
    _refuse_missing(offset + pixels * dtype.itemsize - path.stat().st_size)
    array = np.fromfile(path, dtype, pixels, offset=offset).reshape(shape)
    return Pixels(array.astype(dtype.newbyteorder("=")), full_scale)


def _read_header(path: Path) -> tuple[range, tuple[int, int], np.dtype, float]:
    """Where the images of a sequence begin, their rows and columns, type of pixel and full scale.

    They must be of a kind that can be read: monochrome, 8 or 16 bits, uncompressed.
    """
    with path.open("rb") as file:
        head = file.read(_HEADER.size)
    if len(head) < _HEADER.size:
        raise ValueError("the file is too short for the header of a Norpix sequence")
    magic, _, version, _, _, *fields = _HEADER.unpack(head)
    if magic != 0xFEED:
        raise ValueError("the content is not that of a Norpix sequence")
    columns, rows, bits, used_bits, image_bytes, kind, count, _, step = fields[:9]
    if fields[-1] != 0:
        raise ValueError("compressed Norpix sequences are not supported; export it uncompressed or as TIFF")
    if kind != 100 or bits not in (8, 16):  # 100: monochrome
        got = f"image format {kind} of {bits} bits"
        raise ValueError(f"only monochrome Norpix sequences of 8 or 16 bits are supported, got {got}")
    # from version 5 on the images begin on a sector of 8192 bytes, before at 1024
    first = 8192 if version >= 5 else 1024
    check_size(columns, rows)
    if step <= 0 or used_bits > bits or image_bytes < rows * columns * bits // 8:
        raise ValueError("the header of the Norpix sequence contradicts itself")
    held = max((path.stat().st_size - first) // step, 0)
    # 0: a recording that was not closed properly; one number beyond the end stands for all that are lost
    count = min(count, held + 1) if count else held
    offsets = range(first, first + count * step, step)
    return offsets, (rows, columns), np.dtype(f"<u{bits // 8}"), float(2 ** (used_bits or bits) - 1)


def list_video(path: Path) -> range:
    """Numbers of the images; they are counted if the container does not state their number."""
    with _opened_video(path) as video:
        count = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
        if count > 0:
            return range(min(count, path.stat().st_size))  # an image takes a byte or more
        return range(sum(takewhile(bool, iter(video.grab, None))))


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
    """The open video; stderr, to which OpenCV and FFmpeg write directly, is suppressed."""
    with _lock, Path(os.devnull).open("wb") as nowhere:
        stderr, video = os.dup(2), cv2.VideoCapture()
        os.dup2(nowhere.fileno(), 2)
        try:
            if not video.open(str(path)):
                raise ValueError("the content is not that of a video that OpenCV can decode")
            yield video
        finally:
            video.release()
            os.dup2(stderr, 2)
            os.close(stderr)


# --- TIFF pages of any bit depth, byte order, compression and photometric type

LOSSLESS: dict[str, Any] = {"compression": "zlib", "predictor": True, "metadata": None, "software": False}
"""How tifffile writes grey levels or labels: the same image always gives the same bytes."""

_SMALLEST_PAGE = 18  # bytes of a page header with one tag (TIFF 6.0, section 2)
_PHOTOMETRIC = tifffile.PHOTOMETRIC
_SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")  # little and big endian, classic and BigTIFF
_complaints: ContextVar[list[str] | None] = ContextVar("complaints", default=None)


def _collect(record: logging.LogRecord) -> bool:
    """Collect what tifffile logs in a thread that is inside `_opened`, instead of printing it."""
    complaints = _complaints.get()
    if complaints is not None:
        complaints.append(record.getMessage())
    return complaints is None


# it stays: another thread would miss a complaint while a filter is removed
logging.getLogger("tifffile").addFilter(_collect)


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, list[str]]]:
    """The open file, and the messages that tifffile logs in this thread, which are not printed."""
    with path.open("rb") as file:
        if file.read(4) not in _SIGNATURES:
            raise ValueError("the content is not that of a TIFF image")
    complaints = list[str]()
    try:
        with holding(_complaints, complaints), tifffile.TiffFile(path) as tif:
            yield tif, complaints
    except (tifffile.TiffFileError, struct.error, IndexError) as error:  # the last: no pages
        raise ValueError(f"the file is truncated or damaged: {error}") from None


def list_tiff(path: Path) -> list[int]:
    """Numbers of the pages that are images, not thumbnails or masks.

    If the chain of pages is broken or a ring, one more number stands for the lost pages.
    """
    with _opened(path) as (tif, complaints):
        count = _images_of_one_page(tif)
        if count > 1:
            return list(range(count))
        most = tif.filehandle.size // _SMALLEST_PAGE + 1  # more only if the chain of pages is a ring
        numbered = enumerate(islice(tif.pages, most + 1))
        pages = [k for k, page in numbered if k == most or not (page.is_reduced or page.is_mask)]
        lost = any("TiffPages" in complaint for complaint in complaints)
        return [*pages, len(tif.pages)] if lost and most not in pages else pages


def read_tiff(path: Path, index: int) -> Pixels:
    """Pixels of page number ``index``, from 0, of a TIFF file."""
    with _opened(path) as (tif, _):
        several = _images_of_one_page(tif) > 1
        number = 0 if several else index
        if number > tif.filehandle.size // _SMALLEST_PAGE or not _has_page(tif, number):
            raise ValueError(f"the file is truncated or damaged after page {number - 1}")
        page, file = tif.pages[number], tif.filehandle
        sizes = [(page.imagewidth, page.imagelength, page.imagedepth)]
        sizes += [(page.tilewidth, page.tilelength, page.tiledepth)] if page.is_tiled else []
        for columns, rows, depth in sizes:
            check_size(columns, rows, max(page.samplesperpixel, 1) * max(depth, 1))
        if several and tif.is_imagej:  # the images follow each other without a gap
            start = page.dataoffsets[0] + index * page.nbytes
            _refuse_missing(start + page.nbytes - file.size)
            file.seek(start)
            pixels = file.read_array(page.dtype.newbyteorder(tif.byteorder), page.size)
            return _interpret(page, pixels.reshape(page.shape))
        segments = list(zip(page.dataoffsets, page.databytecounts, strict=True))
        if not segments or 0 in page.databytecounts:
            raise ValueError("the file is damaged: part of the image has no data")
        _refuse_missing(max(offset + count for offset, count in segments) - file.size)
        array = page.asarray()
        if several:
            array = array[index]
        elif page.axes == "SYX":
            array = np.moveaxis(array, 0, -1)
        return _interpret(page, array)


def _has_page(tif: Any, index: int) -> bool:
    """True if the chain of pages contains this one; later pages are not read."""
    with suppress(IndexError):
        return tif.pages[index] is not None
    return False


def _images_of_one_page(tif: Any) -> int:
    """Grey images of a stack that has one page for all; 1 for any other file.

    ImageJ beyond 4 GB writes one page header. tifffile, and with it imageio and scikit-image, takes an array
    of shape (3, rows, columns) for the planes of a colour image; colours that other programs store by planes
    have no description of an array.
    """
    page = tif.pages[0]
    if _has_page(tif, 1):
        return 1
    if tif.is_imagej and page.is_contiguous:
        stated = int((tif.imagej_metadata or {}).get("images", 1))
        # one number beyond the end of the file stands for all that are lost
        return min(stated, max(tif.filehandle.size // max(page.nbytes, 1), 1) + 1)
    planes = page.photometric == _PHOTOMETRIC.RGB and page.axes == "SYX" and tif.is_shaped
    return page.samplesperpixel if planes else 1


def _refuse_missing(count: int) -> None:
    """Raise if bytes are missing at the end of the file."""
    if count > 0:
        raise ValueError(f"the file is truncated: {count} bytes are missing")


def _interpret(page: Any, array: NDArray) -> Pixels:
    """Grey or red-green-blue, according to the photometric tag of the page; the full scale of the sensor."""
    if array.ndim > 2 and "S" not in page.axes:
        raise ValueError(f"an image with axes {page.axes} is not a plane of pixels")
    full_scale = float(2 ** int(np.max(page.bitspersample)) - 1) if array.dtype.kind in "bu" else None
    array = _strip_alpha(page, array)
    if array.dtype == bool:
        array, full_scale = array.astype(np.uint8) * np.uint8(255), 255.0
    tag = page.tags.get("MaxSampleValue")
    stated = 0 if tag is None or full_scale is None else int(np.max(tag.value))
    if full_scale is not None and 255 <= stated < full_scale and stated & (stated + 1) == 0:
        full_scale = float(stated)  # of an n-bit camera: all bits are 1
    if page.photometric == _PHOTOMETRIC.MINISWHITE:
        if full_scale is None:
            raise ValueError(f"inverted grey levels of type {array.dtype} are not supported")
        white = array.dtype.type(full_scale)
        array = white - np.minimum(array, white)
    return Pixels(array.astype(array.dtype.newbyteorder("="), copy=False), full_scale)


def _strip_alpha(page: Any, array: NDArray) -> NDArray:
    """Grey or red-green-blue without transparency; any other set of channels has no grey level."""
    jpeg = tifffile.COMPRESSION.JPEG, tifffile.COMPRESSION.OJPEG  # its decoder makes red, green and blue
    grey = page.photometric in (_PHOTOMETRIC.MINISBLACK, _PHOTOMETRIC.MINISWHITE)
    decoded = page.photometric == _PHOTOMETRIC.YCBCR and page.compression in jpeg
    if not (grey or decoded or page.photometric == _PHOTOMETRIC.RGB):
        name = getattr(page.photometric, "name", page.photometric)
        raise ValueError(f"pixels of photometric type {name} are not supported: save it as grey levels")
    if array.ndim == 2:
        return array
    channels = 1 if grey else 3
    extra = array.shape[-1] - channels
    alpha = tifffile.EXTRASAMPLE.ASSOCALPHA, tifffile.EXTRASAMPLE.UNASSALPHA
    transparent = bool(page.extrasamples) and page.extrasamples[-1] in alpha
    if extra < 0 or extra > 1 or (grey and extra == 1 and not transparent):
        raise ValueError(f"{array.shape[-1]} channels are neither grey nor red-green-blue")
    return array[..., 0] if grey else array[..., :3]


def write_frame(frame: Frame, path: Path) -> None:
    """Write a frame as a losslessly compressed TIFF (deflate) that keeps dtype and full scale.

    Parameters
    ----------
    frame : Frame
        Pixels and full scale; the name is not stored.
    path : Path
        The file, written completely or not at all.

    Notes
    -----
    The full scale of integers (4095 for 12 bits in 16) is stored as MaxSampleValue, which the reader uses.
    The same frame always gives the same bytes.
    """
    scale, integer = frame.full_scale, frame.image.dtype.kind == "u"
    # 281: MaxSampleValue (TIFF 6.0, section 8)
    tags = [(281, "H", 1, int(scale), True)] if integer and scale is not None else []
    with replacing(path) as part:
        tifffile.imwrite(part, frame.image, extratags=tags, **LOSSLESS)


# --- the pixel size that a header states


def stated_pixel_size(path: str | Path) -> tuple[float, float] | None:
    """Width and height of a pixel (m) that a TIFF file of ImageJ or OME states.

    None where nothing or an unknown unit is stated. The resolution of plain TIFF files is ignored: it is that
    of a print (72 or 300 dots per inch).

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "frame.tif"
    ...     pixels = np.zeros((8, 8), np.uint8)
    ...     tifffile.imwrite(path, pixels, imagej=True, resolution=(0.125, 0.125), metadata={"unit": "um"})
    ...     stated_pixel_size(path)
    (8e-06, 8e-06)
    """
    with suppress(Exception), _opened(Path(path)) as (tif, _):  # nor does another format or a damaged header
        if tif.is_ome:  # of the first image, in µm unless its unit says otherwise
            image = tifffile.xml2dict(tif.ome_metadata or "")["OME"]["Image"]
            about = (image[0] if isinstance(image, list) else image)["Pixels"]
            axes = "XY" if "PhysicalSizeY" in about else "XX"
            sides = [(about[f"PhysicalSize{x}"], about.get(f"PhysicalSize{x}Unit", "µm")) for x in axes]
        else:  # pixels per unit stand in the resolution, the unit in the description
            tags, about = tif.pages.first.tags, tif.imagej_metadata or {}
            rates = [tags[name].value for name in ("XResolution", "YResolution")]
            names = (about["unit"], about.get("yunit", about["unit"]))
            sides = [(units / pixels, name) for (pixels, units), name in zip(rates, names, strict=True)]
        width, height = (float(number) * METRES[str(unit).lower()] for number, unit in sides)
        if 0 < width < math.inf and 0 < height < math.inf:
            return width, height
    return None
