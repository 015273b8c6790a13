"""Order statistics of many values by one selection, which NumPy does with vector instructions.

`numpy.median` and `numpy.percentile` select two or three values at once, which it does not, and take five to
ten times as long.
"""

import numpy as np
from numpy.typing import NDArray


def quantile(values: NDArray, share: float) -> float:
    """The value below which a share of the others lie; not interpolated.

    Examples
    --------
    >>> quantile(np.array([[3.0, 1.0], [2.0, 5.0], [4.0, 6.0]]), 0.8)
    5.0
    """
    k = int(share * (values.size - 1) + 0.5)
    return float(np.partition(values, k, axis=None)[k])


def median(values: NDArray) -> float:
    """The middle value, the higher one of two."""
    return quantile(values, 0.5)


def robust_std(values: NDArray) -> float:
    """Standard deviation of normal deviates of which few are not, from the median distance to the median."""
    return 1.4826 * median(np.abs(values - np.asarray(median(values), values.dtype)))
