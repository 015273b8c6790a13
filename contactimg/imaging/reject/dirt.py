"""Fitted disks that are no contacts: dirt of the reference that is gone, and what hardly any pixel shows."""

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from contactimg.imaging.background.difference_image import DifferenceImage
from contactimg.imaging.pixels.blocks import BLOCK
from contactimg.imaging.pixels.frame_pair import FramePair, Levels
from contactimg.imaging.pixels.masks import Mask, visible_fraction
from contactimg.tables import Reason

LEAST_SEEN = (
    0.2  # of its area: a disk of which less lies in the image and not in a hole is not known to be one
)
ANGLES, STEEPEST = 32, 70.0  # places along a rim, percentile of the falls that tells whether there is one
FALL = 0.35  # of the contrast
SHARPEST_BLUR = 1.0  # px: the image is looked at on whole pixels
WIDEST_BLUR = 8.0  # px: optics are not as blurred as uneven light
WIDE = 4.0  # blur widths: narrower disks are all rim
SHARE = 0.4  # of a contact's excess in the difference that the frame alone must show
WIDEST = 10.0  # px: wider contacts are no dust, and the light varies across them
POINTS = np.array([(i, j) for j in (-1, 0, 1) for i in (-1, 0, 1)]) * 0.5  # of the radius, about the centre


def reject_disks(
    frame_pair: FramePair,
    signed: NDArray[np.float32],
    difference: DifferenceImage,
    disks: NDArray[np.float64],
    *,
    blur: float,
    contrast: float,
) -> NDArray[np.str_]:
    """Why each disk is no contact; empty for contacts.

    Parameters
    ----------
    frame_pair : FramePair
        The frame and its holes.
    signed : ndarray, shape (rows, columns)
        Difference image, contacts positive.
    difference : DifferenceImage
        Where it comes from.
    disks : ndarray, shape (n, >= 3)
        x, y, radius (px).
    blur : float, px
        Standard deviation of the point spread function.
    contrast : float
        Of the contacts.
    """
    hidden = visible_fraction(disks, signed.shape, frame_pair.valid) < LEAST_SEEN
    dust = absent_in_frame(frame_pair.frame, signed, difference, disks)
    blur = min(max(blur, SHARPEST_BLUR), WIDEST_BLUR)
    vague = disks[:, 2] > WIDE * blur
    vague[vague] = _without_rim(signed, frame_pair.valid, disks[vague], blur, contrast)
    reasons = [Reason.OUT_OF_SIGHT, Reason.REFERENCE_DUST, Reason.NO_RIM]
    return np.select([hidden, dust, vague], reasons, "")


def _without_rim(
    signed: NDArray[np.float32],
    valid: Mask,
    disks: NDArray[np.float64],
    blur: float,
    contrast: float,
) -> NDArray[np.bool_]:
    """Those of wide disks across whose rim the image hardly falls: uneven light, not contacts.

    Over four blur widths a contact falls by 95 % of its contrast, wherever no neighbour touches it.
    """
    angles = np.exp(2j * np.pi * np.arange(ANGLES) / ANGLES)
    place = disks[:, 0] + 1j * disks[:, 1]
    levels = []
    for offset in (-2.0 * blur, 2.0 * blur):
        at = place[:, None] + (disks[:, 2] + offset)[:, None] * angles
        x, y = np.rint(at.real).astype(int), np.rint(at.imag).astype(int)
        seen = (x >= 0) & (x < signed.shape[1]) & (y >= 0) & (y < signed.shape[0])
        x, y = np.where(seen, x, 0), np.where(seen, y, 0)
        if valid is not None:
            seen &= valid[y, x] > 0
        levels.append(np.where(seen, signed[y, x], np.nan))
    fall = levels[0] - levels[1]
    count = np.isfinite(fall).sum(axis=1)
    rank = np.rint(STEEPEST / 100.0 * np.maximum(count - 1, 0)).astype(int)
    steep = np.take_along_axis(np.sort(fall, axis=1), rank[:, None], axis=1)[:, 0]  # NaN sorts last
    return np.asarray((count >= ANGLES // 8) & ~(steep >= FALL * contrast))


def absent_in_frame(
    frame: Levels,
    signed: NDArray[np.float32],
    difference: DifferenceImage,
    disks: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Disks that the frame does not show against the slow background.

    Parameters
    ----------
    frame : ndarray, shape (rows, columns)
        Grey levels.
    signed : ndarray
        Difference image, contacts positive.
    difference : DifferenceImage
        Where it comes from; without a ratio to a reference, or on a clean one, nothing is absent.
    disks : ndarray, shape (n, >= 3)
        x, y, radius (px).
    """
    if difference.dust_free or not difference.ratio or not len(disks):
        return np.zeros(len(disks), np.bool_)
    # the median over blocks does not see a speck
    slow = cv2.medianBlur(difference.brightness, 5) * difference.level
    absent = _hardly_shown(
        frame, signed, difference.image, slow, difference.illumination.coefficients, difference.level,
        np.ascontiguousarray(disks[:, :3]),
    )  # fmt: skip
    return np.asarray(absent)


@njit(cache=True)
def _hardly_shown(frame, signed, image, slow, coefficients, level, disks):
    """Whether a narrow disk of the difference image is hardly seen in the frame over its slow background."""
    rows, columns = frame.shape
    out = np.zeros(len(disks), np.bool_)
    for k in range(len(disks)):
        x, y, radius = disks[k]
        if not radius < WIDEST:
            continue
        total = shown = 0.0
        for n in range(len(POINTS)):
            i = min(max(round(x + POINTS[n, 0] * radius), 0), columns - 1)
            j = min(max(round(y + POINTS[n, 1] * radius), 0), rows - 1)
            background = slow[j // BLOCK, i // BLOCK] * _light_at(coefficients, i, j, frame.shape)
            sign = -1.0 if signed[j, i] * image[j, i] < 0 else 1.0
            shown += sign * level * (frame[j, i] / max(background, 1e-6) - 1.0)
            total += signed[j, i]
        out[k] = shown < SHARE * total
    return out


@njit(cache=True)
def _light_at(coefficients, x, y, shape):
    """The polynomial of a `contactimg.imaging.background.illumination.LightField` at a pixel."""
    u, v = 2.0 * x / shape[1] - 1.0, 2.0 * y / shape[0] - 1.0
    value = 0.0
    for row in coefficients[::-1]:
        along = 0.0
        for c in row[::-1]:
            along = along * u + c
        value = value * v + along
    return value
