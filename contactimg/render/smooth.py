"""The wide contact of a smooth sphere on a smooth flat, with the air film around it."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.mechanics import jkr
from contactimg.optics.film import excess_table
from contactimg.optics.render_settings import lamp
from contactimg.optics.spots import Spots
from contactimg.optics.wide_edge import EdgeLight, edge_light, film_opening
from contactimg.render.contacts import contact_spots
from contactimg.scene import Scene
from contactimg.tables import CONTACTS

Values = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class SmoothSpot(Spots):
    """A wide disk of light with an air film around it.

    Parameters
    ----------
    edge : EdgeLight
        Light across its edge, m.
    pixel_size : float, m
    """

    edge: EdgeLight
    pixel_size: float

    @property
    def extent_px(self) -> Values:
        """Distance from the centre beyond which the film has no excess."""
        return self.radius_px + self.edge.reach / self.pixel_size

    def sample(self, chosen: NDArray[np.intp], shape: tuple[int, int], origin: Values, cell: float) -> Values:
        """Mean light in each cell; within a cell the edge is treated as straight."""
        x = origin[0] + cell * np.arange(shape[1]) - self.x_px[chosen[0]]
        y = (origin[1] + cell * np.arange(shape[0]) - self.y_px[chosen[0]])[:, None]
        r = np.hypot(x, y)
        outside = r - self.radius_px[0]
        if outside.max() < -cell:
            return np.full(shape, self.brightness[0])
        away = np.maximum(r, cell)
        # projected across the edge a square cell is a trapezoid: second differences of a double integral;
        # where the edge follows the grid its short side is taken as a thousandth of a cell to avoid 0/0, and
        # at the very centre, which has no direction, the long one as that of a diagonal
        sides = np.abs(x) / away, np.abs(y) / away
        wide, narrow = np.maximum(np.maximum(*sides), 0.5**0.5), np.maximum(np.minimum(*sides), 1e-3)
        ends = [outside + cell * half * (wide + side * narrow) for half in (0.5, -0.5) for side in (1, -1)]
        total = self._twice(ends[0]) - self._twice(ends[1]) + self._twice(ends[2]) - self._twice(ends[3])
        return self.brightness[0] * total / (cell * cell * wide * narrow)

    def _twice(self, outside_px: Values) -> Values:
        """Second integral of the light from the edge on, px^2; 0 at the edge, parabolic inside."""
        inside = 0.5 * np.minimum(outside_px, 0.0) ** 2
        film = self.edge.twice_integrated
        if film is None:
            return inside
        x = np.maximum(outside_px, 0.0) * self.pixel_size
        faded = np.maximum(x - self.edge.reach, 0.0) * float(film(self.edge.reach, 1))
        return inside + (film(np.minimum(x, self.edge.reach)) + faded) / self.pixel_size**2


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
    indenter = scene.need("indenter", "a smooth contact")
    elastic = scene.need("elastic", "a smooth contact")
    simulate = scene.need("simulate", "rendering frames")
    if "film" not in effects:
        return contact_spots(truth, scene, effects, sphere_radius=indenter.radius, rng=rng)
    radius = float(truth["radius_m"].iloc[0])
    adhesion = elastic.work_of_adhesion
    opening = film_opening(contact_modulus=elastic.contact_modulus, work_of_adhesion=adhesion)
    excess = excess_table(lamp(simulate))
    edge = edge_light(radius, sphere_radius=indenter.radius, opening=opening, excess=excess)
    x_px, y_px, radius_px = (truth[column].to_numpy(float) for column in ("x_px", "y_px", "radius_px"))
    pixel_size = scene.need("camera", "rendering the air film").pixel_size
    brightness = 1 + simulate.brightness_spread * rng.standard_normal(1)
    disk = x_px, y_px, radius_px, brightness, np.zeros((1, 1))
    return SmoothSpot(*disk, edge=edge, pixel_size=pixel_size)
