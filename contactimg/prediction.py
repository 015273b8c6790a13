"""What the models predict for a scene: contacts, the frames row and the profile at each load."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd

from contactimg.analysis.profiles import annulus_edges, radial_profile
from contactimg.mechanics import hertz
from contactimg.models.interacting import solve_interacting
from contactimg.pose import Pose
from contactimg.scene import Scene
from contactimg.tables import CONTACTS, FRAMES

__all__ = [
    "Coupling",
    "Prediction",
    "hertz_circle",
    "load_name",
    "model_name",
    "predict_contacts",
    "see_contacts",
]

Coupling = Literal["auto", "none", "asymptotic", "hertz", "full"]


@dataclass(frozen=True)
class Prediction:
    """A model's answer at one load.

    Attributes
    ----------
    contacts : DataFrame
        Contacts table, lengths in metres.
    frames : DataFrame
        One row of the frames table.
    """

    contacts: pd.DataFrame
    frames: pd.DataFrame

    def profile(self, scene: Scene, *, model: str, width: float) -> pd.DataFrame:
        """Profile table about the indenter's apex, in annuli of ``width`` (m)."""
        centre = scene.need("indenter", "a profile").apex
        edges = annulus_edges(self.contacts, centre=centre, width=width)
        frame = str(self.frames["frame"].iloc[0])
        return radial_profile(self.contacts, centre=centre, edges=edges, frame=frame, model=model)


def predict_contacts(
    scene: Scene, asperities: pd.DataFrame, *, load: float, coupling: Coupling = "auto", frame: str = ""
) -> Prediction:
    """Solve the interacting-asperity model for a scene at one load.

    Parameters
    ----------
    scene : Scene
        Sections ``[indenter]`` and ``[elastic]`` are needed.
    asperities : DataFrame
        Asperity table.
    load : float
        N.
    coupling : {"auto", "none", "asymptotic", "hertz", "full"}
        ``"auto"`` obeys the scene's effect ``coupling``: asymptotic unless it is switched off.
    frame : str
        Name entered in the tables; default: the load's own name.

    Returns
    -------
    Prediction

    Raises
    ------
    InputError
        If a section is missing or the load is negative.
    ConvergenceError
        If the solver stops above its tolerance.
    """
    indenter = scene.need("indenter", "a contact model")
    elastic = scene.need("elastic", "a contact model")
    if coupling == "auto":
        coupling = "none" if scene.effects.coupling == "off" else "asymptotic"
    solution = solve_interacting(
        asperities,
        indenter_radius=indenter.radius,
        contact_modulus=elastic.contact_modulus,
        load=load,
        apex=indenter.apex,
        coupling=coupling,
    )
    name = frame or load_name(load)
    contacts = solution.contacts(name)
    row = FRAMES.conform(
        {
            "frame": [name],
            "status": [solution.status],
            "load_N": [load],
            "n_contacts": [len(contacts)],
            "area_m2": [float(contacts["area_m2"].sum())],
            "force_sum_N": [float(contacts["force_N"].sum())],
            "indentation_m": [solution.indentation],
        }
    )
    return Prediction(contacts, row)


def model_name(coupling: Coupling) -> str:
    """Name of the model in ``scores.csv`` and ``profile.csv``."""
    return "uncoupled" if coupling == "none" else "coupled"


def load_name(load: float) -> str:
    """One unique name a load, from its shortest exact decimal form."""
    return f"load_{load!r}N"


def see_contacts(
    contacts: pd.DataFrame, pose: Pose, *, shift_px: tuple[float, float] = (0.0, 0.0)
) -> pd.DataFrame:
    """Fill the pixel columns of a contacts table given in metres, as the camera would see them.

    Parameters
    ----------
    contacts : DataFrame
        Contacts table with ``x_m, y_m, radius_m``; not changed.
    pose : Pose
        Pose of the camera over the reference frame.
    shift_px : (float, float)
        Position in the frame minus position in the reference.
    """
    x, y = pose.to_pixels(contacts["x_m"], contacts["y_m"])
    return CONTACTS.conform(
        contacts.assign(
            x_px=x + shift_px[0],
            y_px=y + shift_px[1],
            radius_px=contacts["radius_m"].to_numpy(float) / pose.pixel_size,
        )
    )


def hertz_circle(scene: Scene, load: float) -> tuple[float, float, float] | None:
    """Apparent contact ``(x, y, radius)`` of the smooth sphere at a load (m), if the scene says enough."""
    if scene.indenter is None or scene.elastic is None or not np.isfinite(load) or load < 0:
        return None
    radius = hertz.radius(
        load, sphere_radius=scene.indenter.radius, contact_modulus=scene.elastic.contact_modulus
    )
    return *scene.indenter.apex, float(radius)
