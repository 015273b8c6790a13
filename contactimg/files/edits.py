"""Corrections by hand, edits.csv: read and checked, and written."""

import hashlib
import io
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from contactimg.errors import InputError
from contactimg.files.atomic import flush_to_disk, write_text
from contactimg.files.corrections import EVERY_FRAME, MaskedArea
from contactimg.files.csv_tables import read_table, read_text_table, text_of_rows, write_table
from contactimg.files.imagej import Region
from contactimg.tables import EDITS

EDITS_FILE = "edits.csv"
"""Name of the table of corrections in a folder of frames."""

MASK = "mask"

_FEWEST_POINTS = {"merge": 2, "split": 2, MASK: 3}

_ACTIONS = ("exclude", "add", "split", "merge", MASK)


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
        complaint = _complaint(row)
        if complaint:
            raise InputError(f"{name}: row {number} ({row['action']}) {complaint}")


def write_edits(table: pd.DataFrame, path: str | Path) -> None:
    """Write corrections by hand, whole or not at all."""
    write_table(table, EDITS, path)


def edit_points(text: str) -> tuple[tuple[float, float], ...]:
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
    points = []
    for pair in filter(None, (part.strip() for part in text.split(";"))):
        x, y = (float(number) for number in pair.split())
        if not (math.isfinite(x) and math.isfinite(y)):
            raise ValueError(text)
        points.append((x, y))
    return tuple(points)


def masked_areas(edits: pd.DataFrame) -> tuple[MaskedArea, ...]:
    """The areas that the edits mask."""
    areas = []
    for row in edits[edits["action"] == MASK].to_dict("records"):
        points = edit_points(row["points"])
        if not points:
            disk = Region("", row["x_px"], row["y_px"], row["radius_px"], row["radius_px"])
            points = tuple((float(x), float(y)) for x, y in disk.outline)
        areas.append(MaskedArea(row["frame"], points=points))
    return tuple(areas)


def _complaint(row: dict) -> str:
    """What a row lacks; empty if nothing."""
    action = row["action"]
    if action not in _ACTIONS:
        return f"has an unknown action; the actions are {', '.join(_ACTIONS)}"
    if not row["frame"]:
        return f"names no frame; give its file name, or {EVERY_FRAME} for all"
    try:
        points = edit_points(row["points"])
    except ValueError:
        return f"must have points of the form 'x y;x y', got {row['points']!r}"
    fewest = _FEWEST_POINTS.get(action, 0)
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
        try:
            return hashlib.sha256(self.path.read_bytes()).hexdigest()[:16]
        except FileNotFoundError:
            return ""
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read ({error.strerror})") from None

    def insert(self, rows: pd.DataFrame, place: int | None = None) -> None:
        """Add rows, before row ``place`` (from 0) or at the end.

        Raises
        ------
        InputError
            If a row lacks what its action needs, or the file cannot be read or written.
        """
        rows = EDITS.conform(rows)
        check_edits(rows, self.path.name)
        text = io.StringIO(text_of_rows(rows, EDITS), newline="")
        new = pd.read_csv(text, names=[*EDITS.columns], dtype="str", keep_default_na=False)
        separator, cells = self._cells()
        place = len(cells) if place is None else place
        self._write(separator, pd.concat([cells[:place], new, cells[place:]]).fillna(""))

    def remove(self, place: int) -> None:
        """Take out row ``place`` (from 0)."""
        separator, cells = self._cells()
        if not 0 <= place < len(cells):
            raise InputError(f"{self.path}: has no row {place + 1}")
        self._write(separator, cells.drop(index=place))

    def _cells(self) -> tuple[str, pd.DataFrame]:
        """Separator and cells of the file, which must be valid; columns of other programs are kept."""
        if not self.path.exists():
            return ",", EDITS.empty().astype("str")
        self.read()
        return read_text_table(self.path)

    def _write(self, separator: str, cells: pd.DataFrame) -> None:
        """Replace the file."""
        write_text(cells.to_csv(sep=separator, index=False, lineterminator="\n"), self.path)
        flush_to_disk(self.path)
