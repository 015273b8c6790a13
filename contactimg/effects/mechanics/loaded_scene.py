"""A scene at one load: the approximate contact state and the ranges of validity that it exceeds."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.effects.mechanics.adhesive_contacts import adhesive_response
from contactimg.effects.mechanics.approximate_state import CandidateSample, CoupledState, Response
from contactimg.effects.mechanics.neighbour_field import FieldTerms, field_terms
from contactimg.effects.output_change import Answer, Asperities, output_changes
from contactimg.errors import ModelRangeError
from contactimg.mechanics.profiles import ProfileUnderLens
from contactimg.models.adhesive_asperity_law import AdhesiveLaw
from contactimg.models.asperity_laws import AsperityLaw, Caps, HertzLaw, left_out_for
from contactimg.models.coupling import Kernel
from contactimg.models.profile_law import PROFILED, ProfileLaw, pressed_profile
from contactimg.models.scaled_problem import ScaledProblem
from contactimg.models.validity import HERTZ_LIMIT, close_pairs, contact_flags
from contactimg.scene import Scene
from contactimg.tables import CONTACTS, Flag

Values = NDArray[np.float64]
Rows = NDArray[np.intp]

PURPOSE = "planning the mechanical effects"

PULLED_DEPTH = 2.0
"""Indentation of an adhesive contact without load over ``(w^2 R/E*^2)^(1/3)``.

Theory: JKR, ``(9 pi/2)^(2/3)/3`` = 1.95.
"""

ENGULFED_DISTANCE = 0.2
"""Distance over contact radius below which two contacts are refused.

