"""Contacts of a series in sample coordinates, each with its asperity and its local force."""

import logging
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.analysis.annuli import FieldOfView
from contactimg.effects.local_law import LawPlan, plan_law
from contactimg.files.runs import Run, frame_shift
from contactimg.forces import fill_forces, sphere_radii
from contactimg.models.cap_shapes import CapShapes
from contactimg.pipeline.frame import locate_contacts
from contactimg.pose import Pose
from contactimg.pose.apex import Apex, find_apex, find_centre
from contactimg.pose.fit import SIGNIFICANT_FRACTION, PoseFit, PoseSearch, fit_pose
from contactimg.pose.global_search import LARGEST_TURN_RAD, LEAST_VOTING_POINTS, search_everywhere
from contactimg.pose.pairs import pair_points, pairing_distance
from contactimg.scene import Scene
from contactimg.surfaces import equivalent_radii
from contactimg.tables import CONTACTS, Status
from contactimg.timings import stage

logger = logging.getLogger(__name__)

POSE_REACH_FRACTION = 0.05
"""Largest error of the stated centre of the camera, as a fraction of the longer side of the frame. Chosen by
hand; sensitivity not measured."""

EXCHANGED_SINE = 0.996
"""Sine of the angle between the pose found and the stated one, mirrored, above which the columns of the
asperities may be exchanged, which is exactly a right angle. Chosen: 5 degrees from it."""

MATCHED_FRACTION = 0.9
"""A frame gets a remark if fewer of its contacts fall on an asperity. Chosen by hand; changes no number."""


FORCES_OFF_LOAD = 1.5
"""Ratio of the sum of local forces to the load, or its inverse, from which on a frame is not ok. Chosen:
above what an uncalibrated modulus or threshold is off by, below a slip of a unit. The ratio is always
printed."""

SIGNIFICANT_STDS = 3.0
"""Standard deviations of the sum of forces beyond which it differs from the load: 0.3 % of false alarms."""


def _with_notes(frames: pd.DataFrame, notes: dict[str, str]) -> pd.DataFrame:
    """The frames table with a note added to the messages of the named frames."""
    messages = [
        "; ".join(text for text in (row["message"], notes.get(row["frame"], "")) if text)
        for row in frames.to_dict("records")
    ]
    return frames.assign(message=messages)


@stage("pose")
def find_pose(run: Run, sites: pd.DataFrame | None, guess: Pose) -> PoseFit:
    """The pose of a series: the one that its contacts confirm, or the stated one.

    Parameters
    ----------
    run : Run
        With the frames table of the series, and at least the contacts of the frame that has most of them.
    sites : DataFrame or None
        Composite summits of the asperities.
    guess : Pose
        As stated.
    """
    if sites is None or run.scene.measure.pose != "fit":
        return PoseFit(guess, fitted=False, n_points=0, n_matched=0, residual=np.nan)
    pose = series_pose(run, guess, sites[["x_m", "y_m"]].to_numpy(float))
    logger.info(
        "pose %s: %d of %d contacts on an asperity, RMS %.3g m",
        "fitted" if pose.fitted else "as given",
        pose.n_matched,
        pose.n_points,
        pose.residual,
    )
    return pose


def apex_of(scene: Scene, shown: Apex | None, asperities: pd.DataFrame | None) -> Apex | None:
    """The apex that a scene states, or else the one that the contacts show; None without an indenter."""
    if scene.indenter is None:
        return None
    stated = "apex" in scene.indenter.model_fields_set or (shown is None and asperities is None)
    if not stated and shown is None:
        logger.warning(
            "[indenter] apex_m is not stated, and the contacts do not show it: (%g, %g) m is taken; state it "
            "for overlay and analyse",
            *scene.indenter.apex,
        )
    return Apex(scene.indenter.apex) if stated else shown


def shown_apex(
    contacts: pd.DataFrame,
    frames: pd.DataFrame,
    scene: Scene,
    pose: Pose | None,
    asperities: pd.DataFrame | None,
) -> Apex | None:
    """The apex that the contacts of one frame show, the frame that shows it best; None if none does.

    None does on a curved sample, or where the asperities are no caps. Without asperities it is the centre of
    the contacts.
    """
    profiled = scene.asperities is not None and scene.asperities.profiled
    lens = None if scene.indenter is None or profiled or scene.shaped else scene.indenter.radius
    if pose is None or lens is None:
        return None
    lost = frames.loc[frames["status"] == Status.NO_POSE, "frame"]
    used = ~contacts["frame"].isin(lost) & (contacts["asperity"].notna() if asperities is not None else True)
    found = []
    for name, part in contacts[used].groupby("frame"):
        in_view = partial(_holds, FieldOfView(pose, frame_shift(frames, str(name))))
        if asperities is None:
            apex = find_centre(part[["x_m", "y_m"]], part["area_m2"], in_view=in_view)
        else:
            caps = asperities.iloc[part["asperity"].to_numpy(int)]
            radius = equivalent_radii(caps)
            apex = find_apex(
                caps[["x_m", "y_m"]],
                caps["height_m"],
                radius / (1 + radius / lens),
                part["radius_m"],
                in_view=in_view,
            )
        if apex is not None:
            found.append(apex)
    return min(found, key=lambda apex: np.hypot(*apex.std), default=None)


