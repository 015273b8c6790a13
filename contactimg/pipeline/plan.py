"""The plan of a scene: its asperities and loads read, its effects weighed."""

from contactimg.effects.plan import Plan, make_plan
from contactimg.errors import InputError, finite_number
from contactimg.files import read_scene_loads
from contactimg.pipeline.inputs import need_asperities
from contactimg.scene import Scene


def plan_effects(scene: Scene, *, load: float | None = None) -> Plan:
    """Decide which effects a scene calls for, each with the number that decides.

    Parameters
    ----------
    scene : Scene
        With asperities, sections ``[indenter]`` and ``[elastic]``; ``[tolerance]`` says what must be accurate
        and how accurate, ``[effects]`` what is ordered.
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
    asperities = need_asperities(scene, "planning the effects")
    chosen = largest_load(scene) if load is None else finite_number(load, "load", "N")
    return make_plan(scene, asperities, load=chosen)


def largest_load(scene: Scene) -> float:
    """The largest load that the scene states (N).

    Raises
    ------
    InputError
        If it states none.
    """
    stated = scene.simulate.loads if scene.simulate is not None else []
    loads = stated or read_scene_loads(scene)
    if not loads:
        raise InputError(
            "the scene states no load; give one, [simulate] loads_N or [images] loads, or --load-N"
        )
    return max(loads)
