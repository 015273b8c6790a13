"""Records, tables and arrays as JSON text from which the same values come back, bit for bit."""

import base64
import importlib
import json
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import PurePath
from typing import Any

import numpy as np
import pandas as pd
from pydantic import BaseModel

_KIND = "@"  # marks an object that is not a plain JSON object
_PACKAGE = "contactimg."
_NUMBERS = ("float64", "int64")  # columns that are stored as bytes


def encode(value: Any) -> str:
    """The text of a value.

    Parameters
    ----------
    value : object
        Of JSON types, bytes, tuples, numpy numbers and arrays, DataFrames, NA, paths, and dataclasses and
        models of contactimg made of these.

    Raises
    ------
    TypeError
        If it contains something else.

    Examples
    --------
    >>> decode(encode({"a": (1, np.float64(0.1)), "b": pd.NA}))
    {'a': (1, 0.1), 'b': <NA>}
    """
    return json.dumps(_plain(value), separators=(",", ":"))


def decode(text: str) -> Any:
    """The value of a text from `encode`; models and paths do not come back (they serve for keys only).

    Raises
    ------
    ValueError
        If the text is damaged or names a class that contactimg does not have.
    """
    try:
        return _restored(json.loads(text))
    except (KeyError, TypeError, AttributeError, ImportError) as error:
        raise ValueError(f"is not a stored record ({error})") from None


def _plain(value: Any) -> Any:
    """The value made of JSON types."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if value is pd.NA:
        return {_KIND: "NA"}
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, bytes):
        return {_KIND: "bytes", "data": base64.b64encode(value).decode()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if isinstance(value, tuple | set | frozenset):
        items = value if isinstance(value, tuple) else sorted(value, key=repr)
        return {_KIND: "tuple", "items": [_plain(item) for item in items]}
    if isinstance(value, Mapping):
        return {_KIND: "dict", "items": [[_plain(key), _plain(item)] for key, item in value.items()]}
    return _plain_record(value)


def _plain_record(value: Any) -> Any:
    """A table, an array or a record made of JSON types."""
    if isinstance(value, pd.DataFrame):
        return _plain_table(value)
    if isinstance(value, np.ndarray):
        data = base64.b64encode(np.ascontiguousarray(value).tobytes()).decode()
        return {_KIND: "array", "dtype": value.dtype.str, "shape": list(value.shape), "data": data}
    if isinstance(value, PurePath):
        return {_KIND: "path", "name": value.as_posix()}
    if is_dataclass(value) and not isinstance(value, type):
        names = {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
        return {_KIND: "record", "class": _name(type(value)), "fields": names}
    if isinstance(value, BaseModel):
        return {_KIND: "model", "class": _name(type(value)), "fields": _plain(value.model_dump())}
    raise TypeError(f"a {type(value).__name__} cannot be stored")


def _plain_table(table: pd.DataFrame) -> dict[str, Any]:
    """A DataFrame made of JSON types."""
    columns = [[name, str(column.dtype), _plain_column(column)] for name, column in table.items()]
    index = None if isinstance(table.index, pd.RangeIndex) else table.index.tolist()
    return {_KIND: "table", "rows": len(table), "index": index, "columns": columns}


def _plain_column(column: pd.Series) -> str | list[Any]:
    """The cells of a column made of JSON types; plain numbers as their bytes, which is ten times faster."""
    if str(column.dtype) in _NUMBERS:
        return base64.b64encode(np.ascontiguousarray(column.to_numpy()).tobytes()).decode()
    return [None if item is pd.NA else _plain(item) for item in column.tolist()]


def _name(kind: type) -> str:
    """Module and name of a class."""
    return f"{kind.__module__}:{kind.__qualname__}"


def _restored(value: Any) -> Any:
    """The value of JSON types with what `_plain` replaced."""
    if isinstance(value, list):
        return [_restored(item) for item in value]
    if not isinstance(value, dict):
        return value
    return _RESTORE[value[_KIND]](value)


def _restored_table(value: dict[str, Any]) -> pd.DataFrame:
    """The DataFrame."""
    if value["rows"] == 0 and value["index"] is None:
        return _empty_table(tuple((name, dtype) for name, dtype, _ in value["columns"])).copy()
    index = pd.RangeIndex(value["rows"]) if value["index"] is None else pd.Index(value["index"])
    data = {name: _restored_column(dtype, items) for name, dtype, items in value["columns"]}
    return pd.DataFrame(data, index=index, copy=False)


@cache
def _empty_table(columns: tuple[tuple[str, str], ...]) -> pd.DataFrame:
    """A DataFrame without rows."""
    data = {name: _restored_column(dtype, []) for name, dtype in columns}
    return pd.DataFrame(data, index=pd.RangeIndex(0))


def _restored_column(dtype: Any, items: str | list[Any]) -> Any:
    """The column."""
    if isinstance(items, str):
        return np.frombuffer(base64.b64decode(items), dtype).copy()
    return pd.array(items, dtype=dtype) if dtype != "object" else items


def _restored_array(value: dict[str, Any]) -> np.ndarray:
    """The array."""
    data = np.frombuffer(base64.b64decode(value["data"]), np.dtype(value["dtype"]))
    return data.reshape(value["shape"]).copy()


def _restored_record(value: dict[str, Any]) -> Any:
    """The record, of a dataclass of contactimg."""
    module, _, name = value["class"].partition(":")
    if not module.startswith(_PACKAGE):
        raise ValueError(f"is no record of contactimg: {module}")
    kind: Any = getattr(importlib.import_module(module), name)
    if not (isinstance(kind, type) and is_dataclass(kind)):
        raise ValueError(f"is no record: {module}.{name}")
    make: Callable[..., Any] = kind
    return make(**{key: _restored(item) for key, item in value["fields"].items()})


_RESTORE: dict[str, Callable[[dict[str, Any]], Any]] = {
    "NA": lambda _: pd.NA,
    "bytes": lambda value: base64.b64decode(value["data"]),
    "tuple": lambda value: tuple(_restored(value["items"])),
    "dict": lambda value: {_restored(key): _restored(item) for key, item in value["items"]},
    "table": _restored_table,
    "array": _restored_array,
    "record": _restored_record,
}
