"""Read Norpix sequences (``.seq`` of StreamPix), uncompressed monochrome."""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from contactimg.files.grey import Pixels, UnsupportedPixelsError
from contactimg.files.limits import check_size

# magic, name, version, header size, description, nine fields of the images, frame rate, eight to compression
_HEADER = struct.Struct("<L24sll512s9Ld8L")
_MAGIC = 0xFEED
_MONOCHROME = 100


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


def list_images(path: Path) -> range:
    """Numbers of the images that the header announces."""
    return range(_read_layout(path).count)


def read_image(path: Path, index: int) -> Pixels:
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
