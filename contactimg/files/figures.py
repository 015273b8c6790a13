"""Write figures and pictures to files."""

import struct
import zlib
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from imagecodecs import deflate_encode
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from contactimg.errors import InputError
from contactimg.files.atomic import replacing
from contactimg.timings import stage

FIGURE_FORMATS = ("png", "svg", "pdf")
"""Formats of every figure."""

FIXED_OUTPUT: Any = {"svg.hashsalt": "contactimg", "pdf.fonttype": 42}
"""Settings of matplotlib: the same figure has the same bytes, and text in PDF files stays text."""

UNDATED: dict[str, dict[str, Any]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
CAPTION_KEYS = {"pdf": "Subject"}
"""Metadata of the formats."""


def write_figures(ax: Axes, folder: str | Path, name: str, *, caption: str = "") -> None:
    """Write the figure that holds these axes as PNG, SVG and PDF.

    Parameters
    ----------
    ax : Axes
    folder : str or Path
        Exists.
    name : str
        File name without ending.
    caption : str
        Goes into the files.

    Raises
    ------
    InputError
        As `write_figure`.
    """
    for ending in FIGURE_FORMATS:
        write_figure(ax, Path(folder, f"{name}.{ending}"), caption=caption)


@stage("pictures")
def write_figure(ax: Axes, path: str | Path, *, caption: str = "") -> None:
    """Write the figure that holds these axes as PNG, SVG or PDF (by the extension), completely or not at all.

    Parameters
    ----------
    ax : Axes
    path : str or Path
        The file; its folder must exist.
    caption : str
        Goes into the file.

    Raises
    ------
    InputError
        If the axes belong to no figure, or the file cannot be written.

    Notes
    -----
    Without the time of writing and random names, so that the same figure has the same bytes.
    """
    path = Path(path)
    data = figure_bytes(ax, path.suffix.removeprefix("."), caption=caption)
    with replacing(path) as part:
        part.write_bytes(data)


def figure_bytes(ax: Axes, kind: str, *, caption: str = "") -> bytes:
    """The figure that holds these axes as a file of a format of `FIGURE_FORMATS`; see `write_figure`."""
    figure = ax.get_figure(root=True)
    if not isinstance(figure, Figure):
        raise InputError("the axes belong to no figure; draw them on one")
    metadata = UNDATED.get(kind, {}) | ({CAPTION_KEYS.get(kind, "Description"): caption} if caption else {})
    with mpl.rc_context(FIXED_OUTPUT), BytesIO() as file:
        figure.savefig(file, format=kind, metadata=metadata)
        return file.getvalue()


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
