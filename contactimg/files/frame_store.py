"""Results of single frames, kept on disk while a run lasts, so that a run that was killed can be taken up."""

import hashlib
import logging
import shutil
import sqlite3
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, overload

from contactimg.engine.installation import source_digest
from contactimg.errors import InputError
from contactimg.files.input_files import InputFiles
from contactimg.files.records import decode, encode

logger = logging.getLogger(__name__)

STORE_FOLDER = ".contactimg.frames"
STORE_FILE = "frames.sqlite"

_KEY_BYTES = 32  # SHA-256
_NO_KEY = bytes(_KEY_BYTES)

_KEPT = 4  # results whose first record stays in memory: what is asked of one frame is asked in a row

_TABLE = (
    "CREATE TABLE IF NOT EXISTS results "
    "(key BLOB NOT NULL, part INTEGER NOT NULL, checksum INTEGER NOT NULL, data BLOB NOT NULL, "
    "UNIQUE (key, part))"
)


@dataclass(frozen=True)
class EncodedResult:
    """A result as a store keeps it: whole, or in parts that can be read one by one.

    Parameters
    ----------
    texts : tuple of bytes
        One a part, for `decode_part`.
    """

    texts: tuple[bytes, ...]

    @classmethod
    def of(cls, result: Any) -> "EncodedResult | None":
        """A result encoded, in parts if it has ``records``; None if it has no text."""
        parts = result.records() if hasattr(result, "records") else (result,)
        try:
            return cls(tuple(encode(part).encode() for part in parts))
        except TypeError as error:
            logger.info("a result cannot be stored: %s", error)
            return None


def decode_part(text: bytes) -> Any:
    """A part of a result from its text."""
    return decode(text.decode())


class KeyList(Sequence["bytes | None"]):
    """Keys of results in order, None where there is none: 32 bytes each in one block of memory.

    Parameters
    ----------
    keys : iterable of bytes or None
    """

    def __init__(self, keys: Iterable[bytes | None] = ()) -> None:
        self._bytes = bytearray()
        for key in keys:
            self.append(key)

    def __len__(self) -> int:
        return len(self._bytes) // _KEY_BYTES

    @overload
    def __getitem__(self, index: int) -> bytes | None: ...

    @overload
    def __getitem__(self, index: slice) -> "KeyList": ...

    def __getitem__(self, index: int | slice) -> "bytes | KeyList | None":
        """One key, or some."""
        if isinstance(index, slice):
            return KeyList(self[k] for k in range(*index.indices(len(self))))
        start = _KEY_BYTES * range(len(self))[index]
        key = bytes(self._bytes[start : start + _KEY_BYTES])
        return None if key == _NO_KEY else key

    def __setitem__(self, index: int, key: bytes | None) -> None:
        start = _KEY_BYTES * range(len(self))[index]
        self._bytes[start : start + _KEY_BYTES] = key or _NO_KEY

    def append(self, key: bytes | None) -> None:
        """Add a key at the end."""
        self._bytes += key or _NO_KEY


