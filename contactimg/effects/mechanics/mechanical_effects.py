"""Estimates of the mechanical effects before the contact problem is solved.

All of them start from one approximate state of the scene (`approximate_state`): contacts coupled by point
forces, with the JKR law where they adhere. The change of an effect is the difference between this state with
the effect and without.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pandas as pd

from contactimg.effects.effect_estimate import EffectEstimate
from contactimg.effects.mechanics.approximate_state import Response
from contactimg.effects.mechanics.left_out import EffectChanges, Pair
from contactimg.effects.mechanics.loaded_scene import PURPOSE, LoadedScene
from contactimg.effects.mechanics.model_error import ModelError, estimate_model_error
from contactimg.effects.mechanics.solve_cost import solve_cost
from contactimg.effects.output_change import WRITTEN, requested_outputs
from contactimg.errors import InputError
from contactimg.mechanics import jkr
from contactimg.models.asperity_laws import SphereLaw
from contactimg.models.scaled_problem import ContactConditions, scale_problem
from contactimg.sample_shape import shaped_asperities
from contactimg.scene import Scene
from contactimg.tables import CONTACTS

MECHANICAL_EFFECTS = ("coupling", "full_coupling", "adhesion", "layer", "sphere_profile")

SMALL_LOAD_FRACTION = 1e-3
"""Load over pull-off force at which adhesive contacts under zero or negative load are estimated.

Chosen small enough not to change the contacts; sensitivity not measured.
"""


@dataclass(frozen=True, eq=False)
class MechanicalEstimates:
    """The estimates of the mechanical effects of a scene.

    Parameters
    ----------
    estimates : tuple of EffectEstimate
        In the order of `MECHANICAL_EFFECTS`.
    limits : tuple of str
        One sentence for each range of validity that some contacts exceed.
    contacts : callable
        Returns the contacts of the approximate state, with the columns `CONTACTS` in metres; radii are good
        to some per cent.
    left_out : callable
        Takes effects and returns by how much each output changes if all of them are left out together.
    model_error : ModelError
        Of the complete model.
    """

    estimates: tuple[EffectEstimate, ...]
    limits: tuple[str, ...]
    contacts: Callable[[], pd.DataFrame]
    left_out: Callable[[Collection[str]], dict[str, float]]
    model_error: ModelError


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
        Negative only if the contacts adhere. At zero or negative load adhesive contacts are estimated at a
        load of `SMALL_LOAD_FRACTION` of the pull-off force.

    Returns
    -------
    MechanicalEstimates

    Raises
    ------
    InputError
        If a section is missing or the load is not valid.
    ModelRangeError
        If the indenter reaches the plane between the asperities, or a contact encloses its neighbour.

    Notes
    -----
    The estimates differ from the change that the full model gives by some per cent; beyond 300 candidates,
    where cells of a grid stand for the neighbours, by up to a quarter.

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
    >>> len(mechanics.contacts()), [one.effect for one in mechanics.estimates if one.change > 0.01]
    (2, ['coupling', 'sphere_profile'])
    """
    indenter, elastic = scene.need("indenter", PURPOSE), scene.need("elastic", PURPOSE)
    scene.check_effects()
    adheres = elastic.work_of_adhesion > 0 and scene.effects.adhesion != "off"
    if not (np.isfinite(load) and (load >= 0 or adheres)):
        no_adhesion = "; adhesion is left out here" if elastic.work_of_adhesion > 0 and not adheres else ""
        raise InputError(
            f"load must be finite, and positive unless the contacts adhere, got {load!r} N{no_adhesion}; "
            "give another"
        )
    estimated_load = load
    if load <= 0 and adheres and len(asperities):
        radius = float(np.median(asperities["radius_m"]))
        pull_off = jkr.pull_off_load(sphere_radius=radius, work_of_adhesion=elastic.work_of_adhesion)
        estimated_load = -SMALL_LOAD_FRACTION * pull_off
    conditions = ContactConditions(
        indenter.radius, elastic.contact_modulus, indenter.apex, np.inf, estimated_load, None
    )
    problem = scale_problem(shaped_asperities(asperities, scene), conditions)
    if not problem.touches:
        reason = f"at {load:g} N there is no contact"
        none = tuple(EffectEstimate(name, 0.0, reason) for name in MECHANICAL_EFFECTS)
        return MechanicalEstimates(none, (), CONTACTS.empty, _nothing, ModelError({}, ""))
    loaded = LoadedScene(scene, problem)
    loaded.check_engulfed()
    answers = {name: _answer(loaded, name) for name in PAIRS}
    changes = EffectChanges.between(loaded, {name: pair for name, (pair, _) in answers.items()})
    estimates = _estimates(loaded, changes, {name: reason for name, (_, reason) in answers.items()})
    left_out: Callable[[Collection[str]], dict[str, float]] = changes.together
    if load <= 0:
        reason = "without adhesion there is no contact at this load"
        everything = dict.fromkeys(WRITTEN, 1.0)
        estimates = tuple(
            replace(e, change=1.0, reason=reason, changes=everything) if e.effect == "adhesion" else e
            for e in estimates
        )
        left_out = partial(_unloaded, changes)
    limits = tuple(loaded.limits())
    return MechanicalEstimates(estimates, limits, loaded.contacts, left_out, estimate_model_error(loaded))


def _nothing(_: Collection[str]) -> dict[str, float]:
    """The changes without a contact."""
    return dict.fromkeys(WRITTEN, 0.0)


