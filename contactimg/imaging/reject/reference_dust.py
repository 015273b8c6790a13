"""Dust in the reference: it darkens the reference alone and so makes a bright disk in the difference."""

import numpy as np
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
    columns, rows = (
        np.clip(np.rint(disks[:, k : k + 1] + disks[:, 2:3] * GRID[:, k]), 0, size - 1).astype(int)
        for k, size in enumerate(frame.shape[::-1])
    )
    smooth = difference.smooth_brightness[rows // BLOCK, columns // BLOCK] * difference.level
    background = smooth * difference.illumination.at(columns, rows, frame.shape)
    height = image[rows, columns].astype(float)
    sign = np.where(height * difference.image[rows, columns] < 0, -1.0, 1.0)
    shown = sign * difference.level * (frame[rows, columns] / np.maximum(background, 1e-6) - 1.0)
    small = disks[:, 2] < LARGEST_DUST_PX
    return np.asarray(small & (shown.sum(axis=1) < SHOWN_FRACTION * height.sum(axis=1)))
