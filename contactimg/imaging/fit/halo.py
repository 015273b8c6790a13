"""Light that the optics scatter far: a second, wide part of the point spread function, from the frame.

A frame seen through ``(1-f) core + f halo`` is ``D = (1-f) M + f G*M`` with M the frame through the core
alone and G the halo's Gaussian. Beyond the reach of the core only the halo is left, and there f and its width
follow from least squares; then M follows from D by taking the halo of the present M away, in turn with the
fit that gives M.
"""

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import special

from contactimg.imaging.pixels.blocks import BlockMeans, block_means
from contactimg.imaging.profile.optics import Halo

WIDTHS = (3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 24.0)  # px
COARSE = 2  # px: halos are smooth, so they are computed on means of this many pixels each way (a power of 2)
DARK = 5e-4  # of the contrast: the core has ended where it is below
CHANCE = 3e-6  # probability of a halo that is none: 8 standard deviations of 12 parts
LARGEST = 0.6  # of the light: more would be no halo but the point spread function
LEAST = 0.01  # of the light: a smaller halo changes no radius by more than its error
PARTS, FEWEST = 12, 3  # parts of the image, one contact each at least, whose scatter gives the uncertainty


def estimate_halo(means: BlockMeans, *, contrast: float, contacts: int) -> Halo | None:
    """Halo of a frame, or None if it has no significant one.

    Parameters
    ----------
    means : BlockMeans
        Of the difference image and of the disks fitted through the core of the point spread function.
    contrast : float
        Of the contacts.
    contacts : int
        How many there are: fewer than three say nothing.
    """
    parts = min(contacts, PARTS)
    if parts < FEWEST or _best(means, contrast, 2 * COARSE, WIDTHS[::3], parts=parts) is None:
        return None
    return _best(means, contrast, COARSE, WIDTHS, parts=parts)


def _best(
    means: BlockMeans,
    contrast: float,
    side: int,
    widths: tuple[float, ...],
    *,
    parts: int,
) -> Halo | None:
    """The halo of one of some widths that explains most, on means over squares of a side."""
    image, core = means(side)
    dark = np.abs(core) < DARK * contrast
    if np.count_nonzero(dark) < 20 * PARTS:
        return None
    halos = [_spread(core, width / side) for width in widths]
    fits = [_line(image, halo, dark) for halo in halos]
    best = int(np.argmin([squares for _, squares in fits]))
    fraction = fits[best][0]
    if fraction < LEAST:
        return None
    scatter = _slope_std(image[dark], halos[best][dark], fraction, parts)
    if fraction < -special.stdtrit(parts - 1, CHANCE) * scatter:
        return None
    return Halo(min(fraction, LARGEST), widths[best])


def remove_halo(image: NDArray[np.float32], model: NDArray[np.float32], halo: Halo) -> NDArray[np.float32]:
    """The image as the core of the point spread function alone would show it."""
    wide = _spread(block_means(model, side=COARSE), halo.sigma_px / COARSE)
    wide = cv2.resize(wide, None, fx=COARSE, fy=COARSE, interpolation=cv2.INTER_CUBIC)
    wide = wide[: image.shape[0], : image.shape[1]]
    return np.asarray((image - np.float32(halo.fraction) * wide) / np.float32(1.0 - halo.fraction))


def _spread(core: NDArray[np.float32], width: float) -> NDArray[np.float32]:
    return cv2.GaussianBlur(core, (0, 0), width, borderType=cv2.BORDER_REPLICATE)


@njit(cache=True)
def _line(data, wide, used):
    """Slope of the data on the halo over the pixels that are used, and the squares that are left."""
    power, common, squares = _moments(data.ravel(), wide.ravel(), used.ravel())
    if power <= 1e-9 * data.size:
        return 0.0, squares
    return common / power, squares - common * common / power


@njit(cache=True, fastmath=True, forceinline=True)
def _moments(data, wide, used):
    """Sums of squares and products about the means."""
    count = level = middle = power = common = squares = 0.0
    for i in range(len(data)):
        weight, x, y = np.float64(used[i]), wide[i], data[i]
        count += weight
        middle += weight * x
        level += weight * y
        power += weight * x * x
        common += weight * x * y
        squares += weight * y * y
    middle, level = middle / count, level / count
    return power - count * middle**2, common - count * middle * level, squares - count * level**2


@njit(cache=True)
def _slope_std(data, wide, slope, parts):
    """Uncertainty of the slope.

    Pixels share noise, so it comes from the scatter between parts of the image that tell as much as each
    other.
    """
    n, level, middle = len(data), data.mean(), wide.mean()
    power = 0.0
    for i in range(n):
        power += (wide[i] - middle) ** 2
    if not power > 0.0:
        return np.inf
    told, part, variance, share = 0.0, 0.0, 0.0, power / parts
    full = share
    for i in range(n):
        x = wide[i] - middle
        told += x * x
        part += x * (data[i] - level - slope * x)
        if told >= full or i == n - 1:
            variance += part * part
            part, full = 0.0, full + share
    return np.sqrt(variance) / power
