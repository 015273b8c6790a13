"""The files that a command has read, with size, digest and time; compact, for series of 10^5 frames."""

import hashlib
import os
import sys
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, overload

import numpy as np

_DIGEST_BYTES = 32
_UNKNOWN = -1


class InputFiles(Sequence[dict[str, Any]]):
    """Files with size and SHA-256: a sequence of mappings, each made when it is asked for.

    Parameters
    ----------
    entries : iterable of mapping
        ``path``, ``bytes`` and ``sha256``, the last two None for a file that could not be read, and then
        ``error``.

    Notes
    -----
    A file takes its name, once, and 56 bytes.
    """

    def __init__(self, entries: Iterable[Mapping[str, Any]] = ()) -> None:
        self._folders: list[str] = []
        self._names: list[str] = []
        self._errors: dict[int, str | None] = {}
        self._digests = bytearray()
        # number of the folder, bytes; then hash of the path, time of the last change
        self._folder, self._size, self._hash, self._time = (array("q") for _ in range(4))
        self._order: np.ndarray | None = None
        for entry in entries:
            self._add(entry, _UNKNOWN)

    @classmethod
    def read(cls, paths: Iterable[Path]) -> "InputFiles":
        """Size, digest and time of the last change of files as they are now."""
        files = cls()
        for path in paths:
            resolved = path.resolve()
            time = _time_of_change(str(resolved))  # before the content: a change while it is read is noticed
            files._add(_fingerprint(resolved), time)
        return files

    def _add(self, entry: Mapping[str, Any], time: int) -> None:
        """Append an entry."""
        path = str(entry["path"])
        folder, name = os.path.split(path)
        if folder not in self._folders[-1:]:  # files of one folder follow each other
            self._folders.append(folder)
        digest, size = entry.get("sha256"), entry.get("bytes")
        if "error" in entry or digest is None:
            self._errors[len(self._names)] = entry.get("error")
        self._names.append(sys.intern(name))  # often that of a frame, too
        self._folder.append(len(self._folders) - 1)
        self._size.append(_UNKNOWN if size is None else size)
        self._digests += bytes(_DIGEST_BYTES) if digest is None else bytes.fromhex(digest)
        self._hash.append(hash(path))
        self._time.append(time)

    def __len__(self) -> int:
        return len(self._names)

    @overload
    def __getitem__(self, index: int) -> dict[str, Any]: ...

    @overload
    def __getitem__(self, index: slice) -> list[dict[str, Any]]: ...

    def __getitem__(self, index: int | slice) -> dict[str, Any] | list[dict[str, Any]]:
        """One entry, or some."""
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        k = range(len(self))[index]
        entry: dict[str, Any] = {"path": self.path(k), "bytes": None, "sha256": None}
        if self._size[k] != _UNKNOWN:
            entry["bytes"] = self._size[k]
        if k in self._errors:
            return entry | {"error": self._errors[k]}
        return entry | {"sha256": self._digest(k)}

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return (self[k] for k in range(len(self)))

    def path(self, k: int) -> str:
        """Path of a file."""
        return os.path.join(self._folders[self._folder[k]], self._names[k])  # noqa: PTH118 - as it was given

    def digest(self, path: Path) -> str | None:
        """SHA-256 of a file by its path; None if it is not known."""
        name = str(path.resolve())
        if self._order is None:
            self._order = np.argsort(np.frombuffer(self._hash, np.int64), kind="stable")
        hashes = np.frombuffer(self._hash, np.int64)
        wanted = np.int64(hash(name))
        place = int(np.searchsorted(hashes, wanted, sorter=self._order))
        while place < len(self) and hashes[k := int(self._order[place])] == wanted:
            if self.path(k) == name:
                return None if k in self._errors else self._digest(k)
            place += 1
        return None

    def changed(self) -> list[str]:
        """Files that were changed since they were read; those that are gone are not among them."""
        found = []
        for k, before in enumerate(zip(self._time, self._size, strict=True)):
            with suppress(OSError):
                status = Path(self.path(k)).stat()
                if before[0] != _UNKNOWN and before != (status.st_mtime_ns, status.st_size):
                    found.append(self.path(k))
        return found

    def _digest(self, k: int) -> str:
        """SHA-256 of a file by its number."""
        return self._digests[_DIGEST_BYTES * k : _DIGEST_BYTES * (k + 1)].hex()


def _time_of_change(path: str) -> int:
    """Time of the last change, ns; `_UNKNOWN` without the file."""
    with suppress(OSError):
        return Path(path).stat().st_mtime_ns
    return _UNKNOWN


def _fingerprint(path: Path) -> dict[str, Any]:
    """Resolved path, size and SHA-256 of a file."""
    try:
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        return {"path": str(path), "bytes": path.stat().st_size, "sha256": digest}
    except OSError as error:
        return {"path": str(path), "bytes": None, "sha256": None, "error": error.strerror}
