"""A-priori estimates of the mechanical effects, each from the response of one cheap state of the scene.

The state is the coupled one with point forces, approached from the uncoupled solution
(`contactimg.effects.mechanics.state`); where the contacts adhere, JKR's law in its displacement. An effect's
change is that between two such states, with it and without.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from contactimg.effects.estimate import Estimate
from contactimg.effects.mechanics.cost import solve_cost
from contactimg.effects.mechanics.scene import PURPOSE, LoadedScene
from contactimg.errors import InputError
from contactimg.mechanics import jkr
from contactimg.models.asperity_laws import SphereLaw
from contactimg.models.scaled_problem import ContactConditions, scale_problem
from contactimg.scene import Scene
from contactimg.tables import CONTACTS

MECHANICAL_EFFECTS = ("coupling", "full_coupling", "adhesion", "layer", "sphere_profile")


HARDLY_PRESSED = 1e-3
"""Load at which adhesive contacts without a load, or under a pull, are weighed; of the pull-off force."""


@dataclass(frozen=True, eq=False)
class Weighing:
    """The mechanical effects of a scene, weighed.

    Parameters
    ----------
    estimates : tuple of Estimate
        In the order of `MECHANICAL_EFFECTS`.
    limits : tuple of str
        One sentence for each limit of the models that contacts exceed, and are computed beyond.
    contacts : callable
        Makes their table.
    """

    estimates: tuple[Estimate, ...]
    limits: tuple[str, ...]
    contacts: Callable[[], pd.DataFrame]


def estimate_mechanics(
    scene: Scene, asperities: pd.DataFrame, *, load: float
) -> tuple[pd.DataFrame, tuple[Estimate, ...]]:
    """What each mechanical effect changes of the requested output at a load.

    Parameters
    ----------
    scene : Scene
        Sections ``[indenter]`` and ``[elastic]`` are needed; ``[tolerance]`` says which output counts. An
        effect that is switched off does not act on the others.
    asperities : DataFrame
        Columns ``x_m, y_m, height_m, radius_m``.
    load : float, N
        Negative only where the contacts adhere; without a load or under a pull these are weighed as if they
        were hardly pressed.

    Returns
    -------
    contacts : DataFrame
        The contacts of the cheap state, radii good to some per cent; the schema `CONTACTS`, in metres.
    estimates : tuple of Estimate
        In the order of `MECHANICAL_EFFECTS`.

    Raises
    ------
    InputError
        If a section is missing or the load breaks its rule.
    ModelRangeError
        If the indenter reaches the plane between the asperities, or two contacts engulf each other.

    Notes
    -----
    Against switching each effect in the full model the estimates are off by some per cent; where the smooth
    displacement of cells stands for the neighbours (beyond 300 candidates) by up to a quarter.

    Examples
    --------
    >>> from contactimg.scene import scene_from_dict
    >>> pair = pd.DataFrame(
    ...     {"x_m": [0.0, 1e-4], "y_m": [0.0, 0.0], "height_m": [4e-5, 4e-5], "radius_m": [1e-4, 1e-4]}
    ... )
    >>> scene = scene_from_dict(
    ...     {"indenter": {"radius_m": 1.0}, "elastic": {"young_modulus_Pa": 3e6}}
    ... )
    >>> contacts, estimates = estimate_mechanics(scene, pair, load=3e-3)
    >>> len(contacts), [estimate.effect for estimate in estimates if estimate.change > 0.01]
    (2, ['sphere_profile'])
    """
    weighing = weigh_mechanics(scene, asperities, load=load)
    return weighing.contacts(), weighing.estimates


def weigh_mechanics(scene: Scene, asperities: pd.DataFrame, *, load: float) -> Weighing:
    """`estimate_mechanics`, the table of contacts left to be made where it is wanted."""
    indenter, elastic = scene.need("indenter", PURPOSE), scene.need("elastic", PURPOSE)
    scene.check_effects()
    adheres = elastic.work_of_adhesion > 0 and scene.effects.adhesion != "off"
    if not (np.isfinite(load) and (load >= 0 or adheres)):
        left_out = "; adhesion is left out here" if elastic.work_of_adhesion > 0 and not adheres else ""
        raise InputError(
            f"load must be finite, and positive unless the contacts adhere, got {load!r} N{left_out}; "
            "give another"
        )
    pressed = load
    if load <= 0 and adheres and len(asperities):
        radius = float(np.median(asperities["radius_m"]))
        pull = jkr.pull_off_load(sphere_radius=radius, work_of_adhesion=elastic.work_of_adhesion)
        pressed = -HARDLY_PRESSED * pull
    setting = ContactConditions(
        indenter.radius, elastic.contact_modulus, indenter.apex, np.inf, pressed, None
    )
    problem = scale_problem(asperities, setting)
    if not problem.touches:
        none = tuple(Estimate(name, 0.0, f"at {load:g} N there is no contact") for name in MECHANICAL_EFFECTS)
        return Weighing(none, (), CONTACTS.empty)
    loaded = LoadedScene(scene, problem)
    loaded.refuse_engulfed()
    loaded.refuse_touching_planes()
    estimates = _estimates(loaded)
    if load <= 0:
        alone = "without adhesion there is no contact at this load"
        estimates = tuple(
            replace(e, change=1.0, reason=alone) if e.effect == "adhesion" else e for e in estimates
        )
    return Weighing(estimates, tuple(loaded.limits()), loaded.contacts)


def _estimates(loaded: LoadedScene) -> tuple[Estimate, ...]:
    """Of all mechanical effects."""
    found = {
        "coupling": _coupling,
        "full_coupling": _full_coupling,
        "adhesion": _adhesion,
        "layer": _layer,
        "sphere_profile": _sphere_profile,
    }
    size = {
        "asperities": loaded.problem.height.size,
        "contacts": loaded.stage.stride * int(np.count_nonzero(loaded.base.contact_radius)),
    }
    return tuple(
        Estimate(name, *found[name](loaded), cost=solve_cost(name, **size)) for name in MECHANICAL_EFFECTS
    )


def _coupling(loaded: LoadedScene) -> tuple[float, str]:
    """Independent contacts against coupled ones, in full."""
    if loaded.engulfed is not None:
        return 1.0, "contacts lie inside each other: coupled, there is no single solution"
    response, radius, _ = loaded.refined
    change = loaded.change(loaded.answer(loaded.alone), loaded.answer(response, radius=radius))
    lowered, state = loaded.stage.at_sample(loaded.state.iterate.displacement), loaded.state.response
    total = float(state.force.sum())
    mean = float(state.force @ lowered) / total
    spread = np.sqrt(float(state.force @ (lowered - mean) ** 2) / total)
    unequal = spread * total / float(state.force @ state.penetration)
    return change, f"the neighbours lower the contacts unequally, by {unequal:.2g} of a mean indentation"


def _full_coupling(loaded: LoadedScene) -> tuple[float, str]:
    """Point forces against the neighbours' field over the width of a contact."""
    if not loaded.coupled:
        return 0.0, "coupling is switched off"
    response, radius, bent = loaded.refined
    change = loaded.change(loaded.settled, loaded.answer(response, radius=radius))
    return change, f"the neighbours' field changes radii of curvature by up to {bent:.2g}"


