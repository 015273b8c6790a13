"""What is reviewed: a run, its frames and edits, and the tables that the page shows."""

import shlex
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import RLock
from typing import Any

import numpy as np
import pandas as pd

from contactimg import files
from contactimg.engine.parallel import sharing
from contactimg.engine.progress import shown_by
from contactimg.errors import InputError
from contactimg.pipeline.measured_series import write_run
from contactimg.pipeline.pictures import series_stretch
from contactimg.pipeline.series import edits_by_frame, measure_parts
from contactimg.review.frame_view import LIGHT_TOP, FrameView, picture
from contactimg.review.jobs import Jobs
from contactimg.scene import Scene, scene_from_dict
from contactimg.tables import CONTACTS, EDITS, FRAMES, OUTLINES, REJECTED

KEPT_FRAMES = 4
"""Prepared frames and pictures kept in memory. Chosen: going back and forth between two or three."""

TABLES = tuple(schema.name for schema in (CONTACTS, FRAMES, REJECTED, OUTLINES))
"""Tables that the page may read from the folder of a run."""
CONTACT_COLUMNS = (
    "label", "x_px", "y_px", "radius_px", "radius_std_px", "flags", "shape", "semi_major_px", "semi_minor_px",
    "angle_rad", "area_m2", "force_N", "force_std_N", "asperity",
)  # fmt: skip
"""Columns of the contacts that the page uses."""
NOT_MEASURED = {"status": "not measured", "n_contacts": None, "load_N": None}
"""Columns of the frames that the list of frames shows, and what it shows of a frame that the run lacks."""

Edits = list[dict[Any, Any]]


def _plain(table: pd.DataFrame) -> pd.DataFrame:
    """A table with None for what JSON does not have."""
    return table.astype(object).where(table.notna(), None).replace([np.inf, -np.inf], None)


def plain_rows(table: pd.DataFrame) -> list[dict[Any, Any]]:
    """Rows with None for what JSON does not have."""
    return _plain(table).to_dict("records")


@dataclass(frozen=True, eq=False)
class Shown:
    """The run that is shown, the folder of its files, and the edits and the scene that it was made from.

    Edits are None where they are not known, because the file has changed since.
    """

    run: files.Run
    folder: Path
    edits: Edits | None
    scene: Scene

    @cached_property
    def tables(self) -> dict[str, files.FrameTables]:
        """Name of a frame -> its tables."""
        return dict(self.run.by_frame())

    @cached_property
    def rows(self) -> dict[str, dict[str, Any]]:
        """Name of a frame -> its row of the table of frames."""
        return {row["frame"]: row for row in plain_rows(self.run.frames)}

    def of_frame(self, frame: str) -> dict[str, Any]:
        """Contacts, rejected candidates, outlines and the row of one frame, for the page."""
        tables, lines = self.tables.get(frame, files.FrameTables()), dict[str, list[Any]]()
        for (label, _), part in tables.outlines.groupby(["label", "outline"]):
            lines.setdefault(str(label), []).append(part[["x_px", "y_px"]].to_numpy(float).tolist())
        return {
            "row": self.rows.get(frame),
            "contacts": _plain(tables.contacts[list(CONTACT_COLUMNS)]).to_dict("list"),
            "rejected": _plain(tables.rejected.drop(columns="frame")).to_dict("list"),
            "outlines": lines,
        }

    def text(self, name: str) -> bytes:
        """The file of a table; empty if the run has none."""
        path = self.folder / f"{name}.csv"
        return path.read_bytes() if path.exists() else b""


