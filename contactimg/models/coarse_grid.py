"""Starting values for many contacts: the contact problem averaged over a coarse grid of square cells.

The asperities of a cell share one displacement, and the sum of their forces displaces the other cells. This
small dense problem gives the displacement of the pattern without its variation inside a cell.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from contactimg.models.asperity_laws import AsperityLaw, Caps
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
    cells : CoarseGrid
    coupling : DenseCoupling
        Of the cells.
    force, penetration : ndarray
        Of the asperities.
    indentation : float
    """

    problem: ScaledProblem
    law: AsperityLaw
    cells: "CoarseGrid"
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
        cells = CoarseGrid.over(problem.x, problem.y, GRID_CELLS)
        start = cls(problem, law, cells, cells.coupling(kernel), force, force, indentation)
        system = cells.system(problem, law, start.coupling)
        state = _solve_cells(system, initial_iterate(system, cells.sums(force), indentation))
        return start._lowered(cells.interpolated(state.displacement), state.indentation)

    def part(self, kept: NDArray[np.bool_]) -> "GridStart":
        """The same for some of the asperities."""
        cells = CoarseGrid(self.cells.places[:, kept], self.cells.shape, self.cells.size)
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
        system = cells.system(within, self.law, self.coupling)
        state = _solve_cells(system, evaluate_iterate(system, force, self.indentation, before))
        change = cells.interpolated(state.displacement - before)
        return self._lowered(displacement + change, state.indentation)

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
class CoarseGrid:
    """Square cells over a pattern.

    Parameters
    ----------
    places : ndarray, shape (2, n)
        Row and column of each asperity, in cells, from the pattern's corner.
    shape : (int, int)
    size : float
        Side of a cell.
    """

    places: Values
    shape: tuple[int, ...]
    size: float

    @classmethod
    def over(cls, x: Values, y: Values, number: int) -> "CoarseGrid":
        """``number`` cells along the longer side of the asperities' bounding box."""
        size = max(float(np.ptp(x)), float(np.ptp(y))) / number
        places = np.stack([(v - v.min()) / size for v in (y, x)])
        return cls(places, tuple(int(p.max()) + 1 for p in places), size)

    @cached_property
    def cell(self) -> NDArray[np.intp]:
        """The cell of each asperity."""
        return np.ravel_multi_index(tuple(self.places.astype(np.intp)), self.shape)

    @property
    def count(self) -> int:
        """How many cells there are, empty ones included."""
        return int(np.prod(self.shape))

    def interpolated(self, values: Values) -> Values:
        """Values of the cells at the asperities."""
        return map_coordinates(values.reshape(self.shape), self.places - 0.5, order=1, mode="nearest")

    def sums(self, values: Values) -> Values:
        """Sums over cells."""
        return _sums(self.cell, values, self.count)

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
