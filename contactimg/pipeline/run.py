"""A run: the tables that a measured series gives."""

from dataclasses import dataclass, field
from math import degrees, nan, radians
from typing import Any

import numpy as np
import pandas as pd

from contactimg.effects.local_law import LawPlan
from contactimg.errors import InputError
from contactimg.files import RunFolder
from contactimg.imaging.fit.film_choice import FilmVerdict
from contactimg.pose import Pose
from contactimg.pose.fit import PoseFit
from contactimg.scene import Scene
from contactimg.tables import OUTLINES, REJECTED, Status
from contactimg.tradeoff.choice import Choice


@dataclass(frozen=True)
class Run:
    """What the measurement of a series gives.

    Attributes
    ----------
    scene : Scene
        The scene as given.
    contacts, rejected, frames : DataFrame
        The tables of that name.
    pose : PoseFit or None
        Pose of the camera over the reference frame; None without a pixel size.
    choices : dict
        Frame -> how it was measured and why, where that was chosen for a tolerance.
    outlines : DataFrame
        Of the contacts of free shape.
    law : LawPlan or None
        Law of the local forces and what it leaves out; None without forces.
    films : dict
        Frame -> what its rims say of an air film, where one was looked for.
    """

    scene: Scene
    contacts: pd.DataFrame
    rejected: pd.DataFrame
    frames: pd.DataFrame
    pose: PoseFit | None
    choices: dict[str, Choice] = field(default_factory=dict)
    outlines: pd.DataFrame = field(default_factory=OUTLINES.empty)
    law: LawPlan | None = None
    films: dict[str, FilmVerdict] = field(default_factory=dict)

    def need_pose(self) -> Pose:
        """The pose of the camera, or an `InputError` that says how to get one."""
        if self.pose is None:
            raise InputError("this run has no pose of the camera; run `process` with a pixel size")
        lost = (self.frames["status"] == Status.NO_POSE).any()
        if lost and self.scene.measure.pose == "fit":
            raise InputError(
                "this run found no pose of the camera: its contacts fall on no asperity; check [camera] "
                "pixel_size_m, centre_m and rotation_deg, [indenter] apex_m and the asperity table, and run "
                '`process` again; pose = "given" in [measure] takes the pose as it is stated'
            )
        return self.pose.pose


def frame_shift(frames: pd.DataFrame, name: str) -> tuple[float, float]:
    """Shift (x, y; px) of a frame against the reference, 0 where it is not known."""
    row = frames[frames["frame"] == name].iloc[0]
    shift = np.nan_to_num([row["shift_x_px"], row["shift_y_px"]], nan=0.0)
    return float(shift[0]), float(shift[1])


def run_of_folder(folder: RunFolder) -> Run:
    """The run that `process` left in a folder, without its rejected candidates.

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
    return Run(folder.scene, folder.contacts, REJECTED.empty(), folder.frames, fit, outlines=folder.outlines)


def pose_record(fit: PoseFit) -> dict[str, Any]:
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
