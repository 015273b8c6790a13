"""Write figures and pictures to files."""

import struct
import zlib
from pathlib import Path

import numpy as np
from imagecodecs import deflate_encode
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from contactimg.errors import InputError
from contactimg.files.atomic import replacing
from contactimg.timings import stage


@stage("pictures")
def write_figure(ax: Axes, path: str | Path) -> None:
    """Write the figure that holds these axes as PNG, SVG or PDF (by the extension), completely or not at all.

    Parameters
    ----------
    ax : Axes
    path : str or Path
        The file; its folder must exist.

    Raises
    ------
    InputError
        If the axes belong to no figure, or the file cannot be written.
    """
    figure = ax.get_figure(root=True)
    if not isinstance(figure, Figure):
        raise InputError(f"{path}: the axes belong to no figure; draw them on one")
    with replacing(path) as part:
        figure.savefig(part, format=Path(path).suffix.removeprefix("."))


@stage("pictures")
def write_palette_image(indices: NDArray[np.uint8], palette: NDArray[np.uint8], path: str | Path) -> None:
    """Write an image of palette indices as PNG, completely or not at all.

    Parameters
    ----------
    indices : ndarray of uint8, shape (rows, columns)
    palette : ndarray of uint8, shape (k, 3)
        Red, green and blue of each index.
    path : str or Path

    Notes
    -----
    Level 1 of libdeflate; Pillow's zlib takes several times as long.
    """
    rows, columns = indices.shape
    lines = np.zeros((rows, columns + 1), np.uint8)  # each begins with its filter: none
    lines[:, 1:] = indices
    header = struct.pack(">IIBBBBB", columns, rows, 8, 3, 0, 0, 0)
    chunks = {
        b"IHDR": header,
        b"PLTE": palette.tobytes(),
        b"IDAT": deflate_encode(lines.tobytes(), level=1),
        b"IEND": b"",
    }
    with replacing(path) as part, part.open("wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        for name, data in chunks.items():
            check = zlib.crc32(data, zlib.crc32(name))
            file.write(struct.pack(">I", len(data)) + name + data + struct.pack(">I", check))
