"""Measure a series: each frame alone, some again with the optics of the series, then pose and forces."""

import logging
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.effects.local_law import LawPlan, plan_law
from contactimg.errors import FrameError, InputError
from contactimg.files import Experiment, FrameStore, open_experiment
from contactimg.forces import LengthScale, fill_forces, sphere_radii
from contactimg.imaging.fit.pooling import gain_of_pooling, pool_edges, pool_optics
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.pipeline.background.second_pass import measure_on_background
from contactimg.pipeline.edits import edits_by_frame
from contactimg.pipeline.effects import film_setting, resolve_measurement
from contactimg.pipeline.frame import FrameOptions, MeasuredFrame, locate_contacts, measure_scene_frame
from contactimg.pipeline.inputs import contact_sites, scene_asperities
from contactimg.pipeline.parallel import FailedFrame, for_each_frame
from contactimg.pipeline.run import Run, frame_shift
from contactimg.pose import Pose
from contactimg.pose.fit import SIGNIFICANT_FRACTION, PoseSearch, fit_pose
from contactimg.pose.global_search import LEAST_VOTING_POINTS, search_everywhere
from contactimg.pose.pairs import pair_points, pairing_distance
from contactimg.pose.refine import PoseFit
from contactimg.scene import Scene
from contactimg.tables import CONTACTS, FRAMES, OUTLINES, REJECTED, Status
from contactimg.timings import stage

logger = logging.getLogger(__name__)

POOLING_GAIN = 1.5
"""A frame is measured again with the optics of the series if that makes the uncertainty of its sum of a^3 at
least this many times smaller. Chosen by hand; sensitivity not measured."""

POSE_REACH_FRACTION = 0.05
"""Largest error of the stated centre of the camera, as a fraction of the longer side of the frame. Chosen by
hand; sensitivity not measured."""

MATCHED_FRACTION = 0.9
"""A frame gets a remark if fewer of its contacts fall on an asperity. Chosen by hand; changes no number."""


