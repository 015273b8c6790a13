"""Measure a series: every frame on its own, then one pose, asperities and forces for all."""

import logging
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import InputError
from contactimg.files import Experiment, open_experiment
from contactimg.matching import PoseFit, PoseSearch, fit_pose, pair_points, pairing_distance
from contactimg.pipeline.frames import film_rim, measure_frames
from contactimg.pipeline.inputs import contact_sites, scene_asperities
from contactimg.pipeline.local_forces import fill_forces
from contactimg.pipeline.measure import locate_contacts
from contactimg.pipeline.measured_effects import resolve_measurement
from contactimg.pose import Pose
from contactimg.scene import Scene
from contactimg.tables import CONTACTS, FRAMES, REJECTED
from contactimg.timings import stage
from contactimg.tradeoff.choice import Choice

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Run:
    """What a series gave.

    Attributes
    ----------
    scene : Scene
        What was asked for.
    contacts, rejected, frames : DataFrame
        The tables of that name.
    pose : PoseFit or None
        Pose of the camera over the reference frame; None without a pixel size.
    choices : dict
        Frame -> how it was measured and why, where that was chosen for a tolerance.
    """

    scene: Scene
    contacts: pd.DataFrame
    rejected: pd.DataFrame
    frames: pd.DataFrame
    pose: PoseFit | None
    choices: dict[str, Choice] = field(default_factory=dict)

    def need_pose(self) -> Pose:
        """The pose of the camera, or an `InputError` that says how to get one."""
        if self.pose is None:
            raise InputError("this run has no pose of the camera; run `process` with a pixel size")
        return self.pose.pose


def measure_series(
    scene: Scene, *, workers: int | None = None, advance: Callable[[], None] | None = None
) -> Run:
    """Measure every frame of a scene.

    Parameters
    ----------
    scene : Scene
        From `contactimg.read_scene`, which knows the folder of its files.
    workers : int, optional
        Processes that share the frames; default one a core, or this one alone for fewer than four frames.
        An active `joblib.parallel_config` (its Dask backend, say) takes precedence.
    advance : callable, optional
        Called once a frame, in order.

    Returns
    -------
    Run
        A frame that cannot be read or measured has a row in ``frames`` that says why, and no contacts.

    Raises
    ------
    InputError
        If no frame at all could be measured; the message gives the first reason.
    """
    return measure_experiment(open_experiment(scene), workers=workers, advance=advance)


def measure_experiment(
    experiment: Experiment,
    *,
    relative: float | None = None,
    workers: int | None = None,
    advance: Callable[[], None] | None = None,
) -> Run:
    """Measure every frame of an opened experiment; see `measure_series`.

    With ``relative``, a tolerance of the scene's output, each frame is measured by the cheapest method that
    is estimated to meet it (`contactimg.tradeoff.choice`).
    """
    scene = experiment.scene
    asperities = None if scene.camera is None else scene_asperities(scene)
    sites = None if asperities is None else contact_sites(asperities, scene)
    experiment = replace(experiment, scene=resolve_measurement(scene, sites))
    parts, shape = measure_frames(
        experiment,
        film=film_rim(experiment.scene, sites),
        relative=relative,
        workers=workers,
        advance=advance or (lambda: None),
    )
    frames = FRAMES.conform(pd.DataFrame([part.row for part in parts])).assign(
        load_N=[experiment.load_of(part.row["frame"]) for part in parts]
    )
    contacts = pd.concat([part.contacts for part in parts], ignore_index=True)
    rejected = pd.concat([part.rejected for part in parts], ignore_index=True)
    choices = {str(part.row["frame"]): part.choice for part in parts if part.choice is not None}
    run = Run(scene, CONTACTS.conform(contacts), REJECTED.conform(rejected), frames, None, choices)
    return run if scene.camera is None else with_forces(_located(run, sites, shape), sites)


def _noted(frames: pd.DataFrame, notes: dict[str, str]) -> pd.DataFrame:
    """The frames table with a note added to the messages of the named frames."""
    messages = [
        "; ".join(text for text in (row["message"], notes.get(row["frame"], "")) if text)
        for row in frames.to_dict("records")
    ]
    return frames.assign(message=messages)


