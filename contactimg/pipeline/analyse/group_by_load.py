"""Frames of several places at nearly the same load, measured or predicted, averaged together."""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.analysis.annuli import MOMENTS, SECTORS, annulus_edges, annulus_moments
from contactimg.analysis.area_against_load import group_loads
from contactimg.engine.calls import in_parallel
from contactimg.errors import ConvergenceError, ModelRangeError
from contactimg.pipeline.analyse.places import Place, radius_ratios
from contactimg.pipeline.inputs import loads_before
from contactimg.prediction import load_name, predict_contacts, scene_of_model
from contactimg.tables import CONTACTS, Schema

Values = NDArray[np.float64]


@dataclass(frozen=True)
class LoadGroup:
    """Frames at one load.

    Parameters
    ----------
    name : str
        The frames' common name, or the load's.
    load : float, N
        Mean over the places.
    frames : dict
        Place -> its frames at this load.
    """

    name: str
    load: float
    frames: dict[str, list[str]]

    def frames_of(self, place: Place) -> list[str]:
        """The frames at this load that a place has."""
        present = set(place.frames["frame"])
        return [frame for frame in self.frames.get(place.name, []) if frame in present]

    def edges(self, places: Sequence[Place], *, width: float) -> Values:
        """Edges of the annuli (m) that hold the contacts of all places."""
        edges = [
            annulus_edges(_contacts(place, frame), centre=place.centre, width=width)
            for place in places
            for frame in self.frames_of(place)
        ]
        return max(edges, key=len)

    def moments(
        self, places: Sequence[Place], edges: Values, *, min_radius_px: float
    ) -> dict[str, pd.DataFrame]:
        """Place -> its sums over the annuli; several frames of a place count as one, averaged.

        Contacts smaller than ``min_radius_px`` do not count, measured or predicted.
        """
        return {
            place.name: _mean(
                [
                    annulus_moments(
                        _visible(place, frame, min_radius_px),
                        centre=place.centre,
                        edges=edges,
                        field=place.field(frame),
                        sectors=SECTORS,
                    )
                    for frame in self.frames_of(place)
                ]
            )
            for place in places
            if self.frames_of(place)
        }


def usable_frames(place: Place) -> pd.DataFrame:
    """Frames of a place with a load above zero and a measured area."""
    frames = place.frames
    return frames[(frames["load_N"] > 0) & frames["area_m2"].notna()]


def group_frames(places: Sequence[Place], *, tolerance: float) -> list[LoadGroup]:
    """Groups of nearly equal load, from the lowest.

    Parameters
    ----------
    places : sequence of Place
    tolerance : float
        Relative difference up to which loads are averaged as one.
    """
    shots = [
        (place.name, str(row["frame"]), float(row["load_N"]))
        for place in places
        for row in usable_frames(place).to_dict("records")
    ]
    numbers = group_loads([load for _, _, load in shots], tolerance=tolerance)
    return [
        _group([shot for shot, number in zip(shots, numbers, strict=True) if number == k])
        for k in range(int(numbers.max(initial=-1)) + 1)
    ]


def _group(shots: list[tuple[str, str, float]]) -> LoadGroup:
    """A group of (place, frame, load)."""
    frames: dict[str, list[str]] = {}
    for place, frame, _ in shots:
        frames.setdefault(place, []).append(frame)
    table = pd.DataFrame(shots, columns=["place", "frame", "load"])
    load = float(table.groupby("place")["load"].mean().mean())
    names = table["frame"].unique()
    return LoadGroup(str(names[0]) if len(names) == 1 else load_name(load), load, frames)


def _contacts(place: Place, frame: str) -> pd.DataFrame:
    """Contacts of one frame."""
    return place.contacts[place.contacts["frame"] == frame]


def _visible(place: Place, frame: str, min_radius_px: float) -> pd.DataFrame:
    """Contacts of one frame that the camera would resolve; all of them without a camera."""
    contacts = _contacts(place, frame)
    if place.pose is None:
        return contacts
    return contacts[contacts["radius_m"] >= min_radius_px * place.pose.pixel_size]