def measure_series(
    scene: Scene, *, workers: int | None = None, advance: Callable[[], None] | None = None
) -> Run:
    """Measure every frame of a scene.

    Parameters
    ----------
    scene : Scene
        From `contactimg.read_scene`, which knows the folder of its files.
    workers : int, optional
        Processes that share the frames; default one per core, or only this one for fewer than four frames.
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
    store: FrameStore | None = None,
) -> Run:
    """Measure every frame of an opened experiment; see `measure_series`.

    With a ``store``, frames that it contains are not measured again.

    With ``relative``, a tolerance of the scene's output, each frame is measured by the cheapest method that
    is estimated to meet it (`contactimg.tradeoff.choice`).
    """
    scene = experiment.scene
    asperities = None if scene.camera is None else scene_asperities(scene)
    sites = None if asperities is None else contact_sites(asperities, scene)
    resolved = resolve_measurement(scene)
    edits = edits_by_frame(experiment, relative=relative)
    options = FrameOptions(resolved, film_setting(resolved, sites), relative, edits)
    parts, shape = _measure_frames(experiment, options, workers=workers, advance=advance, store=store)
    frames = FRAMES.conform(pd.DataFrame([part.row for part in parts])).assign(
        load_N=[experiment.load_of(part.row["frame"]) for part in parts]
    )
    contacts = pd.concat([part.contacts for part in parts], ignore_index=True)
    rejected = pd.concat([part.rejected for part in parts], ignore_index=True)
    outlines = OUTLINES.conform(pd.concat([part.outlines for part in parts], ignore_index=True))
    choices = {str(part.row["frame"]): part.choice for part in parts if part.choice is not None}
    run = Run(
        scene,
        CONTACTS.conform(contacts),
        REJECTED.conform(rejected),
        frames,
        None,
        choices,
        outlines=outlines,
        films={str(part.row["frame"]): part.film for part in parts if part.film is not None},
    )
    return run if scene.camera is None else with_forces(_with_pose(run, sites, shape), sites)


def _measure_frames(
    experiment: Experiment,
    options: FrameOptions,
    *,
    workers: int | None,
    advance: Callable[[], None] | None,
    store: FrameStore | None,
) -> tuple[list[MeasuredFrame], tuple[int, int]]:
    """Measure every frame on its own, then again those that need contrast and blur of the others.

    Returns
    -------
    parts : list of MeasuredFrame
        In order; a frame that cannot be measured has a row that says why.
    shape : (int, int)
        Rows and columns of the frames.

    Raises
    ------
    InputError
        If no frame at all could be measured; the message gives the first reason.
    """
    measure: Callable[..., MeasuredFrame] = partial(measure_scene_frame, options=options)
    parts = []
    for measured in for_each_frame(experiment, measure, workers=workers, advance=advance, store=store):
        part = MeasuredFrame.failed(measured) if isinstance(measured, FailedFrame) else measured
        logger.info("%s", part.summary())
        parts.append(part)
    parts, shape = _same_size(parts)
    parts, background = measure_on_background(experiment, options, parts, workers=workers)
    method = options.scene.measure.method
    # a pixel count takes each frame's own plateau
    fitted = [(part.choice.method if part.choice else method) == "disk" for part in parts]
    own_optics = [part.relative_optics for part, disks in zip(parts, fitted, strict=True) if disks]
    pooled = pool_optics([optics for optics in own_optics if optics is not None])
    if pooled is None:
        return parts, shape
    shared = [_with_edge_of_others(pooled, parts, k) for k in range(len(parts))]
    again = [k for k, part in enumerate(parts) if fitted[k] and _gains_by_pooling(part, shared[k])]
    jobs = [(experiment.frames[k], shared[k].scaled(parts[k].level or 1.0)) for k in again]
    if background is not None:
        measure, store = background.measure, None
        jobs = [background.job(*job) for job in jobs]
    second_pass = for_each_frame(experiment, measure, jobs, workers=workers, store=store)
    for k, measured in zip(again, second_pass, strict=True):
        part = MeasuredFrame.failed(measured) if isinstance(measured, FailedFrame) else measured
        logger.info("with the contrast, the blur and the edge of the series: %s", part.summary())
        parts[k] = part.with_choice(parts[k].choice)
    return parts, shape


def _with_edge_of_others(pooled: SharedOptics, parts: list[MeasuredFrame], number: int) -> SharedOptics:
    """The pooled optics with the edge that the other frames show: its own adds nothing to a frame."""
    others = [part.own_optics for k, part in enumerate(parts) if k != number]
    edges = [optics.edge for optics in others if optics is not None and optics.edge is not None]
    return replace(pooled, edge=pool_edges(edges))


def _gains_by_pooling(part: MeasuredFrame, pooled: SharedOptics) -> bool:
    """Whether the optics of the series make the uncertainty of the sum of a^3 much smaller or its edge right.

    A frame without a contact is measured again too: a faint contact may be detected once its contrast is
    known.
    """
    own = part.relative_optics
    if part.shape is None or pd.isna(part.row["n_contacts"]):
        return False
    if own is None or not len(part.contacts):
        return True
    contacts = part.contacts
    slope = 3.0 * contacts["radius_px"].to_numpy(float) ** 2
    shifts = contacts[["contrast_shift_px", "blur_shift_px"]].to_numpy(float)
    edge = contacts["edge_shift_px"].to_numpy(float)
    shared = np.sum(shifts**2, axis=1) + edge**2
    alone = np.maximum(contacts["radius_std_px"].to_numpy(float) ** 2 - shared, 0.0)
    own_part, edge_part = float(np.sqrt(slope**2 @ alone)), float(slope @ edge)
    gain = gain_of_pooling(slope @ shifts, own_part, own, pooled, edge_part=edge_part)
    return gain > POOLING_GAIN or _lacks_edge(own, pooled)


def _lacks_edge(own: SharedOptics, pooled: SharedOptics) -> bool:
    """Whether the frame missed the edge that the others have, with fewer contacts to see it."""
    if own.edge is None or pooled.edge is None:
        return False
    return own.edge.families != pooled.edge.families and 2 * own.edge.count < pooled.edge.count


def _same_size(parts: list[MeasuredFrame]) -> tuple[list[MeasuredFrame], tuple[int, int]]:
    """The parts, those of an unusual frame size as failures, and the usual size."""
    sizes = Counter(part.shape for part in parts if part.shape is not None)
    if not sizes:
        raise InputError(f"no frame could be measured; the first: {parts[0].row['message']}")
    (rows, columns), _ = sizes.most_common(1)[0]
    checked = []
    for part in parts:
        if part.shape not in (None, (rows, columns)):
            odd = f"has {part.shape[1]} x {part.shape[0]} pixels, the other frames {columns} x {rows}"
            checked.append(MeasuredFrame.failed(FailedFrame.of(part.row["frame"], FrameError(odd))))
        else:
            checked.append(part)
    return checked, (rows, columns)


def _with_notes(frames: pd.DataFrame, notes: dict[str, str]) -> pd.DataFrame:
    """The frames table with a note added to the messages of the named frames."""
    messages = [
        "; ".join(text for text in (row["message"], notes.get(row["frame"], "")) if text)
        for row in frames.to_dict("records")
    ]
    return frames.assign(message=messages)


@stage("pose")
def _with_pose(run: Run, sites: pd.DataFrame | None, shape: tuple[int, int]) -> Run:
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
        locate_frame(part, pose.pose, frame_shift(run.frames, str(name)), targets)
        for name, part in run.contacts.groupby("frame", sort=False)
    ]
    located = CONTACTS.conform(pd.concat(contacts, ignore_index=True)) if contacts else run.contacts
    frames = run.frames
    if targets is not None:
        frames = _with_pose_status(_with_notes(frames, _unmatched_notes(located)), located)
    return replace(run, contacts=located, frames=frames, pose=pose)


def _with_pose_status(frames: pd.DataFrame, contacts: pd.DataFrame) -> pd.DataFrame:
    """The frames table where frames that no pose explains are no longer ok."""
    on_asperity = contacts["asperity"].notna().groupby(contacts["frame"]).agg(["sum", "size"])
    lost = on_asperity["sum"] < SIGNIFICANT_FRACTION * on_asperity["size"]
    lost &= on_asperity["size"] >= LEAST_VOTING_POINTS
    without = (frames["status"] == Status.OK) & frames["frame"].isin(on_asperity.index[lost])
    return frames.assign(status=frames["status"].mask(without, Status.NO_POSE))


def _unmatched_notes(contacts: pd.DataFrame) -> dict[str, str]:
    """What to say of frames where more than a tenth of the contacts fall on no asperity."""
    notes = {}
    for name, part in contacts.groupby("frame"):
        matched = int(part["asperity"].notna().sum())
        if matched < MATCHED_FRACTION * len(part):
            notes[str(name)] = (
                f"only {matched} of {len(part)} contacts fall on an asperity: "
                "check the asperity table, [camera] pixel_size_m and centre_m, and [indenter] apex_m"
            )
    return notes


def series_pose(run: Run, guess: Pose, targets: NDArray[np.float64]) -> PoseFit:
    """The pose from the frame with the most contacts: near the stated one, or else anywhere on the sample."""
    counts = run.frames["n_contacts"].fillna(0)
    name = str(run.frames["frame"].iloc[int(counts.to_numpy(float).argmax())])
    part = run.contacts[run.contacts["frame"] == name]
    shift = frame_shift(run.frames, name)
    reach = POSE_REACH_FRACTION * max(guess.shape) * guess.pixel_size
    x_px, y_px = part["x_px"] - shift[0], part["y_px"] - shift[1]
    fit = fit_pose(x_px, y_px, targets, guess, search=PoseSearch(shift=reach))
    if fit.fitted:
        return fit
    found = search_everywhere(x_px, y_px, targets, guess)
    if found is None:
        return fit
    centre = ", ".join(f"{value:.6g}" for value in found.pose.centre)
    logger.warning(
        "the camera does not look where the scene says; %d of %d contacts fall on asperities with [camera] "
        "centre_m = [%s], rotation_deg = %.4g, mirrored = %s: used here",
        found.n_matched,
        found.n_points,
        centre,
        np.rad2deg(found.pose.rotation),
        str(found.pose.mirrored).lower(),
    )
    return found


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


@stage("forces")
def with_forces(run: Run, sites: pd.DataFrame | None) -> Run:
    """The run with local forces where the elastic body and the asperity's radius are known, and with sums."""
    if run.pose is None:
        scale = LengthScale(run.scene.need("camera", "forces").pixel_size, relative_std=0.0)
    else:
        scale = LengthScale(run.pose.pose.pixel_size, run.pose.length_relative_std)
    law = local_law(run, sites)
    contacts, frames = fill_forces(
        run.scene if law is None else law.scene, run.contacts, run.frames, sites, scale
    )
    frames = _with_notes(frames, _missing_force_notes(contacts))
    forces = contacts["force_N"].notna().any()
    return replace(run, contacts=contacts, frames=frames, law=law if forces else None)


def local_law(run: Run, sites: pd.DataFrame | None) -> LawPlan | None:
    """The law of the local forces of a run, and what it leaves out; None without an elastic body."""
    if run.scene.elastic is None:
        return None
    return plan_law(run.scene, run.contacts, sphere_radii(run.contacts, run.scene, sites))


def _missing_force_notes(contacts: pd.DataFrame) -> dict[str, str]:
    """What to say of frames where some contacts have a force and others, without an asperity, have none."""
    notes = {}
    for name, part in contacts.groupby("frame"):
        missing = int(part["force_N"].isna().sum())
        if 0 < missing < len(part):
            notes[str(name)] = f"{missing} contacts have no asperity and so no force; the sum leaves them out"
    return notes
