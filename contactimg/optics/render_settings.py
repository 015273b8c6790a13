"""Which effects a synthetic frame is to show, what goes together, and the optics that follow."""

from dataclasses import dataclass

import numpy as np

from contactimg.errors import InputError
from contactimg.optics.film import Light
from contactimg.optics.psf import Halo, Psf, airy_psf, gaussian_psf, no_blur, sampling_for
from contactimg.scene import FilmLight, Scene, Simulate

PARAMETER = {
    "blur": "blur_px",
    "vignetting": "vignetting",
    "light_drift": "light_drift",
    "position_drift": "position_drift_px",
    "shot_noise": "electrons_per_level",
    "read_noise": "read_noise_electrons",
    "quantisation": "bit_depth",
    "saturation": "bit_depth",
    "dust": "dust_count",
    "edge_roughness": "edge_roughness_px",
    "supersampling": "supersampling",
}


@dataclass(frozen=True)
class RenderSettings:
    """How synthetic frames of a scene are made; see `read_render_settings`.

    Parameters
    ----------
    simulate : Simulate
        Optics and sensor.
    effects : frozenset of str
        Names of the optical and sensor effects that are rendered.
    """

    simulate: Simulate
    effects: frozenset[str]


def read_render_settings(scene: Scene) -> RenderSettings:
    """What a scene says about its synthetic frames, once it makes sense.

    Parameters
    ----------
    scene : Scene
        With a section ``[simulate]``.

    Returns
    -------
    RenderSettings
        Under "auto" an effect is rendered when its parameter is not zero, and the film is not.

    Raises
    ------
    InputError
        If the section is missing, if noise is asked for without a number of electrons a level, a halo is not
        wider than the blur, a contact is darker than black, or a soft edge is asked for with the film on.

    Examples
    --------
    >>> from contactimg import scene_from_dict
    >>> scene = scene_from_dict({"simulate": {"vignetting": 0.2}, "effects": {"blur": "off"}})
    >>> sorted(read_render_settings(scene).effects)
    ['quantisation', 'saturation', 'supersampling', 'vignetting']
    """
    simulate: Simulate = scene.need("simulate", "rendering frames")
    switches = {effect: getattr(scene.effects, effect) for effect in PARAMETER}
    asked = {
        effect
        for effect, parameter in PARAMETER.items()
        if switches[effect] == "on" or (switches[effect] == "auto" and getattr(simulate, parameter) != 0)
    }
    if scene.effects.film == "on":
        asked.add("film")
    settings = RenderSettings(simulate, frozenset(asked))
    _check_noise(settings)
    _check_light(settings)
    return settings


def lamp(keys: FilmLight | Simulate) -> Light:
    """The light of a scene and the media that it crosses, from ``[light]`` or from its aliases."""
    return Light(
        index_indenter=keys.film_index_indenter,
        index_elastic=keys.film_index_elastic,
        wavelength=keys.film_wavelength_nm * 1e-9,
        bandwidth=keys.film_bandwidth_nm * 1e-9,
        band=(keys.film_range_nm[0] * 1e-9, keys.film_range_nm[1] * 1e-9),
    )


def point_spread(settings: RenderSettings) -> tuple[Psf, Halo | None]:
    """The point spread function of a settings, sampled as it needs, and its wide part if it has one.

    Raises
    ------
    InputError
        If the blur is finer than the finest grid.
    """
    simulate = settings.simulate
    depth = simulate.supersampling if "supersampling" in settings.effects else 1
    if not ("blur" in settings.effects and simulate.blur_px):
        return no_blur(sampling=depth), None
    sigma = simulate.blur_px
    sampling = sampling_for(sigma, at_least=depth)
    if simulate.psf == "airy":
        return airy_psf(sigma, sampling=sampling), None
    core = gaussian_psf(sigma, sampling=sampling)
    if simulate.psf == "gaussian":
        return core, None
    return core, Halo(simulate.halo_fraction, float(np.sqrt(simulate.halo_sigma_px**2 - sigma**2)))


def _check_noise(settings: RenderSettings) -> None:
    """Noise is counted in electrons, so a grey level must be worth some."""
    for effect in ("shot_noise", "read_noise"):
        if effect in settings.effects and settings.simulate.electrons_per_level == 0:
            raise InputError(
                f"[simulate] {effect} needs electrons_per_level above 0, got 0; give it or set "
                f'[effects] {effect} = "off"'
            )


def _check_light(settings: RenderSettings) -> None:
    """Combinations of optical parameters that have no meaning."""
    simulate = settings.simulate
    if "blur" in settings.effects and simulate.psf == "halo" and simulate.halo_sigma_px <= simulate.blur_px:
        raise InputError(
            f"[simulate] halo_sigma_px must exceed blur_px ({simulate.blur_px:g}), "
            f"got {simulate.halo_sigma_px:g}"
        )
    if simulate.background_levels + simulate.contrast_levels < 0:
        raise InputError(
            f"[simulate] contrast_levels ({simulate.contrast_levels:g}) must not exceed the background "
            f"({simulate.background_levels:g}) downwards: a contact cannot be darker than black"
        )
    if "film" in settings.effects and simulate.edge_softness_px > 0:
        raise InputError(
            "[simulate] edge_softness_px must be 0 with the film on, which has an edge of its own; "
            f"got {simulate.edge_softness_px:g}"
        )
