"""Young's modulus of a sample at a calibrated threshold: local forces are proportional to the modulus."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from contactimg.calibration.coverage_estimate import CoverageEstimate
from contactimg.calibration.threshold import load_slope
from contactimg.errors import InputError


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
        Whether the new modulus lies within the 95 % interval of the measured one.
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
    relative = slope.std / slope.value
    half = value * (slope.high - slope.low) / 2 / slope.value
    tuned = CoverageEstimate(value, value * relative, max(value - half, 0.0), value + half)
    difference = value - young_modulus
    distance = difference / np.hypot(tuned.std, young_modulus_std) if young_modulus_std > 0 else np.nan
    compatible = not (young_modulus_std > 0 and abs(difference) > 1.96 * young_modulus_std)
    message = ""
    if not compatible:
        message = (
            f"slope 1 needs E = {value / 1e6:.4g} MPa, outside the measured "
            f"{young_modulus / 1e6:.4g} +- {young_modulus_std / 1e6:.2g} MPa (1.96 standard uncertainties)"
        )
    return ModulusCalibration(tuned, slope, float(distance), compatible, message)
