"""Whether contacts are brighter or darker than the background."""

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.pixels.robust import CLIP_SIGMA, robust_std


def find_polarity(blocks: NDArray[np.float32], background: NDArray[np.bool_] | None = None) -> str:
    """``"bright"`` or ``"dark"``: the sign of the sum of the block means far from the background at 0.

    Parameters
    ----------
    blocks : ndarray
        Block means of the difference image; NaN = no data.
    background : ndarray of bool or None
        Blocks that are background, from which the scatter is read; None: most are.

    Examples
    --------
    >>> find_polarity(np.array([0.1, -0.1, 0.2, -0.2, 0.0, -9.0, -8.0, 0.1]))
    'dark'
    """
    usual = np.isfinite(blocks)
    if background is not None and background.shape == blocks.shape and (usual & background).any():
        usual &= background
    far = np.abs(blocks) > CLIP_SIGMA * robust_std(blocks[usual])
    return "dark" if np.nansum(blocks[far]) < 0 else "bright"
