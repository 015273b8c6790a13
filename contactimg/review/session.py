"""What is reviewed: a run, its frames and edits, and the tables that the page shows."""

import shlex
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import RLock
from typing import Any

import pandas as pd

from contactimg.calibration.plateau import find_plateau
from contactimg.errors import FrameError, InputError
from contactimg.files import (
    EVERY_FRAME,
    MASK,
    SCENE_FILE,
    EditsFile,
    Experiment,
    FrameSource,
    PartStore,
    edits_file,
    open_experiment,
    provenance,
    read_run,
    set_scene_keys,
)
from contactimg.pipeline.calibrate.threshold_scan import measure_thresholds
from contactimg.pipeline.edits import check_frames, edits_by_frame
from contactimg.pipeline.measured_series import write_run
from contactimg.pipeline.pictures import series_stretch
from contactimg.pipeline.series import measure_parts
from contactimg.review.contact_window import contact_window
from contactimg.review.curves import ThresholdCurves
from contactimg.review.frame_light import FrameLight, measure_alone
from contactimg.review.jobs import Jobs
from contactimg.review.pictures import LIGHT_TOP, picture
from contactimg.review.shown_tables import ShownTables
from contactimg.scene import Scene, scene_from_dict
from contactimg.tables import EDITS, OUTLINES

KEPT_FRAMES = 4
"""Prepared frames and pictures kept in memory. Chosen: going back and forth between two or three."""


