"""Results of a run that lasts, one part file each, so that a run that was ended goes on from them."""

import hashlib
import json
import logging
import pickle
import secrets
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path, PurePath
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from platformdirs import user_state_path
from pydantic import BaseModel

from contactimg.engine.calls import in_parallel
from contactimg.engine.cluster import source_digest
from contactimg.errors import InputError
from contactimg.files.atomic import flush_to_disk, replacing

logger = logging.getLogger(__name__)

PARTS_FOLDER = ".contactimg.frames"
"""Inside an output folder: the part files of a run that has not ended."""

Result = TypeVar("Result")


def fingerprint(value: object) -> str:
    """SHA-256 of whatever a result depends on.

    Parameters
    ----------
    value : object
        Of JSON types, bytes, numpy numbers and arrays, paths, sets, and dataclasses and models made of these.

    Examples
    --------
    >>> fingerprint({"a": (1, np.float64(0.1))}) == fingerprint({"a": [1, 0.1]})
    True
    """
    return hashlib.sha256(json.dumps(value, default=_plain, sort_keys=True).encode()).hexdigest()


def _plain(value: Any) -> Any:
    """A value that JSON does not have, made of values that it has."""
    if isinstance(value, np.ndarray):
        digest = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return [value.dtype.str, value.shape, digest]
    if isinstance(value, BaseModel):
        return [type(value).__name__, value.model_dump()]
    if is_dataclass(value) and not isinstance(value, type):
        return [type(value).__name__, {field.name: getattr(value, field.name) for field in fields(value)}]
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, PurePath):
        return value.as_posix()
    if isinstance(value, set | frozenset):
        return sorted(value, key=repr)
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, pd.DataFrame):
        return value.to_dict("list")
    if value is pd.NA:
        return None
    raise TypeError(f"a {type(value).__name__} has no fingerprint")


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
        versions = (record.get("versions"), record.get("platform"), source_digest())
        self._basis = [_key_of_user(), *versions]
        self._digests = {entry["path"]: entry.get("sha256") for entry in record.get("inputs", [])}

    def common(self, settings: object, others: Sequence[Path] = ()) -> str:
        """What the names of several parts have in common: settings, and the content of files."""
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
        workers: int | None,
        lost: Callable[..., Result],
        said: str = "",
    ) -> Iterator[Result]:
        """Results of a function in order: from their part where it is there, else computed and kept in one.

        Parameters
        ----------
        function : callable
            Called with each job. A result with ``kept_in`` leaves its tables in the part.
        jobs : sequence of tuple
        names : sequence of str or None
            Of the parts; a result without one is not kept.
        workers, lost
            As for `contactimg.engine.calls.in_parallel`.
        said : str
            What is logged if a run that was ended has left some, with places for their number and for all.
        """
        try:
            self.folder.mkdir(exist_ok=True)
        except OSError as error:
            raise InputError(f"{self.folder}: cannot be written ({error.strerror or error})") from None
        done = bytearray(name is not None and (self.folder / name).is_file() for name in names)
        if said and any(done) and self.resumes:
            logger.warning(said, f"{sum(done):,}", f"{len(jobs):,}")
        others = array("q", (k for k, there in enumerate(done) if not there))
        compute = partial(_computed, function, str(self.folder))
        calls = ((names[k], *jobs[k]) for k in others)
        new = in_parallel(
            compute, calls, count=len(others), workers=workers, lost=lambda error, _, *job: lost(error, *job)
        )
        for k, there in enumerate(done):
            if not there:
                yield next(new)
                continue
            path = self.folder / str(names[k])
            try:
                result = read_part(path)
            except InputError as error:
                logger.warning("%s; it is computed again", error)
                result = compute(names[k], *jobs[k])
            yield _kept_in(path, result)


def _computed(function: Callable[..., Any], folder: str, name: str | None, *job: Any) -> Any:
    """A result, in any process: written to its part, unless it is a failure."""
    result = function(*job)
    if name is None or getattr(result, "is_failure", False):
        return result
    path = Path(folder) / name
    parts = result.parts() if hasattr(result, "parts") else (result,)
    with replacing(path) as part:
        with part.open("wb") as file:
            for item in parts:
                pickle.dump(item, file, protocol=pickle.HIGHEST_PROTOCOL)
        flush_to_disk(part)
    return _kept_in(path, parts[0])


def _kept_in(path: Path, result: Any) -> Any:
    """A result that knows where its tables are, if it leaves them there."""
    return result.kept_in(path) if hasattr(result, "kept_in") else result


def read_part(path: str | Path, number: int = 0) -> Any:
    """An item of a part file: 0 the result, 1 the tables that it left there.

    Raises
    ------
    InputError
        If the file is damaged.
    """
    try:
        with Path(path).open("rb") as file:
            for _ in range(number):
                pickle.load(file)  # noqa: S301 - written by `_computed`
            return pickle.load(file)  # noqa: S301
    except (OSError, EOFError, pickle.UnpicklingError, ValueError, AttributeError, ImportError) as error:
        raise InputError(f"{path}: is damaged ({type(error).__name__})") from None
