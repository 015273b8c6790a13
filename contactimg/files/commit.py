"""Replace an earlier result by a finished one in one step; a journal lets the next command complete it."""

import json
import logging
import os
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from filelock import FileLock, Timeout

from contactimg.errors import InputError

logger = logging.getLogger(__name__)

Result = TypeVar("Result")

LOCK_FILE = ".contactimg.lock"
STAGING_FOLDER = ".contactimg.part"
PENDING_FOLDER = ".contactimg.commit"
PROVENANCE_FILE = "provenance.json"

_JOURNAL = ".journal.json"
_LOCK_SECONDS = 20.0  # chosen: moving 10^4 files takes about a second
_ATTEMPTS = 5  # chosen: a reader that meets a new commit each time gives up


@dataclass(frozen=True)
class Journal:
    """What a commit does, all of it by renaming and deleting, so that it can be done twice.

    Parameters
    ----------
    new : tuple of str
        Files to move from the pending folder to the output folder, in order; provenance.json is the last.
    foreign : tuple of str
        Those of them for which a file of the same name that no run wrote is kept as ``.bak``.
    old : tuple of str
        Files of the earlier run to delete.
    """

    new: tuple[str, ...]
    foreign: tuple[str, ...]
    old: tuple[str, ...]


def commit(folder: Path, journal: Journal) -> None:
    """Replace the earlier result by the staged one.

    The staging folder is renamed with the journal inside: before this rename the earlier result stands, after
    it the new one does, even if the process ends before the files are in their places.

    Parameters
    ----------
    folder : Path
        The output folder, locked by the caller, with the new files in `STAGING_FOLDER`.
    journal : Journal

    Raises
    ------
    InputError
        If a folder stands where a file must go, or a file where a folder must go; nothing is changed then.
    """
    staging = folder / STAGING_FOLDER
    for name in journal.new:
        _check_place(folder, Path(name))
    with (staging / _JOURNAL).open("w", encoding="utf-8") as file:
        json.dump(vars(journal), file)
        file.flush()
        os.fsync(file.fileno())
    staging.rename(folder / PENDING_FOLDER)
    _roll_forward(folder)


def _check_place(folder: Path, name: Path) -> None:
    """Raise if the file cannot be moved to its place."""
    if (folder / name).is_dir():
        raise InputError(f"{folder / name}: is a folder, where the run writes a file; move it away")
    for parent in list(name.parents)[:-1]:
        place = folder / parent
        if place.exists() and not place.is_dir():
            raise InputError(f"{place}: is a file, where the run needs a folder; move it away")


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
    lock = FileLock(folder / LOCK_FILE, timeout=_LOCK_SECONDS)
    try:
        with lock:
            complete_commit(folder)
            release_lock_file(folder)
    except Timeout:
        raise InputError(f"{folder}: results are being written there; try again when that is done") from None
    except OSError as error:
        raise InputError(
            f"{folder}: a run ended while its results were moved into place, and they cannot be moved now "
            f"({error.strerror or error}); make the folder writable and try again"
        ) from None


def complete_commit(folder: Path) -> None:
    """Complete an interrupted commit in a folder that the caller has locked."""
    if (folder / PENDING_FOLDER).exists():
        logger.info("%s: completing the commit of a run that was interrupted", folder)
        _roll_forward(folder)


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
    try:
        status = (folder / PROVENANCE_FILE).stat()
    except OSError:
        return ((folder / PENDING_FOLDER).exists(),)
    return (folder / PENDING_FOLDER).exists(), status.st_mtime_ns, status.st_ino, status.st_size


def _roll_forward(folder: Path) -> None:
    """Do what the journal says, as far as it is not done yet."""
    pending = folder / PENDING_FOLDER
    journal = _read_journal(pending)
    if journal is not None:
        foreign = set(journal.foreign)
        for name in journal.new:
            _place(folder, Path(name), foreign=name in foreign)
        for name in journal.old:
            (folder / name).unlink(missing_ok=True)
            _remove_empty((folder / name).parent, top=folder)
    shutil.rmtree(pending)


def _read_journal(pending: Path) -> Journal | None:
    """The journal of a pending commit; None where only its removal is left to do."""
    try:
        data = json.loads((pending / _JOURNAL).read_text(encoding="utf-8"))
        return Journal(*(tuple(_inside(name) for name in data[key]) for key in ("new", "foreign", "old")))
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{pending / _JOURNAL}: is damaged; delete {pending} and repeat the run") from None


def _inside(name: str) -> str:
    """The name of a file in the folder."""
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise ValueError(name)
    return name


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


def _remove_empty(folder: Path, *, top: Path) -> None:
    """Remove a folder below ``top``, and those above it, as far as they are empty."""
    while folder != top:
        try:
            folder.rmdir()
        except OSError:
            return
        folder = folder.parent
