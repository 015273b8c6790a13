"""Render synthetic frames of contacts.

    levels = background V (1 + T) (1 - D) (1 + drift) (1 + (contrast/background) C)

with the vignetting V, the surface texture T, the dust D, and the light C of the contacts.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from contactimg.frame import Frame
from contactimg.optics.psf import Psf
from contactimg.optics.render_settings import point_spread, rendered_effects
from contactimg.optics.sensor import add_read_noise, add_shot_noise, digitise
from contactimg.optics.spots import Spots, spots_image
from contactimg.optics.synthetic_background import dust_shadow, light_falloff, surface_texture
from contactimg.render.contacts import contact_spots, place_contacts, smooth_contact, smooth_contact_spot
from contactimg.scene import Scene, Simulate

Values = NDArray[np.float64]
Shift = tuple[float, float]
Shown = frozenset[str]
"""Names of effects."""


@dataclass(frozen=True, eq=False)
class Rendered:
    """A synthetic frame and its true contacts.

    Parameters
    ----------
    frame : Frame
    contacts : DataFrame, contacts schema
        The rendered contacts, with their positions in this frame in the columns in pixels.
    shift_x_px, shift_y_px : float
        Position in the frame minus position in the reference.
    """

    frame: Frame
    contacts: pd.DataFrame
    shift_x_px: float
    shift_y_px: float


def render_contacts(
    contacts: pd.DataFrame,
    scene: Scene,
    *,
    rng: np.random.Generator,
    sphere_radius: ArrayLike | None = None,
    name: str = "frame",
) -> Rendered:
    """Render contacts as the camera of the scene records them, with the truth.

    Parameters
    ----------
    contacts : DataFrame, contacts schema
        Rows with finite ``x_px, y_px, radius_px`` lie there in the pixels of the reference; the others at
        ``x_m, y_m, radius_m``, converted by the camera of the scene. A radius of 0 is dark.
    scene : Scene
        With a section ``[simulate]``, and ``[camera]`` for contacts in metres and for the film.
    rng : numpy.random.Generator
        For noise, position drift, brightness and roughness of the contacts, each with its own stream: without
        noise or drift the rest stays the same. Texture and dust are drawn from the seed of the scene.
    sphere_radius : array_like, m, optional
        Composite radius of curvature of each contact, or one for all, for the film; by default that of the
        asperities and the indenter of the scene, ``R Rl/(R + Rl)``.
    name : str
        Name of the frame.

    Returns
    -------
    Rendered

    Raises
    ------
    InputError
        If a row has no position or a negative radius, or the settings of the scene contradict each other.

    Notes
    -----
    ``light_drift`` is the relative change of the light from the reference to a frame, ``position_drift_px``
    the standard deviation of each component of the shift. The film is rendered around contacts only; a cap
    that comes close without touching is not.

    Examples
    --------
    >>> from contactimg import scene_from_dict
    >>> scene = scene_from_dict({"simulate": {"shape": [60, 80], "position_drift_px": 0.3}})
    >>> contacts = pd.DataFrame({"x_px": [30.0], "y_px": [20.0], "radius_px": [5.0]})
    >>> shot = render_contacts(contacts, scene, rng=np.random.default_rng(1))
    >>> shot.frame.image.dtype, shot.frame.shape, float(shot.contacts["x_px"][0] - shot.shift_x_px)
    (dtype('uint8'), (60, 80), 30.0)
    """
    return _render(contacts, scene, rng, name, partial(contact_spots, sphere_radius=sphere_radius))


def render_frame(
    contacts: pd.DataFrame,
    scene: Scene,
    *,
    rng: np.random.Generator,
    sphere_radius: ArrayLike | None = None,
    name: str = "frame",
) -> Frame:
    """Render contacts like `render_contacts`, and return only the frame.

    Examples
    --------
    >>> from contactimg import scene_from_dict
    >>> scene = scene_from_dict({"simulate": {"shape": [60, 80], "blur_px": 0.0}})
    >>> contacts = pd.DataFrame({"x_px": [30.0], "y_px": [20.0], "radius_px": [5.0]})
    >>> render_frame(contacts, scene, rng=np.random.default_rng(1)).image[20, [24, 25, 30]]
    array([ 80, 129, 180], dtype=uint8)
    """
    return render_contacts(contacts, scene, rng=rng, sphere_radius=sphere_radius, name=name).frame


def render_reference(scene: Scene, *, rng: np.random.Generator, name: str = "reference") -> Frame:
    """Render the frame without contact: light, texture and dust of the scene, with new noise.

    Parameters
    ----------
    scene : Scene
        With a section ``[simulate]``.
    rng : numpy.random.Generator
    name : str

    Returns
    -------
    Frame

    Examples
    --------
    >>> from contactimg import scene_from_dict
    >>> scene = scene_from_dict({"simulate": {"shape": [4, 6], "background_levels": 80}})
    >>> int(render_reference(scene, rng=np.random.default_rng(1)).image.max())
    80
    """
    effects, simulate = rendered_effects(scene), scene.need("simulate", "rendering frames")
    rngs = [np.random.default_rng(seed) for seed in rng.integers(2**63, size=2)]
    levels = _background_levels(simulate, effects, point_spread(simulate, effects)[0], (0.0, 0.0))
    return _record(levels, simulate, effects, rngs, name)


def render_smooth_contact(
    load: float, scene: Scene, *, rng: np.random.Generator, name: str = "frame"
) -> Rendered:
    """Render the contact of a smooth sphere on a smooth flat, with adhesion (JKR).

    Parameters
    ----------
    load : float, N
        Not below the (negative) pull-off load.
    scene : Scene
        With the sections ``[indenter]``, ``[elastic]``, ``[camera]`` and ``[simulate]``; if the film is on,
        its gap is that of the JKR contact.
    rng : numpy.random.Generator
        As for `render_contacts`.
    name : str
        Name of the frame.

    Returns
    -------
    Rendered
        With one contact, at the apex of the indenter.

    Raises
    ------
    InputError
        If a section is missing, or the load lies below pull-off.

    Examples
    --------
    >>> from contactimg import scene_from_dict
    >>> scene = scene_from_dict({
    ...     "indenter": {"radius_m": 0.1288}, "camera": {"pixel_size_m": 24e-6},
    ...     "elastic": {"young_modulus_Pa": 3e6, "work_of_adhesion_J_m2": 0.05},
    ...     "simulate": {"shape": [180, 200]}, "effects": {"film": "on"},
    ... })
    >>> shot = render_smooth_contact(0.0, scene, rng=np.random.default_rng(1))
    >>> int(shot.frame.image[90, 100]), float(shot.contacts["radius_m"][0]) * 1e3
    (180, 1.4312)
    """
    return _render(smooth_contact(load, scene, name=name), scene, rng, name, smooth_contact_spot)


def _render(
    contacts: pd.DataFrame, scene: Scene, rng: np.random.Generator, name: str, spots_of: Callable[..., Spots]
) -> Rendered:
    """The frame of contacts, which ``spots_of`` turns into spots of light, with the truth."""
    effects, simulate = rendered_effects(scene), scene.need("simulate", "rendering frames")
    streams = [np.random.default_rng(k) for k in rng.integers(2**63, size=4)]
    shift = 0.0, 0.0
    if "position_drift" in effects:
        shift = tuple(streams[0].normal(0.0, simulate.position_drift_px, 2).tolist())
    truth = place_contacts(contacts, scene, shape=simulate.shape, shift_px=shift)
    spots = spots_of(truth, scene, effects, rng=streams[1])
    psf, halo = point_spread(simulate, effects)
    light = spots_image(spots, shape=simulate.shape, psf=psf, halo=halo)
    drift = 1 + simulate.light_drift if "light_drift" in effects else 1.0
    levels = drift * _background_levels(simulate, effects, psf, shift)
    levels *= 1 + simulate.contrast_levels / simulate.background_levels * light
    return Rendered(_record(levels, simulate, effects, streams[2:], name), truth, *shift)


def _background_levels(simulate: Simulate, effects: Shown, psf: Psf, shift: Shift) -> Values:
    """Grey levels of the background without contacts and noise."""
    levels = np.full(simulate.shape, simulate.background_levels)
    if "vignetting" in effects:
        levels *= light_falloff(simulate.shape, fraction=simulate.vignetting)
    if simulate.texture:
        blur_px = simulate.blur_px if "blur" in effects else 0.0
        levels *= 1 + surface_texture(
            simulate.shape, rms=simulate.texture, blur_px=blur_px, shift_px=shift, seed=simulate.seed
        )
    if "dust" in effects:
        levels *= 1 - dust_shadow(
            simulate.shape, count=simulate.dust_count, psf=psf, shift_px=shift, seed=simulate.seed
        )
    return levels


def _record(
    levels: Values, simulate: Simulate, effects: Shown, rngs: Sequence[np.random.Generator], name: str
) -> Frame:
    """Add shot and read noise, each with its own generator, and convert to a frame."""
    shot, read = rngs
    levels = np.maximum(levels, 0.0)
    if "shot_noise" in effects:
        levels = add_shot_noise(levels, electrons_per_level=simulate.electrons_per_level, rng=shot)
    if "read_noise" in effects:
        std = simulate.read_noise_electrons / simulate.electrons_per_level
        levels = add_read_noise(levels, std=std, rng=read)
    saturate, quantise = (effect in effects for effect in ("saturation", "quantisation"))
    return digitise(levels, bit_depth=simulate.bit_depth, saturate=saturate, quantise=quantise, name=name)
