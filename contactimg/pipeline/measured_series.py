"""A measured series: its tables, a few frames at a time."""

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial, reduce
from operator import or_
from typing import TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.effects.local_law import LawEvidence, LawPlan, decide_law
from contactimg.engine.calls import in_parallel
from contactimg.forces import sphere_radii
from contactimg.pipeline.measured_frame import MeasuredFrame
from contactimg.pipeline.pose_and_forces import find_pose, with_forces, with_pose
from contactimg.pipeline.run import Run
from contactimg.pose.fit import PoseFit
from contactimg.scene import Scene
from contactimg.tables import CONTACTS, FRAMES, OUTLINES, REJECTED, Schema

logger = logging.getLogger(__name__)

BLOCK_FRAMES = 20
"""Frames whose tables are made at once. Chosen for memory: 20 frames of 1000 contacts take 6 MB, and each
process has some blocks waiting."""

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class MeasuredSeries:
    """The measured frames of a series, with the pose of the camera over all of them.

    Parameters
    ----------
    scene : Scene
    parts : sequence of MeasuredFrame
        In order. Those measured with a store stay there.
    loads : ndarray, shape (n,)
        Load of each frame, N; NaN where it is not known.
    sites : DataFrame or None
        Composite summits of the asperities.
    pose : PoseFit or None
        None without a pixel size.
    workers : int or None
        As for `contactimg.engine.calls.in_parallel`, for what is done with blocks.
    """

    scene: Scene
    parts: Sequence[MeasuredFrame]
    loads: NDArray[np.float64]
    sites: pd.DataFrame | None
    pose: PoseFit | None
    workers: int | None = 1

    @classmethod
    def of(
        cls,
        scene: Scene,
        parts: Sequence[MeasuredFrame],
        loads: pd.DataFrame,
        sites: pd.DataFrame | None,
        shape: tuple[int, int],
        *,
        workers: int | None = 1,
    ) -> "MeasuredSeries":
        """The series of measured frames with these loads and this usual shape."""
        # one number at a time: lists of names would be the largest thing in memory
        load = dict(zip(loads["frame"][::-1], loads["load_N"][::-1], strict=True))
        load_of_part = (load.get(part.row["frame"], np.nan) for part in parts)
        series = cls(scene, parts, np.fromiter(load_of_part, float, len(parts)), sites, None, workers)
        if scene.camera is None:
            return series
        counts = (0 if pd.isna(part.row.get("n_contacts")) else part.row["n_contacts"] for part in parts)
        most = int(np.argmax(np.fromiter(counts, float, len(parts))))
        return replace(series, pose=find_pose(series._part(most, most + 1)._run(), sites, shape))

    def blocks(self) -> Iterator[Run]:
        """The run, a few frames at a time: each block has the tables of its frames, with pose and forces."""
        law = self._law
        return (part._finished(law) for part in self._parts())

    def of_blocks(self, make: Callable[[Run], Result]) -> Iterator[Result]:
        """What a function makes of each block, in order; several processes share the blocks."""
        return self._share(partial(_made_of_block, make, self._law))

    def whole(self) -> Run:
        """The run with the tables of all frames in memory."""
        blocks = list(self.blocks())
        return Run(
            self.scene,
            _joined(CONTACTS, blocks),
            _joined(REJECTED, blocks),
            _joined(FRAMES, blocks),
            self.pose,
            {name: choice for block in blocks for name, choice in block.choices.items()},
            _joined(OUTLINES, blocks),
            next((block.law for block in blocks if block.law is not None), None),
            {name: film for block in blocks for name, film in block.films.items()},
        )

    @cached_property
    def _law(self) -> LawPlan | None:
        """The law of the local forces, on which the contacts of all frames decide; None without forces."""
        if self.scene.elastic is None or self.pose is None:
            return None
        return decide_law(self.scene, reduce(or_, self._share(_law_evidence)))

    def _share(self, call: Callable[..., Result]) -> Iterator[Result]:
        """The results of a function of each block, as a series of its own."""
        common = replace(self, parts=(), loads=np.empty(0))
        blocks = ((part.parts, part.loads) for part in self._parts())
        count = -(-len(self.parts) // BLOCK_FRAMES)
        return in_parallel(partial(call, common), blocks, count=count, workers=self.workers)

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
        parts = [part.whole() for part in self.parts]
        frames = FRAMES.conform(pd.DataFrame([part.row for part in parts]))
        frames = frames.assign(load_N=self.loads)
        contacts, rejected, outlines = (_joined(schema, parts) for schema in (CONTACTS, REJECTED, OUTLINES))
        choices = {part.row["frame"]: part.choice for part in parts if part.choice is not None}
        films = {part.row["frame"]: part.film for part in parts if part.film is not None}
        return Run(self.scene, contacts, rejected, frames, None, choices, outlines, films=films)


def _law_evidence(
    series: MeasuredSeries, parts: Sequence[MeasuredFrame], loads: NDArray[np.float64]
) -> LawEvidence:
    """What a block says of the law of the local forces."""
    run = replace(series, parts=parts, loads=loads)._located()
    return LawEvidence.of(run.scene, run.contacts, sphere_radii(run.contacts, run.scene, series.sites))


def _made_of_block(
    make: Callable[[Run], Result],
    law: LawPlan | None,
    series: MeasuredSeries,
    parts: Sequence[MeasuredFrame],
    loads: NDArray[np.float64],
) -> Result:
    """What a function makes of a block."""
    return make(replace(series, parts=parts, loads=loads)._finished(law))


def _joined(schema: Schema, parts: Sequence[object]) -> pd.DataFrame:
    """The tables of a schema of several parts as one."""
    return schema.conform(pd.concat([getattr(part, schema.name) for part in parts], ignore_index=True))
