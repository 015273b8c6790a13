"""Predictions of a scene at several loads, and their files."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from contactimg.errors import InputError
from contactimg.files import write_table
from contactimg.pipeline.inputs import need_asperities
from contactimg.prediction import Coupling, model_name, predict_contacts, see_contacts
from contactimg.scene import Scene
from contactimg.tables import CONTACTS, FRAMES, PROFILE

__all__ = ["predict_loads"]


def predict_loads(
    scene: Scene, loads: Sequence[float], folder: Path, *, coupling: Coupling, annulus: float
) -> pd.DataFrame:
    """Predict the contacts at each load and write contacts.csv, frames.csv and profile.csv.

    Parameters
    ----------
    scene : Scene
        With asperities; where it says how the camera sees them, the pixel columns are filled too.
    loads : sequence of float
        N, each once.
    folder : Path
        Exists.
    coupling : str
        Level of coupling, or "auto" to obey the scene.
    annulus : float
        Width of the profile's annuli, m.

    Returns
    -------
    DataFrame
        The frames table, one row a load.

    Raises
    ------
    InputError
        If a load is given twice or the scene lacks what the model needs.
    """
    repeated = {load for load in loads if list(loads).count(load) > 1}
    if repeated:
        raise InputError(f"load {repeated.pop()!r} N is given more than once; give each load once")
    asperities = need_asperities(scene, "predicting contacts")
    predictions = [predict_contacts(scene, asperities, load=load, coupling=coupling) for load in loads]
    profiles = [p.profile(scene, model=model_name(coupling), width=annulus) for p in predictions]
    contacts = pd.concat([prediction.contacts for prediction in predictions], ignore_index=True)
    if scene.camera is not None:
        shape = scene.simulate.shape if scene.simulate is not None else (1200, 1600)
        contacts = see_contacts(contacts, scene.pose(shape))
    frames = pd.concat([prediction.frames for prediction in predictions], ignore_index=True)
    write_table(contacts, CONTACTS, folder / "contacts.csv")
    write_table(frames, FRAMES, folder / "frames.csv")
    write_table(pd.concat(profiles, ignore_index=True), PROFILE, folder / "profile.csv")
    return frames
