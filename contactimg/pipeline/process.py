"""What `process` leaves behind: the tables of a run and a picture of each frame."""

from collections.abc import Callable
from dataclasses import asdict
from math import degrees, nan, radians
from pathlib import Path
from typing import Any

import pandas as pd

from contactimg.errors import InputError
from contactimg.files import Experiment, FrameSource, RunFolder, write_figure, write_table
from contactimg.matching import PoseFit
from contactimg.pipeline.parallel import in_parallel
from contactimg.pipeline.pictures import draw_measured
from contactimg.pipeline.series import FAILED, Run
from contactimg.pose import Pose
from contactimg.tables import CONTACTS, FRAMES, REJECTED
from contactimg.timings import stage

__all__ = ["draw_overlays", "picture_name", "run_of_folder", "write_run"]


def write_run(run: Run, folder: Path) -> dict[str, Any]:
    """Write contacts.csv, frames.csv and rejected.csv; return what else the provenance must say."""
    write_table(run.contacts, CONTACTS, folder / "contacts.csv")
    write_table(run.frames, FRAMES, folder / "frames.csv")
    write_table(run.rejected, REJECTED, folder / "rejected.csv")
    record = {} if run.pose is None else {"pose": _pose_record(run.pose)}
    if run.choices:
        record["methods"] = {frame: asdict(choice) for frame, choice in run.choices.items()}
    return record


def run_of_folder(folder: RunFolder) -> Run:
    """The run that `write_run` left in a folder (rejected candidates apart).

    Raises
    ------
    InputError
        If the run has no pose, because it was made without a pixel size or by another command.
    """
    record = folder.provenance.get("pose")
    if record is None or folder.scene is None:
        raise InputError(f"{folder.folder}: has no pose of the camera; run `process` with a pixel size first")
    pose = Pose(
        shape=(record["rows"], record["columns"]),
        pixel_size=record["pixel_size_m"],
        centre=(record["centre_m"][0], record["centre_m"][1]),
        rotation=radians(record["rotation_deg"]),
        mirrored=record["mirrored"],
    )
    fit = PoseFit(
        pose,
        fitted=record["fitted"],
        n_points=record["n_points"],
        n_matched=record["n_matched"],
        residual=nan if record["residual_m"] is None else record["residual_m"],
    )
    return Run(folder.scene, folder.contacts, REJECTED.empty(), folder.frames, fit)


def _pose_record(fit: PoseFit) -> dict[str, Any]:
    """The pose as the provenance states it; `run_of_folder` reads it back."""
    return {
        "rows": fit.pose.shape[0],
        "columns": fit.pose.shape[1],
        "pixel_size_m": fit.pose.pixel_size,
        "centre_m": list(fit.pose.centre),
        "rotation_deg": degrees(fit.pose.rotation),
        "mirrored": fit.pose.mirrored,
        "fitted": fit.fitted,
        "n_points": fit.n_points,
        "n_matched": fit.n_matched,
        "residual_m": fit.residual,
    }


def draw_overlays(
    run: Run,
    experiment: Experiment,
    folder: Path,
    *,
    workers: int | None,
    advance: Callable[[], None] | None = None,
) -> None:
    """Draw the measured contacts on every frame that could be measured, as PNG files."""
    folder.mkdir()
    failed = set(run.frames.loc[run.frames["status"] == FAILED, "frame"])
    pose = None if run.pose is None else run.pose.pose
    sources = [source for source in experiment.frames if source.name not in failed]
    groups = dict(list(run.contacts.groupby("frame")))
    jobs = ((source, groups.get(source.name, CONTACTS.empty()), pose, folder) for source in sources)
    for _ in in_parallel(_draw, jobs, count=len(sources), workers=workers):
        if advance is not None:
            advance()


def picture_name(frame: str) -> str:
    """File name of the picture of a frame."""
    return frame.replace("[", "_").replace("]", "") + ".png"


@stage("pictures")
def _draw(source: FrameSource, contacts: pd.DataFrame, pose: Pose | None, folder: Path) -> None:
    """Read one frame again and draw it."""
    ax = draw_measured(source.read().image, contacts, pose=pose, title=source.name)
    write_figure(ax, folder / picture_name(source.name))