@dataclass(frozen=True)
class _Measured:
    """What the tables shown were made from."""

    tables: ShownTables
    edits: list[dict[Any, Any]] | None
    """None where they are not known, because the file has changed since."""
    scene: Scene


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
        run = read_run(folder)
        if run.scene is None or run.command != "process":
            raise InputError(f"{folder}: holds no run of `contactimg process`, so there is nothing to review")
        if "methods" in run.provenance:
            raise InputError(
                f"{folder}: was measured with --tolerance, which edits do not go with; measure without it"
            )
        self.folder, self.scene, self.command = folder, run.scene, str(run.provenance["command"])
        self.edits = EditsFile(edits_file(run.scene, folder))
        if self.edits.path.is_symlink():
            raise InputError(
                f"{self.edits.path}: is a link, which is not followed; put the table itself there"
            )
        self.jobs, self._workers, self._lock = Jobs(), workers, RLock()
        self._preview: tuple[int, dict[str, Any]] = (-1, {})
        self._known: tuple[str, list[dict[Any, Any]]] = ("", [])
        shown = replace(ShownTables.read(folder), frames=run.frames)
        self._measured = _Measured(shown, self._edits_of_run(run.provenance["inputs"]), run.scene)
        self.changed = run.changed
        self.sources = _readable(self.open(), folder, run.provenance["inputs"])
        pose = run.provenance.get("pose")
        self._pixel_size = None if pose is None else float(pose["pixel_size_m"])
        self._scratch = TemporaryDirectory(prefix="contactimg_review_")
        self._picture = lru_cache(KEPT_FRAMES)(self._draw)
        self._light = lru_cache(KEPT_FRAMES)(self._prepare)

    def close(self) -> None:
        """Remove the files of tables that were measured again."""
        self.jobs.close()
        self._scratch.cleanup()

    def open(self) -> Experiment:
        """The experiment with the edits as they are now."""
        return open_experiment(self.scene)

    def _edits_of_run(self, inputs: list[dict[str, Any]]) -> list[dict[Any, Any]] | None:
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
            shown, edits = self._measured.tables, self._edits_now()
            pending = _changed_frames(self._measured.edits, edits)
            return {
                "run": str(self.folder),
                "command": self.command,
                "edits_file": str(self.edits.path),
                "scene_file": None if self.scene_file is None else str(self.scene_file),
                "method": self.scene.measure.method,
                "threshold": self.scene.measure.threshold,
                "changed": list(self.changed) if shown.folder == self.folder else [],
                "scene_changed": self.scene != self._measured.scene,
                "edits": edits,
                "measured": self.jobs.state.number if shown.folder != self.folder else 0,
                "frames": [
                    shown.summary(source.name)
                    | {
                        "n_edits": sum(row["frame"] in (source.name, EVERY_FRAME) for row in edits),
                        "pending": pending is None or bool(pending & {source.name, EVERY_FRAME}),
                    }
                    for source in self.sources
                ],
                "job": asdict(self.jobs.state),
            }

    def _edits_now(self) -> list[dict[Any, Any]]:
        """The edits, with None for what JSON does not have; the file is read again when it has changed."""
        with self._lock:
            version = self.edits.version
            if version != self._known[0]:
                self._known = (version, _plain_rows(self.edits.read()))
            return self._known[1]

    def tables(self) -> ShownTables:
        """Those of the run, or of the last time it was measured again."""
        with self._lock:
            return self._measured.tables

    def picture(self, number: int) -> bytes:
        """PNG of a frame as it was recorded."""
        return self._picture(number)

    def light_picture(self, number: int) -> bytes:
        """PNG of the light of the contacts of a frame: 0 background, 255 1.25 times the contrast."""
        return picture(self.light(number).image, (0.0, LIGHT_TOP))

    def curves(self, number: int) -> dict[str, Any]:
        """Count and area against the threshold."""
        edits = edits_by_frame(self.open(), relative=None).get(self.sources[number].name, ())
        curves = ThresholdCurves.of(self.light(number), edits)
        return curves.record(self._pixel_size)

    def window(self, number: int, label: int) -> dict[str, Any]:
        """Pixels and model of a contact that the page shows."""
        name, tables = self.sources[number].name, self.tables()
        contacts = tables.contacts.get(name)
        if contacts is None or label not in set(contacts["label"]):
            raise InputError(f"{name}: has no contact {label}")
        return contact_window(
            self.light(number), contacts, tables.outlines.get(name, OUTLINES.empty()), label
        )

    def light(self, number: int) -> FrameLight:
        """A frame prepared for closer looks, with the masks as they are now."""
        frames = (self.sources[number].name, EVERY_FRAME)
        masks = [
            _meaning(row) for row in self._edits_now() if row["action"] == MASK and row["frame"] in frames
        ]
        return self._light(number, tuple(masks), self.scene.measure.method)

    def _draw(self, number: int) -> bytes:
        return picture(replace(self.sources[number], correct=None).read().image, self._stretch)

    def _prepare(self, number: int, _masks: tuple[Any, ...], _method: str) -> FrameLight:
        return FrameLight.of(self.open(), number)

    @cached_property
    def _stretch(self) -> tuple[float, float]:
        return series_stretch([replace(source, correct=None) for source in self.sources])

    # what the page changes

    def insert(self, rows: list[dict[str, Any]], place: int | None) -> None:
        """Write edits; those that are there already, with the same time, were sent twice."""
        table = EDITS.conform(pd.DataFrame(rows, columns=list(EDITS.columns)))
        check_frames(table, [source.name for source in self.sources])
        with self._lock:
            present = self._edits_now()
            new = [not row["time"] or row not in present for row in _plain_rows(table)]
            if any(new):
                self.edits.insert(table[new], place)

    def remove(self, place: int, expected: dict[str, Any]) -> None:
        """Take out an edit, if it is the expected one."""
        with self._lock:
            rows = self.edits.read()
            wanted = EDITS.conform(pd.DataFrame([expected], columns=list(EDITS.columns)))
            if not 0 <= place < len(rows) or not rows.iloc[[place]].reset_index(drop=True).equals(wanted):
                raise InputError(
                    f"{self.edits.path}: was changed by another program; look at it and try again"
                )
            self.edits.remove(place)

    @property
    def scene_file(self) -> Path | None:
        """The scene file that `process` read; None without one, or where it is named by an option."""
        path = Path(self.scene.folder) / SCENE_FILE
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
            set_scene_keys(self.scene_file, "measure", keys)
            data = self.scene.configuration
            self.scene = scene_from_dict(
                data | {"measure": data.get("measure", {}) | keys}, folder=self.scene.folder
            )

    # measuring again

    def measure(self, number: int | None = None) -> bool:
        """Start measuring the series as `process` does, with the present edits; False if a job runs.

        The frame of this number, if any, is measured first and alone, to be shown meanwhile.
        """
        work = partial(self._measure, number=number)
        return self.jobs.start("measure", work, total=len(self.sources))

    def preview(self, number: int) -> dict[str, Any]:
        """A frame measured alone, while the series is measured."""
        if self._preview[0] != number:
            raise InputError("this frame has not been measured alone")
        return self._preview[1]

    def _measure_first(self, experiment: Experiment, number: int) -> None:
        """Measure one frame alone and tell the page; if it fails, the series will say why."""
        with suppress(FrameError):
            part = measure_alone(experiment, number)
            self._preview = (number, ShownTables.of_part(part).of_frame(self.sources[number].name))
            self.jobs.tell({"preview": number})

    def find_plateau(self) -> bool:
        """Start the scan of `calibrate plateau`; False if a job runs."""
        return self.jobs.start("plateau", self._find_plateau, total=len(self.sources))

    def _measure(self, advance: Any, *, number: int | None = None) -> None:
        """Measure; frames whose edits and scene are as before come from the store."""
        with self._lock:
            edits, experiment, scene = self._edits_now(), self.open(), self.scene
        if number is not None and len(experiment.frames) > 1:
            self._measure_first(experiment, number)
        record = provenance(command="contactimg review", scene=scene, inputs=experiment.inputs)
        top = Path(self._scratch.name)
        store = PartStore(top / "frames", record, resumes=False)
        series = measure_parts(experiment, workers=self._workers, advance=advance, store=store)
        folder = top / f"tables_{self.jobs.state.number}"
        folder.mkdir()
        write_run(series, folder)
        tables = ShownTables.read(folder)
        with self._lock:
            self._measured = _Measured(tables, edits, scene)

    def _find_plateau(self, advance: Any) -> dict[str, float]:
        """Thresholds of the plateau of the series."""
        series = measure_thresholds(self.open(), workers=self._workers, advance=advance)
        found = find_plateau(series.thresholds, series.areas)
        names = ("threshold_low", "threshold", "threshold_high", "relative_fall")
        return {name: getattr(found, name) for name in names}


