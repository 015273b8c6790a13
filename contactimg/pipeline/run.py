"""What `process` leaves behind: the tables of a run and a picture of each frame."""

from dataclasses import asdict
from math import degrees, nan, radians
from pathlib import Path
from typing import Any

from contactimg.errors import InputError
from contactimg.files import RunFolder, write_table
from contactimg.matching import PoseFit
from contactimg.pipeline.series import Run
from contactimg.pose import Pose
from contactimg.tables import CONTACTS, FRAMES, REJECTED


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
