"""The output folder of a run: its provenance, and one rename to the new result."""

import hashlib
import importlib.metadata
import json
import logging
import os
import platform
import re
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any, Self, TypeVar

from filelock import FileLock, Timeout

from contactimg import __version__
from contactimg.engine.processes import signals_held
from contactimg.errors import InputError
from contactimg.files.atomic import first_names, flush_to_disk, write_json
from contactimg.files.resume import PARTS_FOLDER, PartStore
from contactimg.scene import Scene

logger = logging.getLogger(__name__)

Result = TypeVar("Result")

SCHEMA_VERSION = 1
"""Increased when a column or key is added to the output; names are never changed."""

LOCK_FILE = ".contactimg.lock"
STAGING_FOLDER = ".contactimg.part"
PENDING_FOLDER = ".contactimg.commit"
PROVENANCE_FILE = "provenance.json"


def provenance(
    *,
    command: str,
    scene: Scene | None = None,
    options: Mapping[str, Any] | None = None,
    inputs: Iterable[Path] = (),
) -> dict[str, Any]:
    """Record how a result was made.

    Parameters
    ----------
    command : str
        The command line.
    scene : Scene, optional
        Recorded with all keys, including defaults.
    options : mapping, optional
        Settings that are not in the scene.
    inputs : iterable of Path
        Files that were read; recorded with size and SHA-256.

    Returns
    -------
    dict
        schema_version, command, created (UTC), versions (of contactimg, Python and each library it depends
        on), platform, configuration (scene, scene_folder, options) and inputs.

    Examples
    --------
    >>> provenance(command="contactimg process frames")["schema_version"]
    1
    """
    configuration: dict[str, Any] = {"options": dict(options or {})}
    if scene is not None:
        configuration |= {"scene": scene.configuration, "scene_folder": str(Path(scene.folder).resolve())}
    return {
        "schema_version": SCHEMA_VERSION,
        "command": command,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {"contactimg": __version__, "python": platform.python_version()} | _library_versions(),
        "platform": platform.platform(),
        "configuration": configuration,
        "inputs": [_fingerprint(path.resolve()) for path in inputs],
    }


@cache
def _library_versions() -> dict[str, str]:
    """Version of each library that the package depends on; to read them takes 40 ms."""
    declared = importlib.metadata.requires("contactimg") or []
    names = [re.split(r"[^A-Za-z0-9._-]", line, maxsplit=1)[0] for line in declared if "extra ==" not in line]
    return {name: importlib.metadata.version(name) for name in sorted(names)}


def _fingerprint(path: Path) -> dict[str, Any]:
    """Path, size, SHA-256 and time of the last change of a file; the error if it cannot be read."""
    try:
        with path.open("rb") as file:
            status = os.fstat(file.fileno())  # before the content: a change while it is read is noticed
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        return {"path": str(path), "bytes": None, "sha256": None, "error": error.strerror}
    size, time = status.st_size, status.st_mtime_ns
    return {"path": str(path), "bytes": size, "sha256": digest, "modified_ns": time}


def changed_inputs(record: Mapping[str, Any]) -> list[str]:
    """Input files of a run that were changed since it read them; those that are gone are not among them."""
    found = []
    for entry in record.get("inputs", []):
        with suppress(OSError):
            status = os.stat(entry["path"])  # noqa: PTH116 - for 10^5 files
            now = {"bytes": status.st_size, "modified_ns": status.st_mtime_ns}
            if "modified_ns" in entry and now != {name: entry[name] for name in now}:
                found.append(entry["path"])
    return found


def sha256_of(path: Path) -> str:
    """SHA-256 of a file; of a missing one, a word that equals no hash."""
    return str(_fingerprint(path)["sha256"] or "missing")


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


def command_of(record: Mapping[str, Any]) -> str:
    """The command that made a result, ``process`` for example; empty if it is not recorded."""
    return [*str(record.get("command", "")).split(), "", ""][1]


def task_of(record: Mapping[str, Any]) -> str:
    """The kind of run: program, command and, for a calibration, its kind."""
    words = str(record.get("command", "")).split()
    return " ".join(words[: 3 if words[1:2] == ["calibrate"] else 2])


