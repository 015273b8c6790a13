"""What each effect of optics and sensor does to the output that is measured on a scene's synthetic frames."""

from collections.abc import Callable
from functools import partial

import pandas as pd

from contactimg.effects.change import POWER
from contactimg.effects.estimate import Estimate
from contactimg.effects.optics.cost import render_cost
from contactimg.effects.optics.edge import (
    blur_change,
    film_change,
    film_makes_the_contrast,
    roughness_change,
    supersampling_change,
)
from contactimg.effects.optics.light import (
    dust_change,
    light_drift_change,
    position_drift_change,
    vignetting_change,
)
from contactimg.effects.optics.reading import Reader
from contactimg.effects.optics.sensor import noise_change, quantisation_change, saturation_change
from contactimg.effects.optics.strip import arrange_strip
from contactimg.effects.optics.trial import Trial
from contactimg.optics.recipe import PARAMETER, read_recipe
from contactimg.scene import Scene

Change = Callable[[Trial], tuple[float, str]]

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
"""The effects, each with its estimate."""

NEEDS_ELECTRONS = ("shot_noise", "read_noise")


def estimate_optics(scene: Scene, contacts: pd.DataFrame) -> tuple[Estimate, ...]:
    """Estimate what leaving out each effect of optics and sensor would change.

    The output is the one that ``[tolerance]`` names, as ``[measure]`` reads it off the frame: the sum of the
    areas, of the forces (a^3/R), or each radius in the mean square. A systematic effect counts by its
    expectation; noise by its root mean square over realisations, contacts lost in it included.

    Parameters
    ----------
    scene : Scene
    contacts : DataFrame, contacts schema
        Of one load, in m: ``x_m, y_m, radius_m``, and ``force_N`` for the radii of curvature.

    Returns
    -------
    tuple of Estimate
        One an effect of `OPTICS`; none without the sections ``[simulate]`` and ``[camera]``: what a measured
        frame shows, it shows.

    Raises
    ------
    InputError
        If the section ``[simulate]`` makes no sense.

    Notes
    -----
    Most numbers are read off a test strip (`contactimg.effects.optics.strip`): some dozens of the contacts,
    drawn and measured as those of the frame, with and without the effect.
    """
    if scene.simulate is None or scene.camera is None:
        return ()
    trial = _trial(scene, contacts)
    return tuple(_estimate(effect, scene, trial) for effect in OPTICS)


def _trial(scene: Scene, contacts: pd.DataFrame) -> Trial | None:
    """The scene with its strip; None if no contact stands in the frame."""
    strip = arrange_strip(scene, contacts, power=POWER[scene.tolerance.output])
    if strip is None:
        return None
    base = read_recipe(scene).effects
    trial = Trial(scene, contacts, Reader(scene, strip), base)
    halo = scene.effects.film == "auto" and film_makes_the_contrast(trial.simulate)
    return trial.with_effect("film") if halo and film_change(trial)[0] > 0 else trial


def _estimate(effect: str, scene: Scene, trial: Trial | None) -> Estimate:
    """One effect's estimate."""
    change, reason = _change(effect, scene, trial)
    return Estimate(effect, change, reason, cost=render_cost(effect, scene, trial))


def _change(effect: str, scene: Scene, trial: Trial | None) -> tuple[float, str]:
    """Change and reason of one effect; 0 where the scene gives it nothing to act with."""
    simulate = scene.need("simulate", "the effects of optics and sensor")
    parameter = PARAMETER.get(effect)
    if effect in NEEDS_ELECTRONS and simulate.electrons_per_level == 0:
        return 0.0, "electrons_per_level is 0: the light is not counted"
    if parameter is not None and getattr(simulate, parameter) == 0:
        return 0.0, f"{parameter} is 0"
    if trial is None:
        return 0.0, "no contact stands in the frame"
    return OPTICS[effect](trial)
