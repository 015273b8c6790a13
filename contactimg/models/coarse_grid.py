"""Starting values for many contacts: the contact problem averaged over a coarse grid of square cells.

The asperities of a cell share one displacement, and the sum of their forces displaces the other cells. This
small dense problem gives the displacement of the pattern without its variation inside a cell.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.models.asperity_laws import AsperityLaw, Caps
from contactimg.models.cells import Cells
from contactimg.models.coupling import DenseCoupling, Kernel, NoCoupling
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

GRID_CELLS = 48
"""Cells along the longer side. Chosen by time: a Newton step on all 48 x 48 cells takes 0.1 s."""

GRID_RESIDUAL = 1e-2
"""Residual at which the grid's problem counts as solved. Chosen by hand: the variation inside a cell is no
smaller; it affects the number of steps of the fine problem, not its solution."""

MAX_GRID_STEPS = 10
"""Most Newton steps on the grid. Chosen by hand; sensitivity not measured."""


@dataclass(frozen=True, eq=False)
class GridStart:
    """A start for asperities of which those of a cell share a displacement.

    Parameters
    ----------
    problem : ScaledProblem
    law : AsperityLaw
    cells : Cells
    coupling : DenseCoupling
        Of the cells.
    force, penetration : ndarray
        Of the asperities.
    indentation : float
    """

    problem: ScaledProblem
    law: AsperityLaw
    cells: Cells
    coupling: DenseCoupling
    force: Values
    penetration: Values
    indentation: float

    @classmethod
    def of(
        cls, problem: ScaledProblem, law: AsperityLaw, kernel: Kernel, force: Values, indentation: float
    ) -> "GridStart":
        """The start from the displacement of the grid's cells.

        ``force`` and ``indentation`` are those without coupling.
        """
        cells = Cells.over(problem.x, problem.y, GRID_CELLS)
        start = cls(problem, law, cells, cells.coupling(kernel), force, force, indentation)
        system = start._system(problem)
        state = _solve_cells(system, initial_iterate(system, cells.sums(force), indentation))
        return start._lowered(cells.interpolated(state.displacement), state.indentation)

    def part(self, kept: NDArray[np.bool_]) -> "GridStart":
        """The same for some of the asperities."""
        cells = Cells(self.cells.places[:, kept], self.cells.shape, self.cells.size)
        values = self.force[kept], self.penetration[kept], self.indentation
        return GridStart(self.problem.part(kept), self.law, cells, self.coupling, *values)

    def corrected(self, displacement: Values) -> "GridStart":
        """A better start from the displacement by the forces of this one, computed pair by pair.

        The cells are solved for what their displacement differs by from that of these forces.
        """
        cells = self.cells
        force = cells.sums(self.force)
        before = self.coupling.displacement(force)
        within = replace(self.problem, gap=self.problem.gap + displacement - before[cells.cell])
        system = self._system(within)
        state = _solve_cells(system, evaluate_iterate(system, force, self.indentation, before))
        change = cells.interpolated(state.displacement - before)
        return self._lowered(displacement + change, state.indentation)

    def _system(self, problem: ScaledProblem) -> ContactSystem:
        """Equations of the cells, each as high as its highest asperity."""
        cells = self.cells
        highest = np.full(cells.count, np.inf)
        np.minimum.at(highest, cells.cell, problem.gap)
        numbers = np.arange(1.0, cells.count + 1)
        depth = problem.gap - highest[cells.cell]
        law = _CellLaw(self.law, depth, problem.caps, cells)
        return ContactSystem(highest, Caps(numbers), law, self.coupling, problem.load, problem.stiffness)

    def _lowered(self, displacement: Values, guess: float) -> "GridStart":
        """The start with the response to a displacement; ``guess`` is near its indentation."""
        p, indentation = self.problem, self.indentation
        alone = ContactSystem(p.gap, p.caps, self.law, NoCoupling(), p.load, p.stiffness)
        if p.load is not None:
            indentation = solve_uncoupled(alone, displacement, p.load, guess=guess)
        penetration = indentation - p.gap - displacement
        force = alone.response(penetration)[0]
        return replace(self, force=force, penetration=penetration, indentation=indentation)


def _solve_cells(system: ContactSystem, state: Iterate) -> Iterate:
    """Newton steps on the cells."""
    for _ in range(MAX_GRID_STEPS):
        following = take_step(system, state, GRID_RESIDUAL) if state.residual > GRID_RESIDUAL else None
        if following is None:
            break
        state = following
    return state


@dataclass(frozen=True, eq=False)
class _CellLaw:
    """Sum of the asperity laws in each cell, as one law per cell.

    A cell has no radius of curvature; ``respond`` gets the number of the cell, from one, in its place.
    """

    law: AsperityLaw
    depth: Values
    caps: Caps
    cells: Cells

    def respond(self, penetration: Values, caps: Caps) -> tuple[Values, Values]:
        """Sums over each cell of the forces and of the contact radii (half the stiffness)."""
        numbers = caps.radius.astype(np.intp) - 1
        lowered = np.full(self.cells.count, -np.inf)
        lowered[numbers] = penetration
        inside = lowered[self.cells.cell] - self.depth
        touching = np.flatnonzero(inside > 0)
        responses = self.law.respond(inside[touching], self.caps[touching])
        cell, count = self.cells.cell[touching], self.cells.count
        force, contact_radius = (
            np.bincount(cell, r, count).astype(np.float64, copy=False) for r in responses
        )
        return force[numbers], contact_radius[numbers]