class OutputFolder:
    """The output folder of one run, written completely or not at all.

    Inside the ``with`` block files are written to a hidden folder; they are moved to their places when the
    block ends without an error. If the process ends while they are moved, the next command that writes or
    reads the folder moves the rest (`finish_commit`).

    Parameters
    ----------
    path : Path
        Created if needed. It must be new, empty, or contain output of contactimg.
    record : dict
        From `provenance`; written as provenance.json together with the names of the files of the run.
    main_files : sequence of str
        Files that this run will certainly write. If another command wrote one of them there, the folder is
        refused before any work is done.
    keeps : sequence of str
        Files and folders of the earlier run of the same command that stay, unless this run writes them.

    Attributes
    ----------
    path : Path
        The output folder.
    folder : Path
        The folder to write to inside the block.

    Raises
    ------
    InputError
        If the folder cannot be written, contains files but no run, is being written by another run, or
        contains files of another command that this run would replace.

    Notes
    -----
    A run that fails leaves the folder as it was. A run that succeeds replaces the earlier one of the same
    command: files that only the earlier run wrote are deleted. Different commands can share a folder if they
    write different files; the record of the last one is at the top of provenance.json, the others are under
    ``beside``. Files that no run wrote stay; if a new file has the same name, the old one is renamed with
    ``.bak``. The lock belongs to the operating system and ends with the process, so a killed run does not
    block the next one.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as top:
    ...     with OutputFolder(Path(top) / "out", provenance(command="demo")) as out:
    ...         _ = (out.folder / "note.txt").write_text("done")
    ...     sorted(file.name for file in (Path(top) / "out").iterdir())
    ['note.txt', 'provenance.json']
    """

    def __init__(
        self, path: Path, record: dict[str, Any], *, main_files: Sequence[str] = (), keeps: Sequence[str] = ()
    ) -> None:
        self.path, self.record = path, dict(record)
        self.folder = path / STAGING_FOLDER
        self._main_files, self._keeps = {Path(name) for name in main_files}, set(keeps)
        self._undo = ExitStack()
        self._lock = FileLock(self.path / LOCK_FILE, timeout=0)

    def __enter__(self) -> Self:
        created = [folder for folder in (self.path, *self.path.parents) if not folder.exists()]
        with ExitStack() as undo:
            undo.callback(_remove_empty, created)
            try:
                self.path.mkdir(parents=True, exist_ok=True)
                self._lock.acquire()
            except OSError as error:
                reason = f"cannot be written ({error.strerror or error});"
                if isinstance(error, Timeout):
                    reason = "another run is writing there; wait for it or"
                raise InputError(f"{self.path}: {reason} choose another output folder") from None
            # in the opposite order: the hidden files first, the lock last
            undo.callback(self._lock.release)
            undo.callback(_drop_lock_file, self.path)
            undo.callback(_remove_empty, [self.path / PARTS_FOLDER])
            undo.callback(shutil.rmtree, self.folder, ignore_errors=True)
            _complete_commit(self.path)
            visible = [item.name for item in self.path.iterdir() if not item.name.startswith(".")]
            if visible and not records_of_runs(self.path):
                raise InputError(
                    f"{self.path}: holds files but no earlier run (among them {min(visible)}); "
                    "choose a new or empty output folder"
                )
            self._refuse_others(self._main_files)
            shutil.rmtree(self.folder, ignore_errors=True)  # left by a run that was killed
            self.folder.mkdir()
            self._undo = undo.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_error: object) -> None:
        with signals_held(), self._undo:
            if kind is None:
                self._commit()

    def part_store(self) -> "PartStore":
        """Results that an earlier run of the same command left when it was ended; inside the block.

        The store is deleted when this run succeeds, and stays if it is ended or fails.
        """
        return PartStore(self.path / PARTS_FOLDER, self.record)

    def _refuse_others(self, files: set[Path]) -> None:
        """Raise if a run of another command wrote one of the files."""
        for other in _files_and_others(self.path, self.record)[1]:
            if common := files & files_of(other):
                raise InputError(
                    f"{self.path}: holds the output of '{task_of(other)}' ({min(common).as_posix()}), which "
                    f"'{task_of(self.record)}' does not replace; choose another output folder"
                )

    def _commit(self) -> None:
        """Replace the files of the earlier run of the same command by the new ones.

        The folder with the new files is renamed: before this rename the earlier result stands, after it the
        new one does, even if the process ends before the files are in their places. What has to be moved and
        deleted stands in the two records, of which the new one takes the place of the earlier one last.
        """
        if changed := first_names(changed_inputs(self.record)):
            cure = "start the command again when the files are complete"
            raise InputError(f"{changed} changed while the command ran; {cure}")
        new = {file.relative_to(self.folder) for file in self.folder.rglob("*") if file.is_file()}
        self._refuse_others(new)
        for name in new:
            file = self.path / name
            if file.is_dir():
                raise InputError(f"{file}: is a folder, where the run writes a file; move it away")
            for place in (self.path / parent for parent in name.parents[:-1]):
                if place.exists() and not place.is_dir():
                    raise InputError(f"{place}: is a file, where the run needs a folder; move it away")
        earlier, others = _files_and_others(self.path, self.record)
        kept = {name for name in earlier if name.parts[0] in self._keeps and (self.path / name).is_file()}
        tables = (name for name in new if name.suffix in (".csv", ".parquet"))
        hashes = {name.as_posix(): sha256_of(self.folder / name) for name in tables}
        outputs = [file.as_posix() for file in sorted(new | kept)]
        top = self.record | {"outputs": outputs, "sha256": dict(sorted(hashes.items()))}
        configuration = top.get("configuration", {})
        if "scene_folder" in configuration:  # so that both folders can be moved together
            with suppress(ValueError):  # on another drive
                relative = os.path.relpath(configuration["scene_folder"], self.path.resolve())
                top["configuration"] = configuration | {"scene_folder_relative": Path(relative).as_posix()}
        write_json(top | ({"beside": others} if others else {}), self.folder / PROVENANCE_FILE)
        flush_to_disk(self.folder / PROVENANCE_FILE)
        self.folder.rename(self.path / PENDING_FOLDER)
        _complete_commit(self.path)
        shutil.rmtree(self.path / PARTS_FOLDER, ignore_errors=True)