class FrameStore:
    """Results by key in a SQLite database; nothing of them stays in memory.

    Parameters
    ----------
    folder : Path
        Made with the first result. The caller holds the lock of the output folder.
    record : mapping
        From `contactimg.files.provenance`: the versions and the SHA-256 of the inputs are part of every key.
    resumes : bool
        Whether what it holds was left by a run that was ended.

    Notes
    -----
    A result is there whole or not at all, whenever the process ends: SQLite writes ahead to a log. A database
    that something else has damaged is deleted with a warning when it is opened.
    """

    def __init__(self, folder: Path, record: Mapping[str, Any], *, resumes: bool = True) -> None:
        self.folder = folder
        self.resumes = resumes
        self._versions = encode([record.get("versions"), record.get("platform"), source_digest()])
        inputs = record.get("inputs", [])
        self._inputs = inputs if isinstance(inputs, InputFiles) else InputFiles(inputs)
        self._database: sqlite3.Connection | None = None
        self._first = lru_cache(_KEPT)(self._read)
        if self._file.is_file():
            self._open()

    @property
    def _file(self) -> Path:
        return self.folder / STORE_FILE

    def __contains__(self, key: bytes | None) -> bool:
        if key is None or self._database is None:
            return False
        with self._errors():
            found = self._database.execute("SELECT 1 FROM results WHERE key = ? AND part = 0", (key,))
            return found.fetchone() is not None

    def common(self, settings: object, others: Iterable[Path]) -> str | None:
        """What the keys of several frames have in common.

        Parameters
        ----------
        settings : object
            Whatever the results depend on besides the frame.
        others : iterable of Path
            Input files that are no frames: the results depend on their content.

        Returns
        -------
        str or None
            None if the settings have no text or a file has no digest: nothing is stored then.
        """
        digests = [self._inputs.digest(path) for path in others]
        if None in digests:
            return None
        try:
            return _sha256(self._versions, encode(settings), encode(digests)).hex()
        except TypeError as error:
            logger.info("the frames cannot be stored: %s", error)
            return None

    def key(self, common: str | None, path: Path | None, job: object) -> bytes | None:
        """The key of a frame, or of a job without a file; None without ``common`` or a digest of the file."""
        digest = "" if path is None else self._inputs.digest(path)
        return None if common is None or digest is None else _sha256(common, digest, encode(job))

    def get(self, key: bytes, part: int = 0) -> Any:
        """The result with a key that the store contains, or a further part of it.

        Raises
        ------
        InputError
            If it is damaged.
        """
        return decode_part(self.text(key, part)) if part else self._first(key)

    def _read(self, key: bytes) -> Any:
        """The first part of a result, from the disk."""
        return decode_part(self.text(key))

    def text(self, key: bytes, part: int = 0) -> bytes:
        """A part of a result as it is stored, for `decode_part`.

        Raises
        ------
        InputError
            If it is damaged.
        """
        database = self._database or self._open()
        with self._errors():
            checksum, data = database.execute(
                "SELECT checksum, data FROM results WHERE key = ? AND part = ?", (key, part)
            ).fetchone()
        if zlib.crc32(data) != checksum:
            raise InputError(f"{self._file}: is damaged; delete {self.folder} and start again")
        text: bytes = data
        return text

    def put(self, key: bytes, result: EncodedResult) -> None:
        """Add a result.

        Raises
        ------
        InputError
            If it cannot be written.
        """
        rows = [(key, number, zlib.crc32(text), text) for number, text in enumerate(result.texts)]
        database = self._database or self._open()
        with self._errors(), database:
            database.executemany("INSERT OR REPLACE INTO results VALUES (?, ?, ?, ?)", rows)
        self._first.cache_clear()

    def remove(self) -> None:
        """Delete the store."""
        self.close()
        with suppress(OSError):
            shutil.rmtree(self.folder)

    def close(self) -> None:
        """Close the database; it is opened again when it is asked for."""
        if self._database is not None:
            self._database.close()
            self._database = None

    def _open(self) -> sqlite3.Connection:
        """Open the database, a new one if there is none or what is there is none."""
        try:
            self.folder.mkdir(exist_ok=True)
        except OSError as error:
            raise InputError(f"{self._file}: cannot be written ({error.strerror or error})") from None
        try:
            self._database = _connect(self._file)
        except sqlite3.OperationalError:
            with self._errors():
                raise
        except sqlite3.DatabaseError as error:
            logger.warning("%s: %s; the frames are measured again", self._file, error)
            self.remove()
            if self._file.exists():
                raise InputError(f"{self._file}: {error}; delete {self.folder} and start again") from None
            return self._open()
        return self._database

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Errors of the database as a sentence."""
        try:
            yield
        except sqlite3.OperationalError as error:
            raise InputError(
                f"{self._file}: cannot be written or read ({error}); is the disk full?"
            ) from None
        except sqlite3.DatabaseError as error:
            raise InputError(f"{self._file}: {error}; delete {self.folder} and start again") from None


def _connect(file: Path) -> sqlite3.Connection:
    """The database in a file, made if it is new."""
    # a job of the review page measures in a thread of its own, one at a time
    database = sqlite3.connect(file, check_same_thread=False)
    try:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA synchronous = NORMAL")
        database.execute(_TABLE)
        database.execute("SELECT max(rowid), max(key) FROM results").fetchone()
    except sqlite3.Error:
        database.close()
        raise
    return database


def _sha256(*texts: str) -> bytes:
    """The digest of texts."""
    return hashlib.sha256("\n".join(texts).encode("utf-8", "surrogateescape")).digest()
