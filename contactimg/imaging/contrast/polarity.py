"""Whether contacts are brighter or darker than the background."""

import numpy as np
from numpy.typing import NDArray


def find_polarity(blocks: NDArray, noise: float) -> str:
    """``"bright"`` or ``"dark"``: the side of zero on which block means of the difference have more tail."""
    excess = np.abs(blocks) - 4.0 * noise
    tail = np.where(excess > 0, blocks, 0.0)
    return "dark" if np.nansum(tail) < 0 else "bright"
