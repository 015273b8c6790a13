"""A preconditioner for the Newton systems of many contacts: the same system averaged over square cells.

The matrix ``I + S C S`` is the identity but for the displacement that many contacts share: its large
eigenvalues, which grow with the extent of the pattern, belong to forces that vary slowly over it. A small
dense problem on the cells of a grid holds these.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from contactimg.models.coarse_grid import CoarseGrid
from contactimg.models.coupling import Kernel

Values = NDArray[np.float64]

CONTACTS_PER_CELL = 16.0
"""Mean number of contacts of a cell. Chosen by time."""

MOST_CELLS_PER_SIDE = 32
"""Most cells along a side: 1024 in all. Chosen by time: what finer cells hold is close to the identity."""


@dataclass(frozen=True, eq=False)
class CellPreconditioner:
    """Solves the averaged system exactly and leaves the rest as it is.

    Parameters
    ----------
    grid : CoarseGrid
    share : ndarray, shape (n,)
        Of each contact in its cell: the scales ``s`` over the root of the cell's sum of squares.
    factor : tuple
        Cholesky's, of the averaged system.
    """

    grid: CoarseGrid
    share: Values
    factor: tuple[Values, bool]

    @classmethod
    def of(cls, x: Values, y: Values, kernel: Kernel, scale: Values) -> "CellPreconditioner":
        """For contacts at ``x, y`` with the scales ``s = sqrt(2 a)``."""
        number = int(np.clip(np.sqrt(x.size / CONTACTS_PER_CELL), 2, MOST_CELLS_PER_SIDE))
        grid = CoarseGrid.over(x, y, number)
        size = np.sqrt(grid.sums(scale**2))
        matrix = size[:, None] * grid.coupling(kernel).matrix * size
        matrix[np.diag_indices_from(matrix)] += 1.0
        return cls(grid, scale / size[grid.cell], cho_factor(matrix, lower=True, overwrite_a=True))

    def __call__(self, side: Values) -> Values:
        """A vector multiplied by the preconditioner."""
        averaged = self.grid.sums(self.share * side)
        change = cho_solve(self.factor, averaged, check_finite=False) - averaged
        return side + self.share * change[self.grid.cell]
