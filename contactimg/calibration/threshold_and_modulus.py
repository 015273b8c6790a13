"""The optical threshold at which the local forces add up to the load (the paper's calibration).

The pixels above a threshold give the contact radii, and Hertz's law the local forces. The slope of their sum
against the load decreases as the threshold increases; the calibrated threshold is the one with slope 1.

At that threshold the local forces tell Young's modulus of another sample, to which they are proportional.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactimg.analysis.estimates import CoverageEstimate, student_estimate
from contactimg.errors import InputError

Values = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ThresholdCalibration:
    """The calibrated threshold and the curve it was read from.

    Parameters
    ----------
    threshold : CoverageEstimate
        Fraction of the contact contrast.
    slope : CoverageEstimate
        Of the force sums against the loads at that threshold, 1 by construction.
    thresholds, slopes, slope_stds : ndarray, shape (m,)
        The curve.
    forces : ndarray, shape (n,), N
        Force sums at the calibrated threshold.
    """

    threshold: CoverageEstimate
    slope: CoverageEstimate
    thresholds: Values
    slopes: Values
    slope_stds: Values
    forces: Values


def load_slope(
    forces: ArrayLike, load: ArrayLike, *, relative_std: float = 0.0, zero_std: float = 0.0
) -> CoverageEstimate:
    """Slope of force sums against loads, least squares through the origin: ``sum(F P)/sum(P^2)``.

    Parameters
    ----------
    forces, load : array_like, shape (n,), N
        The order does not matter; a load of 0 does not count.
    relative_std : float
        Relative standard uncertainty common to all forces, such as that of the modulus, or to all loads.
    zero_std : float, N
        Standard uncertainty of the zero that all loads share; it moves the slope by its ratio to
        ``sum(P^2)/sum(P)``.

    Returns
    -------
    CoverageEstimate
        The scatter about the line, which includes the noise of the loads, gives the other part of the
        uncertainty; for a single load only ``relative_std`` contributes.

    Raises
    ------
    InputError
        If no load presses, a load is negative, or a number is missing.

    Notes
    -----
    The part due to scatter is the larger of two estimates: one for equal errors at all loads, and one from
    the residual at each load (HC3), which is also valid if the errors grow with the load.

    References
    ----------
    MacKinnon and White, J. Econometrics 29 (1985) 305, doi:10.1016/0304-4076(85)90158-7, for HC3.

    Examples
    --------
    >>> load_slope([0.011, 0.019, 0.051], [0.01, 0.02, 0.05]).value
    1.01333333
    """
    F, P = np.atleast_1d(np.asarray(forces, float)), np.atleast_1d(np.asarray(load, float))
    if F.shape != P.shape or F.ndim != 1 or not (np.isfinite(F).all() and np.isfinite(P).all()):
        raise InputError("the slope needs one finite force sum a load; leave out frames without a load")
    if (P < 0).any():
        raise InputError(
            f"loads must not be negative here, got {P.min():g} N: Hertz contacts bear no pull; leave it out"
        )
    F, P = F[P > 0], P[P > 0]
    if not P.size:
        raise InputError("no load presses: the slope of force sums against loads needs a load above 0")
    square = float(P @ P)
    slope = float(F @ P) / square
    freedom, std = P.size - 1, 0.0
    if freedom:
        rest = F - slope * P
        even = float(rest @ rest) / freedom / square
        own = float(np.sum((P * rest / (1 - P**2 / square)) ** 2)) / square**2
        std = max(even, own) ** 0.5
    known = abs(slope) * float(np.hypot(relative_std, zero_std * P.sum() / square))
    found = student_estimate(slope, std, freedom=max(freedom, 1)).widened(known)
    return CoverageEstimate.of_interval(slope, found.low, found.high)


def calibrate_threshold(
    thresholds: ArrayLike,
    forces: ArrayLike,
    load: ArrayLike,
    *,
    relative_std: float = 0.0,
    zero_std: float = 0.0,
) -> ThresholdCalibration:
    """Find the threshold at which the sum of local forces against the load has slope 1.

    Parameters
    ----------
    thresholds : array_like, shape (m,)
        Fractions of the contact contrast at which the frames were measured, in any order.
    forces : array_like, shape (m, n), N
        Sum of the local forces of each of n frames at each threshold.
    load : array_like, shape (n,), N
    relative_std : float
        Relative standard uncertainty of the modulus (and of the scale of the loads, in quadrature).
    zero_std : float, N
        Standard uncertainty of the zero that all loads share.

    Returns
    -------
    ThresholdCalibration
        The uncertainty of the slope over the steepness of the curve is that of the threshold.

    Raises
    ------
    InputError
        If no threshold brackets slope 1, with the range of slopes there is.

    References
    ----------
    Yashima et al., doi:10.1039/C4SM02346C, section on the experimental setups.

    Examples
    --------
    >>> t, P = np.linspace(0.1, 0.9, 9), np.array([0.1, 0.2, 0.5])
    >>> found = calibrate_threshold(t, (1.3 - 0.6 * t)[:, None] * P, P, relative_std=0.03)
    >>> found.threshold.value, found.threshold.std
    (0.5, 0.05)
    """
    t, F, P = np.asarray(thresholds, float), np.asarray(forces, float), np.asarray(load, float)
    if t.ndim != 1 or F.shape != (t.size, P.size) or t.size < 2:
        raise InputError(
            "forces must have one row a threshold (two or more) and one column a load, got shape "
            f"{F.shape} for {t.size} thresholds and {P.size} loads"
        )
    order = np.argsort(t)
    t, F = t[order], F[order]
    common = {"relative_std": relative_std, "zero_std": zero_std}
    slopes = [load_slope(row, P, **common) for row in F]
    values, stds = np.array([s.value for s in slopes]), np.array([s.std for s in slopes])
    k = _crossing(t, values)
    fraction = (values[k] - 1) / (values[k] - values[k + 1])
    at_unit = (1 - fraction) * F[k] + fraction * F[k + 1]
    slope = load_slope(at_unit, P, **common)
    low, high = max(k - 2, 0), min(k + 3, len(t) - 1)
    steepness = float((values[low] - values[high]) / (t[high] - t[low]))
    value = float(t[k] + fraction * (t[k + 1] - t[k]))
    ends = np.clip(value + np.array([-1, 1]) * (slope.high - slope.low) / 2 / steepness, 0.0, 1.0)
    threshold = CoverageEstimate(value, slope.std / steepness, *ends.tolist())
    return ThresholdCalibration(threshold, slope, t, values, stds, at_unit)


def _crossing(t: Values, slopes: Values) -> int:
    """The interval of thresholds in which the slope falls through 1; the one nearest to 0.5 of several."""
    falls = np.flatnonzero((slopes[:-1] >= 1) & (slopes[1:] < 1))
    if not falls.size:
        side = "small" if slopes.max() < 1 else "large"
        raise InputError(
            f"no threshold between {t[0]:g} and {t[-1]:g} gives slope 1: it runs from {slopes[0]:.4g} to "
            f"{slopes[-1]:.4g}, so the forces are too {side}: modulus or pixel size (cubed) may be too "
            f"{side}; check loads and asperity radii as well"
        )
    return int(falls[np.abs(t[falls] - 0.5).argmin()])


@dataclass(frozen=True)
class ModulusCalibration:
    """The modulus for slope 1, compared with the measured one.

    Parameters
    ----------
    young_modulus : CoverageEstimate, Pa
    slope : CoverageEstimate
        Of the force sums against the loads, with the measured modulus.
    distance : float
        New minus measured modulus in standard uncertainties of both; NaN if the measured one has none.
    compatible : bool
        Whether the two differ by at most 1.96 standard uncertainties of both; True if the measured one has
        none.
    message : str
        One sentence to show; empty if the two agree.
    """

    young_modulus: CoverageEstimate
    slope: CoverageEstimate
    distance: float
    compatible: bool
    message: str


def calibrate_modulus(
    forces: ArrayLike,
    load: ArrayLike,
    *,
    young_modulus: float,
    young_modulus_std: float,
    relative_std: float = 0.0,
    zero_std: float = 0.0,
) -> ModulusCalibration:
    """Tune the modulus of a sample for slope 1 of force sums against loads, the threshold kept.

    Parameters
    ----------
    forces : array_like, shape (n,), N
        Sum of the local forces of each frame, found with ``young_modulus`` at one threshold.
    load : array_like, shape (n,), N
    young_modulus, young_modulus_std : float, Pa
        As measured, with its standard uncertainty; 0 if that is not known.
    relative_std : float
        Relative standard uncertainty common to all force sums, such as that due to the threshold, or to all
        loads.
    zero_std : float, N
        Standard uncertainty of the zero that all loads share.

    Returns
    -------
    ModulusCalibration
        ``E = E_measured / slope``: local forces are proportional to the modulus.

    Raises
    ------
    InputError
        If forces at several thresholds are handed in: threshold and modulus cannot both be fitted on one
        load curve. Slope 1 fixes only a line in the plane of the two.

    Examples
    --------
    >>> tuned = calibrate_modulus([0.098, 0.196], [0.1, 0.2], young_modulus=3e6, young_modulus_std=0.1e6)
    >>> tuned.young_modulus.value, tuned.compatible
    (3061224.5, True)
    """
    if np.ndim(forces) != 1:
        raise InputError(
            "threshold and modulus cannot both be fitted on one load curve: slope 1 fixes only a line in the "
            f"plane of the two; hand in the forces at one threshold, got shape {np.shape(forces)}"
        )
    if not (young_modulus > 0 and young_modulus_std >= 0):
        raise InputError(
            "the measured modulus must be positive and its uncertainty not negative, "
            f"got {young_modulus!r} +- {young_modulus_std!r} Pa"
        )
    slope = load_slope(forces, load, relative_std=relative_std, zero_std=zero_std)
    if not slope.value > 0:
        raise InputError("the force sums are zero at every load: no modulus gives slope 1")
    value = young_modulus / slope.value
    half = value * (slope.high - slope.low) / 2 / slope.value
    tuned = CoverageEstimate(value, value * slope.std / slope.value, max(value - half, 0.0), value + half)
    difference = value - young_modulus
    distance = difference / np.hypot(tuned.std, young_modulus_std) if young_modulus_std > 0 else np.nan
    compatible = not abs(distance) > 1.96
    message = ""
    if not compatible:
        message = (
            f"slope 1 needs E = {value / 1e6:.4g} +- {tuned.std / 1e6:.2g} MPa, outside the measured "
            f"{young_modulus / 1e6:.4g} +- {young_modulus_std / 1e6:.2g} MPa (1.96 standard uncertainties), "
            f"or pixels {slope.value ** (-1 / 3):.3g} times as large as stated"
        )
    return ModulusCalibration(tuned, slope, float(distance), compatible, message)
