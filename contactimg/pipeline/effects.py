"""Which effects a scene calls for, and what they cost in time."""

from time import thread_time

from contactimg.effects.mechanics import MECHANICAL_EFFECTS
from contactimg.effects.plan import Plan, make_plan
from contactimg.errors import ContactimgError, finite_number
from contactimg.pipeline.inputs import largest_load, need_asperities, refuse_profile
from contactimg.prediction import make_mechanical_plan, predict_contacts
from contactimg.scene import Scene
from contactimg.tradeoff.measure import time_text

MAX_REPEATED_S = 10.0
"""Time of a plan of the mechanics up to which it is made again, without compilation. Chosen by hand."""


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
    plan = make_mechanical_plan(scene, asperities, load=chosen)
    if scene.simulate is None and thread_time() - began > MAX_REPEATED_S:
        return plan
    return make_plan(scene, asperities, load=chosen)  # whose times are those of compiled code


def computing_times(scene: Scene, plan: Plan) -> str:
    """A sentence: times of the plan and of solutions as planned and with every effect of the mechanics."""
    asperities = need_asperities(scene, "planning the effects")
    elastic = scene.need("elastic", "planning the effects")
    able = {"adhesion": elastic.work_of_adhesion > 0, "layer": elastic.thickness is not None}
    switches = {name: "on" if able.get(name, True) else "off" for name in MECHANICAL_EFFECTS}
    everything = scene.with_effects(switches)
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
