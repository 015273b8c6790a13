"""Masks: which pixels of an image count, and how much of a disk they leave."""

import numpy as np
from numpy.typing import NDArray

NO_MASK = np.zeros((1, 1), np.uint8)
"""Stands for a mask in which nothing is masked."""
COUNT = 64
GOLDEN = np.pi * (3.0 - np.sqrt(5.0))
POINTS = np.sqrt((np.arange(COUNT) + 0.5) / COUNT) * np.exp(1j * GOLDEN * np.arange(COUNT))
"""Places that fill the unit disk evenly (Vogel, doi:10.1016/0025-5564(79)90080-4)."""


def share_seen(disks: NDArray, shape: tuple[int, int], weight: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Share of the area of each disk that lies in the image and not in a hole.

    Parameters
    ----------
    disks : ndarray, shape (n, >= 3)
        x, y, radius (px).
    shape : (int, int)
    weight : ndarray of uint8
        0 at holes; `NO_MASK` for none.

    Examples
    --------
    >>> share_seen(np.array([[-0.5, 10.0, 5.0], [10.0, 10.0, 5.0]]), (30, 30), NO_MASK).tolist()
    [0.5, 1.0]
    """
    if weight.shape != shape:  # nothing hides what lies inside
        x, y, reach = disks[:, 0], disks[:, 1], disks[:, 2] + 1.0
        cut = (x < reach) | (y < reach) | (x > shape[1] - reach) | (y > shape[0] - reach)
    else:
        cut = np.ones(len(disks), np.bool_)
    share = np.ones(len(disks))
    share[cut] = _share_of_points(disks[cut], shape, weight)
    return share


def _share_of_points(
    disks: NDArray, shape: tuple[int, int], weight: NDArray[np.uint8]
) -> NDArray[np.float64]:
    """`share_seen` from points all over each disk."""
    x = np.rint(disks[:, :1] + disks[:, 2:3] * POINTS.real)
    y = np.rint(disks[:, 1:2] + disks[:, 2:3] * POINTS.imag)
    seen = (x >= 0) & (x < shape[1]) & (y >= 0) & (y < shape[0])
    if weight.shape == shape:
        rows, columns = (np.where(seen, place, 0).astype(int) for place in (y, x))
        seen &= weight[rows, columns] > 0
    return np.asarray(seen.mean(axis=1))
