"""What is known of the load cell beforehand: how far its zero and its gain may be off, in every frame alike.

``P_true = (P_read - zero) (1 + gain)``. Fits to a few loads cannot tell either (a gain never), so that both
are averaged over: the zero with a normal distribution of the stated width and a little weight on one ten
times as wide, so that data that show a zero far off may say so; the gain with a normal distribution.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from contactimg.errors import InputError
from contactimg.scene import Load

NORMAL_95 = float(special.ndtri(0.975))
"""Half-width of a normal distribution's 95 % interval in standard deviations, 1.96."""

Values = NDArray[np.float64]

DEFAULT_ZERO_FRACTION = 0.005
"""Standard uncertainty of a zero of which nothing is stated, over the largest load. Chosen: typical data
sheets state 0.1-1 % of the full scale for zero and creep together."""

DEFAULT_GAIN_STD = 0.01
"""Relative standard uncertainty of a gain of which nothing is stated. Chosen: typical of a load cell that was
calibrated once with weights."""

ZERO_SCALES, ZERO_WEIGHTS = np.array([1.0, 10.0]), np.array([0.98, 0.02])
"""Widths of the zero's distribution over the stated one, and their weights. Chosen: the second stays outside
the 95 % of what is not seen in the data; a zero five stated widths off outweighs it."""

ZERO_NODES = 41
"""Number of zeros per width over which a fit is averaged. Chosen: means and spreads of smooth functions are
then exact to 1e-3 of the width."""


@dataclass(frozen=True)
class LoadCell:
    """Standard uncertainties that all loads of a series share.

    Parameters
    ----------
    zero_std : float or None, N
        Of what the cell reads without load; None if nothing is known: half a percent of the largest load.
        0 for loads whose zero is exact.
    gain_std : float
        Of the gain, relative.

    Raises
    ------
    InputError
        If one is negative or not finite.

    Examples
    --------
    >>> LoadCell().zero_width([0.02, 0.5])
    0.0025
    """

    zero_std: float | None = None
    gain_std: float = DEFAULT_GAIN_STD

    def __post_init__(self) -> None:
        for name, value in (("zero", self.zero_std), ("gain", self.gain_std)):
            if value is not None and not 0 <= value < np.inf:
                raise InputError(
                    f"the uncertainty of a load cell's {name} must not be negative, got {value!r}"
                )

    @classmethod
    def stated(cls, load: Load) -> "LoadCell":
        """The load cell as a scene states it, with the defaults for what it does not."""
        return cls(load.zero_std, DEFAULT_GAIN_STD if load.gain_std is None else load.gain_std)

    def zero_width(self, load: ArrayLike) -> float:
        """Standard uncertainty of the zero for a series of loads, N."""
        if self.zero_std is not None:
            return self.zero_std
        return DEFAULT_ZERO_FRACTION * float(np.max(np.abs(np.asarray(load, float)), initial=0.0))


EXACT_LOADS = LoadCell(zero_std=0.0, gain_std=0.0)
"""A load cell without error."""


@dataclass(frozen=True)
class ZeroAverage:
    """Mean of the zero (N), and what not knowing it adds to the standard deviations of the parameters."""

    zero: float
    std: Values


def average_over_zeros(
    fit: Callable[[float], tuple[Values, float]], width: float, *, largest: float = np.inf
) -> ZeroAverage:
    """Average a fit over the zeros that the load cell may have.

    Parameters
    ----------
    fit : callable
        Zero (N) -> parameters, and the logarithm of their likelihood.
    width : float, N
        Standard uncertainty of the zero.
    largest : float, N
        Zeros from here on are impossible: a load that makes contacts is above 0.

    Returns
    -------
    ZeroAverage
        The standard deviations are half the central 95 % over 1.96.

    Examples
    --------
    A parameter that is the zero itself, with no data that tell:

    >>> found = average_over_zeros(lambda z: (np.array([z]), 0.0), 0.1)
    >>> bool(0.1 < found.std[0] < 0.12), round(abs(found.zero), 6)
    (True, 0.0)
    """
    steps = special.ndtri((np.arange(ZERO_NODES) + 0.5) / ZERO_NODES)
    zeros = (width * ZERO_SCALES[:, None] * steps).ravel()
    prior = np.repeat(np.log(ZERO_WEIGHTS / ZERO_NODES), ZERO_NODES)
    zeros, prior = zeros[zeros < largest], prior[zeros < largest]
    values, logs = (np.array(part) for part in zip(*(fit(float(z)) for z in zeros), strict=True))
    weights = special.softmax(logs + prior)
    return ZeroAverage(float(weights @ zeros), np.array([_spread(column, weights) for column in values.T]))


def _spread(values: Values, weights: Values) -> float:
    """Half the central 95 % of weighted values over 1.96."""
    order = np.argsort(values, kind="stable")
    passed = np.cumsum(weights[order]) - 0.5 * weights[order]
    low, high = np.interp([0.025, 0.975], passed, values[order])
    return float(high - low) / (2 * NORMAL_95)