class Session:
    """A run under review.

    Parameters
    ----------
    folder : Path
        Output of `process`.
    workers : int or None
        Processes for measuring again.

    Raises
    ------
    InputError
        If the folder holds no run of `process`, its frames are not found, or edits do not apply to it.
    """

    def __init__(self, folder: Path, *, workers: int | None = None) -> None:
        run = files.read_run(folder)
        if run.command != "process":
            raise InputError(f"{folder}: holds no run of `contactimg process`, so there is nothing to review")
        self.folder, self.scene, self.command = folder, run.scene, str(run.provenance["command"])
        self.edits = files.EditsFile(files.edits_file(run.scene))
        if self.edits.path.is_symlink():
            raise InputError(
                f"{self.edits.path}: is a link, which is not followed; put the table itself there"
            )
        self.jobs, self._workers, self._lock = Jobs(), workers, RLock()
        self._known: tuple[str, Edits] = ("", [])
        self.shown = Shown(run, folder, self._edits_of_run(run.provenance["inputs"]), run.scene)
        self.sources = list(self.open().frames)
        recorded = {str(entry["path"]) for entry in run.provenance["inputs"]}
        tops = [Path(self.scene.folder).resolve(), folder.resolve()]
        for source in self.sources:  # what the page shows lies in these folders, or the run was made from it
            path = source.path.resolve()
            if str(path) not in recorded and not any(path.is_relative_to(top) for top in tops):
                raise InputError(
                    f"{source.path}: leads to {path}, which the run was not made from; repeat the run"
                )
        self._pixel_size = None if run.pose is None else run.pose.pose.pixel_size
        self._scratch = TemporaryDirectory(prefix="contactimg_review_")
        self.picture = lru_cache(KEPT_FRAMES)(self._picture)
        self._view = lru_cache(KEPT_FRAMES)(lambda number, _masks: FrameView.of(self.open(), number))

    def close(self) -> None:
        """Remove the files of tables that were measured again."""
        self.jobs.close()
        self._scratch.cleanup()

    def open(self) -> files.Experiment:
        """The experiment with the edits as they are now."""
        return files.open_experiment(self.scene)

    def _edits_of_run(self, inputs: list[dict[str, Any]]) -> Edits | None:
        """The edits that the run was measured with, if the file is still the same."""
        path = str(self.edits.path.resolve())
        digest = next((str(entry.get("sha256")) for entry in inputs if entry["path"] == path), "")
        if not digest:
            return []
        return self._edits_now() if digest.startswith(self.edits.version or "-") else None

    # what the page shows

    def record(self) -> dict[str, Any]:
        """The run and its frames."""
        with self._lock:
            shown, edits = self.shown, self._edits_now()
            pending = _changed_frames(shown.edits, edits)
            return {
                "run": str(self.folder),
                "command": self.command,
                "scene_file": None if self.scene_file is None else str(self.scene_file),
                "method": self.scene.measure.method,
                "threshold": self.scene.measure.threshold,
                "changed": list(shown.run.changed),
                "scene_changed": self.scene != shown.scene,
                "edits": edits,
                "measured": self.jobs.state.number if shown.folder != self.folder else 0,
                "frames": [
                    {key: shown.rows.get(name, NOT_MEASURED)[key] for key in NOT_MEASURED}
                    | {
                        "name": name,
                        "n_edits": sum(row["frame"] in (name, files.EVERY_FRAME) for row in edits),
                        "pending": pending is None or bool(pending & {name, files.EVERY_FRAME}),
                    }
                    for name in (source.name for source in self.sources)
                ],
                "job": asdict(self.jobs.state),
            }

    def _edits_now(self) -> Edits:
        """The edits, with None for what JSON does not have; the file is read again when it has changed."""
        with self._lock:
            version = self.edits.version
            if version != self._known[0]:
                self._known = (version, plain_rows(self.edits.read()))
            return self._known[1]

    def contacts(self, number: int) -> dict[str, Any]:
        """Contacts, rejected candidates and outlines of a frame."""
        return self.shown.of_frame(self.sources[number].name)

    def light_picture(self, number: int) -> bytes:
        """PNG of the light of the contacts of a frame: 0 background, 255 1.25 times the contrast."""
        return picture(self.view(number).light, (0.0, LIGHT_TOP))

    def curves(self, number: int) -> dict[str, Any]:
        """Count and area against the threshold."""
        corrections = edits_by_frame(self.open()).get(self.sources[number].name, ())
        return self.view(number).curves(corrections, self._pixel_size)

    def window(self, number: int, label: int) -> dict[str, Any]:
        """Pixels and model of a contact that the page shows."""
        name = self.sources[number].name
        tables = self.shown.tables.get(name, files.FrameTables())
        if label not in set(tables.contacts["label"]):
            raise InputError(f"{name}: has no contact {label}")
        return self.view(number).window(tables, label)

    def view(self, number: int) -> FrameView:
        """A frame prepared for closer looks, with the masks as they are now."""
        frames = (self.sources[number].name, files.EVERY_FRAME)
        ours = [row for row in self._edits_now() if row["frame"] in frames]
        return self._view(number, tuple(_meaning(row) for row in ours if row["action"] == files.MASK))

    def _picture(self, number: int) -> bytes:
        """PNG of a frame as it was recorded."""
        return picture(replace(self.sources[number], correct=None).read().image, self._stretch)

    @cached_property
    def _stretch(self) -> tuple[float, float]:
        return series_stretch([replace(source, correct=None) for source in self.sources])

    # what the page changes

    def insert(self, rows: list[dict[str, Any]], place: int | None) -> None:
        """Write edits; those that are there already, with the same time, were sent twice."""
        table = EDITS.conform(pd.DataFrame(rows, columns=list(EDITS.columns)))
        unknown = set(table["frame"]) - {files.EVERY_FRAME, *(source.name for source in self.sources)}
        if unknown:
            raise InputError(f"edits: there is no frame {min(unknown)!r}")
        with self._lock:
            present = self._edits_now()
            new = [not row["time"] or row not in present for row in plain_rows(table)]
            if any(new):
                self.edits.insert(table[new], place)

    def remove(self, place: int, expected: dict[str, Any]) -> None:
        """Take out an edit, of equal ones that nearest to the place: another page may have moved it."""
        with self._lock:
            rows = self.edits.read()
            wanted = EDITS.conform(pd.DataFrame([expected], columns=list(EDITS.columns)))
            equal = [k for k in rows.index if rows.loc[[k]].reset_index(drop=True).equals(wanted)]
            if not equal:
                raise InputError(f"{self.edits.path}: no longer has this edit")
            self.edits.remove(min(equal, key=lambda k: abs(k - place)))

    @property
    def scene_file(self) -> Path | None:
        """The scene file that `process` read; None without one, or where it is named by an option."""
        path = Path(self.scene.folder) / files.SCENE_FILE
        return path if path.is_file() and "--scene" not in shlex.split(self.command) else None

    def choose_threshold(self, threshold: float) -> None:
        """Write a threshold and the method that it acts on into the scene file, and measure with both.

        Raises
        ------
        InputError
            If the run was made without a scene file.
        """
        if self.scene_file is None:
            raise InputError(
                "the run was made without a scene.toml beside the frames; take the options "
                f"--method threshold --threshold {threshold:g} of `contactimg process`"
            )
        keys: dict[str, str | float] = {"method": "threshold", "threshold": threshold}
        with self._lock:
            files.set_scene_keys(self.scene_file, "measure", keys)
            data = self.scene.configuration
            measure = data.get("measure", {}) | keys
            self.scene = scene_from_dict(data | {"measure": measure}, folder=self.scene.folder)

    # measuring again

    def measure(self) -> bool:
        """Start measuring the series as `process` does, with the present edits; False if a job runs."""
        return self.jobs.start(self._measure, total=len(self.sources))

    def _measure(self, advance: Any) -> None:
        """Measure the series; frames whose edits and scene are as before come from the store."""
        with self._lock:
            edits, experiment, scene = self._edits_now(), self.open(), self.scene
        record = files.provenance(command="contactimg review", scene=scene, inputs=experiment.inputs)
        top = Path(self._scratch.name)
        store = files.PartStore(top / "frames", record, resumes=False)
        with shown_by(lambda _text, _count: nullcontext(advance)), sharing(self._workers):
            series = measure_parts(experiment, store=store)
        folder = top / f"tables_{self.jobs.state.number}"
        folder.mkdir()
        write_run(series, folder)
        with self._lock:
            self.shown = Shown(series.run, folder, edits, scene)


def _meaning(row: dict[Any, Any]) -> tuple[Any, ...]:
    """The part of an edit that acts; who made it, when and why does not matter."""
    return tuple(row[name] for name in ("frame", "action", "x_px", "y_px", "radius_px", "points"))


def _changed_frames(before: Edits | None, now: Edits) -> set[str] | None:
    """Frames whose edits are other ones than before; None if those before are not known."""
    if before is None:
        return None
    changes: dict[str, tuple[list[Any], list[Any]]] = {}
    for k, rows in enumerate((before, now)):
        for row in rows:
            changes.setdefault(row["frame"], ([], []))[k].append(_meaning(row))
    return {frame for frame, (old, new) in changes.items() if old != new}