def _holds(field: FieldOfView, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether sample points, one a row, lie in the image."""
    return field.holds(*points.T)


@stage("pose")
def with_pose(run: Run, sites: pd.DataFrame | None, pose: PoseFit) -> Run:
    """The run with sample coordinates and asperities under a pose."""
    targets = None if sites is None else sites[["x_m", "y_m"]].to_numpy(float)
    located = CONTACTS.conform(locate_frames(run.contacts, run.frames, pose.pose, targets))
    frames = run.frames
    if targets is not None:
        matched = _known(located, "asperity")
        notes = {
            str(name): f"only {found} of {count} contacts fall on an asperity: check the asperity table, "
            "[camera] pixel_size_m and centre_m, and [indenter] apex_m"
            for name, found, count in matched.itertuples()
            if found < MATCHED_FRACTION * count
        }
        lost = matched["sum"] < SIGNIFICANT_FRACTION * matched["size"]
        lost &= matched["size"] >= LEAST_VOTING_POINTS
        without = (frames["status"] == Status.OK) & frames["frame"].isin(matched.index[lost])
        frames = _with_notes(frames, notes).assign(status=frames["status"].mask(without, Status.NO_POSE))
    return replace(run, contacts=located, frames=frames, pose=pose)


def _known(contacts: pd.DataFrame, column: str) -> pd.DataFrame:
    """Of each frame, how many of its contacts have a value in a column, and their number."""
    return contacts[column].notna().groupby(contacts["frame"]).agg(["sum", "size"])


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
    turned = np.abs(np.sin(found.pose.rotation - guess.rotation))
    exchanged = found.pose.mirrored != guess.mirrored and turned > EXCHANGED_SINE
    camera = run.scene.camera
    differs = found.pose.mirrored != guess.mirrored or turned > np.sin(LARGEST_TURN_RAD)
    stated = camera is not None and camera.centre is not None
    logger.log(
        logging.WARNING if stated or differs else logging.INFO,
        "the camera does not look where [camera] says; %d of %d contacts fall on asperities with [camera] "
        "centre_m = [%s], rotation_deg = %.4g, mirrored = %s: used here%s",
        found.n_matched,
        found.n_points,
        centre,
        np.rad2deg(found.pose.rotation),
        str(found.pose.mirrored).lower(),
        "; are x_m and y_m of the asperities exchanged?" if exchanged else "",
    )
    return found


def locate_frames(
    contacts: pd.DataFrame, frames: pd.DataFrame, pose: Pose, targets: NDArray[np.float64] | None
) -> pd.DataFrame:
    """The contacts of frames in sample coordinates, each with its asperity."""
    shifts = frames.set_index("frame")[["shift_x_px", "shift_y_px"]].reindex(contacts["frame"])
    shift_x, shift_y = np.nan_to_num(shifts.to_numpy(float).T, nan=0.0)
    located = locate_contacts(contacts, pose, shift_px=(shift_x, shift_y))
    if targets is None:
        return located
    points = located[["x_m", "y_m"]].to_numpy(float)
    asperity, reach = np.full(len(located), -1), pairing_distance(targets, pose)
    for rows in contacts.groupby("frame").indices.values():
        i, j, _ = pair_points(points[rows], targets, max_distance=reach)
        asperity[rows[i]] = j
    return located.assign(asperity=pd.arrays.IntegerArray(asperity, asperity < 0))


@stage("forces")
def with_forces(run: Run, sites: pd.DataFrame | None, law: LawPlan | None = None) -> Run:
    """The run with local forces where the elastic body and the asperity's radius are known, and with sums.

    Without a ``law`` the contacts of this run decide on it.
    """
    if run.pose is None:
        pixel_size, length_std = run.scene.need("camera", "forces").pixel_size, 0.0
    else:
        pixel_size, length_std = run.pose.pose.pixel_size, run.pose.length_relative_std
    law = law or local_law(run, sites)
    if law is not None and sites is not None:
        law = replace(law, shapes=CapShapes.of(sites))
    contacts, frames = fill_forces(
        run.scene if law is None else law.scene,
        run.contacts,
        run.frames,
        sites,
        pixel_size=pixel_size,
        length_relative_std=length_std,
    )
    notes = {
        str(name): f"{count - found} contacts have no asperity and so no force; the sum leaves them out"
        for name, found, count in _known(contacts, "force_N").itertuples()
        if 0 < found < count
    }
    frames = _with_balance(_with_notes(frames, notes), law)
    forces = contacts["force_N"].notna().any()
    return replace(run, contacts=contacts, frames=frames, law=law if forces else None)


def local_law(run: Run, sites: pd.DataFrame | None) -> LawPlan | None:
    """The law of the local forces of a run, and what it leaves out; None without an elastic body."""
    if run.scene.elastic is None:
        return None
    return plan_law(run.scene, run.contacts, sphere_radii(run.contacts, run.scene, sites))


def _with_balance(frames: pd.DataFrame, law: LawPlan | None) -> pd.DataFrame:
    """The frames table where frames whose forces do not balance the load are no longer ok, and say so."""
    if law is None or law.scene.elastic is None:
        return frames
    total, std, load = (frames[name].to_numpy(float) for name in ("force_sum_N", "force_sum_std_N", "load_N"))
    ratio = np.divide(total, load, out=np.full(len(frames), np.nan), where=load > 0)
    off = (np.abs(total - load) > SIGNIFICANT_STDS * std) & (total > 0)
    off &= (ratio > FORCES_OFF_LOAD) | (ratio < 1 / FORCES_OFF_LOAD)
    modulus = law.scene.elastic.young_modulus
    notes = {
        str(
            name
        ): f"the local forces add up to {value:.3g} times the load: check the load and its zero, [elastic] "
        f"young_modulus_Pa = {modulus:g}, [camera] pixel_size_m and the radii of the asperities"
        for name, value in zip(frames["frame"][off], ratio[off], strict=True)
    }
    without = off & (frames["status"] == Status.OK)
    return _with_notes(frames, notes).assign(status=frames["status"].mask(without, Status.OFF_LOAD))
