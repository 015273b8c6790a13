"""Height distributions of the statistical models: how many summits rise above a level, and how far.

Each gives the moments ``F_n(x) = int (z - top + x)^n psi(z) dz`` over the summits higher than ``top - x``,
with ``psi`` the density of heights (integral one). At a depth ``x`` below the top, ``n = 0`` gives the
fraction of summits in contact and ``n = 1/2, 1, 3/2`` their contact radius, area and force; ``dF_n/dx = n
F_{n-1}``. Depths count from the top, so that a slight touch of a rough surface loses no digits.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import pbdv

from contactimg.errors import InputError

Values = NDArray[np.float64]


@dataclass(frozen=True)
class UniformHeights:
    """Heights spread evenly over an interval; an indentation counts from its upper end.

    Parameters
    ----------
    low, high : float, m

    Examples
    --------
    >>> float(UniformHeights(30e-6, 60e-6).moment(15e-6, 0))
    0.5
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.low) and np.isfinite(self.high) and self.low < self.high):
            raise InputError(
                f"uniform heights need a finite low below high, got {self.low!r} and {self.high!r} m"
            )

    @property
    def reference(self) -> float:
        """The highest asperity."""
        return self.high

    top = reference

    @property
    def width(self) -> float:
        """Total width of the interval."""
        return self.high - self.low

    def moment(self, depth: ArrayLike, power: float) -> Values:
        """``[x^{n+1} - (x - width)^{n+1}] / ((n + 1) width)``, brackets not below zero."""
        x = np.asarray(depth, dtype=np.float64)
        above, below = np.maximum(x, 0.0), np.maximum(x - self.width, 0.0)
        # far below the interval the difference of powers cancels; its midpoint rule does not
        deep = below > 1e4 * self.width
        middle = np.where(deep, 0.5 * (above + below), 0.0) ** power
        spread = (above ** (power + 1) - below ** (power + 1)) / ((power + 1) * self.width)
        return np.where(deep, middle, spread)


@dataclass(frozen=True)
class GaussianHeights:
    """Normally distributed heights; an indentation counts from their mean.

    Parameters
    ----------
    mean, std : float, m

    Examples
    --------
    >>> law = GaussianHeights(9e-6, 2.4e-6)
    >>> round(float(law.moment(law.top - law.mean, 0)), 12)
    0.5
    """

    mean: float
    std: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.mean) and 0 < self.std < np.inf):
            raise InputError(
                f"Gaussian heights need a finite mean and a positive std, got {self.mean!r}, {self.std!r} m"
            )

    @property
    def reference(self) -> float:
        """The mean height."""
        return self.mean

    @property
    def top(self) -> float:
        """Eight standard deviations above the mean: one summit in 10^15 is higher."""
        return self.mean + 8 * self.std

    @property
    def width(self) -> float:
        """Standard deviation."""
        return self.std

    def moment(self, depth: ArrayLike, power: float) -> Values:
        """``std^n Gamma(n+1)/sqrt(2 pi) exp(-s^2/4) D_{-n-1}(s)``, Whittaker's function; ``s`` the level."""
        x = 8 - np.asarray(depth, dtype=np.float64) / self.std
        near = np.clip(x, -25.0, 37.0)
        whittaker = pbdv(-power - 1, near)[0]
        exact = math.gamma(power + 1) / math.sqrt(2 * math.pi) * np.exp(-(near**2) / 4) * whittaker
        far = np.maximum(-x, 25.0)
        n, k = power, 1 / far**2
        # E[(far + z)^n] for a standard normal z, far >= 25: the next term is below 1e-11 of the first
        series = 1 + n * (n - 1) / 2 * k * (1 + (n - 2) * (n - 3) / 4 * k * (1 + (n - 4) * (n - 5) / 6 * k))
        return self.std**power * np.where(x < -25, far**power * series, np.where(x < 37, exact, 0.0))


@dataclass(frozen=True, eq=False)
class SampleHeights:
    """Heights of given asperities; an indentation counts from the highest.

    Parameters
    ----------
    values : ndarray, shape (n,), m

    Examples
    --------
    >>> float(SampleHeights(np.array([1e-6, 3e-6])).moment(1e-6, 0))
    0.5
    """

    values: Values

    def __post_init__(self) -> None:
        array = np.asarray(self.values, dtype=np.float64)
        if array.ndim != 1 or not array.size or not np.all(np.isfinite(array)):
            raise InputError("sample heights need a list of at least one finite height")
        object.__setattr__(self, "values", np.sort(array))

    @property
    def reference(self) -> float:
        """The highest asperity."""
        return float(self.values[-1])

    top = reference

    @property
    def width(self) -> float:
        """Range of the heights."""
        return float(self.values[-1] - self.values[0])

    def moment(self, depth: ArrayLike, power: float) -> Values:
        """Mean over the sample of the summits' penetrations to the power ``n``."""
        x, below = np.asarray(depth, dtype=np.float64), self.top - self.values[::-1]
        reached = np.searchsorted(below, x.ravel())  # the others have no part in the sum
        sums = [np.sum((one - below[:count]) ** power) for one, count in zip(x.ravel(), reached, strict=True)]
        return np.reshape(sums, x.shape) / below.size


HeightLaw = UniformHeights | GaussianHeights | SampleHeights
"""Distribution of summit heights, m.

``reference`` is the height from which an indentation counts, ``top`` that from which depths count (the
highest summit, or a height practically never exceeded), ``width`` that of the distribution.
"""
