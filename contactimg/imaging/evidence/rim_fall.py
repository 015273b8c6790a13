"""How far the brightness falls across the rim of a wide disk: uneven light has no rim."""

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.pixels.masks import Mask

WIDE_BLUR_WIDTHS = 4.0
"""Radius over blur above which a disk must have a rim; smaller ones are all rim. Theory: over four blur
widths a straight edge falls by 95 % of the contrast."""
DIRECTIONS, LEAST_SEEN = 32, 4
"""Directions in which the fall is read, from two blur widths inside to two outside, and least number of them
that must be seen. By hand."""
PERCENTILE = 70.0
"""Percentile of these falls that is taken. By hand: up to 30 % of the rim may touch neighbours."""
SHARPEST_BLUR_PX, WIDEST_BLUR_PX = 1.0, 8.0
"""Limits of the blur used here: pixels are not interpolated, and no optics is as blurred as uneven light."""


def measure_fall(
    image: NDArray[np.float32], valid: Mask, disks: NDArray[np.float64], blur: float
) -> NDArray[np.float64]:
    """Fall of the brightness across the rim of each disk, in the units of the image.

    Infinite for small disks, and where too little of the rim is seen.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Contacts positive.
    valid : Mask
    disks : ndarray, shape (n, >= 3)
        x, y, radius (px).
    blur : float, px

    Examples
    --------
    >>> y, x = np.mgrid[0:100, 0:100]
    >>> far = np.hypot(x - 50, y - 50)
    >>> measure_fall(1.0 * (far < 30), None, np.array([[50.0, 50.0, 30.0], [50.0, 50.0, 3.0]]), 1.5).tolist()
    [1.0, inf]
    >>> measure_fall(np.exp(-(far**2) / 1800), None, np.array([[50.0, 50.0, 35.0]]), 1.5).round(2).tolist()
    [0.12]
    """
    blur = min(max(blur, SHARPEST_BLUR_PX), WIDEST_BLUR_PX)
    out = np.full(len(disks), np.inf)
    wide = np.flatnonzero(disks[:, 2] > WIDE_BLUR_WIDTHS * blur)
    if not len(wide):
        return out
    directions = np.exp(2j * np.pi * np.arange(DIRECTIONS) / DIRECTIONS)
    centres = disks[wide, 0] + 1j * disks[wide, 1]
    inside, outside = (
        _values_at(image, valid, centres[:, None] + (disks[wide, 2] + step)[:, None] * directions)
        for step in (-2.0 * blur, 2.0 * blur)
    )
    fall = inside - outside
    count = np.isfinite(fall).sum(axis=1)
    rank = np.rint(PERCENTILE / 100.0 * np.maximum(count - 1, 0)).astype(int)
    steep = np.take_along_axis(np.sort(fall, axis=1), rank[:, None], axis=1)[:, 0]  # NaN sorts last
    out[wide] = np.where(count >= LEAST_SEEN, steep, np.inf)
    return out


def _values_at(image: NDArray, valid: Mask, points: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Pixels of an image at some points x + iy; NaN outside it and in holes."""
    x, y = np.rint(points.real).astype(int), np.rint(points.imag).astype(int)
    seen = (x >= 0) & (x < image.shape[1]) & (y >= 0) & (y < image.shape[0])
    x, y = np.where(seen, x, 0), np.where(seen, y, 0)
    if valid is not None:
        seen &= valid[y, x] > 0
    return np.where(seen, image[y, x], np.nan)
