"""Corrections: of the pixels of each frame when it is read, and of contacts by hand (edits.csv).

A dark frame is subtracted and the result divided by the flat field (minus the dark frame, over its median);
frames and reference alike. Masked pixels of a frame become NaN, which every measurement leaves out.
"""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import FrameError, InputError, finite_number
from contactimg.files.atomic import first_names, flush_to_disk, naming, read_bytes, write_text
from contactimg.files.sources import FrameSource
from contactimg.files.tables import read_table, read_text_table
from contactimg.frame import Frame
from contactimg.scene.sections import MaskArea
from contactimg.tables import EDITS
from contactimg.tables.outlines import Outline

Points = tuple[tuple[float, float], ...]
Sources = tuple[FrameSource, ...]
Changes = tuple[tuple[int, int], ...]

EVERY_FRAME = "*"
"""In place of the name of a frame: all of them."""


@dataclass(frozen=True)
class MaskedArea:
    """An area to leave out.

    Parameters
    ----------
    frame : str
        Name of the frame; ``*`` for all.
    path : Path or None
        An image whose pixels other than 0 are masked, or a file of ImageJ regions.
    points : tuple of (float, float)
        Corners of a polygon, px, if there is no file.
    """

    frame: str
    path: Path | None = None
    points: Points = ()


@dataclass(frozen=True)
class PixelCorrections:
    """The corrections of the pixels of a frame; callable on a `Frame`.

    Parameters
    ----------
    dark, flat : tuple of FrameSource
        Images whose mean is subtracted, and divided by.
    areas : tuple of MaskedArea
        To leave out.
    number : int
        Of the frame, from 1, to which regions of a stack refer; 0 for none.
    masked : bool
        Whether an area of any frame is left out: then no frame keeps its type of pixel.
    """

    dark: Sources = ()
    flat: Sources = ()
    areas: tuple[MaskedArea, ...] = ()
    number: int = 0
    masked: bool = False

    def __bool__(self) -> bool:
        return bool(self.dark or self.flat or self.masked)

    def of_frame(self, name: str, number: int) -> "PixelCorrections":
        """Select the areas of one frame; the reference has none, since a frame leaves out what it hides."""
        areas = tuple(area for area in self.areas if name and area.frame in (EVERY_FRAME, name))
        return replace(self, areas=areas, number=number if areas else 0) if self.masked else self

    def __call__(self, frame: Frame) -> Frame:
        """The corrected frame.

        Raises
        ------
        FrameError
            If an image has another size than the frame.
        """
        if self.dark or self.flat:
            frame = _subtract_and_divide(frame, self.dark, self.flat)
        if not self.masked:
            return frame
        image = frame.image if frame.image.dtype.kind == "f" else frame.image.astype(np.float32)
        for area in self.areas:
            image = np.where(_covered(area, self.number, frame), np.float32(np.nan), image)
        return replace(frame, image=image)


def find_areas(masks: Mapping[str, MaskArea], folder: Path, names: Sequence[str]) -> tuple[MaskedArea, ...]:
    """Find and check the masks that a scene names.

    Parameters
    ----------
    masks : mapping
        Name of a frame or ``*`` -> a file or polygons.
    folder : Path
        Folder that relative paths refer to.
    names : sequence of str
        Names of the frames.

    Raises
    ------
    InputError
        If a file is missing or not valid, or a mask is for a frame that is not there.
    """
    unknown = [frame for frame in masks if frame not in (EVERY_FRAME, *names)]
    if unknown:
        some = first_names(names)
        raise InputError(f"[images] mask: there is no frame {unknown[0]!r}; the frames are {some}")
    areas = []
    for frame, mask in masks.items():
        if isinstance(mask, str):
            path = folder / mask
            if not path.is_file():
                raise InputError(f"{path}: the scene names this mask, but there is no such file")
            with naming("[images] mask"):
                _mask(path, _changes([path]))  # a mistake is found before any frame is measured
            areas.append(MaskedArea(frame, path))
        else:
            areas += [MaskedArea(frame, points=tuple((x, y) for x, y in corners)) for corners in mask]
    return tuple(areas)


def _changes(paths: Iterable[Path]) -> Changes:
    """When files were changed last: what is kept of them holds until then, also in a long session."""
    statuses = (path.stat() for path in paths)
    return tuple((status.st_mtime_ns, status.st_ino) for status in statuses)


@lru_cache(maxsize=16)
def _mask(path: Path, _changed: Changes) -> Frame | list[Any]:
    """The pixels of a mask, or the regions of an ImageJ file."""
    if path.suffix.lower() in (".roi", ".zip"):
        from contactimg.files.exports import read_regions  # noqa: PLC0415 - most runs have no mask

        return read_regions(path)
    return FrameSource(path.name, path).read()


