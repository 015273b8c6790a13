"""The record of a height map."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.errors import InputError

Values = NDArray[np.float64]

MIN_SIDE_PX = 16
"""Fewest rows and columns of a map. Chosen: a cap and the base around it need about ten; not sensitive."""


@dataclass(frozen=True)
class HeightMap:
    """Heights on a grid of equal steps.

    Parameters
    ----------
    heights : ndarray, shape (rows, columns), m
        Positive away from the material; NaN where nothing was measured.
    pixel_size : (float, float), m
        Distance between neighbouring columns, and between neighbouring rows.

    Raises
    ------
    InputError
        If the heights are no matrix of at least `MIN_SIDE_PX` rows and columns, none is finite, or a pixel
        size is not positive.
    """

    heights: Values
    pixel_size: tuple[float, float]

    def __post_init__(self) -> None:
        shape = np.shape(self.heights)
        if len(shape) != 2 or min(shape) < MIN_SIDE_PX:
            raise InputError(
                f"a height map must be a matrix of at least {MIN_SIDE_PX} rows and columns, got the shape "
                f"{shape}"
            )
        if not np.isfinite(self.heights).any():
            raise InputError("the height map holds no finite height")
        if not all(np.isfinite(size) and size > 0 for size in self.pixel_size):
            raise InputError(f"the pixel size must be positive, got {self.pixel_size!r} m")

    @property
    def x(self) -> Values:
        """Coordinates of the columns, m; 0 is the centre of the map."""
        count = self.heights.shape[1]
        return (np.arange(count) - (count - 1) / 2) * self.pixel_size[0]

    @property
    def y(self) -> Values:
        """Coordinates of the rows, m, downwards; 0 is the centre of the map."""
        count = self.heights.shape[0]
        return (np.arange(count) - (count - 1) / 2) * self.pixel_size[1]
