"""Write figures and pictures to files."""

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from contactimg.files.atomic import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FIGURE_FORMATS = ("png", "svg", "pdf")
"""Formats of every figure."""


def write_figures(ax: "Axes", folder: str | Path, name: str, *, caption: str = "") -> None:
    """Write the figure that holds these axes as PNG, SVG and PDF, each completely or not at all.

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
        If a file cannot be written.

    Notes
    -----
    Without the time of writing and random names, so that the same figure has the same bytes.
    """
    for ending in FIGURE_FORMATS:
        with replacing(Path(folder, f"{name}.{ending}")) as part:
            part.write_bytes(figure_bytes(ax, ending, caption=caption))


def figure_bytes(ax: "Axes", kind: str, *, caption: str = "") -> bytes:
    """The figure that holds these axes as a file of a format of `FIGURE_FORMATS`; see `write_figures`."""
    import matplotlib as mpl  # noqa: PLC0415 - takes half a second, and most runs draw no axes

    figure: Any = ax.get_figure(root=True)
    undated: dict[str, Any] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind, {})
    metadata = undated | ({"Subject" if kind == "pdf" else "Description": caption} if caption else {})
    # the same figure has the same bytes, and text in PDF files stays text
    fixed: Any = {"svg.hashsalt": "contactimg", "pdf.fonttype": 42}
    with mpl.rc_context(fixed), BytesIO() as file:
        figure.savefig(file, format=kind, metadata=metadata)
        figure.set_layout_engine(None)  # to lay out what is laid out takes most of the time
        return file.getvalue()


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
    Compressed lightly: a picture is written for each frame.
    """
    with replacing(path) as part:
        image = Image.fromarray(indices, "P")
        image.putpalette(palette.tobytes())
        image.save(part, format="PNG", compress_level=1)