def _unloaded(changes: EffectChanges, dropped: Collection[str]) -> dict[str, float]:
    """The changes where only adhesion makes contacts."""
    return dict.fromkeys(WRITTEN, 1.0) if "adhesion" in dropped else changes.together(dropped)


def _estimates(
    loaded: LoadedScene, changes: EffectChanges, reasons: dict[str, str]
) -> tuple[EffectEstimate, ...]:
    """The estimates of all mechanical effects."""
    asperities = loaded.problem.height.size
    contacts = loaded.sample.stride * int(np.count_nonzero(loaded.base.contact_radius))
    requested = requested_outputs(loaded.scene.tolerance.output)
    return tuple(
        EffectEstimate(
            name,
            max(changes.alone[name][output] for output in requested),
            reasons[name],
            cost=solve_cost(name, asperities=asperities, contacts=contacts),
            changes=changes.alone[name],
            doubtful=changes.doubtful(name),
        )
        for name in MECHANICAL_EFFECTS
    )


Answered = tuple[Pair | None, str]
"""The responses without and with an effect, None where it does nothing, and the numbers that decide."""


def _answer(loaded: LoadedScene, effect: str) -> Answered:
    """The responses without and with one effect."""
    if loaded.own_law and effect in OF_CAPS_ONLY:
        return None, f"not defined for asperities {loaded.own_law}"
    return PAIRS[effect](loaded)


def _coupling(loaded: LoadedScene) -> Answered:
    """Independent contacts and fully coupled ones."""
    if loaded.engulfed_pair is not None:
        nothing = np.zeros_like(loaded.sample.problem.gap)
        pair = (loaded.answer(loaded.uncoupled), Response(nothing, nothing, nothing, 0.0))
        return pair, "contacts lie inside each other: with coupling there is no single solution"
    response, caps = loaded.fully_coupled
    pair = (loaded.answer(loaded.uncoupled), loaded.answer(response, caps=caps))
    lowered, state = loaded.sample.at_sample(loaded.state.iterate.displacement), loaded.state.response
    total = float(state.force.sum())
    mean = float(state.force @ lowered) / total
    spread = np.sqrt(float(state.force @ (lowered - mean) ** 2) / total)
    unequal = spread * total / float(state.force @ state.penetration)
    return pair, f"the displacement by the neighbours varies by {unequal:.2g} of the mean indentation"


def _full_coupling(loaded: LoadedScene) -> Answered:
    """Coupling by point forces and full coupling."""
    if not loaded.coupled:
        return None, "coupling is switched off"
    response, caps = loaded.fully_coupled
    return (
        (loaded.with_adhesion, loaded.answer(response, caps=caps)),
        f"the neighbours change the radii of curvature by up to {np.abs(caps.bending).max():.2g}",
    )


def _adhesion(loaded: LoadedScene) -> Answered:
    """Hertz and JKR contacts."""
    if not loaded.adhesion > 0:
        return None, "no work of adhesion is stated"
    base, caps = loaded.base, loaded.sample.problem.caps
    touching = base.force > 0
    p = float(base.force[touching].mean())
    pull = 3 * np.pi * loaded.adhesion * float(caps.radius[touching].mean())
    gain = (pull + np.sqrt(2 * pull * p + pull**2)) / p
    adhered = (
        loaded.with_adhesion if loaded.adheres else loaded.adhered(base, caps, stride=loaded.sample.stride)
    )
    return (base, adhered), f"it adds {gain:.0%} to a^3 of a contact of {p * loaded.problem.force_unit:.2g} N"


def _layer(loaded: LoadedScene) -> Answered:
    """A half-space and a layer on a rigid support."""
    thickness = loaded.scene.need("elastic", PURPOSE).thickness
    if thickness is None:
        return None, "no thickness is stated, so the body is a half-space"
    if not loaded.coupled:
        return None, "coupling, through which the support acts, is switched off"
    on_layer = loaded.scene.effects.layer != "off"
    other = loaded.state.changed(coupling=loaded.sample.coupling(loaded.kernel(layer=not on_layer)))
    other = loaded.answer(other)
    pair = (other, loaded.with_adhesion) if on_layer else (loaded.with_adhesion, other)
    p, touching = loaded.sample.problem, loaded.state.response.force > 0
    x, y = p.x[touching], p.y[touching]
    extent = float(np.hypot(x - x.mean(), y - y.mean()).max()) * p.length
    return pair, f"the loaded region's radius is {extent / thickness:.2g} of the thickness"


def _sphere_profile(loaded: LoadedScene) -> Answered:
    """Parabolic and spherical caps."""
    base, caps = loaded.with_adhesion, loaded.sample.problem.caps
    strain = loaded.aspect * float((base.contact_radius / caps.radius).max())
    law = SphereLaw(loaded.aspect)
    if loaded.adheres:
        exact = loaded.adhered(loaded.base, caps, stride=loaded.sample.stride, aspect=loaded.aspect)
    else:
        exact = loaded.state.changed(law=law) if loaded.coupled else loaded.sample.uncoupled(law)
    return (base, exact), f"a/R up to {strain:.2f}"


OF_CAPS_ONLY = ("full_coupling", "adhesion", "sphere_profile")
"""Effects whose equations hold for spherical caps of one modulus only."""

PAIRS: dict[str, Callable[[LoadedScene], Answered]] = {
    "coupling": _coupling,
    "full_coupling": _full_coupling,
    "adhesion": _adhesion,
    "layer": _layer,
    "sphere_profile": _sphere_profile,
}
"""Effect -> function that returns the responses without it and with it."""
