"""Rows of edits.csv, added and taken out one by one: all other rows keep their text."""

import csv
import hashlib
import io
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from contactimg.errors import InputError
from contactimg.files.atomic import flush_to_disk, write_text
from contactimg.files.csv_tables import read_text_rows, text_rows
from contactimg.files.edits import check_edits, read_edits
from contactimg.tables import EDITS


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
        separator, lines = self._lines()
        header = [name.strip() for name in lines[0]]
        new = [dict(zip(EDITS.columns, map(str, row), strict=True)) for row in text_rows(rows, EDITS)]
        cells = [[row.get(name, "") for name in header] for row in new]
        start = len(lines) if place is None else min(1 + place, len(lines))
        self._write(separator, [*lines[:start], *cells, *lines[start:]])

    def remove(self, place: int) -> None:
        """Take out row ``place`` (from 0)."""
        separator, lines = self._lines()
        if not 0 <= place < len(lines) - 1:
            raise InputError(f"{self.path}: has no row {place + 1}")
        self._write(separator, [*lines[: 1 + place], *lines[2 + place :]])

    def _lines(self) -> tuple[str, list[list[str]]]:
        """Separator and rows with the header, which names every column."""
        if not self.path.exists():
            return ",", [list(EDITS.columns)]
        self.read()  # what it holds must be valid
        separator, lines = read_text_rows(self.path)
        missing = [name for name in EDITS.columns if name not in [cell.strip() for cell in lines[0]]]
        return separator, [lines[0] + missing, *(line + [""] * len(missing) for line in lines[1:])]

    def _write(self, separator: str, lines: list[list[str]]) -> None:
        """Replace the file."""
        buffer = io.StringIO(newline="")
        csv.writer(buffer, delimiter=separator, lineterminator="\n").writerows(lines)
        write_text(buffer.getvalue(), self.path)
        flush_to_disk(self.path)
