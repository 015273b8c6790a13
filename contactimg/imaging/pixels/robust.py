"""Order statistics of many values, and limits in standard deviations of them."""

import numpy as np
from numpy.typing import NDArray

MAD_TO_STD = 1.4826
"""Standard deviation of normal deviates over their median absolute deviation: 1/Phi^-1(3/4)."""

QUARTILE_TO_STD = 1.0 / 0.3186
"""The same over the lower quartile of the absolute deviations: 1/Phi^-1(5/8)."""
CLIP_SIGMA = 4.0
"""Robust standard deviations beyond which a value is none of the others. Theory: 6e-5 of normal noise."""
SIGNIFICANT_SIGMA = 5.0
"""Standard errors beyond which a mean or a covariance is not there by chance. False-alarm rate 6e-7 (theory).
Also where the mean over a square, or the light of a contact, stands out of the noise."""
AGREEMENT_SIGMA = 2.0
"""Standard errors up to which two measures of the same thing agree, and robust standard deviations up to
which a value agrees with what is fitted to it and others."""
ROUGH_RATIO = 1.5
"""Scatter over the usual one from which it is another one. By hand: compression and sharpening ring beside
contacts; a frame that differs from the others; light that is not followed makes 1.3, flicker 2.0."""
LIGHT_SIGMA = 8.0
"""Least summed light of a component or a faint region, in standard deviations of the noise, and height of a
block or a peak of a correlation over the scatter of the others. Noise and texture alone stay below 6."""

SOME = 60
"""Values that give a scatter to 10 % (theory: 1/sqrt(2 n))."""
FEWEST_VALUES = 300
"""Values that give a variance, to 8 % (theory: sqrt(2/n)), or a tail, in which three of them lie."""
MANY = 160_000
"""Values that are looked at where each tells little: a covariance, or blocks of 64 of them. Accuracy."""
SAMPLE = 20_000
"""Values that are looked at where there are many: they give a scatter to 0.6 % (theory)."""


def finite_values(values: NDArray) -> NDArray:
    """The values that are finite, in one row.

    Examples
    --------
    >>> finite_values(np.array([[3.0, np.nan], [2.0, 5.0]])).tolist()
    [3.0, 2.0, 5.0]
    """
    finite = np.isfinite(values)
    return values.ravel() if finite.all() else values[finite]


def quantile(values: NDArray, share: float) -> float:
    """The value below which a fraction ``share`` of the others lie; not interpolated.

    Examples
    --------
    >>> quantile(np.array([[3.0, 1.0], [2.0, 5.0], [4.0, 6.0]]), 0.8)
    5.0
    """
    flat = values.ravel()
    rank = int(share * (flat.size - 1) + 0.5)
    # among many equal values a partition is slow, and small whole numbers are sorted fast, by their digits
    whole = flat.dtype.kind in "iu"
    ordered = np.sort(flat, kind="stable") if whole else np.partition(flat, rank)
    return float(ordered[rank])


def median(values: NDArray) -> float:
    """The middle value, the higher one of two."""
    return quantile(values, 0.5)


def robust_std(values: NDArray, centre: float | None = None) -> float:
    """Standard deviation of normal deviates with a few outliers: 1.4826 times the median absolute deviation.

    Parameters
    ----------
    values : ndarray
        At least one value, all finite.
    centre : float or None
        What the deviations are taken from; None: the median.

    Examples
    --------
    >>> robust_std(np.array([1.0, 2.0, 3.0, 4.0, 1000.0])), robust_std(np.array([-1.0, 2.0, 3.0]), 0.0)
    (1.4826, 2.9652)
    """
    middle = median(values) if centre is None else centre
    return MAD_TO_STD * median(np.abs(values - np.asarray(middle, values.dtype)))


def noise_std(values: NDArray) -> float:
    """`robust_std` of noise, also where a camera or a compression has made most of the values equal.

    Clipped at full scale, half of the pixels of a white background are equal; compressed as JPEG, most of any
    flat one. The median deviation is then next to 0, and the ninth decile tells.

    Examples
    --------
    >>> noise_std(np.array([0.0] * 16 + [-3.3, 3.3, -3.3, 3.3])), noise_std(np.array([-1.0, 0.0, 1.0]))
    (2.00607, 1.4826)
    """
    middle = median(values)
    deviation = np.abs(values - np.asarray(middle, values.dtype))
    # 1/Phi^-1(0.95) = 0.6079.
    usual, tail = MAD_TO_STD * median(deviation), 0.60790 * quantile(deviation, 0.9)
    # Above, most values are equal. By hand: 1 for normal values, 3 among contacts that leave no block free of
    # their light, 10 or more where values are clipped.
    return tail if tail > 6.0 * usual else usual


def reach_std(values: NDArray, centre: float) -> float:
    """Standard deviation that tells how far values without a contact reach above their centre.

    Waves and fringes reach less far above it than their scatter would let normal noise do, and no contact
    lies below: the smaller of the scatter below and of the tail below, over what these are of normal values.

    Examples
    --------
    >>> wave = np.sin(np.linspace(0.0, 60.0 * np.pi, 6001))
    >>> reach_std(wave, 0.0), reach_std(wave[:100], 0.0)  # a hundred values have no tail
    (0.388, 0.375)
    """
    below = centre - values[values < centre]
    if below.size < FEWEST_VALUES:
        return noise_std(values)
    scatter = MAD_TO_STD * median(below)
    # Theory: of the values below the centre, a hundredth lies beyond 2.576 standard deviations.
    return min(scatter, quantile(below, 0.99) / 2.576)
