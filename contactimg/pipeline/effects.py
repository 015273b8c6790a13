"""Which effects a scene calls for."""

from contactimg.effects.plan import Plan, make_plan
from contactimg.errors import finite_number
from contactimg.pipeline.inputs import largest_load, need_asperities, refuse_profile
from contactimg.scene import Scene


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
    return make_plan(scene, asperities, load=chosen)
