"""A small synthetic image of some of a scene's contacts, on which the effects of the camera are tried.

The contacts are sorted by radius and divided into groups; the image shows one contact of each group, far from
the others. Measuring it with and without an effect estimates the change on the whole frame in a fraction of
the time. The random numbers are always the same, so that two images differ only by the effects.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.optics.film import excess_table
from contactimg.optics.render_settings import RenderSettings, lamp, point_spread
from contactimg.optics.rough_edges import rough_outlines
from contactimg.optics.sensor import digitise
from contactimg.optics.spots import FilmSpots, Spots, spots_image, surround_with_film
from contactimg.optics.synthetic_background import surface_texture
from contactimg.scene import Scene

Values = NDArray[np.float64]

# All of these are chosen by hand to keep the time per effect short; sensitivity not measured.
MAX_CONTACTS, MIN_CONTACTS = 36, 4
MAX_PIXELS = 60_000
REALISATIONS = 2  # of the noise; each contact has noise of its own in addition
REACH_SIGMA = 4.0  # widths of the blur that fit around a contact
SPACE_PX = 12.0  # background around that: 1.5 blocks, so that most of the image is background
SEED = 20150203


@dataclass(frozen=True, eq=False)
class SampleImage:
    """Contacts on the small image; made by `arrange_sample`.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.
    x_px, y_px, radius_px : ndarray, shape (n,)
    sphere_radius : ndarray, shape (n,), m
        Radius of curvature of each asperity; NaN where it is not known.
    off_axis : ndarray, shape (n,)
        Mean squared distance from the centre of the frame; 1 in a corner.
    weight : ndarray, shape (n,)
        Number of contacts of the frame that each one represents.
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
        """Index of the contact nearest to each pixel, shape ``shape``."""
        rows, columns = np.indices(self.shape)
        return self.nearest_contact(columns.ravel(), rows.ravel()).reshape(self.shape)

    def nearest_contact(self, x_px: NDArray, y_px: NDArray) -> NDArray[np.intp]:
        """Index of the contact whose rim is nearest to each point."""
        distance = np.hypot(x_px[:, None] - self.x_px, y_px[:, None] - self.y_px) - self.radius_px
        return distance.argmin(axis=1)

    @cached_property
    def normal_numbers(self) -> Values:
        """Shot and read noise of frame and reference, normalised, shape (realisations, 4, rows, columns)."""
        rng = np.random.default_rng([SEED, 1])
        return rng.standard_normal((REALISATIONS, 4, *self.shape))


