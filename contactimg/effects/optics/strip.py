"""A test strip: some of a scene's contacts, drawn far apart on a small image, to try the camera on.

The contacts are sorted by radius and cut into groups; the strip shows one of each group, which stands for all
of it. What the camera makes of the strip, with and without an effect, says what the effect does to the frame
at a fraction of its price. The chance of the strip is fixed: two strips differ by what is asked for alone.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.optics.film import excess_table
from contactimg.optics.outlines import rough_outlines
from contactimg.optics.recipe import Recipe, lamp, point_spread
from contactimg.optics.sensor import digitise
from contactimg.optics.spots import FilmSpots, Spots, spots_image, surround_with_film
from contactimg.optics.static import surface_texture
from contactimg.scene import Scene

Values = NDArray[np.float64]

MOST_CONTACTS = 36
MOST_PIXELS = 60_000
FEWEST_CONTACTS = 4
REALISATIONS = 2  # of the noise; some dozens of contacts each have their own
REACH = 4.0  # blur widths around a contact that its cell holds
SPACE_PX = 12.0  # of background around that: a block and a half, so that most of the strip is background
SEED = 20150203


@dataclass(frozen=True, eq=False)
class Strip:
    """Contacts on a small image; made by `arrange_strip`.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.
    x_px, y_px, radius_px : ndarray, shape (n,)
    sphere_radius : ndarray, shape (n,), m
        R of each; NaN where it is not known.
    off_axis : ndarray, shape (n,)
        Mean square of the distance from the centre of the frame, that of a corner being 1.
    weight : ndarray, shape (n,)
        Contacts that each stands for.
    pixel_size : float, m
    """

    shape: tuple[int, int]
    x_px: Values
    y_px: Values
    radius_px: Values
    sphere_radius: Values
    off_axis: Values
    weight: Values
    pixel_size: float

    @cached_property
    def nearest(self) -> NDArray[np.intp]:
        """The contact whose cell each pixel lies in, shape ``shape``."""
        rows, columns = np.indices(self.shape)
        return self.owner(columns.ravel(), rows.ravel()).reshape(self.shape)

    def owner(self, x_px: NDArray, y_px: NDArray) -> NDArray[np.intp]:
        """The contact whose rim is nearest to each place."""
        distance = np.hypot(x_px[:, None] - self.x_px, y_px[:, None] - self.y_px) - self.radius_px
        return distance.argmin(axis=1)

    @cached_property
    def deviates(self) -> Values:
        """Standard normal numbers, shape (realisations, 4, rows, columns): shots and read-out, twice."""
        rng = np.random.default_rng([SEED, 1])
        return rng.standard_normal((REALISATIONS, 4, *self.shape))


def arrange_strip(scene: Scene, contacts: pd.DataFrame, *, power: int) -> Strip | None:
    """Choose contacts of a scene and give each a place of its own.

    Parameters
    ----------
    scene : Scene
        Sections ``[camera]`` and ``[simulate]`` are needed.
    contacts : DataFrame, contacts schema
        Lengths in m; those that the frame does not show are left out.
    power : int
        Each contact has the mean of this power of the radii that it stands for.

    Returns
    -------
    Strip or None
        None without a contact in the frame.
    """
    simulate = scene.need("simulate", "a test strip")
    pose = scene.pose(simulate.shape)
    x, y = pose.to_pixels(contacts["x_m"].to_numpy(float), contacts["y_m"].to_numpy(float))
    radius = contacts["radius_m"].to_numpy(float) / pose.pixel_size
    middle = np.array([(n - 1) / 2 for n in simulate.shape])
    seen = (np.abs(y - middle[0]) <= middle[0] + 0.5) & (np.abs(x - middle[1]) <= middle[1] + 0.5)
    seen &= radius > 0
    if not seen.any():
        return None
    curvature = _sphere_radii(scene, contacts)
    off_axis = ((y - middle[0]) ** 2 + (x - middle[1]) ** 2) / max(float(middle @ middle), 1.0)
    order = np.flatnonzero(seen)[np.argsort(radius[seen], kind="stable")]
    side = 2 * (radius[order].mean() + REACH * simulate.blur_px) + SPACE_PX
    count = int(np.clip(MOST_PIXELS / side**2, FEWEST_CONTACTS, MOST_CONTACTS))
    groups = np.array_split(order, min(count, order.size))
    radii = np.array([np.mean(radius[group] ** power) ** (1 / power) for group in groups])
    places, shape = _shelves(2 * (radii + REACH * simulate.blur_px) + SPACE_PX)
    return Strip(
        shape=shape,
        x_px=places[:, 0],
        y_px=places[:, 1],
        radius_px=radii,
        sphere_radius=np.array([curvature[group].mean() for group in groups]),
        off_axis=np.array([off_axis[group].mean() for group in groups]),
        weight=np.array([float(group.size) for group in groups]),
        pixel_size=pose.pixel_size,
    )


def _sphere_radii(scene: Scene, contacts: pd.DataFrame) -> Values:
    """R of each contact by Hertz's law, ``R = 4 E* a^3/(3 p)``; NaN where that is not known."""
    force, radius = contacts["force_N"].to_numpy(float), contacts["radius_m"].to_numpy(float)
    if scene.elastic is None:
        return np.full(len(contacts), np.nan)
    known = np.isfinite(force) & (force > 0)
    cubed = 4 / 3 * scene.elastic.contact_modulus * radius**3
    return np.divide(cubed, force, out=np.full(len(contacts), np.nan), where=known)


