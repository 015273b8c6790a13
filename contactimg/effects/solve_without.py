"""By how much each mechanical effect changes a prediction: the contact problem solved with it and without.

The base solution couples the contacts by point forces, by Hertz's law, with adhesion and on the layer where
the scene has them. One further solution for each effect, without it or with it, gives what the effect adds to
force, radius and penetration of every contact. To first order these differences add up: the complete answer
is the base with all that is missing from it, and an answer without some effects is the complete one less what
they add.

With more than `PART_CONTACTS` contacts only coupling and layer are compared on the whole scene, without
adhesion; the other effects, which act in a contact and among its nearest neighbours, are compared on the part
of the scene about the apex.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.effects.output_change import WRITTEN, Answer, EffectEstimate, output_changes
from contactimg.errors import ConvergenceError, InputError, ModelRangeError
from contactimg.models.adhesive import COUPLINGS as ADHESIVE_COUPLINGS
from contactimg.models.adhesive import solve_adhesive
from contactimg.models.coupling import DenseCoupling, Kernel
from contactimg.models.full_coupling import bounded_saddle
from contactimg.models.interacting import solve_interacting
from contactimg.models.solution import InteractingSolution
from contactimg.models.surroundings import MeanField
from contactimg.models.validity import close_pairs
from contactimg.scene import Effects, Scene
from contactimg.scene.sections import PAPER_MODEL

Values = NDArray[np.float64]
Level = Literal["none", "asymptotic", "full"]

PURPOSE = "planning the mechanical effects"

MECHANICAL_EFFECTS = tuple(PAPER_MODEL)

THROUGH_COUPLING = ("full_coupling", "layer")
"""Effects that act only where the contacts are coupled, and are left out with coupling."""

PART_CONTACTS = 300
"""Contacts up to which every effect is solved on the whole scene. Chosen by time."""

ENGULFED_DISTANCE = 0.2
"""Distance over contact radius without coupling below which an unsolved problem is put down to two contacts.
Chosen well below 0.64, where coupled contacts become unstable."""

UNSOLVED = "no solution to compare with"

SECOND_ORDER = {
    "area": 0.27,
    "force": 0.08,
    "radius": 0.25,
    "hertz": 0.4,
    "profile": 0.08,
    "indentation": 0.03,
}
"""Error of full coupling in each output over the mean square of the relative change of the curvature, mean
and saddle, by the neighbours, weighted by the forces. Measured: the largest of RA+, RA-, SA+, flats and pairs
that nearly touch, against solutions of the whole contact problem (`benchmarks/models_truth.py`)."""


def coupling_level(effects: Effects) -> Level:
    """Level of coupling of the interacting model that the switches of a scene amount to.

    Examples
    --------
    >>> coupling_level(Effects(coupling="on", full_coupling="off"))
    'asymptotic'
    """
    if effects.coupling == "off":
        return "none"
    return "full" if effects.full_coupling == "on" else "asymptotic"


def refuse_touching(solution: InteractingSolution, load: float) -> None:
    """Raise `ModelRangeError` if most of the planes between the asperities touch."""
    if solution.base_gap.beyond_models:
        raise ModelRangeError(f"at {load:g} N {solution.base_gap.sentence}; lower the load")


def solve_scene(
    scene: Scene,
    asperities: pd.DataFrame,
    *,
    load: float,
    coupling: str,
    start: InteractingSolution | None = None,
    surroundings: MeanField | None = None,
) -> InteractingSolution:
    """Solve the interacting model with the effects that the scene switches on.

    Scene, table, load and errors are those of `contactimg.prediction.predict_contacts`;
    ``coupling`` is one of the levels "none", "asymptotic", "hertz" and "full", and ``[effects]`` does not
    enter there. ``start`` is a solution of the same table, from which contacts without adhesion start.
    ``surroundings`` bear their share of the load.
    """
    scene.check_effects()
    indenter, elastic = scene.need("indenter", "a contact model"), scene.need("elastic", "a contact model")
    effects = scene.effects
    solve: Callable[..., InteractingSolution] = partial(solve_interacting, start=start)
    if effects.adhesion == "on":
        if coupling not in ADHESIVE_COUPLINGS:
            raise InputError(
                f'[effects] adhesion = "on" does not go with the coupling "{coupling}"; take "asymptotic", '
                'full_coupling = "off"'
            )
        solve = partial(solve_adhesive, work_of_adhesion=elastic.work_of_adhesion)
    if surroundings is not None:
        asperities, load = surroundings.around(asperities), load - surroundings.load
    solution = solve(
        asperities,
        indenter_radius=indenter.radius,
        contact_modulus=elastic.contact_modulus,
        apex=indenter.apex,
        load=load,
        coupling=coupling,
        law=effects.law,
        thickness=elastic.thickness if effects.layer == "on" else np.inf,
        poisson_ratio=elastic.poisson_ratio,
    )
    return solution if surroundings is None else replace(solution, outside=surroundings.sources)


@dataclass(frozen=True)
class ModelError:
    """Relative error of the complete model, as far as it is known.

    Parameters
    ----------
    errors : mapping
        Output -> relative error.
    source : str
        Where the numbers come from.
    """

    errors: dict[str, float] = field(default_factory=dict)
    source: str = ""

    def missed(self, outputs: tuple[str, ...], tolerance: float) -> str:
        """A sentence if an output cannot be promised to a tolerance; else empty."""
        beyond = {name: self.errors[name] for name in outputs if self.errors.get(name, 0.0) > tolerance}
        if not beyond:
            return ""
        worst = ", ".join(f"{100 * error:.2g} % in {WRITTEN[name]}" for name, error in beyond.items())
        return f"{100 * tolerance:g} % is not reached: the model itself errs by about {worst} ({self.source})"


class Comparison:
    """A contact problem that is solved with and without each effect.

    Parameters
    ----------
    scene : Scene
    table : DataFrame
        Asperity table.
    load : float, N

    Notes
    -----
    A state has four rows: force, radius and penetration of every asperity, and the indentation. ``steps`` are
    what the effects add to it.
    """

    def __init__(self, scene: Scene, table: pd.DataFrame, load: float) -> None:
        self.scene, self.table, self.load = scene, table, load
        self.elastic = scene.need("elastic", PURPOSE)
        self.solved: dict[frozenset[str], InteractingSolution] = {}
        self.steps: dict[str, Values] = {}
        self.reasons: dict[str, str] = {}
        self.alone = self.solve(())
        off = scene.effects.switched_off(*MECHANICAL_EFFECTS)
        self.on = {"coupling"} - off
        self.on |= {name for name in ("adhesion", "layer") if name not in off and not self.lacks(name)}
        no_adhesion = bool(self.lacks("adhesion")) or self.alone.touching.size > PART_CONTACTS
        if no_adhesion:
            self.on -= {"adhesion"}
        try:
            self.base = self.solve(self.on)
        except ConvergenceError:
            refuse_touching(self.alone, load)
            refuse_engulfed(self.alone)
            raise
        # adhesive contacts hold at negative penetrations too
        self.by_depth = np.isfinite(self.base.penetration) & no_adhesion

    def solve(
        self, effects: Collection[str], start: InteractingSolution | None = None
    ) -> InteractingSolution:
        """The solution with these effects and no others."""
        key = frozenset(effects)
        if key in self.solved:
            return self.solved[key]
        switches = {name: "on" if name in effects else "off" for name in MECHANICAL_EFFECTS}
        scene = self.scene.with_effects(switches)
        level = coupling_level(scene.effects)
        load = self.load if "adhesion" in effects else max(self.load, 0.0)
        solution = solve_scene(scene, self.table, load=load, coupling=level, start=start)
        return self.solved.setdefault(key, solution)

    def state(self, solution: InteractingSolution) -> Values:
        """The numbers of a solution, with the penetrations that base and solution both know."""
        told = np.isfinite(self.base.penetration)
        known = told & np.isfinite(solution.penetration)
        penetration = np.where(known, solution.penetration, np.where(told, self.base.penetration, 0))
        depth = np.full_like(penetration, solution.indentation)
        return np.stack([solution.force, solution.radius, penetration, depth])

    def lacks(self, effect: str) -> str:
        """Why an effect cannot act here; empty where it can."""
        if effect == "adhesion" and not self.elastic.work_of_adhesion > 0:
            return "no work of adhesion is stated"
        if effect == "layer" and self.elastic.thickness is None:
            return "no thickness is stated, so the body is a half-space"
        if effect == "full_coupling" and "adhesion" in self.on:
            return "not defined for contacts that adhere"
        if effect in THROUGH_COUPLING and "coupling" not in self.on:
            return "coupling, through which it acts, is switched off"
        return ""

    def compare(self, effect: str) -> None:
        """Solve without an effect that the base has, or with one that the base has not."""
        self.reasons[effect] = self.lacks(effect)
        if self.reasons[effect]:
            return
        base, others = self.state(self.base), self.on | {effect}
        if effect in self.on:
            others = self.on - {effect, *(THROUGH_COUPLING if effect == "coupling" else ())}
        try:
            solution = self.solve(others, self.base)
        except (ConvergenceError, ModelRangeError) as error:
            if effect != "coupling":
                self.reasons[effect] = f"{UNSOLVED}: {error}"
                return
            other = np.zeros_like(base)
            other[2] = -self.base.indentation
            self.reasons[effect] = str(error)
        else:
            other = self.state(solution)
            self.reasons[effect] = reason(self, effect, solution)
        self.steps[effect] = base - other if effect in self.on else other - base

    def change(self, left_out: Collection[str], stretch: float) -> dict[str, float]:
        """Change of each output if these effects are left out, each a number of times."""
        names = {*left_out} | ({"full_coupling"} if "coupling" in left_out else set())
        steps = [step for name, step in self.steps.items() if name in names]
        missing = [step for name, step in self.steps.items() if name not in self.on]
        whole, found = self.state(self.base) + np.sum(missing, axis=0), dict.fromkeys(WRITTEN, 0.0)
        for beyond in {0.0, stretch - 1} if steps else ():  # contacts may form or vanish at either end
            complete = whole + beyond * np.sum(steps, axis=0)
            without = complete - stretch * np.sum(steps, axis=0)
            changes = self._changes(without, complete, may_form=stretch > 1)
            found = {name: max(change, found[name]) for name, change in changes.items()}
        return found

    def _changes(self, without: Values, complete: Values, *, may_form: bool) -> dict[str, float]:
        less, all_of_it = (self.answer(state, may_form=may_form) for state in (without, complete))
        return output_changes(self.distance, self.base.composite_radius, without=less, complete=all_of_it)

    @cached_property
    def distance(self) -> Values:
        """Distance of each asperity from the apex of the lens, m."""
        x, y = self.scene.need("indenter", PURPOSE).apex
        return np.asarray(np.hypot(self.base.x - x, self.base.y - y))

    def answer(self, state: Values, *, may_form: bool) -> Answer:
        """The contacts of a state that was added up: others than those of the base may touch.

        With ``may_form`` adhesive contacts form where the gap closes, with JKR's radius at no penetration.
        """
        force, radius, penetration, depth = state
        forms = penetration > 0
        touches = np.where(self.by_depth, forms, (forms & may_form) | (radius > 0))
        R, ratio = self.base.composite_radius, self.elastic.work_of_adhesion / self.elastic.contact_modulus
        least = np.cbrt(2 * np.pi * ratio * R**2) if "adhesion" in self.on else 0 * R
        radius = np.where(radius > 0, radius, np.maximum(least, np.finfo(float).tiny))
        return Answer(np.where(touches, force, 0.0), np.where(touches, radius, 0.0), float(depth[0]))

    @cached_property
    def curvature_changes(self) -> Values:
        """Squares of what the neighbours change of the curvatures of each contact, mean and saddle."""
        base = self.base
        rows = base.touching
        if "coupling" not in self.on or rows.size < 2:
            return np.zeros(rows.size)
        pressed, a = base.force[rows] / self.elastic.contact_modulus, base.radius[rows]
        R = base.composite_radius[rows]
        fields = DenseCoupling(base.x[rows], base.y[rows], Kernel.of_thickness(np.inf)).fields
        own = fields(pressed, a, bounded_saddle(fields(pressed, a), R))
        return np.asarray(R**2 * (own.curvature**2 + own.saddle_x**2 + own.saddle_y**2))

    def change_by_fields(self) -> dict[str, float]:
        """Change of each output by full coupling, without adhesion; 1 where that has no solution."""
        others = self.on - {"adhesion"}
        try:
            states = [self.state(self.solve(effects)) for effects in (others, others | {"full_coupling"})]
        except (ConvergenceError, ModelRangeError):
            return dict.fromkeys(WRITTEN, 1.0)
        return self._changes(*states, may_form=False)

    def part(self, contacts: int) -> "Comparison":
        """The asperities about the apex among which so many are in contact, lowered as by all the others.

        A flat presses them; their heights are such that they carry the forces that they carry in the whole.
        """
        base = self.base
        reach = np.sort(self.distance[base.touching])[contacts - 1]
        rows = np.flatnonzero((self.distance <= reach) & np.isfinite(base.penetration))
        x, y, force = base.x[rows], base.y[rows], base.force[rows]
        lowered = DenseCoupling(x, y, Kernel.of_thickness(np.inf)).displacement(force)
        # by Hertz's law of a half-space, which has no layer below the contact itself
        radius = base.composite_radius[rows]
        hertz = np.cbrt(9 / 16 * (force / self.elastic.contact_modulus) ** 2 / radius)
        height = np.where(force > 0, hertz, base.penetration[rows]) + lowered / self.elastic.contact_modulus
        height += float(np.max(base.height)) - height.min()
        table = pd.DataFrame({"x_m": x, "y_m": y, "height_m": height, "radius_m": radius})
        flat = self.scene.need("indenter", PURPOSE).model_copy(update={"radius": np.inf})
        elastic = self.elastic.model_copy(update={"thickness": None})
        scene = self.scene.model_copy(update={"indenter": flat, "elastic": elastic})
        return Comparison(scene, table, float(force.sum()))


def reason(pair: Comparison, effect: str, other: InteractingSolution) -> str:
    """The number that decides on an effect, from a compared problem and its other solution."""
    base, elastic, rows = pair.base, pair.elastic, pair.base.touching
    if effect == "coupling":
        coupled, alone = (base, other) if effect in pair.on else (other, base)
        lowered = (coupled.indentation - coupled.penetration) - (alone.indentation - alone.penetration)
        known = np.isfinite(lowered) & (coupled.force > 0)
        force, lowered = coupled.force[known], lowered[known]
        total, sunk = float(force.sum()), float(force @ coupled.penetration[known])
        if not sunk > 0:
            return "no contact bears a load with coupling"
        varies = np.sqrt(float(force @ (lowered - force @ lowered / total) ** 2) / total) * total / sunk
        return f"the displacement by the neighbours varies by {varies:.2g} of the mean indentation"
    if effect == "full_coupling":
        largest = np.sqrt(np.max(pair.curvature_changes, initial=0.0))
        return f"the neighbours change the radii of curvature by up to {largest:.2g}"
    if effect == "layer":
        extent = np.hypot(base.x[rows] - base.x[rows].mean(), base.y[rows] - base.y[rows].mean()).max()
        return f"the loaded region's radius is {extent / elastic.thickness:.2g} of the thickness"
    if effect == "sphere_profile":
        return f"a/R up to {base.validity.max_strain:.2f}"
    if effect != "adhesion":
        raise ValueError(f"no number is known that decides on {effect!r}")
    without = other if effect in pair.on else base
    if not without.touching.size:
        return "without adhesion there is no contact at this load"
    bears = float(without.force[without.touching].mean())
    pull = 3 * np.pi * elastic.work_of_adhesion * float(without.composite_radius[without.touching].mean())
    gain = (pull + np.sqrt(2 * pull * bears + pull**2)) / bears
    return f"it adds {gain:.0%} to a^3 of a contact of {bears:.2g} N"


@dataclass(frozen=True, eq=False)
class MechanicalEstimates:
    """The estimates of the mechanical effects of a scene at a load.

    Parameters
    ----------
    estimates : tuple of EffectEstimate
        In the order of `MECHANICAL_EFFECTS`.
    limits : tuple of str
        One sentence for each range of validity that some contacts exceed, and each effect that could not be
        solved.
    base : InteractingSolution
        Contacts coupled by point forces.
    compared : tuple of Comparison
    model_error : ModelError
        Of the complete model.
    """

    estimates: tuple[EffectEstimate, ...]
    base: InteractingSolution
    limits: tuple[str, ...] = ()
    compared: tuple[Comparison, ...] = ()
    model_error: ModelError = field(default_factory=ModelError)

    def together(self, left_out: Collection[str], stretch: float = 1.0) -> dict[str, float]:
        """Change of each output if all of some effects are left out, each ``stretch`` times."""
        changes = [comparison.change(left_out, stretch) for comparison in self.compared]
        return {output: sum((change[output] for change in changes), 0.0) for output in WRITTEN}


def estimate_mechanics(scene: Scene, asperities: pd.DataFrame, *, load: float) -> MechanicalEstimates:
    """Estimate how much the requested output changes if a mechanical effect is left out.

    Parameters
    ----------
    scene : Scene
        With the sections ``[indenter]`` and ``[elastic]``; ``[tolerance]`` states the output. An effect that
        is switched off does not act on the others.
    asperities : DataFrame
        Columns ``x_m, y_m, height_m, radius_m``.
    load : float, N
        Zero or negative only if the contacts adhere.

    Raises
    ------
    InputError
        If a section is missing or the load is not valid.
    ModelRangeError
        If the indenter reaches the plane between the asperities, or a contact encloses its neighbour.

    Examples
    --------
    >>> from contactimg.scene import scene_from_dict
    >>> pair = pd.DataFrame(
    ...     {"x_m": [0.0, 1e-4], "y_m": [0.0, 0.0], "height_m": [4e-5, 4e-5], "radius_m": [1e-4, 1e-4]}
    ... )
    >>> scene = scene_from_dict(
    ...     {"indenter": {"radius_m": 1.0}, "elastic": {"young_modulus_Pa": 3e6}}
    ... )
    >>> mechanics = estimate_mechanics(scene, pair, load=3e-3)
    >>> [one.effect for one in mechanics.estimates if one.change > 0.01]
    ['coupling', 'sphere_profile']
    """
    scene.need("indenter", PURPOSE)
    elastic = scene.need("elastic", PURPOSE)
    scene.check_effects()
    adheres = elastic.work_of_adhesion > 0 and scene.effects.adhesion != "off"
    if not (np.isfinite(load) and (load >= 0 or adheres)):
        no_adhesion = "; adhesion is left out here" if elastic.work_of_adhesion > 0 and not adheres else ""
        raise InputError(
            f"load must be finite, and positive unless the contacts adhere, got {load!r} N{no_adhesion}; "
            "give another"
        )
    whole = Comparison(scene, asperities, load)
    if not whole.base.touching.size:
        nothing = f"at {load:g} N there is no contact"
        estimates = [EffectEstimate(name, 0.0, nothing) for name in MECHANICAL_EFFECTS]
        return MechanicalEstimates(tuple(estimates), whole.base)
    refuse_touching(whole.base, load)
    limits = whole.base.validity.messages()
    near = whole if whole.base.touching.size <= PART_CONTACTS else whole.part(PART_CONTACTS)
    for name in MECHANICAL_EFFECTS:
        (whole if name in ("coupling", "layer") else near).compare(name)
    compared = (whole,) if near is whole else (whole, near)
    found, reasons = MechanicalEstimates((), whole.base, compared=compared), near.reasons | whole.reasons
    estimates = []
    for name in MECHANICAL_EFFECTS:
        changes = found.together([name])
        estimates.append(EffectEstimate.of(name, reasons[name], changes, scene.tolerance.output))
        if reasons[name].startswith(UNSOLVED):
            limits.append(f"{name} is not compared: {reasons[name]}")
    force = np.abs(near.base.force[near.base.touching])
    square = float(force @ near.curvature_changes) / (float(force.sum()) or 1.0)
    errors = {name: factor * square for name, factor in SECOND_ORDER.items()}
    source = "estimated from the square of what the neighbours change of the curvatures"
    if {"adhesion", "coupling"} <= near.on:
        errors = {name: errors.get(name, 0.0) + change for name, change in near.change_by_fields().items()}
        source += ", and from full coupling without adhesion"
    error = ModelError(errors, source)
    return MechanicalEstimates(tuple(estimates), whole.base, tuple(limits), compared, error)


def refuse_engulfed(alone: InteractingSolution) -> None:
    """Raise `ModelRangeError` if uncoupled contacts lie far inside each other."""
    rows = alone.touching
    i, j, _ = close_pairs(alone.x[rows], alone.y[rows], ENGULFED_DISTANCE * alone.radius[rows])
    if i.size:
        first, second = sorted((int(rows[i[0]]), int(rows[j[0]])))
        raise ModelRangeError(
            f"asperities: rows {first} and {second} would overlap so far that several solutions exist; "
            "lower the load or merge them"
        )
