"""Read and write tables as Parquet, for runs whose CSV files would be large; needs pyarrow."""

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from contactimg.errors import InputError
from contactimg.tables import Schema


class ParquetRows:
    """A Parquet file to which rows are added, each call a row group.

    Parameters
    ----------
    schema : Schema
    path : Path

    Raises
    ------
    InputError
        If pyarrow is not installed or the file cannot be written.
    """

    def __init__(self, schema: Schema, path: Path) -> None:
        self._schema, self._path = schema, path
        self._arrow, parquet = need_pyarrow()
        self._columns = self._arrow.schema([(name, self._kind(name)) for name in schema.columns])
        try:
            self._writer = parquet.ParquetWriter(path, self._columns)
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror or error})") from None

    @staticmethod
    def encoded(table: pd.DataFrame, schema: Schema) -> pd.DataFrame:
        """The rows of a table in the order and with the types of the schema."""
        return schema.conform(table)

    def add(self, whole: pd.DataFrame) -> None:
        """Add rows of `encoded`; NaN and NA become nulls."""
        try:
            self._writer.write_table(
                self._arrow.Table.from_pandas(whole, schema=self._columns, preserve_index=False)
            )
        except (OSError, UnicodeError, self._arrow.ArrowException) as error:
            raise InputError(f"{self._path}: cannot be written as Parquet ({error})") from None

    def close(self) -> None:
        """Complete the file."""
        self._writer.close()

    def _kind(self, name: str) -> Any:
        """The type of a column in the file."""
        dtype, _ = self._schema.columns[name]
        kinds = {"str": self._arrow.string(), "float64": self._arrow.float64()}
        return kinds.get(dtype, self._arrow.int64())


def read_parquet(path: Path, schema: Schema, *, infinite: bool = False) -> pd.DataFrame:
    """Read a Parquet file of a known schema; columns that a later version added may be missing.

    Parameters
    ----------
    path : Path
    schema : Schema
        Other columns in the file are ignored.
    infinite : bool
        Whether infinite numbers are accepted.

    Raises
    ------
    InputError
        If pyarrow is not installed, or the file cannot be read or does not fit the schema.
    """
    arrow, parquet = need_pyarrow()
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
    if not infinite and np.isinf(numbers.to_numpy()).any():
        name = numbers.columns[np.isinf(numbers.to_numpy()).any(axis=0)][0]
        raise InputError(f"{path}: column {name} must hold finite numbers")
    texts = [name for name, (dtype, _) in schema.columns.items() if dtype == "str"]
    found[texts] = found[texts].fillna("")
    return found


def need_pyarrow() -> tuple[Any, Any]:
    """The modules of pyarrow, or an `InputError` that says how to get them."""
    try:
        return importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise InputError(
            "Parquet tables need pyarrow, which is not installed; pip install 'contactimg[parquet]'"
        ) from None
