"""The wide contact of a smooth sphere on a smooth flat, with the air film around it."""

from dataclasses import replace

import numpy as np
import pandas as pd

from contactimg.mechanics import jkr
from contactimg.optics.spots import FilmSpots, Spots
from contactimg.optics.wide_edge import edge_light, film_opening
from contactimg.render.contacts import contact_spots
from contactimg.scene import Scene
from contactimg.tables import CONTACTS


def smooth_contact(load: float, scene: Scene, *, name: str) -> pd.DataFrame:
    """The JKR contact of the sphere under a load, as a table of contacts with one row."""
    indenter = scene.need("indenter", "a smooth contact")
    elastic = scene.need("elastic", "a smooth contact")
    modulus, adhesion = elastic.contact_modulus, elastic.work_of_adhesion
    radius = jkr.radius(
        load, sphere_radius=indenter.radius, contact_modulus=modulus, work_of_adhesion=adhesion
    )
    x, y = indenter.apex
    row = {"frame": name, "label": 1, "x_m": x, "y_m": y, "radius_m": radius, "area_m2": np.pi * radius**2}
    return CONTACTS.conform(pd.DataFrame([row | {"force_N": load}]))


def smooth_contact_spot(
    truth: pd.DataFrame, scene: Scene, effects: frozenset[str], *, rng: np.random.Generator
) -> Spots:
    """The contact as a spot of light, with the JKR gap in the air film if the film is on.

    Parameters
    ----------
    truth : DataFrame, contacts schema
        One row with finite columns in pixels.
    scene : Scene
    effects : frozenset of str
        Those that are rendered.
    rng : numpy.random.Generator
    """
    sphere_radius = scene.need("indenter", "a smooth contact").radius
    spots = contact_spots(truth, scene, effects, sphere_radius=sphere_radius, rng=rng)
    if not isinstance(spots, FilmSpots):
        return spots
    elastic, radius = scene.need("elastic", "a smooth contact"), float(truth["radius_m"].iloc[0])
    opening = film_opening(contact_modulus=elastic.contact_modulus, work_of_adhesion=elastic.work_of_adhesion)
    edge = edge_light(radius, sphere_radius=sphere_radius, opening=opening, excess=spots.excess)
    reach = np.full(len(spots.depth), edge.reach / scene.need("camera", "rendering the air film").pixel_size)
    return replace(spots, film_px=reach, opening=2 / np.pi * opening * radius**0.5)