def _mean(sources: Sources) -> Frame:
    """Mean of images of one size, with name and full scale of the first."""
    frames = (source.read() for source in sources)
    first = next(frames)
    total = first.image.astype(float)
    for frame in frames:
        _check_size(frame, first)
        total += frame.image
    return replace(first, image=np.asarray(total / len(sources), np.float32))


def _covered(area: MaskedArea, number: int, frame: Frame) -> NDArray[np.bool_]:
    """Masked pixels of a frame: those other than 0 of an image, or with their centres in a polygon."""
    polygons: list[NDArray] = [np.array(area.points)]
    if area.path is not None:
        mask = _mask(area.path, _changes([area.path]))
        if isinstance(mask, Frame):
            _check_size(mask, frame)
            return np.asarray(mask.image != 0)
        polygons = [region.polygon[:-1] for region in mask if region.image in (0, number)]
    from skimage.draw import polygon  # noqa: PLC0415 - most runs have no such mask

    out = np.zeros(frame.shape, np.bool_)
    for corners in polygons:
        x, y = corners.T
        out[polygon(y, x, frame.shape)] = True
    return out


def _check_size(image: Frame, frame: Frame) -> None:
    """Raise if an image has another size than the frame."""
    if image.shape != frame.shape:
        raise FrameError(
            f"{image.name} has {image.shape[1]} x {image.shape[0]} pixels, the frame {frame.name} has "
            f"{frame.shape[1]} x {frame.shape[0]}; it must have the size of the frames"
        )


@lru_cache(maxsize=2)
def _fields(darks: Sources, flats: Sources, _changed: Changes) -> tuple[NDArray, NDArray, float, NDArray]:
    """The mean dark frame, the gain (flat field over its median), the dark level, and useless pixels.

    Those are saturated in the dark or without light.
    """
    first = _mean(darks or flats)
    dark = first.image if darks else np.zeros(first.shape, np.float32)
    useless = dark >= (np.inf if first.full_scale is None else first.full_scale)
    gain = np.ones(first.shape, np.float32)
    if flats:
        flat = _mean(flats) if darks else first
        _check_size(flat, first)
        light = flat.image - dark
        middle = float(np.median(light))
        if not middle > 0:
            raise FrameError(f"{flat.name} is not brighter than the dark frame; it must show light")
        gain = light / np.float32(middle)
        useless |= gain < 0.05  # chosen by hand: noise there is 20 times that of the other pixels
        gain[useless] = 1.0
    return dark, gain, float(np.median(dark)), useless


def _subtract_and_divide(frame: Frame, darks: Sources, flats: Sources) -> Frame:
    """The frame without the dark frame, over the flat field.

    Each pixel now saturates at a level of its own, so saturated pixels get one level above all others, the
    new full scale. A frame with one value everywhere keeps one value: black stays black.
    """
    changed = _changes(source.path for source in (*darks, *flats))
    dark, gain, level, useless = _fields(darks, flats, changed)
    _check_size(Frame(gain, (darks or flats)[0].name), frame)
    scale = np.inf if frame.full_scale is None else frame.full_scale
    raw = frame.image
    if raw.min() == raw.max() and raw[0, 0] < scale:
        return replace(frame, image=np.full(frame.shape, max(float(raw[0, 0]) - level, 0.0), np.float32))
    image, full_scale = (raw.astype(np.float32) - dark) / gain, None
    if frame.full_scale is not None:
        top = np.float32(max(float(np.max(image[~useless], initial=0.0)), frame.full_scale - level))
        full_scale = float(np.nextafter(top, np.float32(np.inf)))
        image[raw >= frame.full_scale] = full_scale
    image[useless] = np.nan
    return Frame(image, frame.name, full_scale)


# --- corrections by hand

EDITS_FILE = "edits.csv"
"""Name of the table of corrections in a folder of frames."""

MASK = "mask"

# action -> the fewest points that it takes, if any
_ACTIONS = {"exclude": 0, "add": 0, "split": 2, "merge": 2, MASK: 3}


def read_edits(path: str | Path) -> pd.DataFrame:
    """Read corrections by hand.

    Parameters
    ----------
    path : str or Path
        CSV with the columns of `contactimg.tables.EDITS`; frame and action in every row.

    Returns
    -------
    DataFrame
        Columns of `contactimg.tables.EDITS`, rows in order.

    Raises
    ------
    InputError
        For a missing column, an unknown action, or a row that lacks what its action needs.
    """
    table = read_table(path, EDITS, required=("frame", "action"))
    for name in ("frame", "action"):
        table[name] = table[name].str.strip()
    check_edits(table, str(path))
    return table


