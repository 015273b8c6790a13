"""The effects of a synthetic series: one choice for all its frames, every switch explicit."""

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from contactimg.effects.plan import Plan, make_plan
from contactimg.optics.recipe import read_recipe
from contactimg.scene import Scene


@dataclass(frozen=True)
class SimulationPlan:
    """What a series shows.

    Parameters
    ----------
    scene : Scene
        With every switch "on" or "off".
    plans : tuple of Plan
        Of its smallest and its largest load; empty for a smooth contact, which shows all that the scene
        states.
    """

    scene: Scene
    plans: tuple[Plan, ...]


def plan_simulation(scene: Scene, asperities: pd.DataFrame | None) -> SimulationPlan:
    """Decide which effects the frames of a series show.

    An effect is shown when the plan of the smallest or of the largest load calls for it: small contacts are
    lost in noise and blur, large ones reach full scale and each other.

    Parameters
    ----------
    scene : Scene
        Sections ``[indenter]``, ``[elastic]``, ``[camera]`` and ``[simulate]`` (with loads) are needed.
    asperities : DataFrame or None
        Asperity table; None for a smooth flat.

    Raises
    ------
    InputError
        If a section is missing or makes no sense.
    ModelRangeError
        If the indenter reaches the plane between the asperities.
    """
    simulate = scene.need("simulate", "simulating frames")
    scene.need("camera", "simulating frames")
    scene.check_effects()
    read_recipe(scene)
    if asperities is None or not simulate.loads:
        return SimulationPlan(explicit_switches(scene), ())
    pressed = [load for load in simulate.loads if load > 0] or simulate.loads
    plans = tuple(make_plan(scene, asperities, load=load) for load in sorted({min(pressed), max(pressed)}))
    return SimulationPlan(explicit_switches(_with_any(scene, plans)), plans)


def _with_any(scene: Scene, plans: Sequence[Plan]) -> Scene:
    """The scene with what any of the plans has on."""
    on = {decision.effect for plan in plans for decision in plan.decisions if decision.on}
    known = {decision.effect for plan in plans for decision in plan.decisions}
    switches = {name: "on" if name in on else "off" for name in known}
    return scene.model_copy(update={"effects": scene.effects.model_copy(update=switches)})


def explicit_switches(scene: Scene) -> Scene:
    """The scene with its "auto" switches as a single call of the solver and the renderer takes them.

    Coupling is on where there are asperities, what refines it off; an effect of optics or sensor is on when
    its parameter is not zero; the air film is off.

    Examples
    --------
    >>> from contactimg.scene import scene_from_dict
    >>> scene = explicit_switches(scene_from_dict({"simulate": {"vignetting": 0.2}, "asperities": {}}))
    >>> scene.effects.vignetting, scene.effects.dust, scene.effects.coupling, scene.effects.film
    ('on', 'off', 'on', 'off')
    """
    shown = read_recipe(scene).effects | ({"coupling"} if scene.asperities is not None else set())
    stated = scene.effects.model_dump()
    switches = {name: "on" if name in shown else "off" for name in stated if stated[name] == "auto"}
    return scene.model_copy(update={"effects": scene.effects.model_copy(update=switches)})
