"""Replace an earlier result by a finished one: one rename decides, the next command moves what is left."""

import json
import logging
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from filelock import FileLock, Timeout

from contactimg.errors import InputError
from contactimg.files.atomic import flush_to_disk

logger = logging.getLogger(__name__)

Result = TypeVar("Result")

LOCK_FILE = ".contactimg.lock"
STAGING_FOLDER = ".contactimg.part"
PENDING_FOLDER = ".contactimg.commit"
PROVENANCE_FILE = "provenance.json"

_LOCK_SECONDS = 20.0  # chosen: moving 10^4 files takes about a second
_ATTEMPTS = 5  # chosen: a reader that meets a new commit each time gives up


def read_records(folder: Path) -> list[dict[str, Any]]:
    """The records of the runs that share an output folder, the last one first.

    Returns
    -------
    list of dict
        As `contactimg.files.provenance` makes them, each with the names of its files as ``outputs``.

    Raises
    ------
    OSError
        If there is no provenance.json.
    ValueError
        If it is damaged.
    """
    top = json.loads((folder / PROVENANCE_FILE).read_text(encoding="utf-8"))
    beside = top.get("beside", []) if isinstance(top, dict) else None
    if not isinstance(beside, list) or not all(isinstance(record, dict) for record in beside):
        raise ValueError(f"{folder / PROVENANCE_FILE} is damaged")
    return [{name: value for name, value in top.items() if name != "beside"}, *beside]


def records_of_runs(folder: Path) -> list[dict[str, Any]]:
    """The records of the runs in a folder; none if they cannot be read or do not name their files."""
    try:
        records = read_records(folder)
    except (OSError, ValueError):
        return []
    return records if all(isinstance(record.get("outputs"), list) for record in records) else []


def files_of(record: Mapping[str, Any]) -> set[Path]:
    """The files that a run wrote, relative to its folder."""
    files = {Path(str(name)) for name in record["outputs"]}
    return {file for file in files if not file.is_absolute() and ".." not in file.parts}


def task_of(record: Mapping[str, Any]) -> str:
    """The kind of run: program, command and, for a calibration, its kind."""
    words = str(record.get("command", "")).split()
    return " ".join(words[: 3 if words[1:2] == ["calibrate"] else 2])


def commit(folder: Path) -> None:
    """Replace the earlier result of the same kind of run by the staged one.

    The staging folder is renamed: before this rename the earlier result stands, after it the new one does,
    even if the process ends before the files are in their places. What has to be moved and deleted stands in
    the two records, of which the new one takes the place of the earlier one last.

    Parameters
    ----------
    folder : Path
        The output folder, locked by the caller, with the new files and their record in `STAGING_FOLDER`.

    Raises
    ------
    InputError
        If a folder stands where a file must go, or a file where a folder must go; nothing is changed then.
    """
    staging = folder / STAGING_FOLDER
    for name in files_of(read_records(staging)[0]):
        if (folder / name).is_dir():
            raise InputError(f"{folder / name}: is a folder, where the run writes a file; move it away")
        for parent in list(name.parents)[:-1]:
            place = folder / parent
            if place.exists() and not place.is_dir():
                raise InputError(f"{place}: is a file, where the run needs a folder; move it away")
    flush_to_disk(staging / PROVENANCE_FILE)
    staging.rename(folder / PENDING_FOLDER)
    complete_commit(folder)


def complete_commit(folder: Path) -> None:
    """Move the files of a pending commit, as far as that is not done yet, in a folder that is locked."""
    pending = folder / PENDING_FOLDER
    if (pending / PROVENANCE_FILE).is_file():
        try:
            record = read_records(pending)[0]
            new = files_of(record)
            if len(new) < len(record["outputs"]):
                raise ValueError(record["outputs"])
        except (ValueError, KeyError, TypeError):
            file = pending / PROVENANCE_FILE
            raise InputError(f"{file}: is damaged; delete {pending} and repeat the run") from None
        before = [one for one in records_of_runs(folder) if task_of(one) == task_of(record)]
        earlier = set[Path]().union(*map(files_of, before))
        for name in sorted(new):
            _place(folder, name, foreign=name not in earlier)
        for name in sorted(earlier - new):
            (folder / name).unlink(missing_ok=True)
            with suppress(OSError):  # a folder that is not empty, or the output folder
                for parent in name.parents[:-1]:
                    (folder / parent).rmdir()
        (pending / PROVENANCE_FILE).replace(folder / PROVENANCE_FILE)
    if pending.exists():
        shutil.rmtree(pending)


def _place(folder: Path, name: Path, *, foreign: bool) -> None:
    """Move one file to its place, unless it is there already; rename a file there that no run wrote."""
    source, target = folder / PENDING_FOLDER / name, folder / name
    if not source.exists():
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    if foreign and target.exists():
        kept = target.with_name(target.name + ".bak")
        logger.warning("%s was not written by a run; it is kept as %s", target, kept.name)
        target.replace(kept)
    source.replace(target)


def finish_commit(folder: str | Path) -> None:
    """Complete a commit that was interrupted in an output folder; does nothing without one.

    Parameters
    ----------
    folder : path-like
        Any folder; it need not exist.

    Raises
    ------
    InputError
        If another process is committing there and does not end, or the folder cannot be written.
    """
    folder = Path(folder)
    if not (folder / PENDING_FOLDER).exists():
        return
    try:
        with FileLock(folder / LOCK_FILE, timeout=_LOCK_SECONDS):
            complete_commit(folder)
            release_lock_file(folder)
    except Timeout:
        raise InputError(f"{folder}: results are being written there; try again when that is done") from None
    except OSError as error:
        raise InputError(
            f"{folder}: a run ended while its results were moved into place, and they cannot be moved now "
            f"({error.strerror or error}); make the folder writable and try again"
        ) from None


def release_lock_file(folder: Path) -> None:
    """Delete the lock file, which its owner is about to release."""
    with suppress(OSError):  # Windows does not delete an open file
        (folder / LOCK_FILE).unlink()


def read_settled(folder: str | Path, read: Callable[[], Result]) -> Result:
    """What ``read`` returns, with all files from before a commit or all from after it.

    Parameters
    ----------
    folder : path-like
        The output folder that is read.
    read : callable
        Called again if a commit happened meanwhile; its errors are raised unless one did.

    Raises
    ------
    InputError
        If results are written there over and over.
    """
    folder = Path(folder)
    for _ in range(_ATTEMPTS):
        finish_commit(folder)
        stamp = _stamp(folder)
        try:
            result = read()
        except (InputError, OSError):
            if _stamp(folder) == stamp:
                raise
            continue
        if _stamp(folder) == stamp:
            return result
    raise InputError(f"{folder}: results are being written there; try again when that is done")


def _stamp(folder: Path) -> tuple[object, ...]:
    """Changes with every commit: whether one is pending, and which record is in place."""
    pending = (folder / PENDING_FOLDER).exists()
    with suppress(OSError):
        status = (folder / PROVENANCE_FILE).stat()
        return pending, status.st_mtime_ns, status.st_ino, status.st_size
    return (pending,)
