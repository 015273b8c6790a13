"""Height maps of profilometers: plain matrices, float TIFF, and whatever SurfaceTopography reads."""

import io
import warnings
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from contactimg.errors import InputError
from contactimg.files.decoders import check_size
from contactimg.files.tiff import METRES, stated_pixel_size
from contactimg.summits import HeightMap

Values = NDArray[np.float64]

TEXT = (".txt", ".csv", ".dat", ".asc", ".tsv", ".xyz")
"""Extensions of files that may hold a matrix as text."""

INSTALL = 'pip install "contactimg[maps]"'


def read_height_map(
    path: str | Path, *, pixel_size: float | None = None, height_unit: float | None = None
) -> HeightMap:
    """Read a height map.

    Parameters
    ----------
    path : str or Path
        ``.npy``; a matrix as text, one line a row, values divided by spaces, tabs, commas or semicolons, with
        ``nan`` or an empty cell where nothing was measured; a TIFF of one channel; or a file of an instrument
        that SurfaceTopography reads (extra ``maps``).
    pixel_size : float, optional
        Distance between neighbouring values, m, in place of what the file says.
    height_unit : float, optional
        What a height of 1 means, m, in place of what the file says.

    Returns
    -------
    HeightMap

    Raises
    ------
    InputError
        If the file cannot be read, holds no matrix, or pixel size or unit of height are stated nowhere.
    """
    path = Path(path)
    heights, unit, steps = _plain_matrix(path), None, None
    if heights is None:
        heights, unit, steps = _of_instrument(path)
    unit = height_unit or unit
    if unit is None:
        raise InputError(f"{path}: does not say the unit of its heights; state it with --height-unit")
    pixel = pixel_size or (None if steps else stated_pixel_size(path))
    steps = steps if pixel is None else (pixel, pixel)
    if steps is None:
        raise InputError(f"{path}: does not say its pixel size; state it with --pixel-size-um")
    try:
        return HeightMap(np.where(np.isfinite(heights), heights, np.nan) * unit, steps)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _plain_matrix(path: Path) -> Values | None:
    """The numbers of a plain matrix; None if the file is of another kind."""
    suffix = path.suffix.lower()
    try:
        if suffix == ".npy":
            return _real(path, np.load(path, allow_pickle=False))
        if suffix in (".tif", ".tiff"):
            return _real(path, _tiff(path))
        return _text_matrix(path) if suffix in TEXT else None
    except (OSError, ValueError, EOFError, tifffile.TiffFileError) as error:
        raise InputError(f"{path}: cannot be read as a height map ({error})") from None


def _real(path: Path, array: NDArray) -> Values:
    """A matrix of numbers as float64."""
    if array.ndim != 2 or array.dtype.kind not in "fiu":
        raise InputError(
            f"{path}: must hold one matrix of numbers, got {array.dtype} of the shape {array.shape}"
        )
    check_size(array.shape[1], array.shape[0])
    return array.astype(np.float64)


def _tiff(path: Path) -> NDArray:
    """The first page of a TIFF file, if it is the only one."""
    with tifffile.TiffFile(path) as tif:
        if len(tif.pages) != 1:
            raise InputError(f"{path}: holds {len(tif.pages)} pages; a height map has one")
        page = tif.pages.first
        check_size(page.imagewidth, page.imagelength, page.samplesperpixel)
        return page.asarray()


def _text_matrix(path: Path) -> Values | None:
    """A matrix as text; None if a line is no row of numbers or lines differ in length."""
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    first = next((line for line in text.splitlines() if line.strip() and not line.startswith("#")), "")
    separator = next((mark for mark in ("\t", ";", ",") if mark in first), None)
    if separator in ("\t", ";") and "." not in first:
        text = text.replace(",", ".")  # decimal commas
    try:
        matrix = np.genfromtxt(io.StringIO(text), delimiter=separator, loose=False, ndmin=2)
    except ValueError:
        return None
    if separator and np.isnan(matrix[:, -1]).all():  # a separator at the end of each line
        matrix = matrix[:, :-1]
    return matrix if len(matrix) > 1 and matrix.shape[1] > 3 else None


def _of_instrument(path: Path) -> tuple[Values, float | None, tuple[float, float] | None]:
    """Heights that SurfaceTopography reads, their unit and the pixel sizes along x and y (m) where stated."""
    try:
        import SurfaceTopography  # noqa: PLC0415
    except ImportError:
        raise InputError(
            f"{path}: is neither a matrix of numbers (.npy, text) nor a TIFF; to read files of instruments: "
            f"{INSTALL}"
        ) from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            surface = SurfaceTopography.read_topography(str(path))
            heights = np.ma.filled(np.ma.asarray(surface.heights(), dtype=np.float64), np.nan)
    except Exception as error:  # each of its readers raises errors of its own
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise InputError(f"{path}: cannot be read as a height map ({reason})") from None
    if heights.ndim != 2:
        raise InputError(f"{path}: holds a line profile; summits need a map")
    metres = METRES.get(str(surface.unit))
    sizes, counts = surface.physical_sizes, surface.nb_grid_pts
    steps = None
    if sizes is not None and metres is not None:
        steps = metres * sizes[0] / counts[0], metres * sizes[1] / counts[1]
    return heights.T, metres, steps
