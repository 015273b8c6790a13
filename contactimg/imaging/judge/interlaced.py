"""Whether odd and even rows were read at different times while the image moved (interlaced cameras).

A row of an image at rest is the mean m of its neighbours, up to a curvature that is symmetric about each
contact. Displaced by s along x it differs from it by ``-s dm/dx``, which gives s by least squares; a shear
does not, as it displaces both neighbours the opposite way.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import shift

from contactimg.compiled import njit

LEAST_DISPLACEMENT_PX = 0.5
"""Displacement that is none. Chosen: alternating by half of it, rows blur an edge by 0.25 px, 1.5 % of the
variance of a usual blur."""
SIGNIFICANCE_SIGMA = 6.0
"""Standard deviations, from the scatter between rows. False-alarm rate 1e-9 (theory)."""
ROW_STEP = 4
"""Rows between those that are looked at; even. Chosen, for time: a quarter of the rows is looked at."""
FEWEST_ROWS = 5
"""Rows whose scatter gives the uncertainty. Theory: four degrees of freedom."""
STEPS = 6  # of Gauss and Newton; accuracy


def displacement_of_rows(image: NDArray[np.float32]) -> float:
    """How far odd rows lie to the right of even ones.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Difference image.

    Returns
    -------
    float, px
        0 where no displacement of `LEAST_DISPLACEMENT_PX` or more is significant.

    Examples
    --------
    >>> y, x = np.mgrid[0:90, 0:80]
    >>> disk = np.clip(20.5 - np.hypot(x - 40, y - 45), 0, 1).astype(np.float32)
    >>> displacement_of_rows(disk)
    0.0
    >>> disk[1::2] = np.roll(disk[1::2], 2, axis=1)
    >>> round(displacement_of_rows(disk), 1)
    2.0
    """
    odd = np.arange(1, image.shape[0] - 1, ROW_STEP)
    if len(odd) < FEWEST_ROWS or image.shape[1] < 3:
        return 0.0
    rows = image[odd]
    found, significance = _step(image, rows)
    if significance < SIGNIFICANCE_SIGMA:
        return 0.0
    for _ in range(STEPS - 1):
        found += _step(image, shift(rows, (0.0, -found), order=1, mode="nearest"))[0]
    return found if abs(found) >= LEAST_DISPLACEMENT_PX else 0.0


def _step(image: NDArray[np.float32], rows: NDArray[np.float32]) -> tuple[float, float]:
    """Displacement of the odd rows looked at against the means of their neighbours, and its significance."""
    along, weight = _sum_rows(image, rows)
    total = float(weight.sum())
    if not total > 0.0:
        return 0.0, 0.0
    found = float(along.sum()) / total
    std = float(np.sqrt(np.sum((along - found * weight) ** 2))) / total
    return found, abs(found) / max(std, 1e-12)


@njit(cache=True)
def _sum_rows(image, rows):
    """For each row and the mean of its neighbours: slope of the mean times its excess, and slope squared."""
    along, weight = np.empty(len(rows)), np.empty(len(rows))
    for k in range(len(rows)):
        j = 1 + k * ROW_STEP
        along[k], weight[k] = _sum_row(image[j - 1], rows[k], image[j + 1])
    return along, weight


@njit(cache=True, fastmath=True, forceinline=True)
def _sum_row(above, row, below):
    """The two sums of one row between two others."""
    along, weight, half = np.float32(0.0), np.float32(0.0), np.float32(0.5)
    for i in range(1, len(row) - 1):
        rise = above[i + 1] + below[i + 1] - above[i - 1] - below[i - 1]
        along += (half * (above[i] + below[i]) - row[i]) * rise
        weight += rise * rise
    # the slope of the mean is a quarter of the rise
    return np.float64(along) / 4.0, np.float64(weight) / 16.0