def _mean(tables: list[pd.DataFrame]) -> pd.DataFrame:
    """Mean of tables of moments over the same annuli."""
    columns = list(MOMENTS)
    mean = tables[0].copy()
    mean[columns] = sum(table[columns] for table in tables) / len(tables)
    return mean


def joined(tables: Sequence[pd.DataFrame], schema: Schema) -> pd.DataFrame:
    """Tables of one schema concatenated; empty tables are left out, so that they do not change dtypes."""
    return schema.conform(pd.concat([table for table in tables if len(table)] or [schema.empty()]))


def has_models(place: Place) -> bool:
    """Whether the models can be solved for a place: its lens, rubber and asperities are known."""
    scene = place.scene
    return place.asperities is not None and scene.indenter is not None and scene.elastic is not None


def count_solutions(places: Sequence[Place]) -> int:
    """Solutions that `predict_places` finds for one model; none if a place is not known well enough."""
    known = all(has_models(place) for place in places)
    return sum(len(usable_frames(place)) for place in places) if known else 0


def predict_places(
    places: Sequence[Place],
    model: str,
    *,
    workers: int | None = None,
    advance: Callable[[], None] | None = None,
) -> tuple[list[Place], list[str]]:
    """Solve a model for every frame of places and keep the contacts in the field of view.

    Parameters
    ----------
    places : sequence of Place
        For which `has_models` holds.
    model : {"coupled", "uncoupled"}
    workers : int, optional
        Processes that share the solutions.
    advance : callable, optional
        Called once a solution.

    Returns
    -------
    list of Place
        The same places with the model's contacts and areas. A frame beyond the model's range is left out.
    list of str
        Why frames were left out.
    """
    jobs = [(place.name, row) for place in places for row in usable_frames(place).to_dict("records")]
    tables: dict[str, tuple[list[pd.DataFrame], list[dict[Hashable, Any]]]] = {
        p.name: ([], []) for p in places
    }
    notes = []
    solve = partial(_solve, {place.name: place for place in places}, model)
    solutions = in_parallel(solve, jobs, count=len(jobs), workers=workers)
    for (name, row), solved in zip(jobs, solutions, strict=True):
        if isinstance(solved, str):
            notes.append(f"{name}, {row['frame']}: the {model} model is left out: {solved}")
        else:
            contacts, rows = tables[name]
            contacts.append(solved)
            rows.append(row | {"n_contacts": len(solved), "area_m2": float(solved["area_m2"].sum())})
        if advance is not None:
            advance()
    return [_as_predicted(place, *tables[place.name]) for place in places], notes


def _solve(places: dict[str, Place], model: str, name: str, row: dict[Hashable, Any]) -> pd.DataFrame | str:
    """The contacts of one frame in its field of view, or why there are none."""
    place, load = places[name], float(row["load_N"])
    try:
        prediction = predict_contacts(
            scene_of_model(place.scene, model),
            cast("pd.DataFrame", place.asperities),
            load=load,
            frame=str(row["frame"]),
            history=loads_before(place.scene, load, usable_frames(place)["load_N"].tolist()),
        )
    except (ModelRangeError, ConvergenceError) as error:
        return str(error)
    contacts, field = prediction.contacts, place.field(str(row["frame"]))
    seen = contacts if field is None else contacts[field.holds(contacts["x_m"], contacts["y_m"])]
    return seen.assign(radius_ratio=radius_ratios(seen, place.scene, place.asperities))


def _as_predicted(place: Place, contacts: list[pd.DataFrame], rows: list[dict[Hashable, Any]]) -> Place:
    """The place with a model's contacts and areas, free of measurement errors."""
    none = CONTACTS.empty().assign(radius_ratio=pd.Series(dtype=float))
    frames = pd.DataFrame(rows, columns=place.frames.columns).assign(area_std_m2=0.0)
    together = pd.concat(contacts, ignore_index=True) if contacts else none
    return replace(place, contacts=together, frames=frames)
