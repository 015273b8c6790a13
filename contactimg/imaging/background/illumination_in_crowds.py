"""The slow light of a frame, from blocks of background or, where contacts leave none, from the gaps between.

Among many small contacts hardly a block is free of light from one of them. What then passes for background
is too bright and scatters more than blocks of the reference do; squares of a few pixels fit between them.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.illumination import (
    Illumination,
    background_mode,
    fit_illumination,
    neighbour_scatter,
)
from contactimg.imaging.pixels.blocks import BLOCK, block_means

SQUARE = 2  # px: side of what fits between contacts
SCATTERS = 1.1  # times as much as blocks of the reference: not background alone
EDGES, CROWD = 3.0, 0.1  # share of the blocks that scatter inside by so many times what squares do: rims
MOVED = 0.25  # of the scatter of the blocks: by less, the gaps say nothing else
PURE = 0.05  # of the squares: those nearest to the background


def find_illumination(
    means: Callable[[int], tuple[NDArray, float]], shape: tuple[int, int], *, background_is: str
) -> Illumination:
    """Fit a slow field to what is background.

    Parameters
    ----------
    means : callable
        For a side in px the means of the quantity (ratio to the reference, or difference from it) over
        squares of that side, NaN = no data, and the scatter that noise and texture give one of them.
    shape : (int, int)
        Shape of the image in pixels.
    background_is : str
        Which level is background, see `contactimg.imaging.background.illumination.background_mode`.

    Returns
    -------
    Illumination
        Its background consists of blocks, or of squares of `SQUARE` px where contacts leave no block free.
    """
    blocks, usual = means(BLOCK)
    start, spread = background_mode(blocks, background_is=background_is)
    light = fit_illumination(blocks, shape, start=start, spread=spread)
    if light.spread <= SCATTERS * usual:
        return light
    squares, usual = means(SQUARE)
    if not np.isfinite(squares).any():
        return light
    usual = max(usual, _scatter_next_to(squares, background_is))
    if not np.mean(_scatter_inside(squares) > EDGES * usual) > CROWD:
        return light  # light that is less even than a cubic
    usual = min(usual, neighbour_scatter(squares))
    start, spread = background_mode(squares, background_is=background_is, scatter=usual)
    between = fit_illumination(squares, shape, start=start, spread=min(spread, 2.0 * usual))
    moved = np.abs(between.at_blocks(blocks.shape, shape) - light.at_blocks(blocks.shape, shape))
    return between if np.median(moved) > MOVED * light.spread else light


def _scatter_next_to(squares: NDArray, background_is: str) -> float:
    """Scatter of a square from the differences of neighbours both of which are among the least covered."""
    covered = {
        "lowest": squares,
        "highest": -squares,
        "nearest_one": np.abs(squares - 1.0),
        "most_common": squares,
    }[background_is]
    pure = covered < np.quantile(covered[np.isfinite(covered)], PURE)
    differences = np.abs(np.diff(squares, axis=1)[pure[:, 1:] & pure[:, :-1]])
    return float(1.4826 * np.median(differences) / np.sqrt(2)) if len(differences) else 0.0


def _scatter_inside(squares: NDArray) -> NDArray[np.float64]:
    """Standard deviation of the squares of each block."""
    mean, square = (block_means(part, side=BLOCK // SQUARE) for part in (squares, squares**2))
    return np.sqrt(np.maximum(square - mean**2, 0.0))
