"""The places of an experiment: runs read back for their analysis, and whether they belong together."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from scipy.stats import ks_2samp

from contactimg.analysis.annuli import FieldOfView
from contactimg.errors import InputError
from contactimg.files import Run, open_experiment, read_calibration, read_run
from contactimg.files.runs import frame_shift
from contactimg.pipeline.inputs import scene_asperities
from contactimg.pose import Pose
from contactimg.scene import Scene
from contactimg.surfaces import equivalent_radii
from contactimg.tables import LOADS, Status

logger = logging.getLogger(__name__)

Point = tuple[float, float]

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Place:
    """One place on a sample: the frames taken there, measured.

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

    def field(self, frame: str) -> FieldOfView | None:
        """Field of view of the camera in a frame; None if everything is visible."""
        return None if self.pose is None else FieldOfView(self.pose, frame_shift(self.frames, frame))


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
    scene = run.scene
    pose = _pose(run)
    used = run.provenance["configuration"].get("options", {}).get("calibration") or {}
    centre = _centre(run, pose, centre_px or _centre_in(used.get("record", {})))
    asperities = _optional(lambda: scene_asperities(scene), run.folder, "no asperities")
    loads = _optional(lambda: open_experiment(scene).loads, run.folder, "no friction forces")
    return Place(
        name=str(run.folder),
        contacts=run.contacts.assign(radius_ratio=radius_ratios(run.contacts, scene, asperities)),
        frames=run.frames,
        scene=scene.with_apex(centre),
        pose=pose,
        centre=centre,
        asperities=asperities,
        loads=LOADS.empty() if loads is None else loads,
        predicted=run.command == "predict",
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


def _pose(run: Run) -> Pose | None:
    """The camera's pose, if the run has one."""
    if run.pose is None:
        return None
    if (run.frames["status"] == Status.NO_POSE).any():
        logger.warning(
            "%s: contacts fall on no asperity, so the apex is where the scene states it; profiles and local "
            "pressures depend on that",
            run.folder,
        )
    return run.pose.pose


def _centre(run: Run, pose: Pose | None, centre_px: Point | None) -> Point:
    """Where the centre of the apparent contact is on the sample."""
    if centre_px is not None:
        if pose is None:
            raise InputError(f"{run.folder}: a centre in pixels needs a run with a pixel size")
        x, y = pose.to_sample(*centre_px)
        return float(x), float(y)
    if run.scene.indenter is not None:
        return run.scene.indenter.apex
    if pose is None:
        raise InputError(f"{run.folder}: has no lengths in metres; run `process` with a pixel size first")
    logger.warning("%s: no indenter and no calibrated centre; the image centre is taken", run.folder)
    return pose.centre


def radius_ratios(contacts: pd.DataFrame, scene: Scene, asperities: pd.DataFrame | None) -> pd.Series:
    """Contact radius over the radius of curvature of its asperity, NaN where that is not known."""
    section = scene.asperities
    radii = np.full(len(contacts), np.nan if section is None or section.radius is None else section.radius)
    if asperities is not None:
        known = contacts["asperity"].notna().to_numpy()
        last = contacts["asperity"].max()
        if known.any() and last >= len(asperities):
            raise InputError(
                f"contacts.csv names asperity {last}, but their table has {len(asperities)} rows"
            )
        radii[known] = equivalent_radii(asperities)[contacts["asperity"][known].to_numpy(int)]
    return contacts["radius_m"] / radii


def _optional(read: Callable[[], Result], folder: Path, without: str) -> Result | None:
    """The content of a file, or None and a warning if the file no longer exists."""
    try:
        return read()
    except InputError as error:
        logger.warning("%s: %s (%s)", folder, without, error)
        return None


SAME_NUMBER = 0.01
"""Relative difference up to which two stated lengths or moduli are taken for the same. Chosen."""

CHANCE = 1e-4
"""Probability of asperities as different as these on one surface, below which they are taken for those of
another. Chosen: a false alarm in 200 analyses of twenty-four places."""

STATED = (("indenter", "radius_m"), ("elastic", "young_modulus_Pa"), ("elastic", "thickness_m"))


def warn_of_differences(places: Sequence[Place]) -> None:
    """Warn of places that do not belong together."""
    for difference in differences(places):
        logger.warning(difference)


def differences(places: Sequence[Place]) -> Iterator[str]:
    """A sentence for each property in which a place differs from the first one."""
    for place in places[1:]:
        yield from _different_numbers(places[0], place)
        yield from _different_asperities(places[0], place)


def _different_numbers(first: Place, place: Place) -> Iterator[str]:
    """Lens and rubber as the scenes state them."""
    for section, key in STATED:
        one, two = (float(run.scene.source.get(section, {}).get(key, np.nan)) for run in (first, place))
        if abs(two - one) > SAME_NUMBER * max(abs(one), abs(two)):
            yield (
                f"[{section}] {key} is {one:g} in {first.name} and {two:g} in {place.name}: averaged "
                f"as places of one surface under one lens, with the value of {first.name}"
            )


def _different_asperities(first: Place, place: Place) -> Iterator[str]:
    """Distributions of heights and radii; the height that heights count from has no meaning."""
    tables = [run.asperities for run in (first, place) if run.asperities is not None]
    if len(tables) < 2:
        return
    for column, name in (("height_m", "heights above their median"), ("radius_m", "radii")):
        one, two = (_centred(table[column]) for table in tables)
        if len(one) and len(two) and ks_2samp(one, two).pvalue < CHANCE:
            yield (
                f"the asperities of {place.name} are not of the surface of {first.name}: their {name} have "
                f"standard deviations of {np.std(one):.3g} and {np.std(two):.3g} m; analyse the runs apart"
            )


def _centred(column: pd.Series) -> np.ndarray:
    """Heights about their median; radii as they are, where they are known."""
    values = column.to_numpy(float)
    values = values[np.isfinite(values)]
    return values - np.median(values) if column.name == "height_m" and len(values) else values
