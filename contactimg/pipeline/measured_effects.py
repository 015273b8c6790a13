"""Which effects the measurement of frames takes into account: what the scene says that the frames show."""

import pandas as pd

from contactimg.effects.optics.edge import film_makes_the_contrast
from contactimg.scene import Scene

SHARP_PX = 1e-3
"""Blur of a frame that is known to have none, next to which the pixel is wide."""


def resolve_measurement(scene: Scene, sites: pd.DataFrame | None) -> Scene:
    """The scene as its frames are measured.

    A correction under "auto" stays on: the frame itself shows how far it drifted, how noisy, dusty and
    blurred it is. What is "off" is not looked for: drift of position, dust, saturated pixels, blur (the fit
    takes a sharp edge). The film under "auto" is on where ``[simulate]`` states a contrast within a factor of
    two of what its light gives an air film, and the radius of the asperities is known. Uneven light, drift of
    light, noise, steps of the converter and rough edges are measured or divided out in any case.

    Parameters
    ----------
    scene : Scene
    sites : DataFrame or None
        Its asperities, if they are known.

    Returns
    -------
    Scene

    Examples
    --------
    >>> from contactimg.scene import scene_from_dict
    >>> resolve_measurement(scene_from_dict({"effects": {"blur": "off"}}), None).measure.blur_px
    0.001
    >>> resolve_measurement(scene_from_dict({}), None).effects.film
    'off'
    """
    film, measure = scene.effects.film, scene.measure
    if film == "auto":
        film = "on" if _states_a_film(scene, sites) else "off"
    if scene.effects.blur == "off" and measure.blur_px is None:
        measure = measure.model_copy(update={"blur_px": SHARP_PX})
    effects = scene.effects.model_copy(update={"film": film})
    return scene.model_copy(update={"effects": effects, "measure": measure})


def _states_a_film(scene: Scene, sites: pd.DataFrame | None) -> bool:
    """Whether the scene states a contrast that is the film's, and what its rim needs."""
    if scene.camera is None or scene.simulate is None or not film_makes_the_contrast(scene.simulate):
        return False
    stated = scene.asperities is not None and scene.asperities.radius is not None
    return stated or (sites is not None and len(sites) > 0)
