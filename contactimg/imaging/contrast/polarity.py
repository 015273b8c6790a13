"""Whether contacts are brighter or darker than the background."""

import cv2
import numpy as np

from contactimg.imaging.pixels.masks import Flags, Values
from contactimg.imaging.pixels.robust import CLIP_SIGMA, robust_std

AT_BORDER = 0.3
"""Weight of a region at the border. By hand: four dark corners of 500 px^2 against 25 contacts of 3 px."""


def find_sign(blocks: Values, background: Flags) -> int:
    """1 if most of what stands out of a background at 0 is bright, or nothing does, else -1.

    A connected region counts as the square root of its light: one shadow is not many contacts. One at the
    border counts less, since light falls off there.

    Parameters
    ----------
    blocks : ndarray, shape (rows, columns)
        Block means of the difference image; NaN = no data.
    background : ndarray of bool
        Blocks that are background, from which the scatter is read; of another shape, or none: most are.

    Examples
    --------
    >>> blocks = np.array([[0.1, -0.1, 0.2, -0.2, 0.0, -9.0, -8.0, 0.1]])
    >>> find_sign(blocks, np.abs(blocks) < 1.0)
    -1
    """
    usual = np.isfinite(blocks)
    if not usual.any():
        return 1
    if background.shape == blocks.shape and (usual & background).any():
        usual &= background
    limit = CLIP_SIGMA * robust_std(blocks[usual])
    shown = []
    for light in (np.nan_to_num(blocks), -np.nan_to_num(blocks)):
        far = light > limit
        count, regions = cv2.connectedComponents(far.astype(np.uint8))
        weight = np.ones(count)
        for side in (regions[0], regions[-1], regions[:, 0], regions[:, -1]):
            weight[side] = AT_BORDER
        shown.append(weight @ np.sqrt(np.bincount(regions[far], light[far], minlength=count)))
    return -1 if shown[1] > shown[0] else 1