def arrange_sample(scene: Scene, contacts: pd.DataFrame, *, power: int) -> SampleImage | None:
    """Choose contacts of a scene and place them far apart.

    Parameters
    ----------
    scene : Scene
        With the sections ``[camera]`` and ``[simulate]``.
    contacts : DataFrame, contacts schema
        Lengths in m; contacts outside the frame are left out.
    power : int
        The radius of each contact is the power mean of the radii of its group, with this power.

    Returns
    -------
    SampleImage or None
        None if no contact lies in the frame.
    """
    simulate = scene.need("simulate", "a test sample")
    pose = scene.pose(simulate.shape)
    x, y = pose.to_pixels(contacts["x_m"].to_numpy(float), contacts["y_m"].to_numpy(float))
    radius = contacts["radius_m"].to_numpy(float) / pose.pixel_size
    middle = np.array([(n - 1) / 2 for n in simulate.shape])
    inside = (np.abs(y - middle[0]) <= middle[0] + 0.5) & (np.abs(x - middle[1]) <= middle[1] + 0.5)
    inside &= radius > 0
    if not inside.any():
        return None
    curvature = _sphere_radii(scene, contacts)
    off_axis = ((y - middle[0]) ** 2 + (x - middle[1]) ** 2) / max(float(middle @ middle), 1.0)
    order = np.flatnonzero(inside)[np.argsort(radius[inside], kind="stable")]
    side = 2 * (radius[order].mean() + REACH_SIGMA * simulate.blur_px) + SPACE_PX
    count = int(np.clip(MAX_PIXELS / side**2, MIN_CONTACTS, MAX_CONTACTS))
    groups = np.array_split(order, min(count, order.size))
    radii = np.array([np.mean(radius[group] ** power) ** (1 / power) for group in groups])
    places, shape = _place_in_rows(2 * (radii + REACH_SIGMA * simulate.blur_px) + SPACE_PX)
    return SampleImage(
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
    """Radius of curvature of each contact by the Hertz law, ``R = 4 E* a^3/(3 p)``; NaN where not known."""
    force, radius = contacts["force_N"].to_numpy(float), contacts["radius_m"].to_numpy(float)
    if scene.elastic is None:
        return np.full(len(contacts), np.nan)
    known = np.isfinite(force) & (force > 0)
    cubed = 4 / 3 * scene.elastic.contact_modulus * radius**3
    return np.divide(cubed, force, out=np.full(len(contacts), np.nan), where=known)


def _place_in_rows(sides: Values) -> tuple[Values, tuple[int, int]]:
    """Place squares side by side in rows; return their centres (x, y) and the shape of the image."""
    width = max(float(np.sqrt(np.sum(sides**2))), float(sides.max()))
    jitter = np.random.default_rng([SEED, 0]).uniform(-0.5, 0.5, (sides.size, 2))
    places, left, top, height = np.empty((sides.size, 2)), 0.0, 0.0, 0.0
    for k, side in enumerate(sides):
        if left + side > width:
            left, top, height = 0.0, top + height, 0.0
        places[k] = left + side / 2, top + side / 2
        left, height = left + side, max(height, side)
    return places + jitter, (int(np.ceil(top + height)) + 1, int(np.ceil(width)) + 1)


def sample_light(sample: SampleImage, settings: RenderSettings) -> Values:
    """Light of the contacts, 1 inside a wide one, with blur, film and rough edges as in the settings."""
    simulate = settings.simulate
    rough = "edge_roughness" in settings.effects
    outlines = np.zeros((sample.radius_px.size, 1))
    if rough:
        rng = np.random.default_rng([SEED, 2])
        outlines = rough_outlines(sample.radius_px, rms_px=simulate.edge_roughness_px, rng=rng)
    ones = np.ones(sample.radius_px.size)
    plain = Spots(sample.x_px, sample.y_px, sample.radius_px, ones, outlines, simulate.edge_softness_px)
    spots: Spots | FilmSpots = plain
    if "film" in settings.effects:
        spots = surround_with_film(
            plain,
            sphere_radius=sample.sphere_radius,
            pixel_size=sample.pixel_size,
            excess=excess_table(lamp(simulate)),
        )
    psf, halo = point_spread(settings)
    return spots_image(spots, shape=sample.shape, psf=psf, halo=halo)


def expose_sample(
    sample: SampleImage, light: Values, settings: RenderSettings, realisation: int
) -> tuple[NDArray, NDArray]:
    """Frame and reference as the sensor records them, with one realisation of the noise.

    Shot noise is normally distributed here (a good approximation above about ten electrons), so that the
    pattern of the noise does not depend on the light.
    """
    simulate = settings.simulate
    levels = np.full(sample.shape, simulate.background_levels)
    if "vignetting" in settings.effects:
        levels *= (1 - simulate.vignetting * sample.off_axis)[sample.nearest]
    if simulate.texture:
        blur_px = simulate.blur_px if "blur" in settings.effects else 0.0
        levels *= 1 + surface_texture(
            sample.shape, rms=simulate.texture, blur_px=blur_px, shift_px=(0.0, 0.0), seed=SEED
        )
    drift = 1 + simulate.light_drift if "light_drift" in settings.effects else 1.0
    frame = drift * levels * (1 + simulate.contrast_levels / simulate.background_levels * light)
    shots = sample.normal_numbers[realisation]
    return _record(frame, settings, shots[:2]), _record(levels, settings, shots[2:])


def _record(levels: Values, settings: RenderSettings, normal_numbers: Values) -> NDArray:
    """Add the noise and convert to grey levels."""
    simulate = settings.simulate
    levels = np.maximum(levels, 0.0)
    noisy = levels
    if "shot_noise" in settings.effects:
        noisy = noisy + np.sqrt(levels / simulate.electrons_per_level) * normal_numbers[0]
    if "read_noise" in settings.effects:
        noisy = noisy + simulate.read_noise_electrons / simulate.electrons_per_level * normal_numbers[1]
    return digitise(
        noisy,
        bit_depth=simulate.bit_depth,
        saturate="saturation" in settings.effects,
        quantise="quantisation" in settings.effects,
        name="sample",
    ).image