@stage("pose")
def _located(run: Run, sites: pd.DataFrame | None, shape: tuple[int, int]) -> Run:
    """The run with sample coordinates and asperities, under the pose that the contacts themselves confirm."""
    guess = run.scene.pose(shape)
    pose = PoseFit(guess, fitted=False, n_points=0, n_matched=0, residual=np.nan)
    targets = None if sites is None else sites[["x_m", "y_m"]].to_numpy(float)
    if targets is not None and run.scene.measure.pose == "fit":
        pose = series_pose(run, guess, targets)
        logger.info(
            "pose %s: %d of %d contacts on an asperity, RMS %.3g m",
            "fitted" if pose.fitted else "as given",
            pose.n_matched,
            pose.n_points,
            pose.residual,
        )
    contacts = [
        locate_frame(part, pose.pose, shift_of(run.frames, str(name)), targets)
        for name, part in run.contacts.groupby("frame", sort=False)
    ]
    located = CONTACTS.conform(pd.concat(contacts, ignore_index=True)) if contacts else run.contacts
    frames = run.frames
    if targets is not None:
        frames = _noted(frames, _strangers(located))
    return replace(run, contacts=located, frames=frames, pose=pose)


def _strangers(contacts: pd.DataFrame) -> dict[str, str]:
    """What to say of frames where more than a tenth of the contacts fall on no asperity."""
    notes = {}
    for name, part in contacts.groupby("frame"):
        matched = int(part["asperity"].notna().sum())
        if matched < 0.9 * len(part):
            notes[str(name)] = (
                f"only {matched} of {len(part)} contacts fall on an asperity: "
                "check the asperity table, the pixel size and where the camera looks"
            )
    return notes


def series_pose(run: Run, guess: Pose, targets: NDArray[np.float64]) -> PoseFit:
    """The pose from the frame with the most contacts."""
    counts = run.frames["n_contacts"].fillna(0)
    name = run.frames.loc[counts.idxmax(), "frame"]
    part = run.contacts[run.contacts["frame"] == name]
    shift = shift_of(run.frames, name)
    reach = 0.05 * max(guess.shape) * guess.pixel_size
    return fit_pose(
        part["x_px"] - shift[0], part["y_px"] - shift[1], targets, guess, search=PoseSearch(shift=reach)
    )


def locate_frame(
    part: pd.DataFrame, pose: Pose, shift: tuple[float, float], targets: NDArray[np.float64] | None
) -> pd.DataFrame:
    """One frame's contacts in sample coordinates, each with its asperity."""
    located = locate_contacts(part, pose, shift_px=shift)
    if targets is None:
        return located
    points = located[["x_m", "y_m"]].to_numpy(float)
    i, j, _ = pair_points(points, targets, max_distance=pairing_distance(targets, pose))
    asperity = pd.array([pd.NA] * len(located), dtype="Int64")
    asperity[i] = j
    return located.assign(asperity=asperity)


def shift_of(frames: pd.DataFrame, name: str) -> tuple[float, float]:
    """Shift (x, y) in pixels of a frame against the reference, 0 where it is not known."""
    row = frames[frames["frame"] == name].iloc[0]
    shift = np.nan_to_num([row["shift_x_px"], row["shift_y_px"]], nan=0.0)
    return float(shift[0]), float(shift[1])


@stage("forces")
def with_forces(run: Run, sites: pd.DataFrame | None) -> Run:
    """The run with local forces where the elastic body and the asperity's radius are known, and with sums."""
    pose = run.pose
    contacts, frames = fill_forces(
        run.scene,
        run.contacts,
        run.frames,
        sites,
        pixel_size=run.scene.need("camera", "forces").pixel_size if pose is None else pose.pose.pixel_size,
        length_relative_std=0.0 if pose is None else pose.length_relative_std,
    )
    return replace(run, contacts=contacts, frames=_noted(frames, _without_force(contacts)))


def _without_force(contacts: pd.DataFrame) -> dict[str, str]:
    """What to say of frames where some contacts have a force and others, without an asperity, have none."""
    notes = {}
    for name, part in contacts.groupby("frame"):
        missing = int(part["force_N"].isna().sum())
        if 0 < missing < len(part):
            notes[str(name)] = f"{missing} contacts have no asperity and so no force; the sum leaves them out"
    return notes
