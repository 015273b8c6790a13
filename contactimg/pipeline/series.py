"""Measure a series: every frame on its own, then one pose, asperities and forces for all."""

import logging
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import FrameError, InputError
from contactimg.files import Experiment, FrameSource, open_experiment
from contactimg.forces import assign_forces, total_area, total_force
from contactimg.frame import Frame
from contactimg.imaging.measure import ImageMeasurement, measure_image
from contactimg.matching import PoseFit, PoseSearch, fit_pose, pair_points, pairing_distance
from contactimg.pipeline.inputs import contact_sites, scene_asperities
from contactimg.pipeline.measure import contacts_table, locate_contacts, rejected_table
from contactimg.pipeline.parallel import in_parallel
from contactimg.pose import Pose
from contactimg.prediction import FAILED
from contactimg.scene import Scene
from contactimg.tables import CONTACTS, FRAMES, REJECTED
from contactimg.timings import stage
from contactimg.tradeoff.choice import Choice, measure_cheapest

logger = logging.getLogger(__name__)

__all__ = [
    "FAILED",
    "Run",
    "locate_frame",
    "measure_experiment",
    "measure_series",
    "series_pose",
    "shift_of",
    "with_forces",
]


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


@dataclass(frozen=True)
class _Measured:
    """One frame's part of a run, in pixels."""

    contacts: pd.DataFrame
    rejected: pd.DataFrame
    row: dict[str, Any]
    shape: tuple[int, int] | None
    choice: Choice | None = None

    def summary(self) -> str:
        """One line about the frame."""
        numbers = (f"{key} {value:.4g}" for key, value in self.row.items() if isinstance(value, float))
        return f"{self.row['frame']}: {self.row['status']}, {len(self.contacts)} contacts, " + ", ".join(
            numbers
        )


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
    scene, parts = experiment.scene, []
    for part in _measure_all(experiment, scene, relative, workers=workers):
        logger.info("%s", part.summary())
        parts.append(part)
        if advance is not None:
            advance()
    parts, shape = _same_size(parts)
    frames = FRAMES.conform(pd.DataFrame([part.row for part in parts])).assign(
        load_N=[experiment.load_of(part.row["frame"]) for part in parts]
    )
    contacts = pd.concat([part.contacts for part in parts], ignore_index=True)
    rejected = pd.concat([part.rejected for part in parts], ignore_index=True)
    choices = {str(part.row["frame"]): part.choice for part in parts if part.choice is not None}
    run = Run(scene, CONTACTS.conform(contacts), REJECTED.conform(rejected), frames, None, choices)
    if scene.camera is None:
        return run
    asperities = scene_asperities(scene)
    sites = None if asperities is None else contact_sites(asperities, scene)
    return with_forces(_located(run, sites, shape), sites)


def _measure_all(
    experiment: Experiment, scene: Scene, relative: float | None, *, workers: int | None
) -> Iterator[_Measured]:
    """The frames' parts in order, a few frames in memory at a time."""
    reference = experiment.reference.read().image if experiment.reference is not None else None
    jobs = ((source, reference, scene, relative) for source in experiment.frames)
    return in_parallel(_measure_source, jobs, count=len(experiment.frames), workers=workers)


def _measure_source(
    source: FrameSource, reference: NDArray | None, scene: Scene, relative: float | None
) -> _Measured:
    """Read and measure one frame; a failure becomes a row."""
    try:
        frame = source.read()
        measurement, choice = _measure(frame, reference, scene, relative)
    except FrameError as error:
        return _failure(source.name, str(error))
    except Exception as error:
        logger.debug("%s", source.name, exc_info=True)
        return _failure(source.name, f"cannot be measured ({type(error).__name__}: {error})")
    row: dict[str, Any] = {
        "frame": source.name,
        "status": measurement.status,
        "n_contacts": len(measurement.disks),
        "threshold": measurement.threshold,
        "contrast": measurement.contrast,
        "noise": measurement.noise,
        "shift_x_px": measurement.shift_x_px,
        "shift_y_px": measurement.shift_y_px,
        "message": "; ".join(text for text in (measurement.message, str(choice or "")) if text),
    }
    contacts, rejected = contacts_table(measurement, source.name), rejected_table(measurement, source.name)
    return _Measured(contacts, rejected, row, frame.shape, choice)


