"""The plan: which effects are computed for a scene, from their estimates and the scene's tolerance.

The effects that the plan leaves out together change every requested output by less than the tolerance. They
are dropped in order of their estimated change, the smallest first, as long as `SAFETY_FACTOR` times what they
change together stays below the tolerance in each of these outputs. What no switch can compute, finite strain
and the slope of the lens, is estimated beside them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from contactimg.effects.output_change import EffectEstimate, change_sentence, requested_outputs
from contactimg.effects.render_without import estimate_optics
from contactimg.effects.solve_without import (
    MECHANICAL_EFFECTS,
    Level,
    MechanicalEstimates,
    ModelError,
    coupling_level,
    estimate_mechanics,
)
from contactimg.mechanics.finite_strain import load_over_law
from contactimg.models.solution import InteractingSolution
from contactimg.scene import Effects, Scene, Tolerance
from contactimg.tables import EFFECTS

REQUIRES = {"full_coupling": "coupling", "layer": "coupling"}
"""Effects that act only through another one."""

INCLUDED = {"full_coupling": "coupling"}
"""Effects whose change is part of the change of another one: if both are left out, only the other one counts.

The layer is no such effect: coupling and layer partly cancel, so that leaving out both can change less than
leaving out one.
"""

SAFETY_FACTOR = 1.25
"""Factor on what the dropped effects add to the solution. Chosen: differences add up to first order only."""

SLOPE_FACTORS = {"area": 1.0, "force": 0.12}
"""Change of an output by the true geometry of caps on a lens, over the square of the largest slope of the
lens: 0.6 and 0.076 % on RA+ with slopes up to 0.08, from solutions of the whole problem (docs/models.md)."""


@dataclass(frozen=True)
class Decision(EffectEstimate):
    """The decision on one effect, with its estimate.

    Parameters
    ----------
    on : bool
        Whether the effect is computed.
    switch : {"auto", "on", "off"}
        The switch in the scene; "auto" leaves the decision to the plan.
    """

    on: bool = True
    switch: str = "auto"


@dataclass(frozen=True)
class Plan:
    """The effects of a scene at one load.

    Parameters
    ----------
    decisions : tuple of Decision
    output : {"all", "area", "force", "radius", "profile"}
        The result that must be accurate.
    relative : float
        Relative change that is allowed.
    load : float, N
    messages : tuple of str
        One sentence for each switch in the scene that contradicts the estimates.
    limits : tuple of str
        One sentence for each range of validity that some contacts exceed; they are computed nevertheless.
    expected_errors : mapping
        Output -> estimated relative change by all mechanical effects that are left out.
    model_error : ModelError
        How well the complete model is known.
    unmodelled : tuple of EffectEstimate
        What every solution leaves out: rows of the table with the decision "not modelled".
    """

    decisions: tuple[Decision, ...]
    output: str
    relative: float
    load: float
    messages: tuple[str, ...] = ()
    limits: tuple[str, ...] = ()
    expected_errors: Mapping[str, float] = field(default_factory=dict)
    model_error: ModelError = field(default_factory=ModelError)
    unmodelled: tuple[EffectEstimate, ...] = ()

    def is_on(self, effect: str) -> bool:
        """Whether an effect is computed; False for an effect that is not in the plan."""
        return self._switches.get(effect) == "on"

    @property
    def coupling(self) -> Level:
        """Level of coupling for the interacting model."""
        return coupling_level(Effects().model_copy(update=self._switches))

    @property
    def _switches(self) -> dict[str, str]:
        """Effect -> "on" or "off"."""
        return {decision.effect: "on" if decision.on else "off" for decision in self.decisions}

    @property
    def left_out(self) -> tuple[str, ...]:
        """Mechanical effects that could act and are left out."""
        mechanical = [d for d in self.decisions if d.effect in MECHANICAL_EFFECTS]
        return tuple(d.effect for d in mechanical if not d.on and d.change > 0)

    def sentence(self) -> str:
        """A sentence that names what is left out and by how much that changes each output."""
        text = "nothing else that acts is left out" if self.limits else "nothing that acts is left out"
        if self.left_out:
            changes = change_sentence(self.expected_errors)
            text = f"left out: {', '.join(self.left_out)}; that changes {changes}"
        missed = self.model_error.missed(requested_outputs(self.output), self.relative)
        return "; ".join(part for part in (f"at {self.load:g} N {text}", missed) if part)

    def apply(self, scene: Scene) -> Scene:
        """The scene with the decisions of the plan as its switches, "on" or "off"."""
        names = scene.effects.switches()
        return scene.with_effects({name: self._switches[name] for name in names if name in self._switches})

    @property
    def record(self) -> list[dict[str, Any]]:
        """The decisions for the provenance: effect, change, decision and reason."""
        rows = self.table()[["effect", "change", "decision", "reason"]].to_dict("records")
        return [{str(key): value for key, value in row.items()} for row in rows]

    @property
    def error_record(self) -> dict[str, Any]:
        """The effects left out, what that changes, and how well the model is known, for the provenance."""
        return {
            "left_out": list(self.left_out),
            "expected_errors": dict(self.expected_errors),
            "model_errors": dict(self.model_error.errors),
            "model_errors_from": self.model_error.source,
        }

    def table(self) -> pd.DataFrame:
        """One row per effect: the schema `contactimg.tables.EFFECTS`."""
        rows = [
            {name: value for name, value in asdict(d).items() if name in EFFECTS.columns}
            | {f"change_{output}": value for output, value in d.changes.items()}
            | {"load_N": self.load, "tolerance": self.relative}
            | {"decision": self._switches.get(d.effect, "not modelled")}
            for d in (*self.decisions, *self.unmodelled)
        ]
        return EFFECTS.conform(pd.DataFrame(rows, columns=list(EFFECTS.columns)))


def decide(
    estimates: Sequence[EffectEstimate],
    switches: Effects,
    tolerance: Tolerance,
    mechanics: MechanicalEstimates | None = None,
) -> tuple[tuple[Decision, ...], tuple[str, ...]]:
    """Drop the smallest effects, as long as together they change each output by less than the tolerance.

    Parameters
    ----------
    estimates : sequence of EffectEstimate
    switches : Effects
        Of the scene. Effects that it switches "on" or "off" stay so and do not count.
    tolerance : Tolerance
        The output that must be accurate, and the relative change that is allowed.
    mechanics : MechanicalEstimates, optional
        Says what mechanical effects change together, where contacts form or vanish by several of them.

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
    >>> [decision.on for decision in decide(estimates, Effects(), Tolerance(relative=0.01))[0]]
    [False, True]
    """
    switch = {e.effect: getattr(switches, e.effect, "auto") for e in estimates}

    def fits(dropped: Sequence[EffectEstimate]) -> bool:
        names = {e.effect for e in dropped}
        known = mechanics.together(names, SAFETY_FACTOR) if mechanics is not None else {}
        counted = [e for e in dropped if INCLUDED.get(e.effect) not in names]
        return all(
            max(SAFETY_FACTOR * sum(e.change_of(name) for e in counted), known.get(name, 0.0))
            < tolerance.relative
            for name in requested_outputs(tolerance.output)
        )

    def kept(required: set[str]) -> set[str]:
        """Effects that are switched on, that others require, or that change the output too much."""
        dropped: list[EffectEstimate] = []
        for estimate in sorted(estimates, key=lambda e: (e.change, e.effect)):
            free = switch[estimate.effect] == "auto" and estimate.effect not in required
            if free and fits([*dropped, estimate]):
                dropped.append(estimate)
        return {name for name in switch if switch[name] != "off"} - {e.effect for e in dropped}

    required = {base for effect, base in REQUIRES.items() if switch.get(effect) == "on"}
    on = kept(required)
    also_required = {base for effect, base in REQUIRES.items() if effect in on - set(INCLUDED)}
    if not also_required <= on:
        on = kept(required | also_required)
    inactive = {effect for effect, base in REQUIRES.items() if base in switch and base not in on}
    on -= inactive
    decisions, warnings = [], []
    for e in estimates:
        numbers = asdict(e)
        if e.effect in inactive:
            reason = f"acts through {REQUIRES[e.effect]}, which is left out"
            numbers |= {"change": 0.0, "reason": reason, "changes": dict.fromkeys(e.changes, 0.0)}
        d = Decision(**numbers, on=e.effect in on, switch=switch[e.effect])
        decisions.append(d)
        if d.switch == "on" and not d.on:
            warnings.append(f"{d.effect} is switched on but {d.reason}")
        elif d.switch == "off" and d.change >= tolerance.relative:
            warnings.append(
                f"{d.effect} is switched off although that changes the requested output by about "
                f"{d.change:.2g} (tolerance {tolerance.relative:g}): {d.reason}"
            )
    return tuple(decisions), tuple(warnings)


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
    ('asymptotic', False)
    """
    mechanics = estimate_mechanics(scene, asperities, load=load)
    estimates = *mechanics.estimates, *estimate_optics(scene, mechanics.base.contacts())
    tolerance = scene.tolerance
    decisions, messages = decide(estimates, scene.effects, tolerance, mechanics)
    dropped = [d.effect for d in decisions if not d.on]
    law = "hertz" if "sphere_profile" in dropped else "sphere"
    return Plan(
        decisions,
        output=tolerance.output,
        relative=tolerance.relative,
        load=float(load),
        messages=messages,
        limits=mechanics.limits,
        expected_errors=mechanics.together(dropped),
        model_error=mechanics.model_error,
        unmodelled=unmodelled_effects(mechanics.base, law=law, output=tolerance.output),
    )