Chosen well below 0.64, where coupled contacts become unstable, because these radii are without coupling.
"""


@dataclass(frozen=True, eq=False)
class LoadedScene:
    """A scene at one load with its approximate contact state, in dimensionless quantities.

    Parameters
    ----------
    scene : Scene
    problem : ScaledProblem
    """

    scene: Scene
    problem: ScaledProblem

    @cached_property
    def profile(self) -> ProfileUnderLens | None:
        """The profile of the asperities under the lens where the scene states one."""
        return pressed_profile(self.scene)

    @property
    def own_law(self) -> str:
        """What the asperities are, in words, if they are not spherical caps of one modulus; else empty."""
        if self.profile is not None:
            return PROFILED
        return "" if self.problem.shapes is None else self.problem.shapes.words

    @cached_property
    def law(self) -> AsperityLaw:
        """The law of the state that the effects are compared with: paraboloids, or the stated profile."""
        if self.profile is None:
            return HertzLaw()
        return ProfileLaw(self.profile, self.problem.length, self.problem.depth)

    @cached_property
    def sample(self) -> CandidateSample:
        """The candidates for contact and the sample of them that is solved."""
        pulled = 0.0
        if self.adheres:
            pulled = PULLED_DEPTH * float(np.cbrt(self.adhesion**2 * self.problem.radius.max()))
        return CandidateSample.of(self.problem, self.law, pulled=pulled)

    @cached_property
    def uncoupled(self) -> Response:
        """The sampled contacts without coupling."""
        return self.sample.uncoupled(self.law)

    def kernel(self, *, layer: bool) -> Kernel:
        """Displacement kernel of the scene's layer, if it has one, or of a half-space."""
        thickness = self.scene.elastic.thickness if self.scene.elastic is not None else None
        return Kernel.of_thickness(thickness / self.problem.length if layer and thickness else np.inf)

    @cached_property
    def state(self) -> CoupledState:
        """The coupled state; on the layer unless that is switched off."""
        kernel = self.kernel(layer=self.scene.effects.layer != "off")
        return self.sample.coupled(self.sample.coupling(kernel))

    @property
    def coupled(self) -> bool:
        """Whether coupling between the contacts is not switched off."""
        return self.scene.effects.coupling != "off"

    @property
    def base(self) -> Response:
        """The state that the effects other than coupling are compared with."""
        return self.state.response if self.coupled else self.uncoupled

    @property
    def aspect(self) -> float:
        """Ratio of the units of height and of length."""
        return self.problem.depth / self.problem.length

    @property
    def adhesion(self) -> float:
        """Dimensionless work of adhesion."""
        elastic = self.scene.need("elastic", PURPOSE)
        depth = self.problem.depth
        return float(elastic.work_of_adhesion / (elastic.contact_modulus * depth) / self.aspect)

    @property
    def adheres(self) -> bool:
        """Whether the contacts adhere and this is not switched off."""
        return not self.own_law and self.adhesion > 0 and self.scene.effects.adhesion != "off"

    def adhered(self, response: Response, caps: Caps, *, stride: int = 1, aspect: float = 0.0) -> Response:
        """The contacts of a response with the JKR law; it holds one in ``stride`` of all asperities."""
        adhered = adhesive_response(
            -response.penetration,
            caps,
            law=AdhesiveLaw(self.adhesion, aspect),
            load=float(self.problem.load or 0.0) / stride,
            indentation=0.0,
        )
        return replace(adhered, indentation=response.indentation + adhered.indentation)

    def answer(self, response: Response, *, caps: Caps | None = None) -> Response:
        """A response of the sample, with adhesion if the contacts adhere."""
        caps = self.sample.problem.caps if caps is None else caps
        return self.adhered(response, caps, stride=self.sample.stride) if self.adheres else response

    @cached_property
    def with_adhesion(self) -> Response:
        """The base state, with adhesion if the contacts adhere."""
        return self.answer(self.base)

    @cached_property
    def asperities(self) -> Asperities:
        """The sampled asperities with their annuli about the apex of the indenter."""
        p, (x0, y0) = self.sample.problem, self.scene.need("indenter", PURPOSE).apex
        distance = np.hypot(p.x * self.problem.length - x0, p.y * self.problem.length - y0)
        return Asperities.about(distance, p.radius)

    def changes(self, without: Response, complete: Response) -> dict[str, float]:
        """Relative change of every output between two responses."""
        rows = self.sample.problem.order
        return output_changes(
            self.asperities,
            without=Answer(without.force, self.radii(without, rows), without.indentation),
            complete=Answer(complete.force, self.radii(complete, rows), complete.indentation),
        )

    def radii(self, response: Response, rows: Rows) -> Values:
        """Contact radii of a response of the asperities ``rows``: those whose areas are the contacts'."""
        shapes, unit = self.problem.shapes, self.problem.length
        if shapes is None:
            return response.contact_radius
        force = np.zeros(self.problem.height.size)
        force[rows] = response.force * unit * self.problem.depth
        return shapes.contact_radius(force)[rows] / unit

    @cached_property
    def all_candidates(self) -> Response:
        """Response of all candidates."""
        p = self.sample.candidates
        response = self.state.all_candidates() if self.coupled else self.sample.uncoupled_candidates(self.law)
        return self.adhered(response, p.caps) if self.adheres else response

    @cached_property
    def touching(self) -> Rows:
        """Rows of the candidates that are in contact."""
        return np.flatnonzero(self.all_candidates.contact_radius)

    @cached_property
    def flags(self) -> NDArray[np.int64]:
        """Flags of the contacts."""
        p, rows = self.sample.candidates, self.touching
        strain_radius = p.radius[rows] / self.aspect  # radii of curvature have a unit of their own
        if p.shapes is not None:
            strain_radius = p.shapes.strain_radius[p.order[rows]] / p.length
        return contact_flags(
            p.x[rows], p.y[rows], self.radii(self.all_candidates, p.order)[rows], strain_radius
        )

    def contacts(self) -> pd.DataFrame:
        """Table of all contacts."""
        p, response, rows = self.sample.candidates, self.all_candidates, self.touching
        x, y, a = (v[rows] * self.problem.length for v in (p.x, p.y, self.radii(response, p.order)))
        return CONTACTS.conform(
            pd.DataFrame(
                {
                    "label": np.arange(1, rows.size + 1),
                    "x_m": x,
                    "y_m": y,
                    "radius_m": a,
                    "area_m2": np.pi * a**2,
                    "asperity": p.order[rows],
                    "force_N": response.force[rows] * self.problem.force_unit,
                    "flags": self.flags,
                }
            )
        )

    @cached_property
    def engulfed_pair(self) -> tuple[int, int] | None:
        """Rows of two asperities, if any, that lie far inside each other's contact without coupling."""
        p, response = self.sample.candidates, self.sample.uncoupled_candidates(self.law)
        rows = np.flatnonzero(response.contact_radius)
        i, j, _ = close_pairs(p.x[rows], p.y[rows], ENGULFED_DISTANCE * response.contact_radius[rows])
        if not i.size:
            return None
        first, second = sorted(int(p.order[rows[k[0]]]) for k in (i, j))
        return first, second

    def check_engulfed(self) -> None:
        """Raise `ModelRangeError` if coupled contacts lie far inside each other."""
        if self.coupled and self.engulfed_pair is not None:
            first, second = self.engulfed_pair
            raise ModelRangeError(
                f"asperities: rows {first} and {second} would overlap so far that several solutions exist; "
                "lower the load or merge them"
            )

    def limits(self) -> Iterator[str]:
        """Sentences on the ranges of validity that are exceeded."""
        sentences = {
            Flag.BEYOND_HERTZ: f"have a/R above {HERTZ_LIMIT}, where the Hertz law is no longer accurate",
            Flag.OVERLAP: "overlap a neighbour and would merge with it",
        }
        for flag, sentence in sentences.items():
            count = int(np.count_nonzero(self.flags & flag))
            if count:
                yield f"about {count} of {self.flags.size} contacts {sentence}"
        if self.own_law:
            yield left_out_for(self.own_law)

    @cached_property
    def field_terms(self) -> FieldTerms:
        """What full coupling adds to the candidates; nothing where it is not defined."""
        p, response = self.sample.candidates, self.state.all_candidates()
        zero = np.zeros_like(p.gap)
        terms = FieldTerms(zero, np.zeros((p.gap.size, 2)), zero.copy())
        if self.own_law:
            return terms
        rows = np.flatnonzero(response.force)
        found = field_terms(
            p.x[rows],
            p.y[rows],
            p.radius[rows],
            force=response.force[rows],
            contact_radius=response.contact_radius[rows],
            kernel=self.kernel(layer=self.scene.effects.layer != "off"),
        )
        terms.rise[rows], terms.bends[rows], terms.squared[rows] = found.rise, found.bends, found.squared
        return terms

    @cached_property
    def fully_coupled(self) -> tuple[Response, Caps]:
        """Response with full coupling, and the caps with what it adds to their profiles."""
        p, stride = self.sample.problem, self.sample.stride
        if self.own_law:
            return self.state.response, p.caps
        caps = replace(p.caps, bends=self.field_terms.bends[::stride])
        return self.state.changed(gap=p.gap + self.field_terms.rise[::stride], caps=caps), caps