def _files_and_others(folder: Path, record: Mapping[str, Any]) -> tuple[set[Path], list[dict[str, Any]]]:
    """The files that runs of the same task wrote in a folder, and the records of the runs of other tasks."""
    task, records = task_of(record), records_of_runs(folder)
    earlier = (files_of(one) for one in records if task_of(one) == task)
    return set[Path]().union(*earlier), [one for one in records if task_of(one) != task]


def _remove_empty(folders: Iterable[Path]) -> None:
    """Remove folders as far as they are there and empty."""
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()


def _complete_commit(folder: Path) -> None:
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
        earlier, _ = _files_and_others(folder, record)
        for name in sorted(new):
            source, target = pending / name, folder / name
            if not source.exists():  # it is in its place already
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            if name not in earlier and target.exists():
                kept = target.with_name(target.name + ".bak")
                logger.warning("%s was not written by a run; it is kept as %s", target, kept.name)
                target.replace(kept)
            source.replace(target)
        for name in sorted(earlier - new):
            (folder / name).unlink(missing_ok=True)
            _remove_empty(folder / parent for parent in name.parents[:-1])
        (pending / PROVENANCE_FILE).replace(folder / PROVENANCE_FILE)
    if pending.exists():
        shutil.rmtree(pending)


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
        with FileLock(folder / LOCK_FILE, timeout=20.0):  # s, chosen: to move 10^4 files takes one
            _complete_commit(folder)
            _drop_lock_file(folder)
    except Timeout:
        raise InputError(f"{folder}: results are being written there; try again when that is done") from None
    except OSError as error:
        raise InputError(
            f"{folder}: a run ended while its results were moved into place, and they cannot be moved now "
            f"({error.strerror or error}); make the folder writable and try again"
        ) from None


def _drop_lock_file(folder: Path) -> None:
    """Delete the lock file, which its owner is about to release."""
    with suppress(OSError):  # Windows does not delete an open file
        (folder / LOCK_FILE).unlink()


def read_settled(folder: str | Path, read: Callable[[], Result]) -> Result:
    """Return what ``read`` returns, with all files from before a commit or all from after it.

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
    for _ in range(5):  # chosen: a reader that meets a new commit each time gives up
        finish_commit(folder)
        stamp = _stamp(folder)
        try:
            result = read()
            if _stamp(folder) == stamp:
                return result
        except (InputError, OSError):
            if _stamp(folder) == stamp:
                raise
    raise InputError(f"{folder}: results are being written there; try again when that is done")


def _stamp(folder: Path) -> tuple[object, ...]:
    """Changes with every commit: whether one is pending, and which record is in place."""
    pending = (folder / PENDING_FOLDER).exists()
    with suppress(OSError):
        status = (folder / PROVENANCE_FILE).stat()
        return pending, status.st_mtime_ns, status.st_ino, status.st_size
    return (pending,)
