"""The output folder of a run: written completely or not at all, with its provenance."""

import os
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from filelock import FileLock, Timeout

from contactimg.engine.processes import signals_held
from contactimg.errors import InputError
from contactimg.files.atomic import write_json
from contactimg.files.commit import (
    LOCK_FILE,
    PROVENANCE_FILE,
    STAGING_FOLDER,
    commit,
    complete_commit,
    files_of,
    records_of_runs,
    release_lock_file,
    task_of,
)
from contactimg.files.part_store import PARTS_FOLDER, PartStore
from contactimg.files.runs import changed_inputs, table_hashes
from contactimg.timings import stage


class OutputFolder:
    """The output folder of one run, written completely or not at all.

    Inside the ``with`` block files are written to a hidden folder; they are moved to their places when the
    block ends without an error. If the process ends while they are moved, the next command that writes or
    reads the folder moves the rest (`contactimg.files.commit`).

    Parameters
    ----------
    path : str or Path
        Created if needed. It must be new, empty, or contain output of contactimg.
    record : mapping
        From `provenance`; written as provenance.json together with the names of the files of the run.
    main_files : sequence of str
        Files that this run will certainly write. If another command wrote one of them there, the folder is
        refused before any work is done.

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
    >>> from contactimg.files import provenance
    >>> with TemporaryDirectory() as top:
    ...     with OutputFolder(Path(top) / "out", provenance(command="demo")) as out:
    ...         _ = (out.folder / "note.txt").write_text("done")
    ...     sorted(file.name for file in (Path(top) / "out").iterdir())
    ['note.txt', 'provenance.json']
    """

    def __init__(
        self, path: str | Path, record: Mapping[str, Any], *, main_files: Sequence[str] = ()
    ) -> None:
        self.path = Path(path)
        self.folder = self.path / STAGING_FOLDER
        self.record = dict(record)
        self._main_files = {Path(name) for name in main_files}
        self._created: list[Path] = []
        self._lock = FileLock(self.path / LOCK_FILE, timeout=0)

    def __enter__(self) -> Self:
        self._created = [folder for folder in (self.path, *self.path.parents) if not folder.exists()]
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self._lock.acquire()
        except Timeout:
            raise InputError(
                f"{self.path}: another run is writing there; wait for it or choose another output folder"
            ) from None
        except OSError as error:
            self._remove_created()
            raise InputError(
                f"{self.path}: cannot be written ({error.strerror or error}); choose another output folder"
            ) from None
        try:
            complete_commit(self.path)
            self._check_contents()
            shutil.rmtree(self.folder, ignore_errors=True)  # left by a run that was killed
            self.folder.mkdir()
        except BaseException:
            self._release()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with signals_held():
            try:
                if kind is None:
                    self._commit()
            finally:
                self._release()

    def part_store(self) -> PartStore:
        """Results that an earlier run of the same command left when it was ended; inside the block.

        The store is deleted when this run succeeds, and stays if it is ended or fails.
        """
        return PartStore(self.path / PARTS_FOLDER, self.record)

    def _check_contents(self) -> None:
        """Raise if the folder contains files but no run, or files of another command to be replaced."""
        visible = [item.name for item in self.path.iterdir() if not item.name.startswith(".")]
        if visible and not records_of_runs(self.path):
            raise InputError(
                f"{self.path}: holds files but no earlier run (among them {min(visible)}); "
                "choose a new or empty output folder"
            )
        self._refuse_others(self._main_files)

    def _refuse_others(self, files: set[Path]) -> None:
        """Raise if a run of another command wrote one of the files."""
        task = task_of(self.record)
        for record in records_of_runs(self.path):
            common = files & files_of(record)
            if common and task_of(record) != task:
                raise InputError(
                    f"{self.path}: holds the output of '{task_of(record)}' ({min(common).as_posix()}), which "
                    f"'{task}' does not replace; choose another output folder"
                )

    @stage("writing")
    def _commit(self) -> None:
        """Replace the files of the earlier run of the same command by the new ones."""
        changed = changed_inputs(self.record)
        if changed:
            raise InputError(
                f"{changed[0]} changed while the command ran"
                + (f" (and {len(changed) - 1} other files)" if len(changed) > 1 else "")
                + "; start the command again when the files are complete"
            )
        new = {file.relative_to(self.folder) for file in self.folder.rglob("*") if file.is_file()}
        self._refuse_others(new)
        outputs = [file.as_posix() for file in sorted(new)]
        top = self.record | {"outputs": outputs, "sha256": table_hashes(self.folder, outputs)}
        configuration = top.get("configuration", {})
        if "scene_folder" in configuration:  # so that both folders can be moved together
            with suppress(ValueError):  # on another drive
                relative = os.path.relpath(configuration["scene_folder"], self.path.resolve())
                top["configuration"] = configuration | {"scene_folder_relative": Path(relative).as_posix()}
        others = [one for one in records_of_runs(self.path) if task_of(one) != task_of(self.record)]
        write_json(top | ({"beside": others} if others else {}), self.folder / PROVENANCE_FILE)
        commit(self.path)
        shutil.rmtree(self.path / PARTS_FOLDER, ignore_errors=True)

    def _release(self) -> None:
        """Remove the hidden files and the folders that are still empty, and release the lock."""
        shutil.rmtree(self.folder, ignore_errors=True)
        with suppress(OSError):  # it holds parts, or was never made
            (self.path / PARTS_FOLDER).rmdir()
        release_lock_file(self.path)
        self._lock.release()
        self._remove_created()

    def _remove_created(self) -> None:
        """Remove the folders that this run created, as far as they are empty."""
        for folder in self._created:
            with suppress(OSError):
                folder.rmdir()
