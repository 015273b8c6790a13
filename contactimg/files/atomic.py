"""Write files completely or not at all."""

import json
import math
import os
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from contactimg.errors import InputError
from contactimg.timings import stage


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
    try:
        try:
            yield part
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from None


def read_bytes(path: str | Path) -> bytes:
    """The content of a file, or an `InputError` with the system's reason."""
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None


@stage("writing")
def write_text(text: str, path: str | Path) -> None:
    r"""Write text as UTF-8 with line ends ``\n``, completely or not at all."""
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8", errors="surrogateescape", newline="\n")


def flush_to_disk(path: str | Path) -> None:
    """Wait until a file and its name are on the disk, so that they outlive a loss of power."""
    path = Path(path)
    for place in (path, path.parent) if os.name == "posix" else (path,):
        handle = os.open(place, os.O_RDONLY if os.name == "posix" else os.O_RDWR)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


@stage("writing")
def write_json(data: Mapping[str, Any], path: str | Path) -> None:
    """Write JSON: numpy numbers and arrays as numbers and lists, paths as text, NaN and infinity as ``null``.

    Parameters
    ----------
    data : mapping
        Data to write.
    path : str or Path
        The file, written completely or not at all.
    """
    with replacing(path) as part, part.open("w", encoding="ascii", newline="\n") as file:
        json.dump(_plain(data), file, indent=2)
        file.write("\n")


def _plain(value: Any) -> Any:
    """The value with JSON types only."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, Sequence | set) and not isinstance(value, str | bytes):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, Path):
        return value.as_posix()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
