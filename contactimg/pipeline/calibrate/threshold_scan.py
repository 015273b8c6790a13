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
from contactimg.imaging.measure import count_again
from contactimg.pipeline.frame import frame_row, measure_prepared
from contactimg.pipeline.inputs import asperities_and_sites
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
    parts = [
        (part.row, [], (0, 0)) if isinstance(part, FailedFrame) else part
        for part in for_each_frame(experiment, measure, workers=workers, advance=advance)
    ]
    loads = [experiment.load_of(str(row["frame"])) for row, _, _ in parts]
    frames = FRAMES.conform(pd.DataFrame([row for row, _, _ in parts])).assign(load_N=loads)
    good = np.array([len(contacts) > 0 for _, contacts, _ in parts])
    if not good.any():
        raise InputError(f"no frame could be measured; the first: {frames['message'].iloc[0]}")
    kept = frames[good].reset_index(drop=True)
    counted = [
        pd.concat(tables, ignore_index=True)
        for tables in zip(*(contacts for _, contacts, _ in parts if contacts), strict=True)
    ]
    shape = next(size for _, contacts, size in parts if contacts)
    runs = _runs(scene, kept, counted, shape, int(np.abs(levels - 0.5).argmin()))
    return ThresholdSeries(
        levels,
        np.array([run.frames["area_m2"].to_numpy(float) for run in runs]),
        np.array([run.frames["force_sum_N"].to_numpy(float) for run in runs]),
        kept,
        frames[~good].reset_index(drop=True),
    )


def _count_frame(
    frame: Frame, reference: NDArray | None, *, scene: Scene, thresholds: Values
) -> tuple[dict[str, object], list[pd.DataFrame], tuple[int, int]]:
    """Register one frame and count it: its row, its contacts at each threshold, and its shape."""
    measurement = measure_prepared(frame, reference, scene, count_at=0.5)
    if not measurement.contrast:
        raise FrameError(measurement.message or "nothing stands out of the noise")
    counted = (count_again(measurement.foreground, float(level)).disks for level in thresholds)
    contacts = [CONTACTS.conform(disks.assign(frame=frame.name)) for disks in counted]
    own = {"n_contacts": len(measurement.disks), "smallest_px": np.nan}
    return frame_row(measurement, frame.name) | own, contacts, frame.shape


def _runs(
    scene: Scene, frames: pd.DataFrame, counted: list[pd.DataFrame], shape: tuple[int, int], half: int
) -> list[Run]:
    """One run a threshold, all under the pose found at the threshold of number ``half``."""
    scene, asperities, sites = asperities_and_sites(scene)
    if asperities is not None:
        refuse_own_caps(asperities, "calibrate", columns=("young_modulus_Pa",))
    targets = None if sites is None else sites[["x_m", "y_m"]].to_numpy(float)
    middle = counted[half]
    run = Run(scene, middle, frames)
    pose = scene.pose(shape)
    if targets is not None and scene.measure.pose == "fit" and len(middle):
        pose = series_pose(run, pose, targets).pose

    def located(contacts: pd.DataFrame) -> Run:
        return replace(run, contacts=CONTACTS.conform(locate_frames(contacts, frames, pose, targets)))

    law = local_law(located(middle), sites)  # one for all thresholds
    run = run if law is None else replace(run, scene=law.scene)
    return [with_forces(located(contacts), sites) for contacts in counted]
