"""Light that the optics scatter far: a second, wide part of the point spread function, from the frame.

A frame seen through ``(1-f) core + f halo`` is ``D = (1-f) M + f G*M`` with M the frame through the core
alone and G the halo's Gaussian. Beyond the reach of the core only the halo is left, and there f and its width
follow from least squares; then M follows from D by taking the halo of the present M away, in turn with the
fit that gives M.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import stats

__all__ = ["Halo", "estimate_halo", "remove_halo"]

WIDTHS = (3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 24.0)  # px
COARSE = 2  # px: halos are smooth, so they are computed on means of this many pixels each way
DARK = 5e-4  # of the contrast: the core has ended where it is below
CHANCE = 3e-6  # probability of a halo that is none: 8 standard deviations of 12 parts
LARGEST = 0.6  # of the light: more would be no halo but the point spread function
LEAST = 0.01  # of the light: a smaller halo changes no radius by more than its error
PARTS, FEWEST = 12, 3  # parts of the image, one contact each at least, whose scatter gives the uncertainty


@dataclass(frozen=True)
class Halo:
    """Wide part of the point spread function.

    Parameters
    ----------
    fraction : float
        Of the light.
    sigma_px : float
        Standard deviation of its Gaussian.
    """

    fraction: float
    sigma_px: float


def estimate_halo(
    image: NDArray[np.float32], model: NDArray[np.float32], *, contrast: float, contacts: int
) -> Halo | None:
    """Halo of a frame, or None if it has no significant one.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Difference image.
    model : ndarray, shape (rows, columns)
        Fitted disks through the core of the point spread function.
    contrast : float
        Of the contacts.
    contacts : int
        How many there are: fewer than three say nothing.
    """
    parts = min(contacts, PARTS)
    if parts < FEWEST or _best(image, model, contrast, 2 * COARSE, WIDTHS[::3], parts=parts) is None:
        return None
    return _best(image, model, contrast, COARSE, WIDTHS, parts=parts)


def _best(
    image: NDArray, model: NDArray, contrast: float, coarse: int, widths: tuple[float, ...], *, parts: int
) -> Halo | None:
    """The halo of one of some widths that explains most, on means of so many pixels each way."""
    small, core = _means(image, coarse), _means(model, coarse)
    dark = np.abs(core) < DARK * contrast
    if np.count_nonzero(dark) < 20 * PARTS:
        return None
    data = small[dark].astype(float)
    fits = [(_regress(data, _spread(core, width / coarse)[dark], parts), width) for width in widths]
    (fraction, least, _), width = min(fits, key=lambda item: item[0][2])
    return None if fraction < max(LEAST, least) else Halo(min(fraction, LARGEST), width)


def remove_halo(image: NDArray[np.float32], model: NDArray[np.float32], halo: Halo) -> NDArray[np.float32]:
    """The image as the core of the point spread function alone would show it."""
    wide = _spread(_means(model, COARSE), halo.sigma_px / COARSE)
    wide = cv2.resize(wide, image.shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray((image - np.float32(halo.fraction) * wide) / np.float32(1.0 - halo.fraction))


def _means(image: NDArray[np.float32], coarse: int) -> NDArray[np.float32]:
    size = (max(image.shape[1] // coarse, 1), max(image.shape[0] // coarse, 1))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def _spread(core: NDArray[np.float32], width: float) -> NDArray[np.float32]:
    return cv2.GaussianBlur(core, (0, 0), width, borderType=cv2.BORDER_REPLICATE)


def _regress(data: NDArray, wide: NDArray, parts: int) -> tuple[float, float, float]:
    """Slope of the data on the halo, its least significant value, and what is left."""
    slope, scatter, rest = _slope(data, wide.astype(float), parts)
    return slope, float(stats.t.isf(CHANCE, parts - 1) * scatter), rest


@njit(cache=True)
def _slope(data, wide, parts):
    """Slope of the data on the halo, its uncertainty, and the squares that are left.

    Pixels share noise, so the uncertainty comes from the scatter between parts of the image that tell as much
    as each other.
    """
    x, y = wide - wide.mean(), data - data.mean()
    n, power = len(x), np.dot(x, x)
    if power <= 1e-9 * n:
        return 0.0, np.inf, np.dot(y, y)
    slope = np.dot(x, y) / power
    told, squares, part, variance, number = 0.0, 0.0, 0.0, 0.0, 1
    for i in range(n):
        rest = y[i] - slope * x[i]
        told += x[i] * x[i]
        part += x[i] * rest
        squares += rest * rest
        if told >= power * number / parts or i == n - 1:
            variance += part * part
            part, number = 0.0, number + 1
    return slope, np.sqrt(variance) / power, squares
