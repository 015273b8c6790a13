"""The plan: which effects are computed for a scene, from their estimates and the scene's tolerance.

The effects that the plan leaves out change the requested output together by less than the tolerance. Effects
are dropped in order of their estimated change, the smallest first, as long as `SAFETY_FACTOR` times the sum
of the estimates stays below the tolerance.
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import pandas as pd

from contactimg.effects.effect_estimate import EffectEstimate
from contactimg.effects.mechanics.mechanical_effects import estimate_mechanics
from contactimg.effects.optics.optical_effects import estimate_optics
from contactimg.scene import Effects, Scene
from contactimg.tables import EFFECTS
from contactimg.timings import stage

Level = Literal["none", "asymptotic", "full"]

REQUIRES = {"full_coupling": "coupling", "layer": "coupling"}
"""Effects that act only through another one."""

INCLUDED = {"full_coupling": "coupling"}
"""Effects whose change is part of the change of another one: if both are left out, only the other one counts.

The layer is no such effect: coupling and layer partly cancel, so that leaving out both can change less than
leaving out one.
"""

SAFETY_FACTOR = 1.25
"""Factor on the sum of the dropped estimates. Chosen: estimates differ from solutions by up to a quarter."""


def coupling_level(*, coupling: bool, full_coupling: bool) -> Level:
    """Level of coupling of the interacting model that two switches amount to.

    Examples
    --------
    >>> coupling_level(coupling=True, full_coupling=False)
    'asymptotic'
    """
    if not coupling:
        return "none"
    return "full" if full_coupling else "asymptotic"


@dataclass(frozen=True)
class Decision:
    """The decision on one effect.

    Parameters
    ----------
    effect : str
    change : float
        Estimated relative change of the requested output if the effect is left out.
    tolerance : float
        Upper limit for the sum of the changes of all effects that are left out.
    on : bool
        Whether the effect is computed.
    switch : {"auto", "on", "off"}
        The switch in the scene; "auto" leaves the decision to the plan.
    reason : str
        The numbers that decide, in words.
    cost : float
        Time to solve, render or measure with the effect divided by the time without.
    """

    effect: str
    change: float
    tolerance: float
    on: bool
    switch: str
    reason: str
    cost: float


@dataclass(frozen=True)
class Plan:
    """The effects of a scene at one load.

    Parameters
    ----------
    decisions : tuple of Decision
    output : {"area", "force", "radius"}
        The result that must be accurate.
    relative : float
        Relative change that is allowed.
    load : float, N
    messages : tuple of str
        One sentence for each switch in the scene that contradicts the estimates.
    limits : tuple of str
        One sentence for each range of validity that some contacts exceed; they are computed nevertheless.
    """

    decisions: tuple[Decision, ...]
    output: str
    relative: float
    load: float
    messages: tuple[str, ...] = ()
    limits: tuple[str, ...] = ()

    def is_on(self, effect: str) -> bool:
        """Whether an effect is computed; False for an effect that is not in the plan."""
        return any(decision.on for decision in self.decisions if decision.effect == effect)

    @property
    def coupling(self) -> Level:
        """Level of coupling for the interacting model."""
        return coupling_level(coupling=self.is_on("coupling"), full_coupling=self.is_on("full_coupling"))

    def apply(self, scene: Scene) -> Scene:
        """The scene with the decisions of the plan as its switches, "on" or "off"."""
        names = Effects.model_fields
        switches = {d.effect: "on" if d.on else "off" for d in self.decisions if d.effect in names}
        return scene.model_copy(update={"effects": scene.effects.model_copy(update=switches)})

    @property
    def record(self) -> list[dict[str, Any]]:
        """The decisions for the provenance: effect, change, decision and reason."""
        rows = self.table()[["effect", "change", "decision", "reason"]].to_dict("records")
        return [{str(key): value for key, value in row.items()} for row in rows]

    def table(self) -> pd.DataFrame:
        """One row per effect: the schema `contactimg.tables.EFFECTS`."""
        rows = [
            asdict(d) | {"load_N": self.load, "decision": "on" if d.on else "off"} for d in self.decisions
        ]
        return EFFECTS.conform(pd.DataFrame(rows, columns=[*EFFECTS.columns, "on"]).drop(columns="on"))


def decide(
    estimates: Sequence[EffectEstimate], switches: Effects, *, tolerance: float
) -> tuple[tuple[Decision, ...], tuple[str, ...]]:
    """Drop the smallest effects, as long as their changes add up to less than the tolerance.

    Parameters
    ----------
    estimates : sequence of EffectEstimate
    switches : Effects
        Of the scene. Effects that it switches "on" or "off" stay so and do not count in the sum.
    tolerance : float
        Relative change that is allowed.

    Returns
    -------
    decisions : tuple of Decision
        In the order of the estimates.
    messages : tuple of str
        One sentence for each effect that is switched off although it changes the output by the tolerance or
        more, or switched on although it cannot act.

    Examples
    --------
    >>> estimates = [EffectEstimate("layer", 0.004, "thin"), EffectEstimate("coupling", 0.2, "close")]
    >>> [decision.on for decision in decide(estimates, Effects(), tolerance=0.01)[0]]
    [False, True]
    """
    switch = {e.effect: getattr(switches, e.effect, "auto") for e in estimates}
    required = {base for effect, base in REQUIRES.items() if switch.get(effect) == "on"}
    on = _kept_effects(estimates, switch, required, tolerance)
    also_required = {base for effect, base in REQUIRES.items() if effect in on - set(INCLUDED)}
    if not also_required <= on:
        on = _kept_effects(estimates, switch, required | also_required, tolerance)
    inactive = {effect: base for effect, base in REQUIRES.items() if base in switch and base not in on}
    on -= set(inactive)
    decisions = tuple(
        Decision(
            e.effect,
            0.0 if e.effect in inactive else e.change,
            tolerance,
            e.effect in on,
            switch[e.effect],
            f"acts through {inactive[e.effect]}, which is left out" if e.effect in inactive else e.reason,
            e.cost,
        )
        for e in estimates
    )
    return decisions, tuple(_warnings(decisions))


def _warnings(decisions: Sequence[Decision]) -> Iterable[str]:
    """Sentences on the switches that contradict the estimates."""
    for d in decisions:
        if d.switch == "on" and not d.on:
            yield f"{d.effect} is switched on but {d.reason}"
        elif d.switch == "off" and d.change >= d.tolerance:
            yield (
                f"{d.effect} is switched off although that changes the requested output by about "
                f"{d.change:.2g} (tolerance {d.tolerance:g}): {d.reason}"
            )


def _kept_effects(
    estimates: Sequence[EffectEstimate], switch: dict[str, str], required: set[str], tolerance: float
) -> set[str]:
    """Effects that are switched on, that others require, or that change the output too much to be dropped."""
    free = [e for e in estimates if switch[e.effect] == "auto" and e.effect not in required]
    dropped = _dropped_effects(free, tolerance)
    return {effect for effect in switch if switch[effect] != "off" and effect not in dropped}


def _dropped_effects(estimates: Iterable[EffectEstimate], tolerance: float) -> set[str]:
    """The smallest effects whose changes add up to less than the tolerance."""
    dropped: dict[str, float] = {}
    for estimate in sorted(estimates, key=lambda e: (e.change, -e.cost, e.effect)):
        included = {effect for effect, base in INCLUDED.items() if base == estimate.effect}
        others = sum(change for effect, change in dropped.items() if effect not in included)
        change = 0.0 if INCLUDED.get(estimate.effect) in dropped else estimate.change
        if SAFETY_FACTOR * (others + change) < tolerance:
            dropped |= {estimate.effect: change} | dict.fromkeys(included & set(dropped), 0.0)
    return set(dropped)


@stage("planning")
def make_plan(scene: Scene, asperities: pd.DataFrame, *, load: float) -> Plan:
    """Decide which effects a scene calls for at a load.

    Parameters
    ----------
    scene : Scene
        With the sections ``[indenter]`` and ``[elastic]``; ``[tolerance]`` states the output and the relative
        change that is allowed, ``[effects]`` the switches. With ``[simulate]`` and ``[camera]`` the effects
        of optics and sensor are estimated as well.
    asperities : DataFrame
        Columns ``x_m, y_m, height_m, radius_m``.
    load : float, N

    Returns
    -------
    Plan

    Raises
    ------
    InputError
        If a section is missing or the load is not valid.
    ModelRangeError
        If the indenter reaches the plane between the asperities.

    Examples
    --------
    >>> from contactimg.scene import scene_from_dict
    >>> pair = pd.DataFrame(
    ...     {"x_m": [0.0, 1e-3], "y_m": [0.0, 0.0], "height_m": [4e-5, 3.9e-5], "radius_m": [1e-4, 1e-4]}
    ... )
    >>> scene = scene_from_dict({"indenter": {"radius_m": 1.0}, "elastic": {"young_modulus_Pa": 3e6}})
    >>> plan = make_plan(scene, pair, load=1e-4)
    >>> plan.coupling, plan.is_on("sphere_profile")
    ('none', False)
    """
    mechanics = estimate_mechanics(scene, asperities, load=load)
    optics = estimate_optics(scene, mechanics.contacts()) if scene.simulate is not None else ()
    estimates = (*mechanics.estimates, *optics)
    decisions, messages = decide(estimates, scene.effects, tolerance=scene.tolerance.relative)
    return Plan(
        decisions,
        output=scene.tolerance.output,
        relative=scene.tolerance.relative,
        load=float(load),
        messages=messages,
        limits=mechanics.limits,
    )
