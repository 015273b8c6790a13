"""What contacts below the detection limit add to the area and the force of a frame.

A contact of radius ``a`` on a sphere of radius ``R`` is pressed in by ``a^2/R``. Summits just touched are as
many per depth as those a little deeper, whatever the heights' distribution, as long as it is smooth on that
scale: the density of contacts in ``u = a^2`` is even near zero. That density is counted just above the
detection limit and extended below it, with its trend where that is no chance. The light of a small contact is
proportional to ``u``, and what stands out of the noise by `DETECTION_SIGMA` is detected in half of the cases,
so that a share ``Phi(DETECTION_SIGMA (u/u_half - 1))`` of the contacts is found.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

DETECTION_SIGMA = 6.0
"""Signal over noise at which half of the contacts are detected: the level of the matched filter."""

WINDOW = (1.5, 5.5)
"""Range of ``u/u_half`` in which contacts are counted. From 1.5 on all are found (three standard deviations);
chosen: the upper end, a balance between counting and the trend of the distribution, which the two halves of
the window give."""

MEAN_UNSEEN_RATIO = 2 / 3
"""Mean of ``u/u_half`` over the unseen area. Theory: an even density up to 1."""

PRIOR_COUNT = 0.5
"""Contacts added to those of the window (Jeffreys' prior of a count), so that none in it is not nothing."""


@dataclass(frozen=True)
class Total:
    """A sum over the contacts of a frame, with its standard uncertainty."""

    value: float
    std: float

    @property
    def rms(self) -> float:
        """Root mean square: the error of a sum that leaves this out."""
        return float(np.hypot(self.value, self.std))


NOTHING = Total(0.0, 0.0)


def unseen_area(contacts: pd.DataFrame, smallest: float) -> Total:
    """Area of the contacts that are too small to be detected, m^2.

    Parameters
    ----------
    contacts : DataFrame
        Those of one frame, with ``radius_m``.
    smallest : float, m
        Radius of which half of the contacts are detected.

    Returns
    -------
    Total
        Without any contact 0, known no better than one contact of that radius; nothing where the limit is
        not known.

    Examples
    --------
    >>> even = pd.DataFrame({"radius_m": 1e-6 * np.sqrt(np.arange(1.25, 30, 0.5))})
    >>> found = unseen_area(even, 1e-6)  # two contacts per unit of u/u_half, and half a one
    >>> round(found.value / (np.pi * 1e-12), 2)
    1.09
    """
    if not smallest > 0:
        return NOTHING
    if not len(contacts):
        return Total(0.0, float(np.pi * smallest**2))
    return _unseen_sum(contacts, smallest, power=1.0, factor=np.pi)


def unseen_force(contacts: pd.DataFrame, smallest: float) -> Total:
    """Force on the contacts that are too small to be detected, N.

    Parameters
    ----------
    contacts : DataFrame
        Those of one frame, with ``radius_m`` and ``force_N``; the force over ``a^3`` of those below is the
        median of these.
    smallest : float, m
        Radius of which half of the contacts are detected.

    Returns
    -------
    Total
        Nothing where no contact has a force.
    """
    force, radius = contacts["force_N"].to_numpy(float), contacts["radius_m"].to_numpy(float)
    known = np.isfinite(force)
    if not smallest > 0 or not known.any():
        return NOTHING
    factor = float(np.median(force[known] / radius[known] ** 3))
    return _unseen_sum(contacts, smallest, power=1.5, factor=factor)


def _unseen_sum(contacts: pd.DataFrame, smallest: float, *, power: float, factor: float) -> Total:
    """Sum of ``factor u^power`` over the contacts below the limit."""
    ratio = (contacts["radius_m"].to_numpy(float) / smallest) ** 2
    low, high = WINDOW
    middle, width = 0.5 * (low + high), high - low
    near, far = (_count(ratio, *ends) for ends in ((low, middle), (middle, high)))
    number, trend = near + far + PRIOR_COUNT, near - far
    # a straight line through the two halves, to where the missing area is; shrunk as far as it is chance
    reach = (middle - MEAN_UNSEEN_RATIO) / (0.25 * width**2)
    shrunk = trend**2 / (trend**2 + number)
    density = max(number / width + shrunk * reach * trend, PRIOR_COUNT / width)  # per u_half
    variance = number / width**2 + (shrunk * reach) ** 2 * number + ((1 - shrunk) * reach * trend) ** 2
    scale = abs(factor) * smallest ** (2 * power)
    own = density * _missed_moment(2 * power)  # the unseen are a number of independent contacts themselves
    std = scale * np.sqrt(variance * _missed_moment(power) ** 2 + own)
    return Total(float(np.sign(factor) * scale * _missed_moment(power) * density), float(std))


def _count(ratio: NDArray[np.float64], low: float, high: float) -> int:
    return int(np.count_nonzero((ratio >= low) & (ratio < high)))


def _missed_moment(power: float) -> float:
    """``int x^power (1 - Phi(s (x - 1))) dx`` from 0, to second order in ``1/s``: ``E[X^(p+1)]/(p+1)``."""
    return (1 + 0.5 * (power + 1) * power / DETECTION_SIGMA**2) / (power + 1)
