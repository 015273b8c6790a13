"""Results of a run that lasts, one part file each, so that a run that was ended goes on from them."""

import hashlib
import json
import logging
import pickle
import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from platformdirs import user_state_path
from pydantic_core import to_jsonable_python

from contactimg.engine.cluster import source_digest
from contactimg.engine.parallel import in_parallel
from contactimg.errors import InputError
from contactimg.files.atomic import explaining, flush_to_disk, plain, replacing

logger = logging.getLogger(__name__)

Result = TypeVar("Result")

PARTS_FOLDER = ".contactimg.frames"
"""Inside an output folder: the part files of a run that has not ended."""


def fingerprint(value: object) -> str:
    """SHA-256 of whatever a result depends on.

    Parameters
    ----------
    value : object
        Of JSON types, bytes, numpy numbers and arrays, paths, and dataclasses and models made of these.

    Examples
    --------
    >>> fingerprint({"a": (1, np.float64(0.1))}) == fingerprint({"a": [1, 0.1]})
    True
    """

    def digested(part: object) -> object:
        if isinstance(part, np.ndarray):
            digest = hashlib.sha256(np.ascontiguousarray(part).tobytes()).hexdigest()
            return [part.dtype.str, part.shape, digest]
        return plain(part)

    values = to_jsonable_python(value, fallback=digested, bytes_mode="hex")
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def _key_of_user() -> str:
    """A secret of this user, part of every name: part files that somebody else left in a folder are not read.

    Part files are pickled, and reading one may run what it says. Without a place for the secret every run has
    its own, and goes on from nothing.
    """
    path = user_state_path("contactimg") / "part_key"
    with suppress(OSError, InputError):
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as part:
                part.write_text(secrets.token_hex())
            path.chmod(0o600)
        return path.read_text()
    return secrets.token_hex()


class PartStore:
    """Results in part files, each named by the digest of all it depends on.

    A part is written to a temporary name and renamed: it is there whole or not at all.

    Parameters
    ----------
    folder : Path
        Made with the first result. The caller holds the lock of the output folder.
    record : mapping
        From `contactimg.files.provenance`: the versions and the SHA-256 of the inputs are part of every name.
    resumes : bool
        Whether what it holds was left by a run that was ended.
    """

    def __init__(self, folder: Path, record: Mapping[str, Any], *, resumes: bool = True) -> None:
        self.folder, self.resumes = folder.resolve(), resumes
        self._basis = [_key_of_user(), record.get("versions"), record.get("platform"), source_digest()]
        self._digests = {entry["path"]: entry.get("sha256") for entry in record.get("inputs", [])}

    def common(self, settings: object, others: Sequence[Path] = ()) -> str:
        """The part that names of several results share: settings, and the content of files."""
        return fingerprint([self._basis, settings, [self._digest(path) for path in others]])

    def name(self, common: str, path: Path | None, job: object) -> str | None:
        """Name of the part of a frame in a file, or of a job without one; None if the file has no digest."""
        digest = "" if path is None else self._digest(path)
        return None if digest is None else fingerprint([common, digest, job])

    def _digest(self, path: Path) -> str | None:
        """SHA-256 of an input file."""
        return self._digests.get(str(path.resolve()))

    def results(
        self,
        function: Callable[..., Result],
        jobs: Sequence[tuple[Any, ...]],
        names: Sequence[str | None],
        *,
        lost: Callable[..., Result],
        shown: str = "",
    ) -> Iterator[Result]:
        """Results of a function in order: from their part where it is there, else computed and kept in one.

        Parameters
        ----------
        function : callable
            Called with each job. A result with ``kept_in`` leaves its tables in the part.
        jobs : sequence of tuple
        names : sequence of str or None
            Of the parts; a result without one is not kept.
        lost
            As for `contactimg.engine.parallel.in_parallel`.
        shown : str
            What a person is shown of the loop; then it is logged if a run that was ended has left some.
        """
        with explaining(self.folder, "written"):
            self.folder.mkdir(exist_ok=True)
        done = sum(name is not None and (self.folder / name).is_file() for name in names)
        if shown and done and self.resumes:
            frames = f"{done:,} of {len(jobs):,} frames"
            logger.warning("%s were done by a run that was ended; the others are measured", frames)
        return in_parallel(
            partial(_kept, function, str(self.folder)),
            ((name, *job) for name, job in zip(names, jobs, strict=True)),
            count=len(jobs),
            lost=lambda error, _, *job: lost(error, *job),
            shown=shown,
        )


def _kept(function: Callable[..., Any], folder: str, name: str | None, *job: Any) -> Any:
    """A result, in any process: from its part, or computed and written there, unless it is a failure."""
    path = None if name is None else Path(folder) / name
    if path is not None and path.is_file():
        try:
            return _kept_in(path, read_part(path))
        except InputError as error:
            logger.warning("%s; it is computed again", error)
    result = function(*job)
    if path is None or getattr(result, "is_failure", False):
        return result
    with replacing(path) as part:
        part.write_bytes(pickle.dumps(result, protocol=pickle.HIGHEST_PROTOCOL))
        flush_to_disk(part)
    return _kept_in(path, result)


def _kept_in(path: Path, result: Any) -> Any:
    """A result that knows where its tables are, if it leaves them there."""
    return result.kept_in(path) if hasattr(result, "kept_in") else result


def read_part(path: str | Path) -> Any:
    """The result in a part file, with its tables.

    Raises
    ------
    InputError
        If the file is damaged.
    """
    try:
        return pickle.loads(Path(path).read_bytes())  # noqa: S301 - written by `_kept`
    except (OSError, EOFError, pickle.UnpicklingError, ValueError, AttributeError, ImportError) as error:
        raise InputError(f"{path}: is damaged ({type(error).__name__})") from None
