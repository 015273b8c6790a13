"""The profile of contacts with a film at any blur, from tables at a few.

A film has lengths of its own, so that a table (`contactimg.imaging.profile.film_rim.rim_table`) holds for one
blur. At a given distance from the rim in units of the blur, tables change smoothly with the logarithm of the
blur: a parabola through three of them gives any other.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.profile.blurred_disk import EdgeTable
from contactimg.imaging.profile.film_rim import Rim, rim_table

BLUR_RATIO = 1.15
"""Of the blurs of neighbouring tables. Accuracy: the parabola errs by 4e-4 of the contrast at most."""
ROUNDED_LOG = 1e-4  # step of the logarithm of the blur; accuracy: tables are kept for the same blur


def film_table(rim: Rim, blur: float) -> EdgeTable:
    """Profile of contacts with a rim at a blur; see `rim_table`, which is exact and takes long.

    Parameters
    ----------
    rim : Rim
        Hashable.
    blur : float, px
        Standard deviation of the Gaussian, pixel included.

    Examples
    --------
    >>> from contactimg.imaging.profile.film_rim import PlainRim
    >>> quick, exact = (table(PlainRim(2.0), 1.3) for table in (film_table, rim_table))
    >>> columns = min(quick.values.shape[1], exact.values.shape[1])
    >>> bool(np.abs(quick.values[:, :columns, 0] - exact.values[:, :columns, 0]).max() < 1e-3)
    True
    """
    return _between(rim, round(float(np.log(blur)) / ROUNDED_LOG))


@lru_cache(maxsize=24)
def _between(rim: Rim, rounded: int) -> EdgeTable:
    """The parabola through the three next tables."""
    place = rounded * ROUNDED_LOG / np.log(BLUR_RATIO)
    middle = round(place)
    x = place - middle
    weights = (0.5 * x * (x - 1.0), 1.0 - x * x, 0.5 * x * (x + 1.0))
    tables = [rim_table(rim, BLUR_RATIO ** (middle + k)) for k in (-1, 0, 1)]
    columns = max(table.values.shape[1] for table in tables)
    values = np.zeros((tables[0].values.shape[0], columns, 3), np.float32)
    for weight, table in zip(weights, tables, strict=True):
        part: NDArray[np.float32] = np.float32(weight) * table.values
        values[:, : part.shape[1]] += part
    return EdgeTable(values, max(table.outer for table in tables))
