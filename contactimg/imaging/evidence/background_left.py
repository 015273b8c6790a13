"""What is left of the background where no contact was found: unevenness, dark patches, or no background."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.detect.candidates import DARK_FRACTION
from contactimg.imaging.detect.peaks import FALSE_ALARM_SIGMA
from contactimg.imaging.pixels.blocks import BLOCK, block_means
from contactimg.imaging.pixels.masks import Mask, clear_disks
from contactimg.imaging.pixels.robust import SAMPLE, robust_std
from contactimg.imaging.profile.limits import SQUARE_PX

UNEVENNESS = 0.02
"""Unevenness of the background over the contrast above which the light was not followed, and distance of a
block from the background up to which it was. By hand: it moves the radius of two blur widths by 1 %."""


@dataclass(frozen=True)
class BackgroundLeft:
    """The background that is left after all corrections, where no contact was found.

    Parameters
    ----------
    uneven : float
        Scatter of its means over patches of 32 px in excess of the noise, over the contrast.
    waves : float
        Scatter of its means over blocks of 8 px in excess of the noise of single pixels, over the contrast:
        fringes, or a texture that no reference takes out.
    dark_share : float
        Share of the free blocks that are darker than the background by a fifth of the contrast.
    free_share : float
        Share of the frame that contacts leave free.
    found_share : float
        Share of that on which the light was followed.
    """

    uneven: float = 0.0
    waves: float = 0.0
    dark_share: float = 0.0
    free_share: float = 1.0
    found_share: float = 1.0


def inspect_background(
    image: NDArray[np.float32],
    valid: Mask,
    background: NDArray[np.bool_],
    disks: NDArray[np.float64],
    *,
    reach_px: float,
    contrast: float,
) -> BackgroundLeft:
    """Inspect the background of a difference image.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Contacts positive.
    valid : Mask
    background : ndarray of bool
        Blocks on which the light was followed.
    disks : ndarray, shape (n, 3)
        x, y, radius (px) of contacts, and of what was excluded by hand.
    reach_px : float
        Distance from their rims up to which they reach.
    contrast : float
        Grey levels.
    """
    places = disks + np.array([0.0, 0.0, reach_px])
    for side in (BLOCK, SQUARE_PX):
        means = block_means(image, valid, side=side)
        free = np.isfinite(means).astype(np.uint8)
        if valid is not None:
            free &= (block_means(valid.astype(np.float32), side=side) == 1.0).astype(np.uint8)
        seen = max(int(np.count_nonzero(free)), 1)
        # the centre of a block is half a block from its first pixel, half a diagonal from its corners
        reach = places + np.array([0.5, 0.5, side / np.sqrt(2.0)])
        clear_disks(free, reach / side - np.array([0.5, 0.5, 0.0]))
        # Chosen: dots of 4 px every 18 px leave 0.03 of the blocks free.
        if np.count_nonzero(free) >= 0.1 * seen:
            break
    left = means[free > 0]
    if not left.size or not contrast > 0:
        return BackgroundLeft(free_share=left.size / seen)
    noise = robust_std(left)
    dark = left < -max(DARK_FRACTION * contrast, FALSE_ALARM_SIGMA * noise)
    found = 1.0
    if background.shape == free.shape:
        found = float(np.mean(background[free > 0] | (np.abs(left) < UNEVENNESS * contrast)))
    # noise that neighbouring pixels do not share
    steps = np.diff(image[:: max(image.size // SAMPLE, 1)], axis=1)
    single = robust_std(steps) / np.sqrt(2.0) if steps.size else 0.0
    return BackgroundLeft(
        # Over patches of 32 px.
        uneven=_unevenness(means, free, noise, 32 // side) / contrast,
        waves=np.sqrt(max(noise**2 - (single / side) ** 2, 0.0)) / contrast,
        dark_share=float(np.mean(dark)),
        free_share=left.size / seen,
        found_share=found,
    )


def _unevenness(means: NDArray[np.float32], free: NDArray[np.uint8], noise: float, coarse: int) -> float:
    """Scatter of the means over patches of so many blocks in excess of what their scatter explains."""
    rows, columns = (size // coarse * coarse for size in means.shape)
    shape = (rows // coarse, coarse, columns // coarse, coarse)
    weight = free[:rows, :columns].reshape(shape).sum(axis=(1, 3), dtype=float)
    filled = np.where(free > 0, means, np.float32(0.0))[:rows, :columns]
    total = filled.reshape(shape).sum(axis=(1, 3), dtype=float)
    used = weight >= coarse
    # Six patches give the unevenness to 30 %: 1/sqrt(2 n).
    if np.count_nonzero(used) < 6:
        return 0.0
    patches = total[used] / weight[used]
    expected = noise**2 * float(np.mean(1.0 / weight[used]))
    return float(np.sqrt(max(np.var(patches) - expected, 0.0)))
