"""A measured series: its tables, a few frames at a time."""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from operator import or_

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.effects.local_law import LawEvidence, LawPlan, decide_law
from contactimg.forces import sphere_radii
from contactimg.pipeline.measured_frame import MeasuredFrame
from contactimg.pipeline.pose_and_forces import find_pose, with_forces, with_pose
from contactimg.pipeline.run import Run
from contactimg.pose.refine import PoseFit
from contactimg.scene import Scene
from contactimg.tables import CONTACTS, FRAMES, OUTLINES, REJECTED, Schema

logger = logging.getLogger(__name__)

BLOCK_FRAMES = 50
"""Frames whose tables are in memory at once. Chosen for memory: 50 frames of 1000 contacts take 15 MB."""


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
    """

    scene: Scene
    parts: Sequence[MeasuredFrame]
    loads: NDArray[np.float64]
    sites: pd.DataFrame | None
    pose: PoseFit | None

    @classmethod
    def of(
        cls,
        scene: Scene,
        parts: Sequence[MeasuredFrame],
        loads: pd.DataFrame,
        sites: pd.DataFrame | None,
        shape: tuple[int, int],
    ) -> "MeasuredSeries":
        """The series of measured frames with these loads and this usual shape."""
        names = [part.row["frame"] for part in parts]
        load = loads.drop_duplicates("frame").set_index("frame")["load_N"]
        series = cls(scene, parts, load.reindex(names).to_numpy(float), sites, None)
        if scene.camera is None:
            return series
        counts = [0 if pd.isna(part.row.get("n_contacts")) else part.row["n_contacts"] for part in parts]
        most = int(np.argmax(counts))
        return replace(series, pose=find_pose(series._run(most, most + 1), sites, shape))

    def blocks(self) -> Iterator[Run]:
        """The run, a few frames at a time: each block has the tables of its frames, with pose and forces."""
        for run in self._located():
            yield run if self.pose is None else with_forces(run, self.sites, self._law)

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
        if self.scene.elastic is None:
            return None
        evidence = (
            LawEvidence.of(run.scene, run.contacts, sphere_radii(run.contacts, run.scene, self.sites))
            for run in self._located()
        )
        return decide_law(self.scene, reduce(or_, evidence))

    def _located(self) -> Iterator[Run]:
        """The blocks without forces."""
        for first in range(0, len(self.parts), BLOCK_FRAMES):
            run = self._run(first, first + BLOCK_FRAMES)
            yield run if self.pose is None else with_pose(run, self.sites, self.pose)

    def _run(self, first: int, end: int) -> Run:
        """Some frames, in pixels."""
        parts = [part.whole() for part in self.parts[first:end]]
        frames = FRAMES.conform(pd.DataFrame([part.row for part in parts]))
        frames = frames.assign(load_N=self.loads[first:end])
        contacts, rejected, outlines = (_joined(schema, parts) for schema in (CONTACTS, REJECTED, OUTLINES))
        choices = {part.row["frame"]: part.choice for part in parts if part.choice is not None}
        films = {part.row["frame"]: part.film for part in parts if part.film is not None}
        return Run(self.scene, contacts, rejected, frames, None, choices, outlines, films=films)


def _joined(schema: Schema, parts: Sequence[object]) -> pd.DataFrame:
    """The tables of a schema of several parts as one."""
    return schema.conform(pd.concat([getattr(part, schema.name) for part in parts], ignore_index=True))
