"""Square cells over a pattern, as coarse unknowns: those of a cell share one displacement.

The matrix ``I + S C S`` of a Newton system is the identity but for the displacement that many contacts share:
its large eigenvalues, which grow with the extent of the pattern, belong to forces that vary slowly over it. A
small dense problem on the cells holds these: it is a preconditioner for the conjugate gradients of many
contacts here, and a start for the whole problem in `contactimg.models.coarse_grid`.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.ndimage import map_coordinates

from contactimg.models.coupling import DenseCoupling, Kernel

Values = NDArray[np.float64]

CONTACTS_PER_CELL = 16.0
"""Mean number of contacts of a cell. Chosen by time."""

MOST_CELLS_PER_SIDE = 32
"""Most cells along a side: 1024 in all. Chosen by time: what finer cells hold is close to the identity."""


@dataclass(frozen=True, eq=False)
class Cells:
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
    def over(cls, x: Values, y: Values, number: int) -> Self:
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
        return np.bincount(self.cell, values, self.count).astype(np.float64, copy=False)

    def coupling(self, kernel: Kernel) -> DenseCoupling:
        """Coupling between cell centres; the force of a cell acts on the cell itself as well."""
        row, column = (
            self.size * k.astype(np.float64) for k in np.unravel_index(np.arange(self.count), self.shape)
        )
        # a uniform pressure on a square of side h lowers its middle by 4 asinh(1)/(pi h) of the force
        uniform = 4 * np.arcsinh(1.0) / self.size
        return DenseCoupling(column, row, kernel, own=(uniform - kernel.relief[0]) / np.pi)


@dataclass(frozen=True, eq=False)
class CellPreconditioner:
    """Solves the averaged system exactly and leaves the rest as it is.

    Parameters
    ----------
    grid : Cells
    share : ndarray, shape (n,)
        Of each contact in its cell: the scales ``s`` over the root of the cell's sum of squares.
    factor : tuple
        Cholesky's, of the averaged system.
    """

    grid: Cells
    share: Values
    factor: tuple[Values, bool]

    @classmethod
    def of(cls, x: Values, y: Values, kernel: Kernel, scale: Values) -> "CellPreconditioner":
        """For contacts at ``x, y`` with the scales ``s = sqrt(2 a)``."""
        number = int(np.clip(np.sqrt(x.size / CONTACTS_PER_CELL), 2, MOST_CELLS_PER_SIDE))
        grid = Cells.over(x, y, number)
        size = np.sqrt(grid.sums(scale**2))
        matrix = size[:, None] * grid.coupling(kernel).matrix * size
        matrix[np.diag_indices_from(matrix)] += 1.0
        return cls(grid, scale / size[grid.cell], cho_factor(matrix, lower=True, overwrite_a=True))

    def __call__(self, side: Values) -> Values:
        """A vector multiplied by the preconditioner."""
        averaged = self.grid.sums(self.share * side)
        change = cho_solve(self.factor, averaged, check_finite=False) - averaged
        return side + self.share * change[self.grid.cell]
