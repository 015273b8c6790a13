"""Read results back: a run from its output folder, and ``calibration.json``."""

import json
import logging
import math
import os
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from contactimg.errors import InputError
from contactimg.files import output
from contactimg.files.atomic import first_names, read_bytes
from contactimg.files.tables import read_run_table, table_file
from contactimg.forces import sums_of_contacts
from contactimg.pose import Pose
from contactimg.pose.apex import FOUND, STATED, Apex
from contactimg.pose.fit import PoseFit
from contactimg.scene import Scene, scene_from_dict
from contactimg.tables import CONTACTS, FRAMES, OUTLINES, REJECTED, Schema, Status
from contactimg.tables.outlines import Outline, contact_outlines

logger = logging.getLogger(__name__)

RUN_TABLES = ("contacts.csv", "frames.csv", "contacts.parquet", "frames.parquet")
"""The tables that other results are derived from, in either format."""


def is_out_of_date(record: Mapping[str, Any], run: Path) -> bool:
    """Whether a result was made from other tables than those that a run holds now.

    Parameters
    ----------
    record : mapping
        Of the derived result; its inputs have the hashes of the tables it was made from.
    run : Path
        The output folder of the run.
    """
    used = {name: input_hashes(record.get("inputs", []), [name]) for name in RUN_TABLES}
    return any(hashes and output.sha256_of(run / name) not in hashes for name, hashes in used.items())


def _pose_of(record: Mapping[str, Any]) -> PoseFit:
    """The pose of the camera, and how well it explains the contacts, from its `pose_record`."""
    names = ("rows", "columns", "n_points", "n_matched")
    rows, columns, points, matched = (int(record[name]) for name in names)
    x, y = map(float, record["centre_m"])
    turn = math.radians(record["rotation_deg"])
    pose = Pose((rows, columns), float(record["pixel_size_m"]), (x, y), turn, bool(record["mirrored"]))
    residual = math.nan if record["residual_m"] is None else float(record["residual_m"])
    return PoseFit(pose, bool(record["fitted"]), points, matched, residual)


def pose_record(fit: PoseFit) -> dict[str, Any]:
    """The pose of the camera as the provenance states it."""
    return {
        "rows": fit.pose.shape[0],
        "columns": fit.pose.shape[1],
        "pixel_size_m": fit.pose.pixel_size,
        "centre_m": list(fit.pose.centre),
        "rotation_deg": math.degrees(fit.pose.rotation),
        "mirrored": fit.pose.mirrored,
        "known": FOUND if fit.fitted else STATED,
        "fitted": fit.fitted,
        "n_points": fit.n_points,
        "n_matched": fit.n_matched,
        "residual_m": fit.residual,
    }


def apex_record(apex: Apex) -> dict[str, Any]:
    """The apex of the indenter as the provenance states it."""
    found: dict[str, Any] = {"apex_m": list(apex.place), "std_m": list(apex.std), "known": apex.known}
    if apex.radius is not None:
        found["indenter_radius_m"] = {"value": apex.radius, "std": apex.radius_std}
    return found


@dataclass(frozen=True, eq=False)
class FrameTables:
    """The tables of a measured frame.

    Parameters
    ----------
    contacts, rejected : DataFrame
    outlines : DataFrame
        Of its contacts of free shape.
    """

    contacts: pd.DataFrame = field(default_factory=CONTACTS.empty)
    rejected: pd.DataFrame = field(default_factory=REJECTED.empty)
    outlines: pd.DataFrame = field(default_factory=OUTLINES.empty)

    @property
    def shapes(self) -> list[Outline]:
        """The outline of each contact, whatever its shape."""
        return contact_outlines(self.contacts, self.outlines)


