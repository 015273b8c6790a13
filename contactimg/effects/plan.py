"""The plan: which effects are computed for a scene, decided by a number against the scene's tolerance.

Everything that is left out by the plan's own decision changes the requested output, all together, by less
than the tolerance: the smallest effects are dropped first, as long as the sum of the estimates, each a
quarter larger because estimates err, stays below the tolerance. A sum that meets it exactly keeps the effect
on.
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import pandas as pd

from contactimg.effects.estimate import Estimate
from contactimg.effects.mechanics.estimates import weigh_mechanics
from contactimg.effects.optics.estimates import estimate_optics
from contactimg.scene import Effects, Scene
from contactimg.tables import EFFECTS
from contactimg.timings import stage

Level = Literal["none", "asymptotic", "full"]

REQUIRES = {"full_coupling": "coupling", "layer": "coupling"}
"""Effects that act through another one only."""

INCLUDED = {"full_coupling": "coupling"}
"""Effects whose change that of another one includes: left out with it, they count no more.

Not so the layer: where it matters, an uncoupled model is right only as far as two effects cancel.
"""

MARGIN = 1.25
"""Factor on estimates in the sum of what is dropped: they err by up to a quarter."""


@dataclass(frozen=True)
class Decision:
    """What the plan says of one effect.

    Parameters
    ----------
    effect : str
    change : float
        Estimated relative change of the requested output if the effect is left out.
    tolerance : float
        What the estimates of all that is left out must stay below together.
    on : bool
        Whether the effect is computed.
    switch : {"auto", "on", "off"}
        What the scene orders; "auto" leaves it to the plan.
    reason : str
        Half a sentence with the numbers that decide.
    cost : float
        Time of its stage with the effect over the time without.
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
        What must be accurate.
    relative : float
        To what relative change.
    load : float, N
    messages : tuple of str
        One sentence for each effect that is left out against the plan's advice.
    limits : tuple of str
        One sentence for each limit of the models that contacts exceed, and are computed beyond.
    """

    decisions: tuple[Decision, ...]
    output: str
    relative: float
    load: float
    messages: tuple[str, ...] = ()
    limits: tuple[str, ...] = ()

    def is_on(self, effect: str) -> bool:
        """Whether an effect is computed; one that the plan does not know is not."""
        return any(decision.on for decision in self.decisions if decision.effect == effect)

    @property
    def coupling(self) -> Level:
        """Level of coupling for the interacting model."""
        if not self.is_on("coupling"):
            return "none"
        return "full" if self.is_on("full_coupling") else "asymptotic"

    def apply(self, scene: Scene) -> Scene:
        """The scene with every switch that the plan decides on explicit: "on" or "off"."""
        known = Effects.model_fields
        explicit = {d.effect: "on" if d.on else "off" for d in self.decisions if d.effect in known}
        return scene.model_copy(update={"effects": scene.effects.model_copy(update=explicit)})

    @property
    def record(self) -> list[dict[str, Any]]:
        """What the provenance keeps: effect, change, decision and reason."""
        rows = self.table()[["effect", "change", "decision", "reason"]].to_dict("records")
        return [{str(key): value for key, value in row.items()} for row in rows]

    def table(self) -> pd.DataFrame:
        """One row an effect: the schema `EFFECTS`."""
        rows = [
            asdict(d) | {"load_N": self.load, "decision": "on" if d.on else "off"} for d in self.decisions
        ]
        return EFFECTS.conform(pd.DataFrame(rows, columns=[*EFFECTS.columns, "on"]).drop(columns="on"))


def decide(
    estimates: Sequence[Estimate], switches: Effects, *, tolerance: float
) -> tuple[tuple[Decision, ...], tuple[str, ...]]:
    """Keep the effects that matter; the sum of what is dropped stays below the tolerance.

    Parameters
    ----------
    estimates : sequence of Estimate
    switches : Effects
        The scene's; an order is obeyed. What is off by order does not count in the sum.
    tolerance : float
        Relative change.

    Returns
    -------
    decisions : tuple of Decision
        In the order of the estimates.
    messages : tuple of str
        One sentence for each effect that is off by order although it changes the output by the tolerance or
        more.

    Examples
    --------
    >>> found = [Estimate("layer", 0.004, "thin"), Estimate("coupling", 0.2, "close")]
    >>> [decision.on for decision in decide(found, Effects(), tolerance=0.01)[0]]
    [False, True]
    """
    order = {e.effect: getattr(switches, e.effect, "auto") for e in estimates}
    needed = {base for effect, base in REQUIRES.items() if order.get(effect) == "on"}
    on = _kept(estimates, order, needed, tolerance)
    pulled = {base for effect, base in REQUIRES.items() if effect in on - set(INCLUDED)}
    if not pulled <= on:
        on = _kept(estimates, order, needed | pulled, tolerance)
    moot = {effect: base for effect, base in REQUIRES.items() if base in order and base not in on}
    on -= set(moot)
    decisions = tuple(
        Decision(
            e.effect,
            0.0 if e.effect in moot else e.change,
            tolerance,
            e.effect in on,
            order[e.effect],
            f"acts through {moot[e.effect]}, which is left out" if e.effect in moot else e.reason,
            e.cost,
        )
        for e in estimates
    )
    return decisions, tuple(_warnings(decisions))


def _warnings(decisions: Sequence[Decision]) -> Iterable[str]:
    """What is off against the plan's advice."""
    for d in decisions:
        if d.switch == "on" and not d.on:
            yield f"{d.effect} is switched on but {d.reason}"
        elif d.switch == "off" and d.change >= d.tolerance:
            yield (
                f"{d.effect} is switched off although that changes the requested output by about "
                f"{d.change:.2g} (tolerance {d.tolerance:g}): {d.reason}"
            )


