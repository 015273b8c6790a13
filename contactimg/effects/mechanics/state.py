"""A cheap state of the contact problem, and how it answers when something in its equations changes.

Up to some hundred candidates act on each other one by one; more are gathered in square cells, and of very
many a sample stands for all. One Newton step from the state in changed equations is its response, the
prescribed load included: first order in the change, and as cheap for 10^6 asperities as for 10^4.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from contactimg.models.asperity_laws import AsperityLaw, HertzLaw
from contactimg.models.coarse_grid import CoarseGrid
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

SINGLE = 300
"""Candidates up to which each stands for itself."""

CELLS = 16
"""Cells along the longer side for more candidates than that."""

SAMPLE = 20_000
"""Candidates, evenly over the heights, that stand for more."""

SETTLED = 1e-4
"""Residual of the coupled state: what the smallest changes of interest are compared with."""

ROUNDING = 1e-13
"""Residual below which a change is none."""

MAX_STEPS = 6


@dataclass(frozen=True, eq=False)
class Response:
    """What the sampled asperities do in a state.

    Parameters
    ----------
    force, contact_radius, penetration : ndarray
        One value a sampled asperity, without dimension.
    """

    force: Values
    contact_radius: Values
    penetration: Values


@dataclass(frozen=True, eq=False)
class Stage:
    """The candidates of a problem, in the way they are coupled cheaply.

    Parameters
    ----------
    candidates : ScaledProblem
        What the indenter reaches once the uncoupled forces have lowered the surface.
    stride : int
        Every ``stride``-th candidate, in the order of the heights, stands for as many.
    indentation : float
        Of the uncoupled solution.
    cells : CoarseGrid or None
        Of all candidates; None if each stands for itself.
    """

    candidates: ScaledProblem
    stride: int
    indentation: float
    cells: CoarseGrid | None

    @classmethod
    def of(cls, problem: ScaledProblem) -> "Stage":
        """The candidates of a problem at prescribed load."""
        still = np.zeros_like(problem.gap)
        system = ContactSystem(problem.gap, problem.radius, HertzLaw(), NoCoupling(), problem.load)
        depth = solve_uncoupled(system, still, float(problem.load or 0.0))
        reach = depth + displacement_under_largest_force(problem, system.response(depth - problem.gap)[0])
        candidates = problem.part(slice(int(np.searchsorted(problem.gap, reach, side="right"))))
        single = candidates.gap.size <= SINGLE and candidates.duplicates() is None
        cells = None if single else CoarseGrid.over(candidates, CELLS)
        return cls(candidates, -(-candidates.gap.size // SAMPLE), depth, cells)

    @cached_property
    def problem(self) -> ScaledProblem:
        """The sample."""
        return self.candidates.part(slice(None, None, self.stride))

    @cached_property
    def _sampled_cells(self) -> CoarseGrid | None:
        """The cells with the sample in them."""
        c = self.cells
        return None if c is None else CoarseGrid(c.places[:, :: self.stride], c.shape, c.size)

    def alone(self, law: AsperityLaw) -> Response:
        """The sample without coupling."""
        p = self.problem
        system = ContactSystem(p.gap, p.radius, law, NoCoupling(), float(p.load or 0.0) / self.stride)
        penetration = solve_uncoupled(system, np.zeros_like(p.gap), float(system.load or 0.0)) - p.gap
        return Response(*law.respond(penetration, p.radius), penetration)

    def everywhere_alone(self, law: AsperityLaw) -> Response:
        """All candidates without coupling."""
        penetration = self.indentation - self.candidates.gap
        return Response(*law.respond(penetration, self.candidates.radius), penetration)

    def coupling(self, kernel: Kernel) -> DenseCoupling:
        """Between the candidates or between the cells."""
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
        self, law: AsperityLaw, coupling: Coupling, *, gap: Values | None = None, radius: Values | None = None
    ) -> ContactSystem:
        """The equations, where wanted with other gaps or radii of curvature."""
        p = self.problem
        p = replace(p, gap=p.gap if gap is None else gap, radius=p.radius if radius is None else radius)
        cells = self._sampled_cells
        if cells is None:
            return ContactSystem(p.gap, p.radius, law, coupling, p.load)
        return cells.system(p, law, coupling, weight=self.stride)

    def coupled(self, coupling: Coupling) -> "State":
        """The state of paraboloids with coupling."""
        law, force, cells = HertzLaw(), self.alone(HertzLaw()).force, self._sampled_cells
        system = self.system(law, coupling)
        if cells is not None:
            force = self.stride * cells.sums(force)
        iterate = initial_iterate(system, force, self.indentation)
        for _ in range(MAX_STEPS):
            following = take_step(system, iterate, SETTLED) if iterate.residual > SETTLED else None
            if following is None:
                break
            iterate = following
        return State(self, law, system, iterate)

    def at_sample(self, displacement: Values) -> Values:
        """A displacement of the candidates or cells, at each of the sample."""
        cells = self._sampled_cells
        return displacement if cells is None else displacement[cells.cell]

    def at_all(self, displacement: Values) -> Values:
        """A displacement of the candidates or cells, at each candidate."""
        return displacement if self.cells is None else displacement[self.cells.cell]


@dataclass(frozen=True, eq=False)
class State:
    """A state of the candidates with coupling.

    Parameters
    ----------
    stage : Stage
    law : AsperityLaw
    system : ContactSystem
    iterate : Iterate
    """

    stage: Stage
    law: AsperityLaw
    system: ContactSystem
    iterate: Iterate

    @cached_property
    def response(self) -> Response:
        """Of the sampled asperities."""
        p = self.stage.problem
        return self._response(self.iterate, self.law, p.gap, p.radius)

    def everywhere(self) -> Response:
        """Of all candidates."""
        p = self.stage.candidates
        penetration = self.iterate.indentation - p.gap - self.stage.at_all(self.iterate.displacement)
        return Response(*self.law.respond(penetration, p.radius), penetration)

    def changed(
        self,
        *,
        law: AsperityLaw | None = None,
        coupling: Coupling | None = None,
        gap: Values | None = None,
        radius: Values | None = None,
    ) -> Response:
        """The answer to a change of the law, the coupling, the gaps or the radii of curvature."""
        law = self.law if law is None else law
        operator = self.system.coupling if coupling is None else coupling
        system = self.stage.system(law, operator, gap=gap, radius=radius)
        # the indentation that bears the load takes up what a change does to all alike
        force, displacement = self.iterate.force, operator.displacement(self.iterate.force)
        depth = solve_uncoupled(
            system, displacement, float(system.load or 0.0), guess=self.iterate.indentation
        )
        start = evaluate_iterate(system, force, depth, displacement)
        following = take_step(system, start, SETTLED) if start.residual > ROUNDING else None
        p = self.stage.problem
        return self._response(
            start if following is None else following,
            law,
            p.gap if gap is None else gap,
            p.radius if radius is None else radius,
        )

    def _response(self, iterate: Iterate, law: AsperityLaw, gap: Values, radius: Values) -> Response:
        """Of the sampled asperities in an iterate."""
        penetration = iterate.indentation - gap - self.stage.at_sample(iterate.displacement)
        return Response(*law.respond(penetration, radius), penetration)