@dataclass(frozen=True, eq=False)
class Run:
    """A run: what `measure_series` gives, or `process` or `predict` left in a folder.

    Attributes
    ----------
    scene : Scene
        As given, with the apex that was found where none is stated; of a folder, with all keys, and without a
        section if it states none.
    contacts, frames : DataFrame
        Columns of `contactimg.tables.CONTACTS` (flags as numbers) and `contactimg.tables.FRAMES`. If a table
        was changed after the run, number, area and forces of each frame are summed from the contacts.
    pose : PoseFit or None
        Pose of the camera over the reference frame; None without a pixel size.
    tables : dict
        Name -> further tables that are in memory; those of a folder are read when they are asked for.
    folder : Path
        The output folder.
    provenance : dict
        The record of the run in provenance.json; empty for a run in memory.
    changed : tuple of str
        Names of the tables that were changed after the run.
    """

    scene: Scene
    contacts: pd.DataFrame
    frames: pd.DataFrame
    pose: PoseFit | None = None
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    folder: Path = Path()
    provenance: dict[str, Any] = field(default_factory=dict)
    changed: tuple[str, ...] = ()

    @property
    def rejected(self) -> pd.DataFrame:
        """Rejected candidates, columns of `contactimg.tables.REJECTED`."""
        return self._table(REJECTED)

    @property
    def outlines(self) -> pd.DataFrame:
        """Outlines of the contacts of free shape, columns of `contactimg.tables.OUTLINES`."""
        return self._table(OUTLINES)

    def _table(self, schema: Schema) -> pd.DataFrame:
        """A table in memory or in the folder; empty if there is none."""
        if schema.name in self.tables or not self.provenance:
            return self.tables.get(schema.name, schema.empty())
        return read_run_table(self.folder, schema, optional=True)

    def by_frame(self) -> Iterator[tuple[str, FrameTables]]:
        """Name and tables of each frame, in order."""
        tables = (self.contacts, self.rejected, self.outlines)
        groups = [dict(list(table.groupby("frame"))) for table in tables]
        for name in self.frames["frame"]:
            parts = (group.get(name, table[:0]) for group, table in zip(groups, tables, strict=True))
            yield str(name), FrameTables(*parts)

    @property
    def command(self) -> str:
        """The command that made the run, ``process`` or ``predict``; empty if not recorded."""
        return output.command_of(self.provenance)

    def need_pose(self) -> Pose:
        """The pose of the camera, or an `InputError` that says how to get one."""
        place = f"{self.folder}:" if self.provenance else "this run"
        if self.pose is None:
            raise InputError(f"{place} has no pose of the camera; run `process` with a pixel size first")
        if (self.frames["status"] == Status.NO_POSE).any() and self.scene.measure.pose == "fit":
            raise InputError(
                f"{place} found no pose of the camera: its contacts fall on no asperity; check [camera] "
                "pixel_size_m, centre_m and rotation_deg, [indenter] apex_m and the asperity table, and run "
                '`process` again; pose = "given" in [measure] takes the pose as it is stated'
            )
        return self.pose.pose


def frame_shift(frames: pd.DataFrame, name: str) -> tuple[float, float]:
    """Shift (x, y; px) of a frame against the reference, 0 where it is not known."""
    row = frames[frames["frame"] == name].iloc[0]
    shift = np.nan_to_num([row["shift_x_px"], row["shift_y_px"]], nan=0.0)
    return float(shift[0]), float(shift[1])


def read_run(folder: str | Path) -> Run:
    """Read back the output folder of a run.

    Parameters
    ----------
    folder : str or Path
        Output of `process` or `predict`.

    Returns
    -------
    Run
        Tables, scene and provenance.

    Raises
    ------
    InputError
        If the folder holds no complete run, or one written by a newer contactimg.
    """
    folder = Path(folder)
    return output.read_settled(folder, lambda: _read_run(folder))


def _read_run(folder: Path) -> Run:
    """The run in a folder; see `read_run`."""
    file = folder / output.PROVENANCE_FILE
    try:
        record, scene, pose = _read_record(folder)
    except OSError:
        raise InputError(f"{folder}: holds no run of contactimg ({file.name} is missing)") from None
    except InputError:
        raise
    except Exception as error:  # whatever a damaged record makes of it
        raise InputError(f"{file}: is damaged ({type(error).__name__}: {error}); repeat the run") from None
    for missing in (table.name for table in (CONTACTS, FRAMES) if not table_file(folder, table).is_file()):
        made, cure = output.command_of(record), "give what `process` or `predict` wrote, or repeat it"
        raise InputError(f"{folder}: holds what `{made}` wrote, and no {missing}.csv; {cure}")
    contacts, frames = read_run_table(folder, CONTACTS), read_run_table(folder, FRAMES)
    _check_tables(folder, contacts, frames)
    known = {name: record["sha256"][name] for name in RUN_TABLES if name in record["sha256"]}
    changed = [name for name in known if known[name] != output.sha256_of(folder / name)]
    if changed:
        frames = sums_of_contacts(contacts, frames)
        cure = "numbers, areas and forces are summed anew"
        logger.warning("%s: %s was changed after the run; %s", folder, " and ".join(changed), cure)
    return Run(scene, contacts, frames, pose, folder=folder, provenance=record, changed=tuple(changed))


def _read_record(folder: Path) -> tuple[dict[str, Any], Scene, PoseFit | None]:
    """The record of the run in a folder, with the scene and the pose of the camera that it states.

    Errors that a damaged record causes are left to the caller.
    """
    records, name = output.read_records(folder), str(folder / output.PROVENANCE_FILE)
    # the record of the command that wrote the contacts; the last one if none says so
    made = {"contacts.csv", "contacts.parquet"}
    record = next((one for one in records if made & set(one.get("outputs", []))), records[0])
    version = record["schema_version"]
    if version > output.SCHEMA_VERSION:
        schemas = f"schema {version}, this one reads {output.SCHEMA_VERSION}"
        raise InputError(f"{folder}: was written by a newer contactimg ({schemas})")
    record["command"].split()  # fails here if it is no text
    stated = record["configuration"]
    calibration = stated.get("options", {}).get("calibration")
    if calibration is not None:
        check_calibration(calibration["record"], f"{name}: the calibration of the run")
    place, relative = stated.get("scene_folder", "."), stated.get("scene_folder_relative")
    if relative is not None and not Path(place).is_dir():  # moved together with the output folder
        place = os.path.normpath(folder / relative)
    scene = scene_from_dict(stated.get("scene") or {}, name=name, folder=place)
    if record.get("apex") is not None:
        x, y = map(float, record["apex"]["apex_m"])
        scene = scene.with_apex((x, y))
    pose = None if record.get("pose") is None else _pose_of(record["pose"])
    read = {entry["path"]: entry.get("sha256") for entry in record.get("inputs", [])}
    later = [path for path in output.changed_inputs(record) if read[path] != output.sha256_of(Path(path))]
    if later:
        logger.warning("%s: %s changed after the run; repeat it", folder, first_names(later))
    hashes = dict(record.get("sha256", {}))
    return {"created": "", "inputs": []} | record | {"sha256": hashes}, scene, pose