def _adhesion(loaded: LoadedScene) -> tuple[float, str]:
    """Hertz's against JKR's contacts."""
    if not loaded.adhesion > 0:
        return 0.0, "no work of adhesion is stated"
    base, radius = loaded.base, loaded.stage.problem.radius
    touching = base.force > 0
    p = float(base.force[touching].mean())
    pull = 3 * np.pi * loaded.adhesion * float(radius[touching].mean())
    gain = (pull + np.sqrt(2 * pull * p + pull**2)) / p
    adhered = loaded.settled if loaded.adheres else loaded.adhered(base, radius, stride=loaded.stage.stride)
    change = loaded.change(base, adhered)
    return change, f"it adds {gain:.0%} to a^3 of a contact of {p * loaded.problem.force_unit:.2g} N"


def _layer(loaded: LoadedScene) -> tuple[float, str]:
    """Half-space against layer."""
    thickness = loaded.scene.need("elastic", PURPOSE).thickness
    if thickness is None:
        return 0.0, "no thickness is stated: a half-space"
    if not loaded.coupled:
        return 0.0, "coupling, by which the support is felt, is switched off"
    on_layer = loaded.scene.effects.layer != "off"
    other = loaded.state.changed(coupling=loaded.stage.coupling(loaded.kernel(layer=not on_layer)))
    pair = (loaded.answer(other), loaded.settled)
    change = loaded.change(*(pair if on_layer else pair[::-1]))
    p, touching = loaded.stage.problem, loaded.state.response.force > 0
    x, y = p.x[touching], p.y[touching]
    extent = float(np.hypot(x - x.mean(), y - y.mean()).max()) * p.length
    return change, f"the loaded region's radius is {extent / thickness:.2g} of the thickness"


def _sphere_profile(loaded: LoadedScene) -> tuple[float, str]:
    """Paraboloids against spheres."""
    base, radius = loaded.settled, loaded.stage.problem.radius
    strain = loaded.aspect * float((base.contact_radius / radius).max())
    law = SphereLaw(loaded.aspect)
    if loaded.adheres:
        exact = loaded.adhered(loaded.base, radius, stride=loaded.stage.stride, aspect=loaded.aspect)
    else:
        exact = loaded.state.changed(law=law) if loaded.coupled else loaded.stage.alone(law)
    return loaded.change(base, exact), f"a/R up to {strain:.2f}"
