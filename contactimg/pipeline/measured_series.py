"""A measured series: its tables, a few frames at a time, and the files that they are written to."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from functools import cached_property, reduce
from operator import or_
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.effects.local_law import LawEvidence, LawPlan, decide_law
from contactimg.engine.calls import in_parallel
from contactimg.files import (
    OutputFolder,
    Run,
    TableFormat,
    TableWriter,
    encoded_rows,
    main_tables,
    provenance,
    read_run,
)
from contactimg.files.runs import apex_record, pose_record
from contactimg.forces import sphere_radii
from contactimg.imaging.fit.film_choice import summarise_films
from contactimg.pipeline.frame import MeasuredFrame
from contactimg.pipeline.inputs import contact_sites
from contactimg.pipeline.pose_and_forces import apex_of, find_pose, shown_apex, with_forces, with_pose
from contactimg.pose.apex import STATED, Apex
from contactimg.pose.fit import PoseFit
from contactimg.scene import Scene
from contactimg.tables import CONTACTS, FRAMES, OUTLINES, REJECTED, Schema

logger = logging.getLogger(__name__)

BLOCK_FRAMES = 20
"""Frames whose tables are made at once. Chosen for memory: 20 frames of 1000 contacts take 6 MB, and each
process has some blocks waiting."""

_TABLES = (CONTACTS, FRAMES, REJECTED, OUTLINES)

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class MeasuredSeries:
    """The measured frames of a series, with the pose of the camera over all of them.

    Parameters
    ----------
    scene : Scene
    parts : sequence of MeasuredFrame
        In order.
    loads : ndarray, shape (n,)
        Load of each frame, N; NaN where it is not known.
    sites : DataFrame or None
        Composite summits of the asperities.
    pose : PoseFit or None
        None without a pixel size.
    apex : Apex or None
        None without an indenter.
    shown : Apex or None
        Apex and radius of the lens that the contacts show, None where they show none.
    workers : int or None
        As for `contactimg.engine.calls.in_parallel`, for what is done with blocks.
    """

    scene: Scene
    parts: Sequence[MeasuredFrame]
    loads: NDArray[np.float64]
    sites: pd.DataFrame | None
    pose: PoseFit | None = None
    apex: Apex | None = None
    shown: Apex | None = None
    workers: int | None = 1

    def posed(self, shape: tuple[int, int], asperities: pd.DataFrame | None = None) -> "MeasuredSeries":
        """The series with the pose and apex that the frame with most contacts gives.

        Frames have this usual shape. Where an asperity first touches depends on the apex, by less than the
        asperities are apart: where the apex is found from the contacts, the pose is found once more.
        """
        if self.scene.camera is None:
            return self
        counts = [part.row.get("n_contacts", pd.NA) for part in self.parts]
        most = int(np.argmax([0 if pd.isna(count) else count for count in counts]))
        run = self._part(most, most + 1)._run()
        pose = find_pose(run, self.sites, self.scene.pose(shape))
        places = np.unique(np.linspace(0, len(self.parts) - 1, BLOCK_FRAMES).astype(int))
        several = replace(self, parts=[self.parts[k] for k in places], loads=self.loads[places])
        located = with_pose(several._run(), self.sites, pose)
        shown = shown_apex(located.contacts, located.frames, self.scene, pose.pose, asperities)
        apex = apex_of(self.scene, shown, asperities)
        if apex is None or apex.known == STATED or asperities is None:
            return replace(self, pose=pose, apex=apex, shown=shown)
        logger.info("%s", apex.sentence())
        scene = self.scene.with_apex(apex.place)
        sites = contact_sites(asperities, scene)
        return replace(
            self, scene=scene, sites=sites, pose=find_pose(run, sites, pose.pose), apex=apex, shown=shown
        )

    def blocks(self) -> Iterator[Run]:
        """The run, a few frames at a time: each block has the tables of its frames, with pose and forces."""
        law = self._law
        return (part._finished(law) for part in self._parts())

    def of_blocks(self, make: Callable[[Run], Result]) -> Iterator[Result]:
        """What a function makes of each block, in order; several processes share the blocks."""
        law = self._law
        return self._share(lambda block: make(block._finished(law)))

    def whole(self) -> Run:
        """The run with the tables of all frames in memory."""
        blocks = list(self.blocks())
        contacts, frames, rejected, outlines = (_joined(schema, blocks) for schema in _TABLES)
        law = next((block.law for block in blocks if block.law is not None), None)
        return Run(self.scene, contacts, frames, self.pose, {"rejected": rejected, "outlines": outlines}, law)

    @cached_property
    def _law(self) -> LawPlan | None:
        """The law of the local forces, on which the contacts of all frames decide; None without forces."""
        if self.scene.elastic is None or self.pose is None:
            return None
        return decide_law(self.scene, reduce(or_, self._share(_law_evidence)))

    def _share(self, call: Callable[["MeasuredSeries"], Result]) -> Iterator[Result]:
        """The results of a function of each block, as a series of its own."""
        count = -(-len(self.parts) // BLOCK_FRAMES)
        return in_parallel(call, ((part,) for part in self._parts()), count=count, workers=self.workers)

    def _parts(self) -> Iterator["MeasuredSeries"]:
        """The blocks, each as a series."""
        return (self._part(first, first + BLOCK_FRAMES) for first in range(0, len(self.parts), BLOCK_FRAMES))

    def _part(self, first: int, end: int) -> "MeasuredSeries":
        """Some of the frames as a series."""
        return replace(self, parts=self.parts[first:end], loads=self.loads[first:end])

    def _finished(self, law: LawPlan | None) -> Run:
        """The run with pose and forces."""
        run = self._located()
        return run if self.pose is None else with_forces(run, self.sites, law)

    def _located(self) -> Run:
        """The run without forces."""
        run = self._run()
        return run if self.pose is None else with_pose(run, self.sites, self.pose)

    def _run(self) -> Run:
        """The run in pixels."""
        tables = [part.tables for part in self.parts]
        frames = FRAMES.conform(pd.DataFrame([part.row for part in self.parts]))
        contacts, rejected, outlines = (_joined(schema, tables) for schema in (CONTACTS, REJECTED, OUTLINES))
        more = {"rejected": rejected, "outlines": outlines}
        return Run(self.scene, contacts, frames.assign(load_N=self.loads), tables=more)


def _law_evidence(block: MeasuredSeries) -> LawEvidence:
    """What a block says of the law of the local forces."""
    run = block._located()
    return LawEvidence.of(run.scene, run.contacts, sphere_radii(run.contacts, run.scene, block.sites))


def _joined(schema: Schema, parts: Sequence[object]) -> pd.DataFrame:
    """The tables of a schema of several parts as one."""
    return schema.conform(pd.concat([getattr(part, schema.name) for part in parts], ignore_index=True))


def write_run(
    series: MeasuredSeries, folder: Path, table_format: TableFormat = "csv"
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Write contacts, frames, rejected and, if any, outlines, a few frames at a time.

    Returns
    -------
    frames : DataFrame
        The frames table.
    record : dict
        What the provenance must state of pose, law of the forces, air film and methods.
    """
    record: dict[str, Any] = {} if series.pose is None else {"pose": pose_record(series.pose)}
    if series.apex is not None:
        record |= {"apex": apex_record(series.apex)}
    frames = [FRAMES.empty()]
    with ExitStack() as stack:
        tables = [stack.enter_context(TableWriter(schema, folder, table_format)) for schema in _TABLES]

        def encoded(block: Run) -> tuple[list[str | pd.DataFrame], pd.DataFrame, str]:
            rows = [encoded_rows(getattr(block, one.name), one, table_format) for one in _TABLES]
            return rows, block.frames, "" if block.law is None else block.law.sentence()

        for contents, rows, law in series.of_blocks(encoded):
            for table, part in zip(tables, contents, strict=True):
                table.append(part)
            frames.append(rows)
            if law:
                record["law"] = law
    if tables[-1].empty:
        tables[-1].path.unlink()
    films = [part.film for part in series.parts if part.film is not None]
    if films:
        record["film_summary"] = summarise_films(films)
    for name, matter in (("film", "film"), ("methods", "choice")):
        said = [(part.row["frame"], getattr(part, matter)) for part in series.parts]
        record[name] = {frame: asdict(found) for frame, found in said if found is not None}
    record = {name: value for name, value in record.items() if value}
    return FRAMES.conform(pd.concat(frames[1:] or frames, ignore_index=True)), record


def write_joined_tables(
    runs: Mapping[str, Path], target: Path, *, command: str, table_format: TableFormat = "csv"
) -> None:
    """Write the tables all_contacts and all_frames of several runs, with the name of the run first.

    Parameters
    ----------
    runs : mapping
        Name -> output folder of `process`.
    target : Path
        The folder to write, with its provenance.
    command : str
        For the provenance.
    table_format : {"csv", "parquet"}
    """
    tables = {name: read_run(folder) for name, folder in runs.items()}
    record = provenance(command=command, inputs=main_tables(runs.values()))
    with OutputFolder(target, record, main_files=[f"all_frames.{table_format}"]) as out:
        for schema in (CONTACTS, FRAMES):
            parts = [getattr(run, schema.name).assign(run=name) for name, run in tables.items()]
            columns = {"run": ("str", "name of the folder of frames")} | dict(schema.columns)
            joined = Schema(f"all_{schema.name}", columns, schema.description)
            with TableWriter(joined, out.folder, table_format) as table:
                table.add(pd.concat(parts, ignore_index=True))