def _check_tables(folder: Path, contacts: pd.DataFrame, frames: pd.DataFrame) -> None:
    """Raise if the tables of a run do not belong together."""
    names, file = frames["frame"], table_file(folder, FRAMES)
    repeated, unknown = names[names.duplicated()], contacts["frame"][~contacts["frame"].isin(names)]
    if len(repeated):
        raise InputError(f"{file}: names frame {repeated.iloc[0]!r} more than once")
    placed, wrong = np.isfinite(contacts[["x_m", "y_m"]].to_numpy(float)).all(axis=1), ""
    twice = contacts[contacts.duplicated(["frame", "label"])]
    below = (contacts[["radius_px", "radius_m", "area_m2"]] < 0).any()
    if len(unknown):
        wrong = f"names frame {unknown.iloc[0]!r}, which {file.name} does not;"
    elif len(twice):
        frame, label = twice.iloc[0][["frame", "label"]]
        wrong = f"names contact {label} of frame {frame!r} more than once;"
    elif (contacts["asperity"] < 0).any() or below.any():
        wrong = f"column {below.idxmax() if below.any() else 'asperity'} must not be negative;"
    elif placed.any() and not placed.all():
        row = int(np.argmin(placed)) + 1
        wrong = f"row {row} of {len(placed)} has no x_m and y_m, others have; delete the row or"
    if wrong:
        raise InputError(f"{table_file(folder, CONTACTS)}: {wrong} repeat the run")


# --- calibrations

CALIBRATION_FILE = "calibration.json"


def calibration_file(path: str | Path) -> Path:
    """The file of a calibration: as given, or in the folder that is given."""
    return Path(path) / CALIBRATION_FILE if Path(path).is_dir() else Path(path)


def read_calibration(path: str | Path) -> dict[str, Any]:
    """Read the result of `calibrate`.

    Parameters
    ----------
    path : path-like
        The file, or the folder that holds it.

    Returns
    -------
    dict
        For each number ``{"value": , "std": , "unit": }``, and how it was obtained.

    Raises
    ------
    InputError
        If the file cannot be read, is no JSON object, or a value in it is no number.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder) / "calibration.json"
    ...     _ = file.write_text('{"threshold": {"value": 0.43, "std": 0.02, "unit": ""}}')
    ...     read_calibration(folder)["threshold"]["value"]
    0.43
    """
    path = calibration_file(path)
    output.finish_commit(path.parent)
    data = read_bytes(path)
    try:
        record = json.loads(data)
    except ValueError as error:
        raise InputError(f"{path}: is not JSON ({error}); give the calibration.json of `calibrate`") from None
    if not isinstance(record, dict):
        raise InputError(f"{path}: must hold an object; give the calibration.json of `calibrate`")
    check_calibration(record, str(path))
    return record


NUMBERS = ("young_modulus", "threshold", "edge_shift", "centre_x", "centre_y")
"""Names of the numbers of a calibration that others act by."""


def check_calibration(record: Mapping[str, Any], place: str) -> None:
    """Raise an `InputError` if a number of a calibration is none, or has no value."""
    for name, entry in record.items():
        if not (isinstance(entry, dict) and "value" in entry):
            if name in NUMBERS:
                raise InputError(f"{place}: {name} must hold a value, got {entry!r}")
            continue
        if not _is_number(entry["value"]):
            raise InputError(f"{place}: the value of {name} must be a number, got {entry['value']!r}")
        std = entry.get("std")
        if std is not None and not (_is_number(std) and std >= 0):
            raise InputError(f"{place}: the std of {name} must be a number that is not negative, got {std!r}")


def _is_number(value: object) -> bool:
    """Whether a value of JSON is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def input_hashes(inputs: Iterable[Mapping[str, Any]], names: Collection[str]) -> frozenset[str]:
    """SHA-256 of those inputs of a run (as `provenance` lists them) that are called by one of the names."""
    chosen = (one for one in inputs if Path(str(one.get("path"))).name in names)
    return frozenset(one["sha256"] for one in chosen if one.get("sha256") is not None)
