"""How far the edge of the JKR reference contact seems to lie outside the true one.

An edge that is soft to one side looks like that of a larger contact: one image does not tell. A series does.
With the apparent radius ``a`` and the shift ``d`` of its edge the load is ``P(a - d) = P(a) - P'(a) d``, and
``P'`` goes with the radius as no other part of the law does. A shift in proportion to the radius is none that
the loads can tell: it acts like an error of the pixel size.
"""

from dataclasses import dataclass, replace

from contactimg.calibration.coverage_estimate import CoverageEstimate, estimate_from_draws
from contactimg.calibration.jkr_fit import JkrSeries, average_noises

FALSE_ALARM_RATE = 0.01
"""False-alarm rate: probability that an edge where it should be is called shifted. Theory: posterior
quantile, two-sided."""
SPARE_LOADS = 2
"""Loads beyond the number of unknowns that the shift needs. Chosen: one more than a fit without a test."""
SETTLED_STD_PX = 0.1
"""Standard uncertainty up to which a shift that is not seen is worth stating. Chosen: 1 % of the radius of a
contact of 10 px."""


@dataclass(frozen=True, eq=False)
class EdgeShift:
    """Shift of the edge, and the series in which it is fitted.

    Parameters
    ----------
    shift : CoverageEstimate, px
        Positive where the contact seems too large.
    seen : bool
        Whether the data show that there is one.
    series : JkrSeries
        With the shift among what is fitted.
    """

    shift: CoverageEstimate
    seen: bool
    series: JkrSeries

    @property
    def settled(self) -> bool:
        """Whether the shift is worth handing on."""
        return self.seen or self.shift.std < SETTLED_STD_PX


def find_edge_shift(series: JkrSeries, pixel_size: float) -> EdgeShift | None:
    """Fit the shift of the edge together with stiffness, adhesion and what else the series has.

    Parameters
    ----------
    series : JkrSeries
        The frames used.
    pixel_size : float, m

    Returns
    -------
    EdgeShift or None
        None for a series too short to tell; its own series has as many frames.
    """
    with_edge = with_shifted_edge(series, series, pixel_size)
    unknowns = with_edge.physical + with_edge.drift.shape[1] + 1
    if len(series.load) < unknowns + SPARE_LOADS:
        return None
    draws = average_noises(with_edge).draws()
    shifts = draws[:, with_edge.physical + with_edge.drift.shape[1]]
    seen = bool(min((shifts < 0).mean(), (shifts > 0).mean()) < FALSE_ALARM_RATE / 2)
    return EdgeShift(estimate_from_draws(shifts), seen, with_edge)


def with_shifted_edge(series: JkrSeries, used: JkrSeries, pixel_size: float) -> JkrSeries:
    """A series in which the shift of the edge is fitted, with the slope of the law fitted to those used."""
    slope = series.slope(series.radius, average_noises(used).centre) * series.load_scale
    return replace(series, edge=-slope * pixel_size)
