"""Whether odd and even rows were read at different times while the image moved (interlaced cameras).

A row of an image at rest is the mean m of its neighbours, up to a curvature that is symmetric about each
contact. Displaced by s along x it differs from it by ``-s dm/dx``, which gives s by least squares; a shear
does not, as it displaces both neighbours the opposite way.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import shift

Values = NDArray[np.float64]

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
    rows, mean = image[odd].astype(float), 0.5 * (image[odd - 1].astype(float) + image[odd + 1])
    found, significance = _step(rows, mean)
    if significance < SIGNIFICANCE_SIGMA:
        return 0.0
    for _ in range(STEPS - 1):
        found += _step(shift(rows, (0.0, -found), order=1, mode="nearest"), mean)[0]
    return found if abs(found) >= LEAST_DISPLACEMENT_PX else 0.0


def _step(rows: Values, mean: Values) -> tuple[float, float]:
    """Displacement of rows against the means of their neighbours, and its significance."""
    slope = 0.5 * (mean[:, 2:] - mean[:, :-2])
    along = -np.einsum("ij,ij->i", rows[:, 1:-1] - mean[:, 1:-1], slope)
    weight = np.einsum("ij,ij->i", slope, slope)
    total = float(weight.sum())
    if not total > 0.0:
        return 0.0, 0.0
    found = float(along.sum()) / total
    std = float(np.sqrt(np.sum((along - found * weight) ** 2))) / total
    return found, abs(found) / max(std, 1e-12)
