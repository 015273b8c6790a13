"""The places of an experiment: runs read back, whether they belong together, and what models see there."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd
import scipy
from numpy.typing import NDArray

from contactimg.analysis.annuli import MOMENTS, SECTORS, FieldOfView, annulus_moments
from contactimg.analysis.area_power_law import group_loads
from contactimg.errors import ContactimgError, ConvergenceError, InputError, ModelRangeError
from contactimg.files import Experiment, Run, input_hashes, open_experiment, read_calibration, read_run
from contactimg.files.runs import frame_shift
from contactimg.pipeline.inputs import scene_asperities
from contactimg.pipeline.predict import predict_in_view
from contactimg.pose import Pose
from contactimg.prediction import load_name, scene_of_model
from contactimg.scene import Scene
from contactimg.surfaces import of_asperities
from contactimg.tables import CONTACTS, LOADS, Status

logger = logging.getLogger(__name__)

Point = tuple[float, float]

Result = TypeVar("Result")

CHANCE = 1e-4
"""Probability of asperities as different as these on one surface, below which they are taken for those of
another. Chosen: a false alarm in 200 analyses of twenty-four places."""

STATED = (("indenter", "radius_m"), ("elastic", "young_modulus_Pa"), ("elastic", "thickness_m"))


@dataclass(frozen=True, eq=False)
class Place:
    """One place on a sample: the frames taken there, measured, or what a model says of them.

    Parameters
    ----------
    name : str
        Folder of the run.
    contacts, frames : DataFrame
        Tables of the run; the contacts also have ``radius_ratio``, a/R, NaN where R is not known.
    scene : Scene
        With the indenter's apex at ``centre``.
    pose : Pose or None
        Of the camera; None for a run of `predict`, where everything is visible.
    centre : (float, float), m
        Of the apparent contact, sample coordinates.
    asperities : DataFrame or None
    loads : DataFrame
        Columns of `contactimg.tables.LOADS`, with the friction; empty if there are none.
    predicted : bool
        Whether its contacts come from `predict`.
    experiment : Experiment or None
        Its images; None if they are gone.
    images : frozenset of str
        SHA-256 of the files of the frames that show contacts.
    """

    name: str
    contacts: pd.DataFrame
    frames: pd.DataFrame
    scene: Scene
    pose: Pose | None
    centre: Point
    asperities: pd.DataFrame | None
    loads: pd.DataFrame
    predicted: bool = False
    experiment: Experiment | None = None
    images: frozenset[str] = frozenset()

    def field(self, frame: str) -> FieldOfView | None:
        """Field of view of the camera in a frame; None if everything is visible."""
        return None if self.pose is None else FieldOfView(self.pose, frame_shift(self.frames, frame))

    def at(self, load: float) -> "Place":
        """The place with only the frames of a ``group_load`` (N), from `grouped`, and their contacts."""
        frames = self.frames[self.frames["group_load"] == load]
        contacts = self.contacts[self.contacts["frame"].isin(frames["frame"])]
        return replace(self, contacts=contacts, frames=frames)


def open_place(folder: str | Path, *, centre_px: Point | None = None) -> Place:
    """Read a run back as a place.

    Parameters
    ----------
    folder : path-like
        Output of `process` or `predict`.
    centre_px : (float, float), optional
        Column and row of the centre of the apparent contact in the reference frame, from `read_centre`;
        default: that of the calibration the run was measured with, else the indenter's apex, else the image
        centre.

    Returns
    -------
    Place

    Raises
    ------
    InputError
        If the folder holds no complete run, or the run has no lengths in metres.
    """
    run = read_run(folder)
    scene, pose = run.scene, None if run.pose is None else run.pose.pose
    if (run.frames["status"] == Status.NO_POSE).any():
        logger.warning("%s: contacts fall on no asperity: profiles are about the stated apex", run.folder)
    shown = run.frames.loc[run.frames["n_contacts"].fillna(0) > 0, "frame"]
    names = set(shown.str.replace(r"\[\d+\]$", "", regex=True))  # of a stack the file
    used = run.provenance["configuration"].get("options", {}).get("calibration") or {}
    centre = _centre(run, pose, centre_px or _centre_in(used.get("record", {})))
    asperities = _optional(lambda: scene_asperities(scene), run.folder, "no asperities")
    without = "no friction forces, no limits of unseen contacts"
    experiment = _optional(lambda: open_experiment(scene), run.folder, without)
    return Place(
        name=str(run.folder),
        contacts=run.contacts.assign(radius_ratio=radius_ratios(run.contacts, scene, asperities)),
        frames=run.frames,
        scene=scene.with_apex(centre),
        pose=pose,
        centre=centre,
        asperities=asperities,
        loads=LOADS.empty() if experiment is None else experiment.loads,
        predicted=run.command == "predict",
        experiment=experiment,
        images=input_hashes(run.provenance["inputs"], names),
    )


def read_centre(path: str | Path) -> Point:
    """Centre of the apparent contact (column, row; px) from a ``calibration.json``.

    Parameters
    ----------
    path : path-like
        Written by `calibrate jkr`, or its folder.

    Raises
    ------
    InputError
        If the file cannot be read or holds no centre.
    """
    centre = _centre_in(read_calibration(path))
    if centre is None:
        raise InputError(f"{path}: holds no centre_x, centre_y; give the result of 'calibrate jkr'")
    return centre


def _centre_in(record: Mapping[str, Any]) -> Point | None:
    """The centre that a calibration found, if it looked for one."""
    if not {"centre_x", "centre_y"} <= set(record):
        return None
    return float(record["centre_x"]["value"]), float(record["centre_y"]["value"])


def _centre(run: Run, pose: Pose | None, centre_px: Point | None) -> Point:
    """The centre of the apparent contact on the sample."""
    if centre_px is None and run.scene.indenter is not None:
        return run.scene.indenter.apex
    if pose is None:
        raise InputError(f"{run.folder}: has no pixel size, so no length in m; run `process` with one first")
    if centre_px is None:
        logger.warning("%s: no indenter and no calibrated centre; the image centre is taken", run.folder)
        return pose.centre
    x, y = pose.to_sample(*centre_px)
    return float(x), float(y)


def radius_ratios(contacts: pd.DataFrame, scene: Scene, asperities: pd.DataFrame | None) -> pd.Series:
    """Contact radius over the radius of curvature of its asperity, NaN where that is not known."""
    radii = pd.Series(np.nan if scene.asperities is None else scene.asperities.radius, contacts.index, float)
    if asperities is not None:
        own = of_asperities(asperities["radius_m"], contacts["asperity"])
        radii = radii.where(np.isnan(own), own)
    return contacts["radius_m"] / radii


def _optional(read: Callable[[], Result], folder: Path, without: str) -> Result | None:
    """The content of a file, or None and a warning if the file no longer exists."""
    try:
        return read()
    except InputError as error:
        logger.warning("%s: %s (%s)", folder, without, error)
        return None


def fit_or_note(
    notes: list[str], what: str, fit: Callable[..., Result], *data: object, **how: object
) -> Result | None:
    """The fit, or None and a note where the data do not allow it."""
    try:
        return fit(*data, **how)
    except ContactimgError as error:
        notes.append(f"{what}: {error}")
        return None


# --- places of one surface


def differences(places: Sequence[Place]) -> Iterator[str]:
    """A sentence for each property in which a place differs from the first one.

    Of the asperities the distributions are compared; the height that heights count from has no meaning.
    """
    for place in places[1:]:
        first = places[0]
        for section, key in STATED:
            one, two = (float(run.scene.source.get(section, {}).get(key, np.nan)) for run in (first, place))
            if abs(two - one) > 0.01 * max(abs(one), abs(two)):  # chosen: up to 1 % they are the same
                used = f"averaged as places of one surface under one lens, with the value of {first.name}"
                yield f"[{section}] {key} is {one:g} in {first.name} and {two:g} in {place.name}: {used}"
        caps = [run.asperities for run in (first, place) if run.asperities is not None]
        caps = [table.assign(height_m=table["height_m"] - table["height_m"].median()) for table in caps]
        for column, name in (("height_m", "heights above their median"), ("radius_m", "radii")):
            values = [table[column].dropna().to_numpy(float) for table in caps if table[column].notna().any()]
            if len(values) == 2 and scipy.stats.ks_2samp(values[0], values[1]).pvalue < CHANCE:
                stds = " and ".join(f"{np.std(one):.3g}" for one in values)
                why = f"their {name} have standard deviations of {stds} m; analyse the runs apart"
                yield f"the asperities of {place.name} are not of the surface of {first.name}: {why}"


# --- their frames, and the models of them


def usable_frames(place: Place) -> pd.DataFrame:
    """Frames of a place with a load above zero and contacts that bear it."""
    frames = place.frames
    return frames[(frames["load_N"] > 0) & (frames["area_m2"] > 0)]


def grouped(places: Sequence[Place], *, tolerance: float) -> list[Place]:
    """The places with their usable frames only, which are grouped by nearly equal load.

    Columns ``group`` (from the lowest load), ``group_name`` (the common name of its frames, or of the load)
    and ``group_load`` (N, the mean over the places) are added to the frames.

    Parameters
    ----------
    places : sequence of Place
    tolerance : float
        Relative difference up to which loads are averaged as one.
    """
    shots = pd.concat([usable_frames(place).assign(place=place.name) for place in places], ignore_index=True)
    if shots.empty:
        raise InputError("there is nothing to analyse: no frame was measured at a known load above zero")
    shots["group"] = group_loads(shots["load_N"].tolist(), tolerance=tolerance)
    load = shots.groupby(["group", "place"])["load_N"].mean().groupby("group").mean()
    shots["group_load"] = shots["group"].map(load)
    alone = shots.groupby("group")["frame"].transform("nunique") == 1
    shots["group_name"] = shots["frame"].where(alone, shots["group_load"].map(load_name))
    return [replace(place, frames=shots[shots["place"] == place.name]) for place in places]


def annuli_of(place: Place, edges: NDArray, least: float) -> pd.DataFrame:
    """Sums over annuli of the contacts from radius ``least`` (px) on, averaged over the frames of a place."""
    smallest = -np.inf if place.pose is None else least * place.pose.pixel_size
    shown = place.contacts[place.contacts["radius_m"] >= smallest]
    how: dict[str, Any] = {"centre": place.centre, "edges": edges, "sectors": SECTORS}
    tables = [
        annulus_moments(shown[shown["frame"] == frame], field=place.field(frame), **how)
        for frame in place.frames["frame"]
    ]
    mean, columns = tables[0].copy(), list(MOMENTS)
    mean[columns] = sum(table[columns] for table in tables) / len(tables)
    return mean


def predict_places(places: Sequence[Place], model: str) -> tuple[list[Place], list[str]]:
    """Solve a model for the frames of places and keep the contacts in the field of view.

    Parameters
    ----------
    places : sequence of Place
        With lens, rubber and asperities, from `grouped`.
    model : {"coupled", "uncoupled"}

    Returns
    -------
    list of Place
        With the model's contacts, and the frames with their areas. A frame beyond the model's range is left
        out.
    list of str
        Why frames were left out.
    """
    surfaces = {
        place.name: (scene_of_model(place.scene, model), place.asperities)
        for place in places
        if place.asperities is not None
    }
    shots = [(place, row) for place in places for row in place.frames.to_dict("records")]
    jobs = [(place.name, row["frame"], row["load_N"], place.field(row["frame"])) for place, row in shots]
    solutions = predict_in_view(surfaces, jobs, shown=f"solving the {model} model")
    solved, notes = {place.name: list[tuple[Any, pd.DataFrame]]() for place in places}, list[str]()
    for (place, row), found in zip(shots, solutions, strict=True):
        if isinstance(found, ModelRangeError | ConvergenceError):
            notes.append(f"{place.name}, {row['frame']}: the {model} model is left out: {found}")
        elif isinstance(found, ContactimgError):
            raise found
        else:
            count, area = len(found.contacts), float(found.contacts["area_m2"].sum())
            # free of measurement errors
            row |= {"n_contacts": count, "area_m2": area, "area_std_m2": 0.0}
            solved[place.name].append((row, found.contacts))

    def predicted(place: Place) -> Place:
        contacts = CONTACTS.joined(seen for _, seen in solved[place.name])
        ratios = radius_ratios(contacts, place.scene, place.asperities)
        frames = pd.DataFrame([row for row, _ in solved[place.name]], columns=place.frames.columns)
        return replace(place, contacts=contacts.assign(radius_ratio=ratios), frames=frames)

    return [predicted(place) for place in places], notes
