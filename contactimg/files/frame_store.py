"""Results of single frames, kept on disk while a run lasts, so that a run that was killed can be taken up."""

import hashlib
import logging
import shutil
import zlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from contactimg.engine.installation import source_digest
from contactimg.errors import InputError
from contactimg.files.records import decode, encode

logger = logging.getLogger(__name__)

STORE_FOLDER = ".contactimg.frames"

_FILE = "frames.txt"
_KEY_DIGITS = 64  # of SHA-256


class FrameStore:
    """Results by key in one file that only grows: each line a key, a checksum and a record.

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
    A line that was cut off, because the process was killed while it was written, is dropped.
    """

    def __init__(self, folder: Path, record: Mapping[str, Any], *, resumes: bool = True) -> None:
        self.folder = folder
        self.resumes = resumes
        self._file = folder / _FILE
        self._versions = encode([record.get("versions"), record.get("platform"), source_digest()])
        self._digests = {entry["path"]: entry.get("sha256") for entry in record.get("inputs", [])}
        self._places = dict(self._scan())

    def _scan(self) -> Iterable[tuple[str, tuple[int, int]]]:
        """Key, and offset and length of the record, of every whole line; what follows is cut off."""
        if not self._file.is_file():
            return
        end = 0
        with self._file.open("rb") as file:
            for line in file:
                key, _, rest = line.partition(b" ")
                checksum, _, data = rest.partition(b" ")
                if len(key) != _KEY_DIGITS or checksum != _checksum(data[:-1]) or not line.endswith(b"\n"):
                    break
                yield key.decode(), (end + len(line) - len(data), len(data))
                end += len(line)
        with self._file.open("r+b") as file:
            file.truncate(end)

    def __contains__(self, key: str | None) -> bool:
        return key in self._places

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
        digests = [self._digests.get(str(path.resolve())) for path in others]
        if None in digests:
            return None
        try:
            return _sha256(self._versions, encode(settings), encode(digests))
        except TypeError as error:
            logger.info("the frames cannot be stored: %s", error)
            return None

    def key(self, common: str | None, path: Path | None, job: object) -> str | None:
        """The key of a frame, or of a job without a file; None without ``common`` or a digest of the file."""
        digest = "" if path is None else self._digests.get(str(path.resolve()))
        return None if common is None or digest is None else _sha256(common, digest, encode(job))

    def get(self, key: str) -> Any:
        """The result with a key that the store contains."""
        offset, length = self._places[key]
        with self._file.open("rb") as file:
            file.seek(offset)
            return decode(file.read(length).decode())

    def put(self, key: str, value: object) -> None:
        """Add a result; one that has no text is left out.

        Raises
        ------
        InputError
            If it cannot be written.
        """
        try:
            data = encode(value).encode()
        except TypeError as error:
            logger.info("a frame cannot be stored: %s", error)
            return
        try:
            self.folder.mkdir(exist_ok=True)
            with self._file.open("ab") as file:
                start = file.tell() + _KEY_DIGITS + 10
                file.write(b" ".join([key.encode(), _checksum(data), data]) + b"\n")
        except OSError as error:
            raise InputError(f"{self._file}: cannot be written ({error.strerror or error})") from None
        self._places[key] = (start, len(data))

    def remove(self) -> None:
        """Delete the store."""
        with suppress(OSError):
            shutil.rmtree(self.folder)


def _checksum(data: bytes) -> bytes:
    """Eight hexadecimal digits."""
    return f"{zlib.crc32(data):08x}".encode()


def _sha256(*texts: str) -> str:
    """The digest of texts."""
    return hashlib.sha256("\n".join(texts).encode("utf-8", "surrogateescape")).hexdigest()
