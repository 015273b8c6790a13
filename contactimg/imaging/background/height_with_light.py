"""Whether the contacts of a frame are as much brighter or darker as the light on them.

Contacts that transmit a fraction of the light stand out in proportion to the background: the frame is divided
by it. Dots that shine by themselves on an uneven glow do not, and a division would make those in the dim
corners too bright. How the heights go with the background, over the frame, tells which.
"""

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.contrast.plateau import WIDE_AREA, measure_contrast
from contactimg.imaging.pixels.binned_image import BinnedImage
from contactimg.imaging.pixels.blocks import BLOCK
from contactimg.imaging.pixels.robust import median, robust_std
from contactimg.imaging.shapes.labelled_regions import label_regions

LEAST_LIGHT_SPREAD = 0.1
"""Scatter of the logarithm of the background below which it hardly matters. Chosen: matched frames have 0.05,
and a wrong decision changes a small contact by a twentieth of its radius there."""
HEIGHT_FRACTION = 0.3  # of the plateau: regions above it are contacts; as for foreign objects
FEWEST_HEIGHTS = 20  # contacts that tell; theory: their scatter is then known to a sixth
CLIP_SIGMA = 2.5  # robust standard deviations; false-alarm rate 1e-2 (theory: normal deviates)
ROUNDS = 4  # of clipping; accuracy
DECISION_SIGMA = 3.0
"""Standard uncertainties by which the exponent must differ from 1/2. False-alarm rate 1e-3."""


def stands_out_by_itself(
    image: NDArray[np.float32], brightness: NDArray[np.float64], *, noise: float
) -> bool:
    """Whether the heights of the contacts do not go with the light.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Frame minus background, contacts positive.
    brightness : ndarray, shape (block rows, block columns)
        Background of each block relative to its level.
    noise : float
        Of a background pixel, grey levels.

    Returns
    -------
    bool
        True if the height goes as a power of the background that is clearly less than 1/2.
    """
    logs = np.log(np.maximum(brightness, 1e-3))
    if float(np.std(logs)) < LEAST_LIGHT_SPREAD:
        return False
    binned = BinnedImage.of(image)
    plateau = measure_contrast(binned, noise).plateau
    if not plateau > 0.0:
        return False
    regions = label_regions(binned.image, HEIGHT_FRACTION * plateau)
    used = ~regions.long & (regions.area >= WIDE_AREA)
    row, column = (
        np.minimum(place[used] * binned.step / BLOCK, size - 1).astype(int)
        for place, size in zip((regions.y, regions.x), logs.shape, strict=True)
    )
    slope, std = _robust_slope(logs[row, column], np.log(regions.peak[used]))
    return bool(slope + DECISION_SIGMA * std < 0.5)


def _robust_slope(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float]:
    """Slope of a line without outliers, and its standard uncertainty; infinite if too little tells it."""
    kept, slope, std = np.ones(len(x), np.bool_), 0.0, np.inf
    for _ in range(ROUNDS):
        if np.count_nonzero(kept) < FEWEST_HEIGHTS or not np.ptp(x[kept]) > 0.0:
            return 0.0, np.inf
        dx = x - x[kept].mean()
        slope = float(dx[kept] @ y[kept] / (dx[kept] @ dx[kept]))
        rest = y - slope * dx
        rest -= median(rest[kept])
        scatter = robust_std(rest[kept], centre=0.0)
        std = scatter / float(np.sqrt(dx[kept] @ dx[kept]))
        kept = np.abs(rest) <= CLIP_SIGMA * scatter
    return slope, std
