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
from scipy import special

from contactimg.imaging.light import block_means

__all__ = ["Halo", "estimate_halo", "remove_halo"]

WIDTHS = (3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 24.0)  # px
COARSE = 2  # px: halos are smooth, so they are computed on means of this many pixels each way (a power of 2)
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
    small, core = block_means(image, side=coarse), block_means(model, side=coarse)
    dark = np.abs(core) < DARK * contrast
    if np.count_nonzero(dark) < 20 * PARTS:
        return None
    data = small[dark]
    fits = [(_slope(data, _spread(core, width / coarse)[dark], parts), width) for width in widths]
    (fraction, scatter, _), width = min(fits, key=lambda item: item[0][2])
    least = -special.stdtrit(parts - 1, CHANCE) * scatter
    return None if fraction < max(LEAST, least) else Halo(min(fraction, LARGEST), width)


def remove_halo(image: NDArray[np.float32], model: NDArray[np.float32], halo: Halo) -> NDArray[np.float32]:
    """The image as the core of the point spread function alone would show it."""
    wide = _spread(block_means(model, side=COARSE), halo.sigma_px / COARSE)
    wide = cv2.resize(wide, None, fx=COARSE, fy=COARSE, interpolation=cv2.INTER_CUBIC)
    wide = wide[: image.shape[0], : image.shape[1]]
    return np.asarray((image - np.float32(halo.fraction) * wide) / np.float32(1.0 - halo.fraction))


def _spread(core: NDArray[np.float32], width: float) -> NDArray[np.float32]:
    return cv2.GaussianBlur(core, (0, 0), width, borderType=cv2.BORDER_REPLICATE)


@njit(cache=True)
def _slope(data, wide, parts):
    """Slope of the data on the halo, its uncertainty, and the squares that are left.

    Pixels share noise, so the uncertainty comes from the scatter between parts of the image that tell as much
    as each other.
    """
    n = len(data)
    middle, level = _sum(wide) / n, _sum(data) / n
    power, common, squares = _products(data, wide, level, middle)
    if power <= 1e-9 * n:
        return 0.0, np.inf, squares
    slope, share = common / power, power / parts
    told, part, variance, full = 0.0, 0.0, 0.0, share
    for i in range(n):
        x = wide[i] - middle
        told += x * x
        part += x * (data[i] - level - slope * x)
        if told >= full or i == n - 1:
            variance += part * part
            part, full = 0.0, full + share
    return slope, np.sqrt(variance) / power, squares - slope * common


@njit(cache=True, fastmath=True, forceinline=True)
def _sum(values):
    """Sum in double precision, in vector instructions."""
    total = 0.0
    for i in range(len(values)):
        total += values[i]
    return total


@njit(cache=True, fastmath=True, forceinline=True)
def _products(data, wide, level, middle):
    """Sums of squares and products about the means, in vector instructions."""
    power = common = squares = 0.0
    for i in range(len(data)):
        x, y = wide[i] - middle, data[i] - level
        power += x * x
        common += x * y
        squares += y * y
    return power, common, squares
