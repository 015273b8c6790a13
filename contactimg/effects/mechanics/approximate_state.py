"""An approximate solution of the contact problem, and its first-order change if the equations change.

Up to some hundred candidates act on each other one by one. More candidates are gathered in the square cells
of a grid, and a sample represents very many. The response to a changed law, coupling, gap or radius is one
Newton step at prescribed load. The time is the same for 10^6 asperities as for 10^4.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from contactimg.models.asperity_laws import AsperityLaw, Caps
from contactimg.models.cells import Cells
from contactimg.models.contact_solver import displacement_under_largest_force
from contactimg.models.coupling import Coupling, DenseCoupling, Kernel, NoCoupling
from contactimg.models.newton_iteration import (
    ContactSystem,
    Iterate,
    evaluate_iterate,
    initial_iterate,
    solve_uncoupled,
    take_step,
)
from contactimg.models.scaled_problem import ScaledProblem

Values = NDArray[np.float64]

MAX_SINGLE_CANDIDATES = 300
"""Number of candidates up to which all pairs are coupled. Chosen by hand; sensitivity not measured."""

CELLS_PER_SIDE = 16
"""Number of cells along the longer side beyond that. Chosen: estimates then differ by up to a quarter."""

REACH_MARGIN = 0.1
"""Asperities beyond the estimated reach by this fraction of it are candidates, too.

Measured: the error of the penetrations is below 6 % of the largest where cells replace neighbours; full
coupling and the profile of the sphere change the indentation by less.
"""

MAX_SAMPLED_CANDIDATES = 20_000
"""Largest number of candidates that are computed, evenly over the heights. Chosen to bound the time."""

STATE_RESIDUAL = 1e-4
"""Residual of the coupled state, chosen below the smallest changes of interest."""

ROUNDING_RESIDUAL = 1e-13
"""Residual below which the equations count as unchanged: rounding error."""

MAX_NEWTON_STEPS = 6
"""Largest number of Newton steps of the coupled state. A safety limit, chosen by hand."""


@dataclass(frozen=True, eq=False)
class Response:
    """Forces, contact radii and penetrations of asperities.

    Parameters
    ----------
    force, contact_radius, penetration : ndarray
        One value per asperity, dimensionless.
    indentation : float
    """

    force: Values
    contact_radius: Values
    penetration: Values
    indentation: float


class CoarseGrid(Cells):
    """Cells whose coupling and laws count a sample of the asperities."""

    def coupling(self, kernel: Kernel, *, own: float | Values = 1.0) -> DenseCoupling:
        """Coupling between cell centres; ``own``: share of a cell's force that acts on the cell itself."""
        row, column = (
            self.size * k.astype(np.float64) for k in np.unravel_index(np.arange(self.count), self.shape)
        )
        # a uniform pressure on a square of side h lowers its middle by 4 asinh(1)/(pi h) of the force
        uniform = 4 * np.arcsinh(1.0) / self.size
        return DenseCoupling(column, row, kernel, own=own * uniform / np.pi)

    def system(
        self, problem: ScaledProblem, law: AsperityLaw, coupling: Coupling, *, weight: float = 1.0
    ) -> ContactSystem:
        """Equations of the cells, each as high as its highest asperity; every asperity counts ``weight``."""
        highest = np.full(self.count, np.inf)
        np.minimum.at(highest, self.cell, problem.gap)
        numbers = np.arange(1.0, self.count + 1)
        depth = problem.gap - highest[self.cell]
        cells = _CellLaw(law, depth, problem.caps, self.cell, self.count, weight)
        return ContactSystem(highest, Caps(numbers), cells, coupling, problem.load, problem.stiffness)


