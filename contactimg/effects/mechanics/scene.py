"""One scene under one load: its cheap state, the contacts in it, and the limits of the models they reach."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.effects.change import relative_change
from contactimg.effects.mechanics.adhesion import adhesive_response
from contactimg.effects.mechanics.fields import field_terms
from contactimg.effects.mechanics.state import Response, Stage, State
from contactimg.errors import ModelRangeError
from contactimg.models.adhesive_asperity_law import AdhesiveLaw
from contactimg.models.asperity_laws import HertzLaw
from contactimg.models.coupling import Kernel
from contactimg.models.scaled_problem import ScaledProblem
from contactimg.models.validity import HERTZ_LIMIT, close_pairs, contact_flags
from contactimg.scene import Scene
from contactimg.tables import CONTACTS, Flag

Values = NDArray[np.float64]
Rows = NDArray[np.intp]

PURPOSE = "planning the mechanical effects"

GAP_ERROR = 0.1
"""Error of the state's penetrations: below 6 % of the deepest where cells stand for neighbours."""

ENGULFED = 0.2
"""Distance over contact radius below which two contacts are one; coupled, they are unstable from 0.64 on."""


@dataclass(frozen=True, eq=False)
class LoadedScene:
    """One scene under one load, in a cheap state; without dimension.

    Parameters
    ----------
    scene : Scene
    problem : ScaledProblem
    """

    scene: Scene
    problem: ScaledProblem

    @cached_property
    def stage(self) -> Stage:
        """The candidates."""
        return Stage.of(self.problem)

    @cached_property
    def alone(self) -> Response:
        """Without coupling."""
        return self.stage.alone(HertzLaw())

    def kernel(self, *, layer: bool) -> Kernel:
        """Of the scene's layer, if it has one, or of a half-space."""
        thickness = self.scene.elastic.thickness if self.scene.elastic is not None else None
        return Kernel.of_thickness(thickness / self.problem.length if layer and thickness else np.inf)

    @cached_property
    def state(self) -> State:
        """With coupling; on the layer unless that is switched off."""
        kernel = self.kernel(layer=self.scene.effects.layer != "off")
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
        depth = self.problem.depth
        return float(elastic.work_of_adhesion / (elastic.contact_modulus * depth) / self.aspect)

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

    @cached_property
    def base_gap(self) -> float:
        """Least distance of the indenter from the plane that the touched caps stand on, m."""
        rows, depth = self.touching, self.problem.depth * self.everywhere.penetration
        return float(np.min(self.problem.height[self.stage.candidates.order[rows]] - depth[rows]))

    @property
    def unsure(self) -> float:
        """Error of that distance, m."""
        return GAP_ERROR * self.problem.depth * float(self.everywhere.penetration.max())

    def refuse_touching_planes(self) -> None:
        """`ModelRangeError` if the indenter surely reaches the plane between the asperities."""
        if self.base_gap < -self.unsure:
            load = float(self.problem.load or 0.0) * self.problem.force_unit
            raise ModelRangeError(
                f"at {load:g} N the indenter lies about {-self.base_gap * 1e6:.3g} um below the plane "
                "between the asperities: the planes touch, outside every asperity model; lower the load"
            )

    def limits(self) -> Iterator[str]:
        """Sentences on the limits of the models that are reached."""
        sentences = {
            Flag.BEYOND_HERTZ: f"have a/R above {HERTZ_LIMIT}: beyond Hertz's law",
            Flag.OVERLAP: "overlap a neighbour: they would merge",
        }
        for flag, sentence in sentences.items():
            count = int(np.count_nonzero(self.flags & flag))
            if count:
                yield f"about {count} of {self.flags.size} contacts {sentence}"
        if self.base_gap < self.unsure:
            yield (
                f"the indenter comes to {self.base_gap * 1e6:.2g} um, give or take "
                f"{self.unsure * 1e6:.2g} um, of the plane between the asperities: the solution will tell "
                "whether the planes touch"
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
            kernel=self.kernel(layer=self.scene.effects.layer != "off"),
        )
        gap, radius = (
            self.stage.problem.gap + lowering[::stride],
            self.stage.problem.radius / bending[::stride],
        )
        return self.state.changed(gap=gap, radius=radius), radius, float(np.abs(bending - 1).max())
