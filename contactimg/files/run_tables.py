"""The tables of a run folder, as CSV or Parquet: written a few frames at a time, read alike."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self, get_args

import pandas as pd

from contactimg.files.csv_tables import CsvRows, read_table
from contactimg.files.parquet_tables import ParquetRows, need_pyarrow, read_parquet
from contactimg.tables import CONTACTS, FRAMES, Schema
from contactimg.timings import stage

TableFormat = Literal["csv", "parquet"]
"""How the tables of a run are written."""

_ROWS: dict[str, type[CsvRows] | type[ParquetRows]] = {"csv": CsvRows, "parquet": ParquetRows}

FORMATS: tuple[str, ...] = get_args(TableFormat)


@dataclass(frozen=True, eq=False)
class EncodedRows:
    """Rows of a table as a file has them: made in any process, written in one.

    Parameters
    ----------
    count : int
    content : str or DataFrame
        Text of CSV, or columns for Parquet.
    """

    count: int
    content: str | pd.DataFrame

    @classmethod
    @stage("writing")
    def of(cls, table: pd.DataFrame, schema: Schema, table_format: TableFormat) -> "EncodedRows":
        """The rows of a table.

        Raises
        ------
        InputError
            If they do not fit the schema.
        """
        return cls(len(table), _ROWS[table_format].encoded(table, schema))


class TableWriter:
    """A table of a run to which rows are added.

    Parameters
    ----------
    schema : Schema
    folder : Path
        A folder that only counts when all of its files are complete (`contactimg.files.OutputFolder`).
    table_format : {"csv", "parquet"}

    Attributes
    ----------
    rows : int
        Number of rows written.
    """

    def __init__(self, schema: Schema, folder: Path, table_format: TableFormat = "csv") -> None:
        self.schema, self.rows, self._format = schema, 0, table_format
        self.path = folder / f"{schema.name}.{table_format}"
        self._file: Any = _ROWS[table_format](schema, self.path)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._file.close()

    def add(self, table: pd.DataFrame) -> None:
        """Add the rows of a table.

        Raises
        ------
        InputError
            If they do not fit the schema or cannot be written.
        """
        self.append(EncodedRows.of(table, self.schema, self._format))

    @stage("writing")
    def append(self, rows: EncodedRows) -> None:
        """Add rows that were encoded for this table and its format.

        Raises
        ------
        InputError
            If they cannot be written.
        """
        self._file.add(rows.content)
        self.rows += rows.count


def table_file(folder: Path, schema: Schema) -> Path:
    """The file of a table of a run: the CSV file unless there is only the other one."""
    first, *others = (folder / f"{schema.name}.{ending}" for ending in FORMATS)
    return next((path for path in others if path.is_file() and not first.is_file()), first)


def main_tables(folders: Iterable[Path]) -> list[Path]:
    """The tables of runs that other results are derived from."""
    return [table_file(Path(folder), schema) for folder in folders for schema in (CONTACTS, FRAMES)]


def read_run_table(
    folder: Path, schema: Schema, *, infinite: bool = False, optional: bool = False
) -> pd.DataFrame:
    """Read a table of a run.

    Parameters
    ----------
    folder : Path
    schema : Schema
    infinite : bool
        Whether infinite numbers are accepted.
    optional : bool
        Whether a table that is not there is empty.

    Raises
    ------
    InputError
        With the file, and where possible the line and column of what is not valid.
    """
    path = table_file(folder, schema)
    if optional and not path.is_file():
        return schema.empty()
    if path.suffix == ".csv":
        return read_table(path, schema, infinite=infinite)
    return read_parquet(path, schema, infinite=infinite)


def require_format(table_format: TableFormat) -> None:
    """Raise an `InputError` if tables cannot be written in this format, before any work is done."""
    if table_format == "parquet":
        need_pyarrow()