def _kept(
    estimates: Sequence[Estimate], order: dict[str, str], needed: set[str], tolerance: float
) -> set[str]:
    """Effects that are on by order, because others need them or because they matter."""
    free = [e for e in estimates if order[e.effect] == "auto" and e.effect not in needed]
    dropped = _dropped(free, tolerance)
    return {effect for effect, switch in order.items() if switch != "off" and effect not in dropped}


def _dropped(estimates: Iterable[Estimate], tolerance: float) -> set[str]:
    """Effects whose changes, the smallest first, add up to less than the tolerance."""
    dropped: dict[str, float] = {}
    for estimate in sorted(estimates, key=_size):
        moot = {effect for effect, base in INCLUDED.items() if base == estimate.effect}
        others = sum(change for effect, change in dropped.items() if effect not in moot)
        change = 0.0 if INCLUDED.get(estimate.effect) in dropped else estimate.change
        if MARGIN * (others + change) < tolerance:
            dropped |= {estimate.effect: change} | dict.fromkeys(moot & set(dropped), 0.0)
    return set(dropped)


def _size(estimate: Estimate) -> tuple[float, float, str]:
    """Smallest first; of equal ones the dearest, then by name."""
    return (estimate.change, -estimate.cost, estimate.effect)


@stage("planning")
def make_plan(scene: Scene, asperities: pd.DataFrame, *, load: float) -> Plan:
    """Decide which effects a scene calls for at a load.

    Parameters
    ----------
    scene : Scene
        Sections ``[indenter]`` and ``[elastic]`` are needed; ``[tolerance]`` says what must be accurate and
        how accurate, ``[effects]`` what is ordered. With ``[simulate]`` and ``[camera]`` optics
        and sensor are weighed as well.
    asperities : DataFrame
        Columns ``x_m, y_m, height_m, radius_m``.
    load : float, N

    Returns
    -------
    Plan

    Raises
    ------
    InputError
        If the scene lacks a section or the load breaks its rule.
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
    mechanics = weigh_mechanics(scene, asperities, load=load)
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
