"""A-priori estimates of the mechanical effects, each from the response of one cheap state of the scene.

The state is the coupled one with point forces, approached from the uncoupled solution
(`contactimg.effects.mechanics_state`); where the contacts adhere, JKR's law in its displacement. An effect's
change is that between two such states, with it and without.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.effects.change import relative_change
from contactimg.effects.estimate import Estimate
from contactimg.effects.mechanics_adhesion import adhesive_response
from contactimg.effects.mechanics_cost import solve_cost
from contactimg.effects.mechanics_fields import field_terms
from contactimg.effects.mechanics_state import Response, Stage, State
from contactimg.errors import InputError, ModelRangeError
from contactimg.models.adhesive_laws import AdhesiveLaw
from contactimg.models.coupling import Kernel
from contactimg.models.local_laws import HertzLaw, SphereLaw
from contactimg.models.problem import Problem, Setting, pose_problem
from contactimg.models.validity import close_pairs, contact_flags
from contactimg.scene import Scene
from contactimg.tables import CONTACTS

__all__ = ["MECHANICAL_EFFECTS", "Weighing", "estimate_mechanics", "weigh_mechanics"]

Values = NDArray[np.float64]
Rows = NDArray[np.intp]

MECHANICAL_EFFECTS = ("coupling", "full_coupling", "adhesion", "layer", "sphere_profile")

PURPOSE = "planning the mechanical effects"

ENGULFED = 0.2
"""Distance over contact radius below which two contacts are one; coupled, they are unstable from 0.64 on."""


@dataclass(frozen=True, eq=False)
class Weighing:
    """The mechanical effects of a scene, weighed.

    Parameters
    ----------
    estimates : tuple of Estimate
        In the order of `MECHANICAL_EFFECTS`.
    flags : ndarray
        Of the contacts of the cheap state.
    contacts : callable
        Makes their table.
    """

    estimates: tuple[Estimate, ...]
    flags: NDArray[np.int64]
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
        Negative only where the contacts adhere.

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
    adheres = elastic.work_of_adhesion > 0 and scene.effects.adhesion != "off"
    if not (np.isfinite(load) and (load >= 0 or adheres)):
        raise InputError(
            f"load must be finite, and positive unless the contacts adhere, got {load!r} N; give another"
        )
    setting = Setting(indenter.radius, elastic.contact_modulus, indenter.apex, np.inf, load, None)
    problem = pose_problem(asperities, setting)
    if load <= 0 or not problem.touches:
        return Weighing(_unloaded(load, adheres=adheres), np.zeros(0, dtype=np.int64), CONTACTS.empty)
    found = _Mechanics(scene, problem)
    found.refuse_engulfed()
    found.refuse_touching_planes()
    return Weighing(found.estimates(), found.flags, found.contacts)


def _unloaded(load: float, *, adheres: bool) -> tuple[Estimate, ...]:
    """Estimates without a load: only adhesion makes contacts."""
    reason = f"at {load:g} N there is no contact"
    changes = dict.fromkeys(MECHANICAL_EFFECTS, 0.0) | {"adhesion": 1.0 if adheres else 0.0}
    reasons = {"adhesion": "only adhesion makes contacts at this load"} if adheres else {}
    return tuple(Estimate(name, changes[name], reasons.get(name, reason)) for name in MECHANICAL_EFFECTS)


@dataclass(frozen=True, eq=False)
class _Mechanics:
    """One scene under one load; without dimension."""

    scene: Scene
    problem: Problem

    @cached_property
    def stage(self) -> Stage:
        """The candidates."""
        return Stage.of(self.problem)

    @cached_property
    def alone(self) -> Response:
        """Without coupling."""
        return self.stage.alone(HertzLaw())

    def _kernel(self, *, layer: bool) -> Kernel:
        """Of the scene's layer, if it has one, or of a half-space."""
        thickness = self.scene.elastic.thickness if self.scene.elastic is not None else None
        return Kernel.of_thickness(thickness / self.problem.length if layer and thickness else np.inf)

    @cached_property
    def state(self) -> State:
        """With coupling; on the layer unless that is switched off."""
        kernel = self._kernel(layer=self.scene.effects.layer != "off")
        return self.stage.coupled(self.stage.coupling(kernel))

    @property
    def coupled(self) -> bool:
        """Whether contacts may act on each other."""
        return self.scene.effects.coupling != "off"

    @property
    def base(self) -> Response:
        """The state from which the effects beyond coupling are judged."""
        return self.state.response if self.coupled else self.alone

    @property
    def aspect(self) -> float:
        """Unit of height over unit of length."""
        return self.problem.depth / self.problem.length

    @property
    def adhesion(self) -> float:
        """Work of adhesion without dimension."""
        elastic = self.scene.need("elastic", PURPOSE)
        return float(
            elastic.work_of_adhesion * self.problem.length / (elastic.contact_modulus * self.problem.depth**2)
        )

    @property
    def adheres(self) -> bool:
        """Whether the contacts may adhere."""
        return self.adhesion > 0 and self.scene.effects.adhesion != "off"

    def adhered(
        self, response: Response, radius: Values, *, stride: int = 1, aspect: float = 0.0
    ) -> Response:
        """The contacts of a response with JKR's law; one in ``stride`` of all asperities is there."""
        return adhesive_response(
            -response.penetration,
            radius,
            law=AdhesiveLaw(self.adhesion, aspect),
            load=float(self.problem.load or 0.0) / stride,
            indentation=0.0,
        )

    def answer(self, response: Response, *, radius: Values | None = None) -> Response:
        """The sample in a response, adhesive where the scene's contacts are."""
        radius = self.stage.problem.radius if radius is None else radius
        return self.adhered(response, radius, stride=self.stage.stride) if self.adheres else response

    @cached_property
    def settled(self) -> Response:
        """The state itself, adhesive where the scene's contacts are."""
        return self.answer(self.base)

    def change(self, without: Response, complete: Response) -> float:
        """Of the output that the scene asks for."""
        return relative_change(
            self.scene.tolerance.output,
            without=(without.force, without.contact_radius),
            complete=(complete.force, complete.contact_radius),
        )

    @cached_property
    def everywhere(self) -> Response:
        """All candidates in the state."""
        p = self.stage.candidates
        found = self.state.everywhere() if self.coupled else self.stage.everywhere_alone(HertzLaw())
        return self.adhered(found, p.radius) if self.adheres else found

    @cached_property
    def touching(self) -> Rows:
        """Which of the candidates are in contact."""
        return np.flatnonzero(self.everywhere.contact_radius)

    @cached_property
    def flags(self) -> NDArray[np.int64]:
        """Flags of the contacts."""
        p, rows = self.stage.candidates, self.touching
        strain_radius = p.radius[rows] / self.aspect  # radii of curvature have a unit of their own
        return contact_flags(p.x[rows], p.y[rows], self.everywhere.contact_radius[rows], strain_radius)

    def contacts(self) -> pd.DataFrame:
        """All contacts in the state."""
        p, found, rows = self.stage.candidates, self.everywhere, self.touching
        x, y, a = (v[rows] * self.problem.length for v in (p.x, p.y, found.contact_radius))
        return CONTACTS.conform(
            pd.DataFrame(
                {
                    "label": np.arange(1, rows.size + 1),
                    "x_m": x,
                    "y_m": y,
                    "radius_m": a,
                    "area_m2": np.pi * a**2,
                    "asperity": p.order[rows],
                    "force_N": found.force[rows] * self.problem.force_unit,
                    "flags": self.flags,
                }
            )
        )

    @cached_property
    def engulfed(self) -> tuple[int, int] | None:
        """Two asperities far inside each other's contact without coupling, as rows of the table."""
        p, found = self.stage.candidates, self.stage.everywhere_alone(HertzLaw())
        rows = np.flatnonzero(found.contact_radius)
        i, j, _ = close_pairs(p.x[rows], p.y[rows], ENGULFED * found.contact_radius[rows])
        if not i.size:
            return None
        first, second = sorted(int(p.order[rows[k[0]]]) for k in (i, j))
        return first, second

    def refuse_engulfed(self) -> None:
        """`ModelRangeError` if coupled contacts are far inside each other."""
        if self.coupled and self.engulfed is not None:
            first, second = self.engulfed
            raise ModelRangeError(
                f"asperities: rows {first} and {second} would overlap so far that several solutions exist; "
                "lower the load or merge them"
            )

    def refuse_touching_planes(self) -> None:
        """`ModelRangeError` if the indenter reaches the plane between the asperities."""
        rows, depth = self.touching, self.problem.depth * self.everywhere.penetration
        gap = self.problem.height[self.stage.candidates.order[rows]] - depth[rows]
        if gap.size and gap.min() < 0:
            load = float(self.problem.load or 0.0) * self.problem.force_unit
            raise ModelRangeError(
                f"at {load:g} N the indenter lies about {-gap.min() * 1e6:.3g} um below the plane between "
                "the asperities: the planes touch, outside every asperity model; lower the load"
            )

    def estimates(self) -> tuple[Estimate, ...]:
        """Of all mechanical effects."""
        found = {
            "coupling": self._coupling,
            "full_coupling": self._full_coupling,
            "adhesion": self._adhesion,
            "layer": self._layer,
            "sphere_profile": self._sphere_profile,
        }
        contacts = self.stage.stride * int(np.count_nonzero(self.base.contact_radius))
        return tuple(
            Estimate(
                name, *found[name](), solve_cost(name, asperities=self.problem.height.size, contacts=contacts)
            )
            for name in MECHANICAL_EFFECTS
        )

    @cached_property
    def refined(self) -> tuple[Response, Values, float]:
        """The state's response to full coupling, the radii of curvature in it and their largest change."""
        p, found, stride = self.stage.candidates, self.state.everywhere(), self.stage.stride
        rows = np.flatnonzero(found.force)
        lowering, bending = np.zeros_like(p.gap), np.ones_like(p.gap)
        lowering[rows], bending[rows] = field_terms(
            p.x[rows],
            p.y[rows],
            p.radius[rows],
            force=found.force[rows],
            contact_radius=found.contact_radius[rows],
            kernel=self._kernel(layer=self.scene.effects.layer != "off"),
        )
        gap, radius = (
            self.stage.problem.gap + lowering[::stride],
            self.stage.problem.radius / bending[::stride],
        )
        return self.state.changed(gap=gap, radius=radius), radius, float(np.abs(bending - 1).max())

    def _coupling(self) -> tuple[float, str]:
        """Independent contacts against coupled ones, in full."""
        if self.engulfed is not None:
            return 1.0, "contacts lie inside each other: coupled, there is no single solution"
        response, radius, _ = self.refined
        change = self.change(self.answer(self.alone), self.answer(response, radius=radius))
        lowered, state = self.stage.at_sample(self.state.iterate.displacement), self.state.response
        total = float(state.force.sum())
        mean = float(state.force @ lowered) / total
        spread = np.sqrt(float(state.force @ (lowered - mean) ** 2) / total)
        unequal = spread * total / float(state.force @ state.penetration)
        return change, f"the neighbours lower the contacts unequally, by {unequal:.2g} of a mean indentation"

    def _full_coupling(self) -> tuple[float, str]:
        """Point forces against the neighbours' field over the width of a contact."""
        if not self.coupled:
            return 0.0, "coupling is switched off"
        response, radius, bent = self.refined
        change = self.change(self.settled, self.answer(response, radius=radius))
        return change, f"the neighbours' field changes radii of curvature by up to {bent:.2g}"

    def _adhesion(self) -> tuple[float, str]:
        """Hertz's against JKR's contacts."""
        if not self.adhesion > 0:
            return 0.0, "no work of adhesion is stated"
        base, radius = self.base, self.stage.problem.radius
        touching = base.force > 0
        p, pull = (
            float(base.force[touching].mean()),
            3 * np.pi * self.adhesion * float(radius[touching].mean()),
        )
        gain = (pull + np.sqrt(2 * pull * p + pull**2)) / p
        adhered = self.settled if self.adheres else self.adhered(base, radius, stride=self.stage.stride)
        change = self.change(base, adhered)
        return (
            change,
            f"adhesion adds {gain:.2g} of itself to a^3 of a contact of {p * self.problem.force_unit:.2g} N",
        )

    def _layer(self) -> tuple[float, str]:
        """Half-space against layer."""
        thickness = self.scene.need("elastic", PURPOSE).thickness
        if thickness is None:
            return 0.0, "no thickness is stated: a half-space"
        if not self.coupled:
            return 0.0, "coupling, by which the support is felt, is switched off"
        on_layer = self.scene.effects.layer != "off"
        other = self.state.changed(coupling=self.stage.coupling(self._kernel(layer=not on_layer)))
        pair = (self.answer(other), self.settled)
        change = self.change(*(pair if on_layer else pair[::-1]))
        p, touching = self.stage.problem, self.state.response.force > 0
        x, y = p.x[touching], p.y[touching]
        extent = float(np.hypot(x - x.mean(), y - y.mean()).max()) * p.length
        return change, f"the loaded region's radius is {extent / thickness:.2g} of the thickness"

    def _sphere_profile(self) -> tuple[float, str]:
        """Paraboloids against spheres."""
        base, radius = self.settled, self.stage.problem.radius
        strain = self.aspect * float((base.contact_radius / radius).max())
        law = SphereLaw(self.aspect)
        if self.adheres:
            exact = self.adhered(self.base, radius, stride=self.stage.stride, aspect=self.aspect)
        else:
            exact = self.state.changed(law=law) if self.coupled else self.stage.alone(law)
        return self.change(base, exact), f"a/R up to {strain:.2f}"
