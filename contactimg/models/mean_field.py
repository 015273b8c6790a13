"""A start for many contacts: the contact problem of the pattern's square cells.

A cell answers a penetration with the sum of its asperities' forces and lowers the others by that sum. This
small dense problem gives the displacement of the pattern less what varies within a cell.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from contactimg.models.coupling import DenseCoupling, Kernel, NoCoupling
from contactimg.models.local_laws import LocalLaw
from contactimg.models.newton import System, initial_iterate, solve_uncoupled, take_step
from contactimg.models.problem import Problem

__all__ = ["mean_field"]

Values = NDArray[np.float64]

CELLS = 48
"""Cells along the longer side: a Newton step on all of them takes 0.1 s."""

ENOUGH = 1e-2
"""Residual of the cells' problem: what varies within a cell is no smaller."""

MAX_STEPS = 10


def mean_field(
    problem: Problem, law: LocalLaw, kernel: Kernel, force: Values, indentation: float
) -> tuple[Values, float]:
    """Forces and indentation in the smooth displacement of the cells, from those without coupling."""
    size = max(float(np.ptp(problem.x)), float(np.ptp(problem.y))) / CELLS
    places = np.stack([(v - v.min()) / size for v in (problem.y, problem.x)])
    shape = tuple(int(p.max()) + 1 for p in places)
    cell = np.ravel_multi_index(tuple(places.astype(np.intp)), shape)
    system = _cell_system(problem, law, kernel, cell, shape, size)
    state = initial_iterate(system, _sums(cell, force, system.gap.size), indentation)
    for _ in range(MAX_STEPS):
        following = take_step(system, state, ENOUGH) if state.residual > ENOUGH else None
        if following is None:
            break
        state = following
    displacement = map_coordinates(state.displacement.reshape(shape), places - 0.5, order=1, mode="nearest")
    alone = System(problem.gap, problem.radius, law, NoCoupling(), problem.load)
    if problem.load is not None:
        indentation = solve_uncoupled(alone, displacement, problem.load, guess=state.indentation)
    return alone.response(indentation - problem.gap - displacement)[0], indentation


@dataclass(frozen=True, eq=False)
class _CellLaw:
    """Asperities that move together with their cell.

    A cell has no radius of curvature; its number, from one, stands in that place.
    """

    law: LocalLaw
    depth: Values
    radius: Values
    cell: NDArray[np.intp]
    count: int

    def respond(self, penetration: Values, radius: Values) -> tuple[Values, Values]:
        """Sums of the forces and of the contact radii, half the stiffness, in cells."""
        numbers = radius.astype(np.intp) - 1
        lowered = np.full(self.count, -np.inf)
        lowered[numbers] = penetration
        inside = lowered[self.cell] - self.depth
        touching = np.flatnonzero(inside > 0)
        responses = self.law.respond(inside[touching], self.radius[touching])
        force, contact_radius = (_sums(self.cell[touching], r, self.count) for r in responses)
        return force[numbers], contact_radius[numbers]


def _sums(cell: NDArray[np.intp], values: Values, count: int) -> Values:
    """Sums over cells."""
    return np.bincount(cell, values, count).astype(np.float64, copy=False)


def _cell_system(  # noqa: PLR0917
    problem: Problem,
    law: LocalLaw,
    kernel: Kernel,
    cell: NDArray[np.intp],
    shape: tuple[int, ...],
    size: float,
) -> System:
    """The cells as candidates, each in its middle and as high as its highest asperity."""
    count = int(np.prod(shape))
    highest = np.full(count, np.inf)
    np.minimum.at(highest, cell, problem.gap)
    row, column = (size * k.astype(np.float64) for k in np.unravel_index(np.arange(count), shape))
    coupling = DenseCoupling(column, row, kernel)
    # a uniform pressure on a square of side h lowers its middle by 4 asinh(1)/(pi h) of the force
    own = (4 * np.arcsinh(1.0) / size - float(kernel.deficit(np.zeros(1))[0])) / np.pi
    np.fill_diagonal(coupling.matrix, own)
    numbers = np.arange(1.0, count + 1)
    cells = _CellLaw(law, problem.gap - highest[cell], problem.radius, cell, count)
    return System(highest, numbers, cells, coupling, problem.load)
