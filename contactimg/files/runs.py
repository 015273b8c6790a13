"""The provenance of a result, and reading a run back from its output folder."""

import importlib.metadata
import json
import logging
import os
import platform
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from contactimg import __version__
from contactimg.errors import InputError
from contactimg.files.commit import PROVENANCE_FILE, read_settled
from contactimg.files.input_files import InputFiles
from contactimg.files.run_record import check_record
from contactimg.files.run_tables import read_run_table, table_file
from contactimg.files.table_hashes import changed_tables
from contactimg.forces import sums_of_contacts
from contactimg.scene import Scene, scene_from_dict
from contactimg.tables import CONTACTS, FRAMES, OUTLINES
from contactimg.timings import stage

logger = logging.getLogger(__name__)

SCHEMA_VERSION = 1
"""Increased when a column or key is added to the output; names are never changed."""


@stage("provenance")
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
        on), platform, configuration (scene, scene_folder, options) and inputs (`InputFiles`).

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
        "versions": _versions(),
        "platform": platform.platform(),
        "configuration": configuration,
        "inputs": InputFiles.read(inputs),
    }


def relative_to_output(record: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Add the folder of the scene relative to the output folder, so that both can be moved together."""
    configuration = dict(record.get("configuration", {}))
    if "scene_folder" in configuration:
        with suppress(ValueError):  # on another drive
            relative = os.path.relpath(configuration["scene_folder"], folder.resolve())
            configuration["scene_folder_relative"] = Path(relative).as_posix()
    return dict(record) | {"configuration": configuration}


def _versions() -> dict[str, str]:
    """Versions of contactimg, Python and the libraries that contactimg declares."""
    declared = importlib.metadata.requires("contactimg") or []
    names = [re.split(r"[^A-Za-z0-9._-]", line, maxsplit=1)[0] for line in declared if "extra ==" not in line]
    versions = {name: importlib.metadata.version(name) for name in sorted(names)}
    return {"contactimg": __version__, "python": platform.python_version()} | versions


def read_records(folder: Path) -> list[dict[str, Any]]:
    """The records of the runs that share an output folder, the last one first.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    list of dict
        As `provenance` makes them, each with the names of its files as ``outputs``.

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


@dataclass(frozen=True, eq=False)
class RunFolder:
    """The output of `process` or `predict`.

    Attributes
    ----------
    folder : Path
        The output folder.
    contacts, frames : DataFrame
        Columns of `contactimg.tables.CONTACTS` (flags as numbers) and `contactimg.tables.FRAMES`. If a table
        was changed after the run, number, area and forces of each frame are summed from the contacts.
    scene : Scene or None
        The scene of the run, with all keys.
    provenance : dict
        The record of the run in provenance.json.
    changed : tuple of str
        Names of the tables that were changed after the run.
    """

    folder: Path
    contacts: pd.DataFrame
    frames: pd.DataFrame
    scene: Scene | None
    provenance: dict[str, Any]
    changed: tuple[str, ...] = ()

    @property
    def outlines(self) -> pd.DataFrame:
        """Outlines of the contacts of free shape, columns of `contactimg.tables.OUTLINES`."""
        return read_run_table(self.folder, OUTLINES, optional=True)

    @property
    def command(self) -> str:
        """The command that made the run, ``process`` or ``predict``; empty if not recorded."""
        words = str(self.provenance.get("command", "")).split()
        return words[1] if len(words) > 1 else ""


def read_run(folder: str | Path) -> RunFolder:
    """Read back the output folder of a run.

    Parameters
    ----------
    folder : str or Path
        Output of `process` or `predict`.

    Returns
    -------
    RunFolder
        Tables, scene and provenance.

    Raises
    ------
    InputError
        If the folder holds no complete run, or one written by a newer contactimg.
    """
    folder = Path(folder)
    return read_settled(folder, lambda: _read_run(folder))


def _read_run(folder: Path) -> RunFolder:
    """The run in a folder; see `read_run`."""
    try:
        records = read_records(folder)
    except OSError:
        raise InputError(f"{folder}: holds no run of contactimg ({PROVENANCE_FILE} is missing)") from None
    except (ValueError, RecursionError):
        raise InputError(f"{folder / PROVENANCE_FILE}: is damaged; repeat the run") from None
    record = _record_of_contacts(records)
    version = record.get("schema_version")
    if isinstance(version, int) and version > SCHEMA_VERSION:
        raise InputError(
            f"{folder}: was written by a newer contactimg (schema {version}, this one reads {SCHEMA_VERSION})"
        )
    record = check_record(record, folder / PROVENANCE_FILE)
    contacts = read_run_table(folder, CONTACTS, infinite=True)
    frames = read_run_table(folder, FRAMES, infinite=True)
    _check_tables(folder, contacts, frames)
    changed = changed_tables(record, folder)
    if changed:
        frames = sums_of_contacts(contacts, frames)
        logger.warning(
            "%s: %s was changed after the run; numbers, areas and forces are summed anew",
            folder,
            " and ".join(changed),
        )
    scene = _scene_of_run(folder, record["configuration"])
    return RunFolder(folder, contacts, frames, scene, record, tuple(changed))


def _record_of_contacts(records: list[dict[str, Any]]) -> dict[str, Any]:
    """The record of the command that wrote the contacts; the last one if none says so."""
    for record in records:
        outputs = record.get("outputs")
        if isinstance(outputs, list) and {"contacts.csv", "contacts.parquet"} & set(map(str, outputs)):
            return record
    return records[0]


def _check_tables(folder: Path, contacts: pd.DataFrame, frames: pd.DataFrame) -> None:
    """Raise if the tables of a run do not belong together."""
    repeated = frames["frame"][frames["frame"].duplicated()]
    if len(repeated):
        raise InputError(f"{table_file(folder, FRAMES)}: names frame {repeated.iloc[0]!r} more than once")
    unknown = contacts["frame"][~contacts["frame"].isin(frames["frame"])]
    if len(unknown):
        raise InputError(
            f"{table_file(folder, CONTACTS)}: names frame {unknown.iloc[0]!r}, which "
            f"{table_file(folder, FRAMES).name} does not; "
            "repeat the run"
        )
    if (contacts["asperity"] < 0).any():
        raise InputError(
            f"{table_file(folder, CONTACTS)}: column asperity must not be negative; repeat the run"
        )
    placed = np.isfinite(contacts[["x_m", "y_m"]].to_numpy(float)).all(axis=1)
    if placed.any() and not placed.all():
        raise InputError(
            f"{table_file(folder, CONTACTS)}: row {int(np.argmin(placed)) + 1} of {len(placed)} has no x_m "
            "and y_m, others have; delete the row or repeat the run"
        )


def _scene_of_run(folder: Path, configuration: dict[str, Any]) -> Scene | None:
    """The scene of a run; it may have been moved together with the output folder."""
    data = configuration.get("scene")
    if data is None:
        return None
    return scene_from_dict(
        data, name=str(folder / PROVENANCE_FILE), folder=_scene_folder(folder, configuration)
    )


def _scene_folder(folder: Path, configuration: dict[str, Any]) -> str:
    """The folder of the scene: as recorded, or else relative to the output folder."""
    recorded = str(configuration.get("scene_folder", "."))
    relative = configuration.get("scene_folder_relative")
    if Path(recorded).is_dir() or relative is None:
        return recorded
    return os.path.normpath(folder / relative)
