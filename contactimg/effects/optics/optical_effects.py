"""Estimates of the effects of optics and sensor on the output measured on synthetic frames."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import pandas as pd

from contactimg.effects.optics.edge_effects import (
    blur_change,
    film_change,
    film_makes_the_contrast,
    roughness_change,
    supersampling_change,
)
from contactimg.effects.optics.illumination_effects import (
    dust_change,
    light_drift_change,
    position_drift_change,
    vignetting_change,
)
from contactimg.effects.optics.render_cost import render_cost
from contactimg.effects.optics.sample_comparison import SampleComparison
from contactimg.effects.optics.sample_image import arrange_sample
from contactimg.effects.optics.sample_measurement import SampleMeasurer
from contactimg.effects.optics.sensor_effects import noise_change, quantisation_change, saturation_change
from contactimg.effects.output_change import OUTPUTS, POWER, EffectEstimate
from contactimg.optics.render_settings import PARAMETER, read_render_settings
from contactimg.scene import Scene

Change = Callable[[SampleComparison], tuple[float, str]]

OPTICS: dict[str, Change] = {
    "blur": blur_change,
    "film": film_change,
    "vignetting": vignetting_change,
    "light_drift": light_drift_change,
    "position_drift": position_drift_change,
    "shot_noise": partial(noise_change, effect="shot_noise"),
    "read_noise": partial(noise_change, effect="read_noise"),
    "quantisation": quantisation_change,
    "saturation": saturation_change,
    "dust": dust_change,
    "edge_roughness": roughness_change,
    "supersampling": supersampling_change,
}
"""Effect -> function that estimates it."""

NEEDS_ELECTRONS = ("shot_noise", "read_noise")


def estimate_optics(scene: Scene, contacts: pd.DataFrame) -> tuple[EffectEstimate, ...]:
    """Estimate what leaving out each effect of optics and sensor would change.

    The outputs are those that ``[tolerance]`` names, measured as ``[measure]`` says: the sum of the areas,
    the sum of the forces (a^3/R; for the profile too), or the root mean square of the radii; with ``"all"``
    each of the three. For a systematic effect the change is
    its expectation, for noise the root mean square over realisations, including contacts that are lost.

    Parameters
    ----------
    scene : Scene
    contacts : DataFrame, contacts schema
        At one load: ``x_m, y_m, radius_m``, and ``force_N`` for the radii of curvature.

    Returns
    -------
    tuple of EffectEstimate
        One per effect of `OPTICS`; empty without the sections ``[simulate]`` and ``[camera]``.

    Raises
    ------
    InputError
        If the section ``[simulate]`` is not valid.

    Notes
    -----
    Most changes are measured on a small image of some dozens of the contacts, rendered with and without the
    effect (`contactimg.effects.optics.sample_image`).
    """
    if scene.simulate is None or scene.camera is None:
        return ()
    output = scene.tolerance.output
    outputs = OUTPUTS if output == "all" else ("force" if output == "profile" else output,)
    alone = [_estimates(_requesting(scene, output), contacts) for output in outputs]
    return tuple(_worst(dict(zip(outputs, estimates, strict=True))) for estimates in zip(*alone, strict=True))


def _requesting(scene: Scene, output: str) -> Scene:
    """The scene with one requested output."""
    return scene.model_copy(update={"tolerance": scene.tolerance.model_copy(update={"output": output})})


def _estimates(scene: Scene, contacts: pd.DataFrame) -> tuple[EffectEstimate, ...]:
    """The estimates of all effects for the one output that a scene requests."""
    comparison = _compare(scene, contacts)
    return tuple(_estimate(effect, scene, comparison) for effect in OPTICS)


def _worst(estimates: dict[str, EffectEstimate]) -> EffectEstimate:
    """The estimate of one effect, from those for each output: that of the largest change."""
    changes = {output: estimate.change for output, estimate in estimates.items()}
    return replace(max(estimates.values(), key=lambda e: e.change), changes=changes)


def _compare(scene: Scene, contacts: pd.DataFrame) -> SampleComparison | None:
    """The comparison for a scene; None if no contact lies in the frame."""
    sample = arrange_sample(scene, contacts, power=POWER[scene.tolerance.output])
    if sample is None:
        return None
    base = read_render_settings(scene).effects
    comparison = SampleComparison(scene, contacts, SampleMeasurer(scene, sample), base)
    halo = scene.effects.film == "auto" and film_makes_the_contrast(comparison.simulate)
    return comparison.with_effect("film") if halo and film_change(comparison)[0] > 0 else comparison


def _estimate(effect: str, scene: Scene, comparison: SampleComparison | None) -> EffectEstimate:
    """The estimate of one effect."""
    change, reason = _change(effect, scene, comparison)
    return EffectEstimate(effect, change, reason, cost=render_cost(effect, scene, comparison))


def _change(effect: str, scene: Scene, comparison: SampleComparison | None) -> tuple[float, str]:
    """Change and reason for one effect; 0 if its parameter in the scene is zero."""
    simulate = scene.need("simulate", "the effects of optics and sensor")
    parameter = PARAMETER.get(effect)
    if effect in NEEDS_ELECTRONS and simulate.electrons_per_level == 0:
        return 0.0, "electrons_per_level is 0, so there is no noise"
    if parameter is not None and getattr(simulate, parameter) == 0:
        return 0.0, f"{parameter} is 0"
    if comparison is None:
        return 0.0, "no contact lies in the frame"
    return OPTICS[effect](comparison)