def _plain_rows(edits: pd.DataFrame) -> list[dict[Any, Any]]:
    """Rows with None for what JSON does not have."""
    return edits.astype(object).where(edits.notna(), None).to_dict("records")


def _meaning(row: dict[Any, Any]) -> tuple[Any, ...]:
    """What an edit does; who made it, when and why does not matter."""
    return tuple(row[name] for name in ("frame", "action", "x_px", "y_px", "radius_px", "points"))


def _changed_frames(before: list[dict[Any, Any]] | None, now: list[dict[Any, Any]]) -> set[str] | None:
    """Frames whose edits are other ones than before; None if those before are not known."""
    if before is None:
        return None
    old, new = ([_meaning(row) for row in rows] for rows in (before, now))
    if old == new[: len(old)]:  # rows were added
        return {row[0] for row in new[len(old) :]}
    frames = {row[0] for row in old + new}
    return {
        name
        for name in frames
        if [row for row in old if row[0] == name] != [row for row in new if row[0] == name]
    }


def _readable(experiment: Experiment, folder: Path, inputs: list[dict[str, Any]]) -> list[FrameSource]:
    """The frames of a run, if each lies in its folders or is a file that the run was made from."""
    recorded = {str(entry["path"]) for entry in inputs}
    tops = [Path(experiment.scene.folder).resolve(), folder.resolve()]
    for source in experiment.frames:
        path = source.path.resolve()
        if str(path) not in recorded and not any(path.is_relative_to(top) for top in tops):
            raise InputError(
                f"{source.path}: leads to {path}, which the run was not made from; repeat the run"
            )
    return list(experiment.frames)
