"""Write files completely or not at all, and say which file or which names an error is about."""

import json
import os
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pydantic_core import to_jsonable_python

from contactimg.errors import InputError


@contextmanager
def explaining(path: str | Path, what: str) -> Iterator[None]:
    """Turn an error of the system into an `InputError`: the file cannot be read (``what``), and why."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be {what} ({error.strerror or error})") from None


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Begin the message of an `InputError` with the file that it is about."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def first_names(names: Iterable[str]) -> str:
    """The first three names, which fill a line, and how many more there are.

    Examples
    --------
    >>> first_names(["a.tif", "b.tif", "c.tif", "d.tif"])
    'a.tif, b.tif, c.tif and 1 more'
    """
    names = list(names)
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Yield a hidden path in the same folder; it replaces ``path`` if the block ends without an error.

    Parameters
    ----------
    path : str or Path
        The file to write; its folder must exist.

    Raises
    ------
    InputError
        If the file cannot be written, with the system's reason.

    Notes
    -----
    The hidden path names the process and the thread, so that two of them may write the same file at once: the
    one that ends last remains. A process that is killed leaves its hidden file.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     with replacing(Path(folder) / "note.txt") as part:
    ...         _ = part.write_text("whole")
    ...     (Path(folder) / "note.txt").read_text()
    'whole'
    """
    path = Path(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}.part")
    with explaining(path, "written"):
        try:
            yield part
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)


def read_bytes(path: str | Path) -> bytes:
    """The content of a file, or an `InputError` with the system's reason."""
    with explaining(path, "read"):
        return Path(path).read_bytes()


def write_text(text: str, path: str | Path) -> None:
    r"""Write text as UTF-8 with line ends ``\n``, completely or not at all."""
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8", errors="surrogateescape", newline="\n")


def flush_to_disk(path: str | Path) -> None:
    """Wait until a file is on the disk, and its name where the system flushes folders."""
    path = Path(path)
    for place in (path, path.parent) if os.name == "posix" else (path,):
        handle = os.open(place, os.O_RDONLY if os.name == "posix" else os.O_RDWR)
        try:
            os.fsync(handle)
        except OSError:
            if place == path:  # shares and FUSE refuse folders
                raise
        finally:
            os.close(handle)


def write_json(data: Mapping[str, Any], path: str | Path) -> None:
    """Write JSON: numpy numbers and arrays as numbers and lists, paths as text, NaN and infinity as ``null``.

    Parameters
    ----------
    data : mapping
        Data to write.
    path : str or Path
        The file, written completely or not at all.
    """
    values = to_jsonable_python(data, fallback=plain, inf_nan_mode="null")
    write_text(json.dumps(values, indent=2) + "\n", path)


def plain(value: Any) -> Any:
    """A number or array of numpy as numbers or lists, NA as None: the ``fallback`` of pydantic's JSON."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if value is pd.NA:
        return None
    raise TypeError(f"a {type(value).__name__} cannot be written as JSON")
