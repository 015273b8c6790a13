"""Reject fitted disks that are not contacts: outside the image, dust in the reference, or without a rim."""

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.difference_image import DifferenceImage
from contactimg.imaging.pixels.frame_pair import FramePair
from contactimg.imaging.pixels.masks import Mask, visible_fraction
from contactimg.imaging.reject.reference_dust import find_reference_dust
from contactimg.tables import Reason

LEAST_VISIBLE_FRACTION = 0.2
"""Of its area in the image and not in a hole, below which a disk is not accepted. Chosen by hand."""
WIDE_DISK_BLURS = 4.0
"""Radius over blur above which a disk must have a rim; smaller ones are all rim. Over four blur widths a
straight edge falls by 95 % of the contrast (theory: ``2 Phi(2) - 1``)."""
RIM_DIRECTIONS = 32
"""Directions in which the fall of brightness across a rim is read, from two blur widths inside to two
outside."""
RIM_PERCENTILE = 70.0
"""Percentile of these falls that must reach `RIM_FALL`: up to 30 % of the rim may touch neighbours. By
hand."""
RIM_FALL = 0.35
"""Least fall across a rim as a fraction of the contrast; 0.95 is expected of a contact. Chosen by hand;
sensitivity not measured."""
SHARPEST_BLUR_PX, WIDEST_BLUR_PX = 1.0, 8.0
"""Limits of the blur used here: pixels are not interpolated, and no optics is as blurred as uneven light."""


def reject_disks(
    frame_pair: FramePair,
    image: NDArray[np.float32],
    difference: DifferenceImage,
    disks: NDArray[np.float64],
    *,
    blur: float,
    contrast: float,
) -> NDArray[np.str_]:
    """Why each disk is not a contact (a `Reason`); empty for contacts.

    Parameters
    ----------
    frame_pair : FramePair
        The frame and its holes.
    image : ndarray, shape (rows, columns)
        Difference image, contacts positive.
    difference : DifferenceImage
        From which it comes.
    disks : ndarray, shape (n, >= 3)
        x, y, radius (px).
    blur : float, px
        Standard deviation of the point spread function.
    contrast : float
        Of the contacts, grey levels.
    """
    hidden = visible_fraction(disks, image.shape, frame_pair.valid) < LEAST_VISIBLE_FRACTION
    dust = find_reference_dust(frame_pair.frame, image, difference, disks)
    blur = min(max(blur, SHARPEST_BLUR_PX), WIDEST_BLUR_PX)
    no_rim = disks[:, 2] > WIDE_DISK_BLURS * blur
    no_rim[no_rim] = _lack_rim(image, frame_pair.valid, disks[no_rim], blur, contrast)
    reasons = [Reason.OUT_OF_SIGHT, Reason.REFERENCE_DUST, Reason.NO_RIM]
    return np.select([hidden, dust, no_rim], reasons, "")


def _lack_rim(
    image: NDArray[np.float32], valid: Mask, disks: NDArray[np.float64], blur: float, contrast: float
) -> NDArray[np.bool_]:
    """Which wide disks have no rim: the brightness hardly falls across it."""
    directions = np.exp(2j * np.pi * np.arange(RIM_DIRECTIONS) / RIM_DIRECTIONS)
    centres = disks[:, 0] + 1j * disks[:, 1]
    levels = []
    for offset in (-2.0 * blur, 2.0 * blur):
        points = centres[:, None] + (disks[:, 2] + offset)[:, None] * directions
        x, y = np.rint(points.real).astype(int), np.rint(points.imag).astype(int)
        visible = (x >= 0) & (x < image.shape[1]) & (y >= 0) & (y < image.shape[0])
        x, y = np.where(visible, x, 0), np.where(visible, y, 0)
        if valid is not None:
            visible &= valid[y, x] > 0
        levels.append(np.where(visible, image[y, x], np.nan))
    fall = levels[0] - levels[1]
    count = np.isfinite(fall).sum(axis=1)
    rank = np.rint(RIM_PERCENTILE / 100.0 * np.maximum(count - 1, 0)).astype(int)
    steep = np.take_along_axis(np.sort(fall, axis=1), rank[:, None], axis=1)[:, 0]  # NaN sorts last
    return np.asarray((count >= RIM_DIRECTIONS // 8) & ~(steep >= RIM_FALL * contrast))
