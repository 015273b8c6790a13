"""Predictions of a scene at several loads, and their files."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from contactimg.errors import InputError
from contactimg.files import write_table
from contactimg.pipeline.inputs import need_asperities, scene_asperities
from contactimg.prediction import (
    Coupling,
    Model,
    Prediction,
    predict_average,
    predict_contacts,
    see_contacts,
)
from contactimg.scene import Scene
from contactimg.tables import CONTACTS, FRAMES, PROFILE

__all__ = ["predict_loads", "write_predictions"]


def predict_loads(
    scene: Scene, loads: Sequence[float], *, model: Model, coupling: Coupling, annulus: float
) -> list[Prediction]:
    """Predict the contacts of a scene at each load.

    Parameters
    ----------
    scene : Scene
        With asperities.
    loads : sequence of float
        N, each once.
    model : {"interacting", "gw", "gt"}
        Row by row, or averages over random asperities.
    coupling : str
        Level of coupling of the interacting model, or "auto" to obey the scene.
    annulus : float
        Width of the profile's annuli (interacting model), m.

    Raises
    ------
    InputError
        If a load is given twice or the scene lacks what the model needs.
    """
    repeated = [load for load in loads if list(loads).count(load) > 1]
    if repeated:
        raise InputError(f"load {repeated[0]!r} N is given more than once; give each load once")
    if model != "interacting":
        table = scene_asperities(scene)
        return [predict_average(scene, table, load=load, model=model) for load in loads]
    asperities = need_asperities(scene, "predicting contacts")
    return [
        predict_contacts(scene, asperities, load=load, coupling=coupling, annulus=annulus) for load in loads
    ]


def write_predictions(predictions: Sequence[Prediction], scene: Scene, folder: Path) -> pd.DataFrame:
    """Write contacts.csv, frames.csv and profile.csv; return the frames table.

    The pixel columns of the contacts are filled where the scene has a camera and the size of its frames.
    """
    contacts = pd.concat([prediction.contacts for prediction in predictions], ignore_index=True)
    if scene.camera is not None and scene.simulate is not None:
        contacts = see_contacts(contacts, scene.pose(scene.simulate.shape))
    frames = pd.concat([prediction.frames for prediction in predictions], ignore_index=True)
    profiles = pd.concat([prediction.profile for prediction in predictions], ignore_index=True)
    write_table(contacts, CONTACTS, folder / "contacts.csv")
    write_table(frames, FRAMES, folder / "frames.csv")
    write_table(profiles, PROFILE, folder / "profile.csv")
    return frames