@dataclass(frozen=True, eq=False)
class _CellLaw:
    """Sum of the asperity laws in each cell, as one law per cell.

    A cell has no radius of curvature; ``respond`` gets the number of the cell, from one, in its place.
    """

    law: AsperityLaw
    depth: Values
    caps: Caps
    cell: NDArray[np.intp]
    count: int
    weight: float

    def respond(self, penetration: Values, caps: Caps) -> tuple[Values, Values]:
        """Sums over each cell of the forces and of the contact radii (half the stiffness)."""
        numbers = caps.radius.astype(np.intp) - 1
        lowered = np.full(self.count, -np.inf)
        lowered[numbers] = penetration
        inside = lowered[self.cell] - self.depth
        touching = np.flatnonzero(inside > 0)
        responses = self.law.respond(inside[touching], self.caps[touching])
        force, contact_radius = (self.weight * _sums(self.cell[touching], r, self.count) for r in responses)
        return force[numbers], contact_radius[numbers]


def _sums(cell: NDArray[np.intp], values: Values, count: int) -> Values:
    """Sums over cells."""
    return np.bincount(cell, values, count).astype(np.float64, copy=False)


@dataclass(frozen=True, eq=False)
class CandidateSample:
    """The candidates for contact of a problem, the sample of them that is solved, and its cells.

    Parameters
    ----------
    candidates : ScaledProblem
        The asperities that the indenter can reach, in order of their gaps.
    stride : int
        The sample is every ``stride``-th candidate.
    indentation : float
        Indentation of the uncoupled solution.
    cells : CoarseGrid or None
        The cells of all candidates; None if all pairs are coupled.
    law : AsperityLaw
        Of the state that the effects are compared with.
    """

    candidates: ScaledProblem
    stride: int
    indentation: float
    cells: CoarseGrid | None
    law: AsperityLaw

    @classmethod
    def of(cls, problem: ScaledProblem, law: AsperityLaw, *, pulled: float = 0.0) -> "CandidateSample":
        """The candidates of a problem at prescribed load; adhesion adds up to ``pulled`` to the indentation.

        Those just out of contact are among them: an effect may bring them into contact.
        """
        still = np.zeros_like(problem.gap)
        system = ContactSystem(problem.gap, problem.caps, law, NoCoupling(), problem.load)
        depth = solve_uncoupled(system, still, float(problem.load or 0.0))
        lowered = displacement_under_largest_force(problem, system.response(depth - problem.gap)[0])
        reach = (1 + REACH_MARGIN) * (depth + lowered) + pulled
        candidates = problem.part(slice(int(np.searchsorted(problem.gap, reach, side="right"))))
        single = candidates.gap.size <= MAX_SINGLE_CANDIDATES and candidates.duplicates() is None
        cells = None if single else CoarseGrid.over(candidates.x, candidates.y, CELLS_PER_SIDE)
        return cls(candidates, -(-candidates.gap.size // MAX_SAMPLED_CANDIDATES), depth, cells, law)

    @cached_property
    def problem(self) -> ScaledProblem:
        """The sampled candidates."""
        return self.candidates.part(slice(None, None, self.stride))

    @cached_property
    def _sampled_cells(self) -> CoarseGrid | None:
        """The cells with the sample in them."""
        c = self.cells
        return None if c is None else CoarseGrid(c.places[:, :: self.stride], c.shape, c.size)

    def uncoupled(self, law: AsperityLaw) -> Response:
        """Response of the sample without coupling."""
        p = self.problem
        system = ContactSystem(p.gap, p.caps, law, NoCoupling(), float(p.load or 0.0) / self.stride)
        depth = solve_uncoupled(system, np.zeros_like(p.gap), float(system.load or 0.0))
        penetration = depth - p.gap
        return Response(*law.respond(penetration, p.caps), penetration, depth)

    def uncoupled_candidates(self, law: AsperityLaw) -> Response:
        """Response of all candidates without coupling."""
        penetration = self.indentation - self.candidates.gap
        response = law.respond(penetration, self.candidates.caps)
        return Response(*response, penetration, self.indentation)

    def coupling(self, kernel: Kernel) -> DenseCoupling:
        """The coupling between the candidates or between the cells."""
        p, cells = self.problem, self._sampled_cells
        return (
            DenseCoupling(p.x, p.y, kernel)
            if cells is None
            else cells.coupling(kernel, own=self._shared(cells))
        )

    def _shared(self, cells: CoarseGrid) -> Values:
        """Share of a cell's force that the others in it exert on one of its contacts.

        ``1 - sum f^2/(sum f)^2``, with the forces that the asperities of a cell would bear at the depth of
        the lowest candidate.
        """
        depth = float(self.problem.gap.max()) - self.problem.gap
        force = np.sqrt(self.problem.radius) * depth**1.5
        total, squares = cells.sums(force), cells.sums(force**2)
        return 1 - np.divide(squares, self.stride * total**2, out=np.ones_like(total), where=total > 0)

    def system(
        self, law: AsperityLaw, coupling: Coupling, *, gap: Values | None = None, caps: Caps | None = None
    ) -> ContactSystem:
        """The equations of the sample; ``gap`` and ``caps`` replace its own."""
        p = self.problem
        caps = p.caps if caps is None else caps
        p = replace(p, gap=p.gap if gap is None else gap, radius=caps.radius, bends=caps.bends)
        cells = self._sampled_cells
        if cells is None:
            return ContactSystem(p.gap, p.caps, law, coupling, p.load)
        return cells.system(p, law, coupling, weight=self.stride)

    def coupled(self, coupling: Coupling) -> "CoupledState":
        """Solve with coupling."""
        law, force, cells = self.law, self.uncoupled(self.law).force, self._sampled_cells
        system = self.system(law, coupling)
        if cells is not None:
            force = self.stride * cells.sums(force)
        iterate = initial_iterate(system, force, self.indentation)
        for _ in range(MAX_NEWTON_STEPS):
            following = (
                take_step(system, iterate, STATE_RESIDUAL) if iterate.residual > STATE_RESIDUAL else None
            )
            if following is None:
                break
            iterate = following
        return CoupledState(self, law, system, iterate)

    def at_sample(self, displacement: Values) -> Values:
        """The displacement of candidates or cells, at each sampled candidate."""
        cells = self._sampled_cells
        return displacement if cells is None else displacement[cells.cell]

    def at_all(self, displacement: Values) -> Values:
        """The displacement of candidates or cells, at each candidate."""
        return displacement if self.cells is None else displacement[self.cells.cell]


@dataclass(frozen=True, eq=False)
class CoupledState:
    """Coupled contacts of the candidates.

    Parameters
    ----------
    sample : CandidateSample
    law : AsperityLaw
    system : ContactSystem
    iterate : Iterate
    """

    sample: CandidateSample
    law: AsperityLaw
    system: ContactSystem
    iterate: Iterate

    @cached_property
    def response(self) -> Response:
        """Response of the sample."""
        p = self.sample.problem
        return self._response(self.iterate, self.law, p.gap, p.caps)

    def all_candidates(self) -> Response:
        """Response of all candidates."""
        p = self.sample.candidates
        penetration = self.iterate.indentation - p.gap - self.sample.at_all(self.iterate.displacement)
        return Response(*self.law.respond(penetration, p.caps), penetration, self.iterate.indentation)

    def changed(
        self,
        *,
        law: AsperityLaw | None = None,
        coupling: Coupling | None = None,
        gap: Values | None = None,
        caps: Caps | None = None,
    ) -> Response:
        """Response to another law, coupling, gaps or caps, to first order."""
        law = self.law if law is None else law
        operator = self.system.coupling if coupling is None else coupling
        system = self.sample.system(law, operator, gap=gap, caps=caps)
        # the indentation absorbs a displacement that is the same for all contacts
        force, displacement = self.iterate.force, operator.displacement(self.iterate.force)
        depth = solve_uncoupled(
            system, displacement, float(system.load or 0.0), guess=self.iterate.indentation
        )
        start = evaluate_iterate(system, force, depth, displacement)
        following = take_step(system, start, STATE_RESIDUAL) if start.residual > ROUNDING_RESIDUAL else None
        p = self.sample.problem
        return self._response(
            start if following is None else following,
            law,
            p.gap if gap is None else gap,
            p.caps if caps is None else caps,
        )

    def _response(self, iterate: Iterate, law: AsperityLaw, gap: Values, caps: Caps) -> Response:
        """Response of the sample in an iterate."""
        penetration = iterate.indentation - gap - self.sample.at_sample(iterate.displacement)
        return Response(*law.respond(penetration, caps), penetration, iterate.indentation)
