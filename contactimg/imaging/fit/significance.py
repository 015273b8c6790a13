"""Which fitted disks the pixels need."""

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.detect.overlap import DEEPEST, count_touching, overlapping
from contactimg.imaging.fit.disks import FittedDisks
from contactimg.imaging.fit.problem import CONTRAST, RADIUS, FitProblem

SIGNIFICANT_LIGHT_SIGMA = 5.0
"""Light below which a disk is dropped. False-alarm rate: 3e-7 for a normal deviate."""
FAINTEST_FRACTION = 0.4
"""Contrast over the expected one below which a disk beside another is part of it. By hand."""
SUSPICIOUS_CHI_SQUARE = 1.3
"""Mean chi-square of a disk above which another is searched beside it before it is dropped. By hand."""
SPECK_RADIUS_PX = 0.5
"""Radius below which a disk that touches another is dropped as part of its rim. By hand."""


def find_insignificant(fit: FittedDisks, problem: FitProblem, *, final: bool) -> NDArray[np.bool_]:
    """Disks whose light is not significant, that lie in a larger one, or that are a faint part of another.

    A faint disk that stands alone is a faint contact. One that fits badly may be two close ones: it is
    dropped only in the ``final`` selection.
    """
    radius = fit.disks[:, RADIUS]
    weak = radius < 2.0 * SIGNIFICANT_LIGHT_SIGMA * fit.std[:, RADIUS]  # light goes as radius^2
    expected, _ = problem.prior.of_disks(fit.disks, fit.blur)
    beside = count_touching(fit.disks, 2.0 * fit.blur) > 0
    faint = (fit.disks[:, CONTRAST] < FAINTEST_FRACTION * expected) & beside
    if not final:
        faint &= fit.chi_square < SUSPICIOUS_CHI_SQUARE
    speck = (radius < SPECK_RADIUS_PX) & beside
    return np.asarray(weak | faint | speck | overlapping(fit.disks, DEEPEST))
