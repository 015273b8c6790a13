"""Whether an ellipse is more than a disk, and whether it describes its pixels."""

from dataclasses import dataclass

import numpy as np

from contactimg.imaging.fit.ellipse import RADIUS, FittedEllipse
from contactimg.imaging.fit.settings import POOR_CHI_SQUARE
from contactimg.imaging.judge.common_distortion import BAND_BLUR_WIDTHS
from contactimg.imaging.judge.shape_calls import LEAST_SIGNIFICANCE, UNEVEN_RATIO
from contactimg.imaging.judge.shape_scene import ShapeScene

POOR_SIGMA = 6.0
"""Excess of the mean squared residual, in its standard deviations, above which a shape does not describe its
pixels. False-alarm rate: 1e-9."""
LEAST_DEPARTURE_BLUR_WIDTHS = 0.2
"""RMS departure of an outline from an ellipse from which on a shape is free. Chosen: JPEG makes 0.12."""


@dataclass(frozen=True, eq=False)
class EllipseVerdict:
    """Judges ellipses of a frame.

    Parameters
    ----------
    scene : ShapeScene
    usual : float
        Mean squared residual of the contacts that fit, over its variance.
    score_scale : float
        Scale of the scores for ellipticity that noise and compression give all contacts.
    """

    scene: ShapeScene
    usual: float
    score_scale: float

    def is_elongated(self, ellipse: FittedEllipse) -> bool:
        """Whether an ellipticity is significant, among those that noise and compression give the others."""
        inflation = self.scene.inflation(float(ellipse.parameters[RADIUS]))
        return bool(ellipse.significance > LEAST_SIGNIFICANCE * max(self.score_scale / inflation, 1.0))

    def is_poor(self, ellipse: FittedEllipse) -> bool:
        """Whether an ellipse does not describe its pixels."""
        excess = self.usual * (1.0 + POOR_SIGMA * np.sqrt(2.0 / max(ellipse.pixels, 1)))
        return bool(ellipse.chi_square[0] > max(POOR_CHI_SQUARE * self.usual, excess))

    def is_misshapen(self, ellipse: FittedEllipse) -> bool:
        """Whether an ellipse is a poor fit by as much as an outline that departs from it would make it.

        A departure d of the outline adds ``(d C/(noise s))^2/(4 sqrt(pi) w)`` to the mean square there,
        w the half width of the band in blur widths.
        """
        noise, optics = self.scene.problem.noise, self.scene.optics
        variance = noise.variance * (1.0 + 0.5 * noise.slope)
        excess = max(float(ellipse.chi_square[0]) - self.usual, 0.0)
        squared = 4.0 * np.sqrt(np.pi) * BAND_BLUR_WIDTHS * excess * variance / optics.contrast**2
        return self.is_poor(ellipse) and squared > LEAST_DEPARTURE_BLUR_WIDTHS**2

    def is_uneven(self, ellipse: FittedEllipse) -> bool:
        """Whether the plateau of an ellipse is not flat."""
        return bool(ellipse.chi_square[1] > UNEVEN_RATIO * self.usual)
