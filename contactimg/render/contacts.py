"""Place contacts in a frame and give them brightness, edges and the air film.

That of a smooth sphere on a smooth flat is a wide contact with the JKR gap around it.
"""

from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.special import elliprg

from contactimg.errors import InputError
from contactimg.mechanics import jkr
from contactimg.optics.film import excess_table
from contactimg.optics.render_settings import lamp
from contactimg.optics.spots import (
    SECTORS,
    FilmSpots,
    Spots,
    elliptic_outlines,
    rough_outlines,
    surround_with_film,
)
from contactimg.optics.wide_edge import edge_light, film_opening
from contactimg.pose import Pose
from contactimg.scene import Scene
from contactimg.tables import CONTACTS

Values = NDArray[np.float64]

PIXEL_COLUMNS = ["x_px", "y_px", "radius_px"]
ELLIPSE_COLUMNS = ["semi_major_px", "semi_minor_px", "angle_rad"]


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
    lengths = contacts[["radius_m", "semi_major_m", "semi_minor_m"]].to_numpy(float)
    radius, major, minor = lengths.T / pose.pixel_size
    return CONTACTS.conform(
        contacts.assign(
            x_px=x + shift_px[0],
            y_px=y + shift_px[1],
            radius_px=radius,
            area_px2=np.pi * radius**2,
            semi_major_px=major,
            semi_minor_px=minor,
            angle_rad=pose.angle_in_image(contacts["angle_rad"]),
            perimeter_px=8 * elliprg(0.0, major**2, minor**2),
        )
    )


def place_contacts(
    contacts: pd.DataFrame, scene: Scene, *, shape: tuple[int, int], shift_px: tuple[float, float]
) -> pd.DataFrame:
    """Compute the positions and radii of contacts in the pixels of a frame.

    Parameters
    ----------
    contacts : DataFrame, contacts schema
        Rows with finite ``x_px, y_px, radius_px`` lie there before the shift; the others at ``x_m, y_m,
        radius_m``, ellipses with the half-axes in m and ``angle_rad`` on the sample.
    scene : Scene
        Its camera relates metres to pixels.
    shape : (int, int)
        Rows and columns of the frame.
    shift_px : (float, float), px
        (x, y) by which the sample has moved.

    Returns
    -------
    DataFrame, contacts schema
        With finite columns in pixels.

    Raises
    ------
    InputError
        If a row has no finite position, or a negative radius, or is an ellipse without its axes.
    """
    table = CONTACTS.conform(contacts)
    by_metres = ~np.isfinite(table[PIXEL_COLUMNS].to_numpy()).all(axis=1)
    if by_metres.any():
        seen, ellipses = see_contacts(table, scene.pose(shape)), by_metres & (table["shape"] == "ellipse")
        for rows, columns in ((by_metres, PIXEL_COLUMNS), (ellipses, ELLIPSE_COLUMNS)):
            table.loc[rows, columns] = seen.loc[rows, columns]
    values = table[PIXEL_COLUMNS].to_numpy()
    wrong = ~np.isfinite(values).all(axis=1) | (values[:, 2] < 0)
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise InputError(
            f"contacts: row {row} needs a finite centre and a radius that is not negative, in px or in m; "
            f"got {', '.join(f'{n} = {v:g}' for n, v in zip(PIXEL_COLUMNS, values[row], strict=True))}"
        )
    axes = table[ELLIPSE_COLUMNS].to_numpy(float)
    ellipse = (table["shape"] == "ellipse").to_numpy(bool) & (values[:, 2] > 0)
    wrong = ellipse & ~(np.isfinite(axes).all(axis=1) & (axes[:, :2] > 0).all(axis=1))
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise InputError(
            f"contacts: row {row} is an ellipse and needs half-axes above 0 and an angle, in px or in m; "
            f"got {', '.join(f'{n} = {v:g}' for n, v in zip(ELLIPSE_COLUMNS, axes[row], strict=True))}"
        )
    # the axes say how large an ellipse is
    table.loc[ellipse, "radius_px"] = np.sqrt(axes[ellipse, 0] * axes[ellipse, 1])
    table["x_px"] += shift_px[0]
    table["y_px"] += shift_px[1]
    return table


def contact_spots(
    truth: pd.DataFrame,
    scene: Scene,
    effects: frozenset[str],
    *,
    sphere_radius: ArrayLike | None,
    rng: np.random.Generator,
) -> Spots:
    """Contacts as spots of light, with their brightness, edges and air film.

    Parameters
    ----------
    truth : DataFrame, contacts schema
        With finite columns in px.
    scene : Scene
        Pixel size and radii of curvature, for the film.
    effects : frozenset of str
        Those that are rendered (`contactimg.optics.render_settings.rendered_effects`).
    sphere_radius : array_like, m, or None
        Radius of curvature of each contact, or one for all; None for that of the scene.
    rng : numpy.random.Generator

    Returns
    -------
    Spots
        One per contact whose radius is not 0.

    Raises
    ------
    InputError
        If the film is switched on and the radii of curvature are not known, or their number is wrong.
    """
    simulate = scene.need("simulate", "rendering frames")
    visible = truth["radius_px"].to_numpy() > 0
    x_px, y_px, radius_px = (truth.loc[visible, name].to_numpy() for name in PIXEL_COLUMNS)
    brightness = 1 + simulate.brightness_spread * rng.standard_normal(radius_px.size)
    outline_px = np.zeros((radius_px.size, 1))
    if "edge_roughness" in effects:
        outline_px = rough_outlines(radius_px, rms_px=simulate.edge_roughness_px, rng=rng)
    chosen = np.flatnonzero(truth.loc[visible, "shape"] == "ellipse")
    if chosen.size:
        axes = truth.loc[visible].iloc[chosen][ELLIPSE_COLUMNS].to_numpy(float).T
        stretched = elliptic_outlines(*axes, outline_px=outline_px[chosen])
        outline_px = np.repeat(outline_px, SECTORS // outline_px.shape[1], axis=1)
        outline_px[chosen] = stretched
    spots = Spots(x_px, y_px, radius_px, brightness, outline_px, simulate.edge_softness_px)
    if "film" not in effects:
        return spots
    if (truth["shape"] == "ellipse").any():
        raise InputError(
            "the air film is rendered around circular contacts, and some of these are ellipses; set "
            '[effects] film = "off"'
        )
    return surround_with_film(
        spots,
        sphere_radius=_sphere_radii(sphere_radius, scene, len(truth))[visible],
        pixel_size=scene.need("camera", "rendering the air film").pixel_size,
        excess=excess_table(lamp(simulate)),
    )


def _sphere_radii(sphere_radius: ArrayLike | None, scene: Scene, count: int) -> Values:
    """Radius of curvature of each contact, as given or from the scene."""
    radius = scene.common_radius if sphere_radius is None else sphere_radius
    if radius is None:
        raise InputError(
            "the film needs the radius of curvature of the contacts: hand over sphere_radius, or give "
            "radius_m in [asperities]"
        )
    radii = np.asarray(radius, float)
    if radii.ndim and radii.shape != (count,):
        raise InputError(
            f"sphere_radius must be one number or one a contact ({count}), got shape {radii.shape}"
        )
    if not np.all(np.isfinite(radii) & (radii > 0)):
        raise InputError("sphere_radius must be positive for every contact")
    return np.broadcast_to(radii, count)


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
