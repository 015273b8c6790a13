"""The places of an experiment with the contacts that a model predicts in the same fields of view."""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, cast

import pandas as pd

from contactimg.engine.calls import in_parallel
from contactimg.errors import ConvergenceError, ModelRangeError
from contactimg.pipeline.analyse.group_by_load import usable_frames
from contactimg.pipeline.analyse.places import Place, radius_ratios
from contactimg.pipeline.loading_path import loads_before
from contactimg.prediction import predict_contacts, scene_of_model
from contactimg.tables import CONTACTS


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