def check_edits(table: pd.DataFrame, name: str) -> None:
    """Raise `InputError` for an unknown action or a row that lacks what its action needs."""
    for number, row in enumerate(table.to_dict("records"), start=1):
        if complaint := _complaint(row):
            raise InputError(f"{name}: row {number} ({row['action']}) {complaint}")


def edit_points(text: str) -> Points:
    """Points of a cell ``x y;x y;...``.

    Raises
    ------
    ValueError
        If it has another form.

    Examples
    --------
    >>> edit_points("1 2;3.5 4")
    ((1.0, 2.0), (3.5, 4.0))
    """
    pairs = [pair.split() for pair in text.split(";") if pair.strip()]
    return tuple((finite_number(x, "x", "px"), finite_number(y, "y", "px")) for x, y in pairs)


def masked_areas(edits: pd.DataFrame) -> tuple[MaskedArea, ...]:
    """The areas that the edits mask."""
    areas = []
    for row in edits[edits["action"] == MASK].to_dict("records"):
        disk = Outline(0, row["x_px"], row["y_px"], row["radius_px"], row["radius_px"])
        points = edit_points(row["points"]) or tuple(map(tuple, disk.polygon[:-1].tolist()))
        areas.append(MaskedArea(row["frame"], points=points))
    return tuple(areas)


def _complaint(row: dict) -> str:
    """A sentence on what a row lacks; empty if nothing."""
    action = row["action"]
    if action not in _ACTIONS:
        return f"has an unknown action; the actions are {', '.join(_ACTIONS)}"
    try:
        points = edit_points(row["points"])
    except ValueError:
        return f"must have points of the form 'x y;x y', got {row['points']!r}"
    fewest = _ACTIONS[action]
    if (points and len(points) < fewest) or (action == "merge" and not points):
        return f"needs at least {fewest} points, got {len(points)}"
    place = bool(np.isfinite([row["x_px"], row["y_px"]]).all())
    if action != "merge" and not (place or (action == MASK and points)):
        return "needs x_px and y_px"
    if (action == "add" or (action == MASK and not points)) and not row["radius_px"] > 0:
        return f"needs a positive radius_px, got {row['radius_px']:g}"
    return ""


@dataclass(frozen=True)
class EditsFile:
    """The table of corrections by hand in a file, which need not exist yet.

    Parameters
    ----------
    path : Path

    Notes
    -----
    Every change reads the file, so that rows written by other programs are kept, writes it whole or not at
    all, and returns when it is on the disk.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> row = pd.DataFrame([{"frame": "a.tif", "action": "exclude", "x_px": 3.0, "y_px": 4.5}])
    >>> with TemporaryDirectory() as folder:
    ...     edits = EditsFile(Path(folder) / "edits.csv")
    ...     edits.insert(row)
    ...     edits.path.read_text().splitlines()[1]
    'a.tif,exclude,3.0,4.5,,,,,'
    """

    path: Path

    def read(self) -> pd.DataFrame:
        """Columns of `contactimg.tables.EDITS`; no row without a file."""
        return read_edits(self.path) if self.path.exists() else EDITS.empty()

    @property
    def version(self) -> str:
        """Another one after each change of the file; empty without a file."""
        return hashlib.sha256(read_bytes(self.path)).hexdigest()[:16] if self.path.exists() else ""

    def insert(self, rows: pd.DataFrame, place: int | None = None) -> None:
        """Add rows, before row ``place`` (from 0) or at the end.

        Raises
        ------
        InputError
            If a row lacks what its action needs, or the file cannot be read or written.
        """
        rows = EDITS.conform(rows)
        check_edits(rows, self.path.name)
        new = rows.astype(object).where(rows.notna(), "").astype("str")
        separator, cells = self._cells()
        place = len(cells) if place is None else place
        self._write(separator, pd.concat([cells[:place], new, cells[place:]]).fillna(""))

    def remove(self, place: int) -> None:
        """Take out row ``place`` (from 0), which must be there."""
        separator, cells = self._cells()
        self._write(separator, cells.drop(index=place))

    def _cells(self) -> tuple[str, pd.DataFrame]:
        """Separator and cells of the file, which must be valid; columns of other programs are kept."""
        if not self.path.exists():
            return ",", EDITS.empty().astype("str")
        self.read()
        return read_text_table(self.path, EDITS)

    def _write(self, separator: str, cells: pd.DataFrame) -> None:
        """Replace the file."""
        write_text(cells.to_csv(sep=separator, index=False, lineterminator="\n"), self.path)
        flush_to_disk(self.path)
