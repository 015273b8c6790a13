"""The tables of a run folder, as CSV or Parquet: written a few frames at a time, read alike."""

import importlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal, Self, get_args

import numpy as np
import pandas as pd

from contactimg.errors import InputError
from contactimg.files.csv_tables import read_table, text_of_rows
from contactimg.tables import CONTACTS, FRAMES, Schema
from contactimg.timings import stage

TableFormat = Literal["csv", "parquet"]
"""How the tables of a run are written. Parquet, for runs whose CSV files would be large, needs pyarrow."""

FORMATS: tuple[str, ...] = get_args(TableFormat)


@stage("writing")
def encoded_rows(table: pd.DataFrame, schema: Schema, table_format: TableFormat) -> str | pd.DataFrame:
    """Rows of a table as a file has them: made in any process, written in one by a `TableWriter`.

    Text of CSV, or columns for Parquet; `InputError` if they do not fit the schema.
    """
    return text_of_rows(table, schema) if table_format == "csv" else schema.conform(table)


class TableWriter:
    """A table of a run to which rows are added.

    Parameters
    ----------
    schema : Schema
    folder : Path
        A folder that only counts when all of its files are complete (`contactimg.files.OutputFolder`).
    table_format : {"csv", "parquet"}
        Of Parquet, each addition is a row group.

    Attributes
    ----------
    empty : bool
        Whether no row was written.

    Raises
    ------
    InputError
        If the file cannot be written.
    """

    def __init__(self, schema: Schema, folder: Path, table_format: TableFormat = "csv") -> None:
        self.schema, self.empty, self._format = schema, True, table_format
        self.path = folder / f"{schema.name}.{table_format}"
        self._file: Any = None
        try:
            if table_format == "csv":
                self._file = self.path.open("w", encoding="utf-8", errors="surrogateescape", newline="")
                self._file.write(",".join(schema.columns) + "\n")
            else:
                self._arrow, parquet = _pyarrow()
                kinds = {"str": self._arrow.string(), "float64": self._arrow.float64()}
                whole = self._arrow.int64()
                columns = [(name, kinds.get(kind, whole)) for name, (kind, _) in schema.columns.items()]
                self._columns = self._arrow.schema(columns)
                self._file = parquet.ParquetWriter(self.path, self._columns)
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written ({error.strerror or error})") from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._file.close()

    def add(self, table: pd.DataFrame) -> None:
        """Add the rows of a table."""
        self.append(encoded_rows(table, self.schema, self._format))

    @stage("writing")
    def append(self, rows: str | pd.DataFrame) -> None:
        """Add rows that were encoded for this table and its format."""
        try:
            if self._format == "csv":
                self._file.write(rows)
                self._file.flush()
            else:
                table = self._arrow.Table.from_pandas(rows, schema=self._columns, preserve_index=False)
                self._file.write_table(table)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"{self.path}: cannot be written ({reason})") from None
        self.empty &= not len(rows)


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
        Columns that a later version added may be missing in the file, others in it are ignored.
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
    arrow, parquet = _pyarrow()
    try:
        with path.open("rb") as file:
            table = parquet.read_table(file).to_pandas()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
    except arrow.ArrowException as error:
        raise InputError(f"{path}: is not a Parquet file ({str(error)[:100]}); repeat the run") from None
    for name in schema.first:
        if name not in table:
            raise InputError(f"{path}: column {name} is missing; repeat the run")
    try:
        found = schema.conform(table[[name for name in schema.columns if name in table]])
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    numbers = found.select_dtypes("float64")
    beyond = numbers.columns[np.isinf(numbers.to_numpy()).any(axis=0)]
    if len(beyond) and not infinite:
        raise InputError(f"{path}: column {beyond[0]} must hold finite numbers")
    texts = [name for name, (dtype, _) in schema.columns.items() if dtype == "str"]
    found[texts] = found[texts].fillna("")
    return found


def require_format(table_format: TableFormat) -> None:
    """Raise an `InputError` if tables cannot be written in this format, before any work is done."""
    if table_format == "parquet":
        _pyarrow()


def _pyarrow() -> tuple[Any, Any]:
    """The modules of pyarrow, or an `InputError` that says how to get them."""
    try:
        return importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise InputError(
            "Parquet tables need pyarrow, which is not installed; pip install 'contactimg[parquet]'"
        ) from None