def _shelves(sides: Values) -> tuple[Values, tuple[int, int]]:
    """Centres (x, y) of squares laid side by side in rows of one width, and rows and columns of it all."""
    width = max(float(np.sqrt(np.sum(sides**2))), float(sides.max()))
    jitter = np.random.default_rng([SEED, 0]).uniform(-0.5, 0.5, (sides.size, 2))
    places, left, top, height = np.empty((sides.size, 2)), 0.0, 0.0, 0.0
    for k, side in enumerate(sides):
        if left + side > width:
            left, top, height = 0.0, top + height, 0.0
        places[k] = left + side / 2, top + side / 2
        left, height = left + side, max(height, side)
    return places + jitter, (int(np.ceil(top + height)) + 1, int(np.ceil(width)) + 1)


def strip_light(strip: Strip, recipe: Recipe) -> Values:
    """Light of the strip's contacts, 1 on a wide one; with the blur, film and rough edges asked for."""
    simulate = recipe.simulate
    rough = "edge_roughness" in recipe.effects
    outlines = np.zeros((strip.radius_px.size, 1))
    if rough:
        rng = np.random.default_rng([SEED, 2])
        outlines = rough_outlines(strip.radius_px, rms_px=simulate.edge_roughness_px, rng=rng)
    ones = np.ones(strip.radius_px.size)
    plain = Spots(strip.x_px, strip.y_px, strip.radius_px, ones, outlines, simulate.edge_softness_px)
    spots: Spots | FilmSpots = plain
    if "film" in recipe.effects:
        spots = surround_with_film(
            plain,
            sphere_radius=strip.sphere_radius,
            pixel_size=strip.pixel_size,
            excess=excess_table(lamp(simulate)),
        )
    psf, halo = point_spread(recipe)
    return spots_image(spots, shape=strip.shape, psf=psf, halo=halo)


def expose_strip(strip: Strip, light: Values, recipe: Recipe, realisation: int) -> tuple[NDArray, NDArray]:
    """Frame and reference of the strip as the sensor gives them, with the noise of one realisation.

    Shots are normal numbers here, which they are at ten electrons and more, so that more or less light keeps
    the noise its pattern.
    """
    simulate = recipe.simulate
    levels = np.full(strip.shape, simulate.background_levels)
    if "vignetting" in recipe.effects:
        levels *= (1 - simulate.vignetting * strip.off_axis)[strip.nearest]
    if simulate.texture:
        blur_px = simulate.blur_px if "blur" in recipe.effects else 0.0
        levels *= 1 + surface_texture(
            strip.shape, rms=simulate.texture, blur_px=blur_px, shift_px=(0.0, 0.0), seed=SEED
        )
    drift = 1 + simulate.light_drift if "light_drift" in recipe.effects else 1.0
    frame = drift * levels * (1 + simulate.contrast_levels / simulate.background_levels * light)
    shots = strip.deviates[realisation]
    return _sensor(frame, recipe, shots[:2]), _sensor(levels, recipe, shots[2:])


def _sensor(levels: Values, recipe: Recipe, deviates: Values) -> NDArray:
    """The camera's pixels."""
    simulate = recipe.simulate
    levels = np.maximum(levels, 0.0)
    noisy = levels
    if "shot_noise" in recipe.effects:
        noisy = noisy + np.sqrt(levels / simulate.electrons_per_level) * deviates[0]
    if "read_noise" in recipe.effects:
        noisy = noisy + simulate.read_noise_electrons / simulate.electrons_per_level * deviates[1]
    return digitise(
        noisy,
        bit_depth=simulate.bit_depth,
        saturate="saturation" in recipe.effects,
        quantise="quantisation" in recipe.effects,
        name="strip",
    ).image