def unmodelled_effects(solution: InteractingSolution, *, law: str, output: str) -> tuple[EffectEstimate, ...]:
    """Estimates of the effects that every solution leaves out.

    Parameters
    ----------
    solution : InteractingSolution
        There is no estimate without contacts.
    law : {"hertz", "sphere"}
        That of the solution which is planned.
    output : str
        The output that must be accurate.

    Returns
    -------
    tuple of EffectEstimate
        ``finite_strain``: of area, radii and Hertz forces at the forces of the solution, and of the forces at
        its radii; ``cap_slope``: of area and forces.
    """
    if not solution.touching.size:
        return ()
    rows, (x0, y0) = solution.touching, solution.conditions.apex
    a, R, weight = solution.radius[rows], solution.composite_radius[rows], np.abs(solution.force[rows])
    load = load_over_law(a / R, law)
    total = float(weight.sum())
    unequal = np.abs(load / (weight @ load / total) - 1) if total > 0 else 0 * load
    area = a**2 * (load ** (-2 / 3) - 1)
    radius = a * (load ** (-1 / 3) - 1)
    strain = {
        "area": abs(float(area.sum() / np.sum(a**2))),
        "radius": float(np.sqrt(np.sum(radius**2) / np.sum(a**2))),
        "hertz": float(np.abs(a**3 / R * (1 / load - 1)).sum() / np.sum(a**3 / R)),
        "force": float(weight @ unequal) / (total or 1.0),
    }
    widest = int(np.argmax(a / R))
    distance = np.hypot(solution.x[rows] - x0, solution.y[rows] - y0)
    slope = float(distance.max() / solution.conditions.indenter_radius)
    tilted = {name: factor * slope**2 for name, factor in SLOPE_FACTORS.items()}
    at = f"a/R up to {a[widest] / R[widest]:.2f}: rubber bears {load[widest]:.3f} of the law's force"
    under = f"slopes of the lens up to {slope:.2g} under the contacts"
    found = ("finite_strain", at, strain), ("cap_slope", under, tilted)
    return tuple(EffectEstimate.of(name, reason, changes, output) for name, reason, changes in found)
