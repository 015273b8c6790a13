"""Height maps of profilometers: plain matrices and float TIFF."""

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from contactimg.errors import InputError
from contactimg.files.atomic import naming
from contactimg.files.decoders import check_size, list_tiff, read_tiff, stated_pixel_size
from contactimg.files.tables import read_text
from contactimg.summits import HeightMap

Values = NDArray[np.float64]


def read_height_map(path: str | Path, *, pixel_size: float | None, height_unit: float | None) -> HeightMap:
    """Read a height map.

    Parameters
    ----------
    path : str or Path
        ``.npy``; a matrix as text, one line a row, values divided by spaces, tabs, commas or semicolons, with
        ``nan`` or an empty cell where nothing was measured; or a TIFF of one channel.
    pixel_size : float or None
        Distance between neighbouring values, m, in place of what the file says.
    height_unit : float or None
        What a height of 1 means, m; no file says it.

    Returns
    -------
    HeightMap

    Raises
    ------
    InputError
        If the file cannot be read, holds no matrix, or pixel size or unit of height are stated nowhere.
    """
    path = Path(path)
    heights = _plain_matrix(path)
    if height_unit is None:
        raise InputError(f"{path}: does not say the unit of its heights; state it with --height-unit")
    sides = (pixel_size, pixel_size) if pixel_size else stated_pixel_size(path)
    if sides is None:
        raise InputError(f"{path}: does not say its pixel size; state it with --pixel-size-um")
    with naming(path):
        return HeightMap(np.where(np.isfinite(heights), heights, np.nan) * height_unit, sides)


def _plain_matrix(path: Path) -> Values:
    """The numbers of a plain matrix."""
    suffix = path.suffix.lower()
    text = read_text(path) if suffix in (".txt", ".csv", ".dat", ".asc", ".tsv", ".xyz") else None
    try:
        if text is not None:
            return _text_matrix(text)
        if suffix == ".npy":
            array = np.load(path, allow_pickle=False)
        elif suffix in (".tif", ".tiff"):
            count = len(list_tiff(path))
            if count != 1:
                raise ValueError(f"it holds {count} pages; a height map has one")
            array = read_tiff(path, 0).array
        else:
            raise ValueError("save it as .npy, text or TIFF")
        if array.ndim != 2 or array.dtype.kind not in "fiu":
            got = f"{array.dtype} of the shape {array.shape}"
            raise ValueError(f"it must hold one matrix of numbers, got {got}")
        check_size(array.shape[1], array.shape[0])
        return array.astype(np.float64)
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{path}: cannot be read as a height map ({error})") from None


def _text_matrix(text: str) -> Values:
    """A matrix as text."""
    first = next((line for line in text.splitlines() if line.strip() and not line.startswith("#")), "")
    if not first:
        raise ValueError("it holds no number")
    cells = first.split()
    spaced = len(cells) > 1 and not any("," in (cell[0], cell[-1]) for cell in cells)
    separator = next((mark for mark in ("\t", ";") if mark in first), None if spaced else ",")
    if separator != "," and "." not in first:
        text = text.replace(",", ".")  # decimal commas
    try:
        matrix = np.genfromtxt(io.StringIO(text), delimiter=separator, loose=False, ndmin=2)
    except ValueError as error:
        first = str(error).splitlines()[:2][-1].strip()  # below its heading; one line of text a row
        raise ValueError(f"{first}; begin lines that are no row of heights with #") from None
    if separator and np.isnan(matrix[:, -1]).all():  # a separator at the end of each line
        matrix = matrix[:, :-1]
    return matrix
