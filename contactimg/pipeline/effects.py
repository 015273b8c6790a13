"""Effects of a scene: which ones it calls for, and which ones its frames are measured with."""

from time import thread_time

import numpy as np
import pandas as pd

from contactimg.effects.mechanics import MECHANICAL_EFFECTS
from contactimg.effects.plan import Plan, make_plan
from contactimg.errors import ContactimgError, InputError, finite_number
from contactimg.forces import common_radius
from contactimg.imaging.profile.film_rim import FilmRim, FilmSetting
from contactimg.optics.render_settings import lamp
from contactimg.pipeline.inputs import largest_load, need_asperities, refuse_profile
from contactimg.prediction import predict_contacts
from contactimg.scene import Scene
from contactimg.tradeoff.measure import time_text

MAX_REPEATED_S = 10.0
"""Time of a plan up to which it is made again, without compilation. Chosen by hand."""

SHARP_BLUR_PX = 1e-3
"""Blur of a frame that is known to have none: small against the width of the pixel. Chosen: any value well
below 0.3 px, the standard deviation of a pixel, gives the same edge."""


def plan_effects(scene: Scene, *, load: float | None = None) -> Plan:
    """Decide which effects a scene calls for, each with the number that decides.

    Parameters
    ----------
    scene : Scene
        With asperities and sections ``[indenter]`` and ``[elastic]``; ``[tolerance]`` states which output
        must be accurate and how accurate, ``[effects]`` may switch effects on or off.
    load : float, optional, N
        By default the largest of the scene: of ``[simulate] loads_N``, else of its table of loads.

    Returns
    -------
    Plan

    Raises
    ------
    InputError
        If the scene lacks what the estimates need, or a load.
    ModelRangeError
        If the indenter reaches the plane between the asperities.

    Examples
    --------
    >>> from contactimg.scene import scene_from_dict
    >>> scene = scene_from_dict(
    ...     {
    ...         "indenter": {"radius_m": 0.1288, "apex_m": [0.002, 0.002]},
    ...         "elastic": {"young_modulus_Pa": 3e6},
    ...         "asperities": {"generate": "SA", "side_m": 0.004},
    ...         "tolerance": {"output": "force"},
    ...     }
    ... )
    >>> plan = plan_effects(scene, load=0.05)
    >>> plan.coupling, plan.is_on("layer")
    ('asymptotic', False)
    """
    refuse_profile(scene, "`effects`")
    asperities = need_asperities(scene, "planning the effects")
    chosen = largest_load(scene) if load is None else finite_number(load, "load", "N")
    began = thread_time()
    plan = make_plan(scene, asperities, load=chosen)
    if thread_time() - began < MAX_REPEATED_S:  # its times are those of compiled code
        plan = make_plan(scene, asperities, load=chosen)
    return plan


def computing_times(scene: Scene, plan: Plan) -> str:
    """A sentence: times of the plan and of solutions as planned and with every effect of the mechanics."""
    asperities = need_asperities(scene, "planning the effects")
    elastic = scene.need("elastic", "planning the effects")
    able = {"adhesion": elastic.work_of_adhesion > 0, "layer": elastic.thickness is not None}
    switches = {name: "on" if able.get(name, True) else "off" for name in MECHANICAL_EFFECTS}
    everything = scene.model_copy(update={"effects": scene.effects.model_copy(update=switches)})
    seconds = [plan.seconds]
    for solved in (plan.apply(scene), everything):
        began = thread_time()
        try:
            predict_contacts(solved, asperities, load=plan.load)
        except ContactimgError:
            return f"time of the plan: {time_text(plan.seconds)}"
        seconds.append(thread_time() - began)
    planned, solved_so, complete = map(time_text, seconds)
    return (
        f"times: plan {planned}, prediction as planned {solved_so}, with everything on {complete}; "
        '"time" is that with the effect over that without it'
    )


def resolve_measurement(scene: Scene) -> Scene:
    """The scene with the switches and the blur that its frames are measured with.

    Under "auto" a correction is on: shift, noise, dust and blur are measured on the frame itself. An effect
    that is "off" is not corrected: shift, dust, saturated pixels, blur (the fit assumes a sharp edge). Under
    "auto" the film is on if ``[simulate]`` states a contrast within a factor of two of that of an air film
    and the radius of the asperities is known. Vignetting, light drift, noise, quantisation and rough edges
    are always measured or divided out.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    Scene

    Examples
    --------
    >>> from contactimg.scene import scene_from_dict
    >>> resolve_measurement(scene_from_dict({"effects": {"blur": "off"}})).measure.blur_px
    0.001
    """
    measure = scene.measure
    if scene.effects.blur == "off" and measure.blur_px is None:
        measure = measure.model_copy(update={"blur_px": SHARP_BLUR_PX})
    return scene.model_copy(update={"measure": measure})


def film_setting(scene: Scene, sites: pd.DataFrame | None) -> FilmSetting | None:
    """The rim that the air film may draw around contacts, and whether it is drawn.

    Under "auto" the pixels decide where pixel size and radius of the asperities are known; else there is no
    film.

    Parameters
    ----------
    scene : Scene
        The light is that of ``[light]`` (by default a white LED, glass and PDMS).
    sites : DataFrame or None
        Composite summits of the asperities: the film of the mean radius is drawn.

    Raises
    ------
    InputError
        If the film is switched on, and the pixel size or the asperities' radius is not known.
    """
    asked = scene.effects.film
    if scene.measure.method != "disk":
        return None
    if scene.asperities is not None and scene.asperities.profiled:
        if asked == "on":
            raise InputError(
                '[effects] film = "on" is defined for caps, not for a stated profile; switch it off'
            )
        return None
    radius = common_radius(scene, None)
    if not np.isfinite(radius) and sites is not None and len(sites):
        radius = float(sites["radius_m"].mean())
    if asked != "on" and (scene.camera is None or not np.isfinite(radius)):
        return None
    camera = scene.need("camera", 'measuring with [effects] film = "on"')
    if not np.isfinite(radius):
        raise InputError(
            '[effects] film = "on" needs the radius of the asperities; give [asperities] radius_m, or a file '
            'with it, or set film = "off"'
        )
    rim = FilmRim(lamp(scene.light), radius, camera.pixel_size)
    return FilmSetting(rim, asked, scene.measure.film_doubt)
