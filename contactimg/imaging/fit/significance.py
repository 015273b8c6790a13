"""Which fitted disks the pixels need."""

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.fit.disks import FittedDisks, wide_disks
from contactimg.imaging.fit.problem import CONTRAST, RADIUS
from contactimg.imaging.fit.settings import (
    FAINTEST_CONTRAST_FRACTION,
    FAINTEST_SPREAD_SIGMA,
    FEWEST_COMMON_CHI_SQUARE,
    SIGNIFICANT_LIGHT_SIGMA,
    SPECK_RADIUS_PX,
    SUSPICIOUS_CHI_SQUARE,
)
from contactimg.imaging.pixels.robust import robust_std
from contactimg.imaging.shapes.overlap import DEEPEST, count_touching, overlapping


def find_insignificant(fit: FittedDisks, contrast: float, *, final: bool) -> NDArray[np.bool_]:
    """Disks whose light is not significant, that are much too faint, or that lie inside a larger one.

    A faint disk that fits badly may be two close ones: it is dropped only in the ``final`` selection.
    """
    radius = fit.disks[:, RADIUS]
    weak = radius < 2.0 * SIGNIFICANT_LIGHT_SIGMA * fit.std[:, RADIUS]  # light goes as radius^2
    faint = fit.disks[:, CONTRAST] < _faintest_fraction(fit) * contrast
    if not final:
        faint &= fit.chi_square < SUSPICIOUS_CHI_SQUARE
    speck = (radius < SPECK_RADIUS_PX) & (count_touching(fit.disks, 2.0 * fit.blur) > 0)
    return np.asarray(weak | faint | speck | overlapping(fit.disks, DEEPEST))


def _faintest_fraction(fit: FittedDisks) -> float:
    """Contrast over the expected one below which a disk is much too faint; less where contrasts scatter."""
    contrasts = fit.disks[wide_disks(fit), CONTRAST]
    if len(contrasts) < FEWEST_COMMON_CHI_SQUARE:
        return FAINTEST_CONTRAST_FRACTION
    spread = robust_std(np.log(np.maximum(contrasts, 1e-6)))
    return min(FAINTEST_CONTRAST_FRACTION, float(np.exp(-FAINTEST_SPREAD_SIGMA * spread)))
