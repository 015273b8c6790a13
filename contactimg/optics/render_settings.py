"""The settings for rendering a scene: which effects a synthetic frame shows, and the optics."""

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
"""Effect -> key of the section [simulate] that sets its strength; 0 switches it off."""


def rendered_effects(scene: Scene) -> frozenset[str]:
    """Names of the effects of optics and sensor that the synthetic frames of a scene show, after a check.

    Parameters
    ----------
    scene : Scene
        With a section ``[simulate]``.

    Returns
    -------
    frozenset of str
        An effect that is "auto" is rendered if its parameter is not zero; the film is not.

    Raises
    ------
    InputError
        If the section is missing, noise is switched on without a number of electrons per level, a halo is not
        wider than the blur, a contact is darker than black, or the film and a soft edge are both switched on.

    Examples
    --------
    >>> from contactimg import scene_from_dict
    >>> scene = scene_from_dict({"simulate": {"vignetting": 0.2}, "effects": {"blur": "off"}})
    >>> sorted(rendered_effects(scene))
    ['quantisation', 'saturation', 'supersampling', 'vignetting']
    """
    simulate: Simulate = scene.need("simulate", "rendering frames")
    switches = {effect: getattr(scene.effects, effect) for effect in PARAMETER}
    effects = {
        effect
        for effect, parameter in PARAMETER.items()
        if switches[effect] == "on" or (switches[effect] == "auto" and getattr(simulate, parameter) != 0)
    }
    if scene.effects.film == "on":
        effects.add("film")
    _refuse_contradictions(simulate, effects)
    return frozenset(effects)


def lamp(keys: FilmLight | Simulate) -> Light:
    """The light of a scene and the media that it crosses, from ``[light]`` or from its aliases."""
    return Light(
        index_indenter=keys.film_index_indenter,
        index_elastic=keys.film_index_elastic,
        wavelength=keys.film_wavelength_nm * 1e-9,
        bandwidth=keys.film_bandwidth_nm * 1e-9,
        band=(keys.film_range_nm[0] * 1e-9, keys.film_range_nm[1] * 1e-9),
    )


def point_spread(simulate: Simulate, effects: frozenset[str]) -> tuple[Psf, Halo | None]:
    """The point spread function, sampled finely enough, and its halo if it has one.

    Raises
    ------
    InputError
        If the blur is finer than the finest grid.
    """
    depth = simulate.supersampling if "supersampling" in effects else 1
    sigma = simulate.blur_px if "blur" in effects else 0.0
    sampling = sampling_for(sigma, at_least=depth)
    if sigma == 0:
        return no_blur(sampling=sampling), None
    psf, halo = airy_psf if simulate.psf == "airy" else gaussian_psf, None
    if simulate.psf == "halo":
        halo = Halo(simulate.halo_fraction, float(np.sqrt(simulate.halo_sigma_px**2 - sigma**2)))
    return psf(sigma, sampling=sampling), halo


def _refuse_contradictions(simulate: Simulate, effects: set[str]) -> None:
    """Raise for noise without a number of electrons, and optical parameters that have no meaning together."""
    for effect in ("shot_noise", "read_noise"):
        if effect in effects and simulate.electrons_per_level == 0:
            raise InputError(
                f"[simulate] {effect} needs electrons_per_level above 0, got 0; give it or set "
                f'[effects] {effect} = "off"'
            )
    if "blur" in effects and simulate.psf == "halo" and simulate.halo_sigma_px <= simulate.blur_px:
        raise InputError(
            f"[simulate] halo_sigma_px must exceed blur_px ({simulate.blur_px:g}), "
            f"got {simulate.halo_sigma_px:g}"
        )
    if simulate.background_levels + simulate.contrast_levels < 0:
        raise InputError(
            f"[simulate] contrast_levels ({simulate.contrast_levels:g}) must not exceed the background "
            f"({simulate.background_levels:g}) downwards: a contact cannot be darker than black"
        )
    if "film" in effects and simulate.edge_softness_px > 0:
        raise InputError(
            "[simulate] edge_softness_px must be 0 with the film on, which has an edge of its own; "
            f"got {simulate.edge_softness_px:g}"
        )
