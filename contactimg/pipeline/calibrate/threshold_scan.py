"""A series counted at many thresholds: every frame is registered once and thresholded many times."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from contactimg.errors import FrameError, InputError
from contactimg.files import Experiment, Run
from contactimg.frame import Frame
from contactimg.imaging.measure import ImageMeasurement, count_again
from contactimg.pipeline.frame import measure_prepared
from contactimg.pipeline.inputs import (
    contact_sites,
    scene_asperities,
    scene_of_defined_laws,
)
from contactimg.pipeline.parallel import FailedFrame, for_each_frame
from contactimg.pipeline.pose_and_forces import local_law, locate_frames, series_pose, with_forces
from contactimg.scene import Scene
from contactimg.surfaces import refuse_own_caps
from contactimg.tables import CONTACTS, FRAMES

Values = NDArray[np.float64]

THRESHOLDS = np.round(np.arange(0.05, 0.951, 0.025), 3)
"""Fractions of the contrast, from where noise makes contacts to where small contacts are lost. Chosen: curves
of area against threshold are smooth on this grid; sensitivity not measured."""


@dataclass(frozen=True, eq=False)
class ThresholdSeries:
    """Area and force sums of a series' frames at many thresholds.

    Parameters
    ----------
    thresholds : ndarray, shape (m,)
    areas : ndarray, shape (m, n), m^2
    forces : ndarray, shape (m, n), N
        NaN where no asperity radius is known.
    frames : DataFrame
        The frames table's rows of the n frames that could be measured.
    failed : DataFrame
        Rows of those that could not.
    """

    thresholds: Values
    areas: Values
    forces: Values
    frames: pd.DataFrame
    failed: pd.DataFrame


def measure_thresholds(
    experiment: Experiment,
    thresholds: ArrayLike = THRESHOLDS,
    *,
    workers: int | None = None,
    advance: Callable[[], None] | None = None,
) -> ThresholdSeries:
    """Count the pixels of every frame above each of many thresholds.

    Parameters
    ----------
    experiment : Experiment
        Of a scene with a camera; forces need the elastic body and the asperities' radii as well.
    thresholds : array_like, shape (m,)
        Fractions of the contact contrast, between 0 and 1.
    workers : int, optional
        Processes that share the frames.
    advance : callable, optional
        Called once a frame.

    Returns
    -------
    ThresholdSeries

    Raises
    ------
    InputError
        If no frame at all could be measured.

    Notes
    -----
    The pose of the camera is found once, at the threshold next to one half.
    """
    levels = np.sort(np.asarray(thresholds, float))
    scene = experiment.scene
    scene.need("camera", "a calibration")
    measure = partial(_count_frame, scene=scene, thresholds=levels)
    parts = list(for_each_frame(experiment, measure, workers=workers, advance=advance))
    frames = FRAMES.conform(pd.DataFrame([part.row for part in parts])).assign(
        load_N=[experiment.load_of(str(part.row["frame"])) for part in parts]
    )
    measured = [part for part in parts if not isinstance(part, FailedFrame)]
    good = np.array([not isinstance(part, FailedFrame) for part in parts])
    if not measured:
        raise InputError(f"no frame could be measured; the first: {frames['message'].iloc[0]}")
    kept = frames[good].reset_index(drop=True)
    runs = _runs(scene, kept, measured, levels)
    return ThresholdSeries(
        levels,
        np.array([run.frames["area_m2"].to_numpy(float) for run in runs]),
        np.array([run.frames["force_sum_N"].to_numpy(float) for run in runs]),
        kept,
        frames[~good].reset_index(drop=True),
    )


@dataclass(frozen=True, eq=False)
class _CountedFrame:
    """One frame's row and its contacts at each threshold."""

    row: dict[str, object]
    contacts: list[pd.DataFrame]
    shape: tuple[int, int]


def _count_frame(
    frame: Frame, reference: NDArray | None, *, scene: Scene, thresholds: Values
) -> _CountedFrame:
    """Register one frame and count it at each threshold."""
    measurement = measure_prepared(frame, reference, scene, method="threshold")
    if not measurement.contrast:
        raise FrameError(measurement.message or "nothing stands out of the noise")
    contacts = [
        CONTACTS.conform(count_at(measurement, float(t)).assign(frame=frame.name)) for t in thresholds
    ]
    row: dict[str, object] = {
        "frame": frame.name,
        "status": measurement.status,
        "n_contacts": len(measurement.disks),
        "contrast": measurement.contrast,
        "noise": measurement.noise,
        "shift_x_px": measurement.shift_x_px,
        "shift_y_px": measurement.shift_y_px,
        "message": measurement.message,
    }
    return _CountedFrame(row, contacts, frame.shape)


def count_at(measurement: ImageMeasurement, threshold: float) -> pd.DataFrame:
    """Contacts of a measured frame at another threshold, a fraction of the contrast: its disks table."""
    return count_again(measurement.foreground, threshold).disks


def _runs(scene: Scene, frames: pd.DataFrame, parts: list[_CountedFrame], thresholds: Values) -> list[Run]:
    """One run a threshold, all under the pose found at the threshold next to one half."""
    asperities = scene_asperities(scene)
    sites = None if asperities is None else contact_sites(asperities, scene)
    scene = scene_of_defined_laws(scene, sites)
    if asperities is not None:
        refuse_own_caps(asperities, "calibrate", columns=("young_modulus_Pa",))
    targets = None if sites is None else sites[["x_m", "y_m"]].to_numpy(float)
    counted = [
        pd.concat([part.contacts[k] for part in parts], ignore_index=True) for k in range(len(thresholds))
    ]
    middle = counted[int(np.abs(thresholds - 0.5).argmin())]
    run = Run(scene, middle, frames)
    pose = scene.pose(parts[0].shape)
    if targets is not None and scene.measure.pose == "fit" and len(middle):
        pose = series_pose(run, pose, targets).pose

    def located(contacts: pd.DataFrame) -> Run:
        return replace(run, contacts=CONTACTS.conform(locate_frames(contacts, frames, pose, targets)))

    law = local_law(located(middle), sites)  # one for all thresholds
    run = run if law is None else replace(run, scene=law.scene)
    return [with_forces(located(contacts), sites) for contacts in counted]