def _measure(
    frame: Frame, reference: NDArray | None, scene: Scene, relative: float | None
) -> tuple[ImageMeasurement, Choice | None]:
    """Measure one frame by the scene's method, or by the cheapest that meets a tolerance."""
    if relative is not None:
        return measure_cheapest(
            frame.image, reference, scene=scene, relative=relative, full_scale=frame.full_scale
        )
    measurement = measure_image(
        frame.image,
        reference,
        method=scene.measure.method,
        polarity=scene.images.polarity,
        threshold=scene.measure.threshold,
        full_scale=frame.full_scale,
        blur_px=scene.measure.blur_px,
    )
    return measurement, None


def _failure(name: str, reason: str) -> _Measured:
    """The part of a frame that could not be measured."""
    message = reason if name in reason else f"{name}: {reason}"
    row = {"frame": name, "status": FAILED, "message": message}
    return _Measured(CONTACTS.empty(), REJECTED.empty(), row, shape=None)


def _same_size(parts: list[_Measured]) -> tuple[list[_Measured], tuple[int, int]]:
    """The parts of the frames of the usual size, the others as failures, and that size."""
    sizes = Counter(part.shape for part in parts if part.shape is not None)
    if not sizes:
        raise InputError(f"no frame could be measured; the first: {parts[0].row['message']}")
    (rows, columns), _ = sizes.most_common(1)[0]
    checked = []
    for part in parts:
        if part.shape not in (None, (rows, columns)):
            odd = f"has {part.shape[1]} x {part.shape[0]} pixels, the other frames {columns} x {rows}"
            checked.append(_failure(part.row["frame"], odd))
        else:
            checked.append(part)
    return checked, (rows, columns)


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
    scene, contacts, relative = run.scene, run.contacts, 0.0
    if scene.elastic is not None:
        relative = scene.elastic.young_modulus_std / scene.elastic.young_modulus
        contacts = assign_forces(
            contacts,
            _sphere_radii(contacts, scene, sites),
            contact_modulus=scene.elastic.contact_modulus,
            modulus_relative_std=relative,
        )
    groups = dict(list(contacts.groupby("frame")))
    rows = []
    for row in run.frames.to_dict("records"):
        if row["status"] != FAILED:
            part = groups.get(row["frame"], CONTACTS.empty())
            area, force = total_area(part), total_force(part, modulus_relative_std=relative)
            row |= {"area_m2": area.value, "area_std_m2": area.std}
            if scene.elastic is not None:
                row |= {"force_sum_N": force.value, "force_sum_std_N": force.std}
        rows.append(row)
    frames = _noted(FRAMES.conform(pd.DataFrame(rows)), _without_force(contacts))
    return replace(run, contacts=contacts, frames=frames)


def _without_force(contacts: pd.DataFrame) -> dict[str, str]:
    """What to say of frames where some contacts have a force and others, without an asperity, have none."""
    notes = {}
    for name, part in contacts.groupby("frame"):
        missing = int(part["force_N"].isna().sum())
        if 0 < missing < len(part):
            notes[str(name)] = f"{missing} contacts have no asperity and so no force; the sum leaves them out"
    return notes


def _sphere_radii(contacts: pd.DataFrame, scene: Scene, sites: pd.DataFrame | None) -> NDArray[np.float64]:
    """Composite radius of each contact's asperity, or the one radius common to all, or NaN."""
    radii = np.full(len(contacts), _common_radius(scene, sites))
    if sites is not None:
        matched = contacts["asperity"].notna().to_numpy()
        radii[matched] = sites["radius_m"].to_numpy(float)[contacts["asperity"][matched].to_numpy(int)]
    return radii


def _common_radius(scene: Scene, sites: pd.DataFrame | None) -> float:
    """Composite radius that holds for contacts without an asperity of their own; NaN if radii differ."""
    if scene.asperities is not None and scene.asperities.radius is not None:
        curvature = 1 / scene.asperities.radius
        return 1 / (curvature + (1 / scene.indenter.radius if scene.indenter is not None else 0.0))
    radii = sites["radius_m"].to_numpy(float) if sites is not None else np.empty(0)
    return float(radii.mean()) if len(radii) and np.ptp(radii) <= 1e-6 * radii.max() else np.nan
