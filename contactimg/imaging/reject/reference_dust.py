"""Dust in the reference: it darkens the reference alone and so makes a bright disk in the difference."""

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from contactimg.imaging.background.difference_image import DifferenceImage
from contactimg.imaging.pixels.blocks import BLOCK
from contactimg.imaging.pixels.frame_pair import Levels

SHOWN_FRACTION = 0.4
"""Least fraction of the height in the difference image that the frame alone must show over its smooth
background. Chosen by hand on rendered frames with dust: 1 is expected of a contact, 0 of dust; sensitivity
not measured."""
LARGEST_DUST_PX = 10.0
"""Radius above which a disk is never dust, and across which the background of the frame may vary. By hand."""
GRID = np.array([(i, j) for j in (-1, 0, 1) for i in (-1, 0, 1)]) * 0.5
"""Nine points in a disk at which the two images are compared, in radii from its centre."""


def find_reference_dust(
    frame: Levels, image: NDArray[np.float32], difference: DifferenceImage, disks: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Which disks of the difference image the frame does not show against its own smooth background.

    Parameters
    ----------
    frame : ndarray, shape (rows, columns)
        Grey levels.
    image : ndarray, shape (rows, columns)
        Difference image, contacts positive.
    difference : DifferenceImage
        From which it comes. Without a ratio to a reference, or without dust, no disk is dust.
    disks : ndarray, shape (n, >= 3)
        x, y, radius (px).

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    if difference.dust_free or not difference.ratio or not len(disks):
        return np.zeros(len(disks), np.bool_)
    # a median over 5 x 5 blocks is not affected by a speck of dust
    smooth = cv2.medianBlur(difference.brightness, 5) * difference.level
    dust = _is_hardly_shown(
        frame, image, difference.image, smooth, difference.illumination.coefficients, difference.level,
        np.ascontiguousarray(disks[:, :3]),
    )  # fmt: skip
    return np.asarray(dust)


@njit(cache=True)
def _is_hardly_shown(frame, signed, image, smooth, coefficients, level, disks):
    """Whether a small disk of the difference image hardly stands out of the frame's smooth background."""
    rows, columns = frame.shape
    out = np.zeros(len(disks), np.bool_)
    for k in range(len(disks)):
        x, y, radius = disks[k]
        if not radius < LARGEST_DUST_PX:
            continue
        total = shown = 0.0
        for n in range(len(GRID)):
            i = min(max(round(x + GRID[n, 0] * radius), 0), columns - 1)
            j = min(max(round(y + GRID[n, 1] * radius), 0), rows - 1)
            background = smooth[j // BLOCK, i // BLOCK] * _polynomial_at(coefficients, i, j, frame.shape)
            sign = -1.0 if signed[j, i] * image[j, i] < 0 else 1.0
            shown += sign * level * (frame[j, i] / max(background, 1e-6) - 1.0)
            total += signed[j, i]
        out[k] = shown < SHOWN_FRACTION * total
    return out


@njit(cache=True)
def _polynomial_at(coefficients, x, y, shape):
    """The polynomial of a `contactimg.imaging.background.illumination.Illumination` at a pixel."""
    u, v = 2.0 * x / shape[1] - 1.0, 2.0 * y / shape[0] - 1.0
    value = 0.0
    for row in coefficients[::-1]:
        along = 0.0
        for c in row[::-1]:
            along = along * u + c
        value = value * v + along
    return value
