"""Friction: the shear stress of the real contact area, against velocity too."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from contactimg.analysis.area_power_law import group_loads
from contactimg.analysis.estimates import Estimate, student_estimate
from contactimg.analysis.linear_fit import Points, fit_proportional
from contactimg.errors import InputError


@dataclass(frozen=True)
class ShearStress:
    """Shear stress ``tau0`` of ``Q = tau0 A``.

    Parameters
    ----------
    stress : Estimate, Pa
    low, high : float, m^2
        Range of the area.
    n_points : int
    freedom : float
        Degrees of freedom behind the uncertainty: points minus one.
    confidence : float
        Of the interval.
    """

    stress: Estimate
    low: float
    high: float
    n_points: int
    freedom: float
    confidence: float


def fit_shear_stress(
    friction: pd.DataFrame, *, friction_std: float = 0.0, confidence: float = 0.95
) -> ShearStress:
    """Fit ``Q = tau0 A`` with errors in both.

    Parameters
    ----------
    friction : DataFrame
        Columns ``friction_N, area_m2, area_std_m2``; rows without friction or area are left out, and an
        uncertainty that is not stated is none. The sign of the friction is that of its direction.
    friction_std : float, N
        Standard uncertainty of the friction force.
    confidence : float
        Of the interval.

    Returns
    -------
    ShearStress

    Raises
    ------
    InputError
        If no frame with friction has contacts.

    Notes
    -----
    A line through the origin; without stated errors the ordinary least squares of the paper, ``sum QA/sum
    A^2``. With the share ``s`` of each frame in the result (its weight times ``A^2``, of sum 1) the variance
    is no less than ``sum (s (Q/A - tau0)/(1 - s))^2`` (HC3), also where the scatter grows with the load and
    the largest loads decide. Student's interval, with one degree of freedom less than there are frames. The
    interval does not include errors common to all areas, such as that of the threshold, which change
    ``tau0`` by their relative size.

    References
    ----------
    Yashima et al., Soft Matter 11 (2015) 871, doi:10.1039/C4SM02346C, eq. (4), Fig. 8. MacKinnon and White,
    J. Econometrics 29 (1985) 305, doi:10.1016/0304-4076(85)90158-7, for HC3.

    Examples
    --------
    >>> table = pd.DataFrame({"friction_N": [0.1, 0.2], "area_m2": [2e-7, 4e-7], "area_std_m2": 0.0})
    >>> round(fit_shear_stress(table).stress.value)
    500000
    """
    good = friction[friction["friction_N"].notna() & (friction["area_m2"] > 0)]
    if good.empty:
        hint = "add the loads' friction_N"
        raise InputError(f"a shear stress needs a frame with friction_N and contacts; {hint}")
    area, force, area_std = (good[name].to_numpy(float) for name in ("area_m2", "friction_N", "area_std_m2"))
    points = Points(area, np.abs(force), x_std=np.nan_to_num(area_std, nan=0.0), y_std=friction_std)
    fit = fit_proportional(points)
    stress, share = float(fit.parameters[0]), fit.weights * area**2
    share /= share.sum()
    # Measured: intervals of two frames, of which the larger has 98 %, hold the truth in 93 % of series; with
    # 0.6 in 79 %.
    own = np.sum((share * (np.abs(force) / area - stress) / (1 - np.minimum(share, 0.95))) ** 2)
    std = float(np.sqrt(max(fit.covariance[0, 0], own)))
    return ShearStress(
        stress=student_estimate(stress, std, freedom=fit.freedom, confidence=confidence),
        low=float(area.min()),
        high=float(area.max()),
        n_points=len(area),
        freedom=fit.freedom,
        confidence=confidence,
    )


def compare_stress(stress: ShearStress, reference: Estimate) -> Estimate:
    """Ratio of a shear stress to that of a smooth contact.

    Parameters
    ----------
    stress : ShearStress
        Of the rough contact.
    reference : Estimate, Pa
        Of the smooth contact; its standard uncertainty is 0 if it is not known.

    Returns
    -------
    Estimate
        The relative variances add; Student's interval with the rough contact's degrees of freedom.

    Raises
    ------
    InputError
        If the reference is not positive.

    Examples
    --------
    >>> rough = ShearStress(Estimate(0.49e6, 0.01e6, 0.0, 0.0), 1e-7, 1e-6, 8, 7, 0.95)
    >>> ratio = compare_stress(rough, Estimate(0.34e6, 0.01e6, 0.0, 0.0))
    >>> round(ratio.value, 2), round(ratio.std, 2)
    (1.44, 0.05)
    """
    if not reference.value > 0:
        raise InputError(f"the shear stress of the reference must be positive, got {reference.value!r} Pa")
    rough = stress.stress
    ratio = rough.value / reference.value
    std = float(np.hypot(rough.std, ratio * reference.std)) / reference.value
    return student_estimate(ratio, std, freedom=stress.freedom, confidence=stress.confidence)


def stress_by_velocity(
    friction: pd.DataFrame, *, friction_std: float = 0.0, tolerance: float = 0.05
) -> pd.DataFrame:
    """Shear stress at each sliding velocity.

    Parameters
    ----------
    friction : DataFrame
        As for `contactimg.fit_shear_stress`, with ``velocity_m_s``, whose sign is that of the direction. Rows
        without a velocity, or with a velocity of zero, are left out.
    friction_std : float, N
        Standard uncertainty of a friction force.
    tolerance : float
        Velocities that exceed the lowest of them by no more than this fraction are taken as one.

    Returns
    -------
    DataFrame
        One row a velocity, rising: ``velocity_m_s`` (geometric mean), ``stress_Pa, stress_std_Pa, n_frames``.
        The uncertainty is NaN where neither a stated error nor a second frame gives one.

    Raises
    ------
    InputError
        If no frame with friction, velocity and contacts is left.

    Notes
    -----
    The stress at each velocity is that of ``Q = tau0 A``. `contactimg.fit_power_law` through the rows gives
    an exponent; it is 0 where friction does not depend on velocity.

    References
    ----------
    Yashima et al., Soft Matter 11 (2015) 871, doi:10.1039/C4SM02346C, section on friction.

    Examples
    --------
    >>> table = pd.DataFrame({"friction_N": [0.1, 0.2, 0.11], "area_m2": [2e-7, 4e-7, 2e-7]})
    >>> found = stress_by_velocity(table.assign(area_std_m2=0.0, velocity_m_s=[1e-5, 1e-5, 1e-3]))
    >>> found["stress_Pa"].round().tolist(), found["n_frames"].tolist()
    ([500000.0, 550000.0], [2, 1])
    """
    table = friction.assign(speed=friction["velocity_m_s"].abs())
    moving = table[(table["speed"] > 0) & table["friction_N"].notna() & (table["area_m2"] > 0)]
    if moving.empty:
        raise InputError(
            "friction against velocity needs frames with friction_N, velocity_m_s and contacts; "
            "add these columns to the loads"
        )
    rows = []
    for _, part in moving.groupby(group_loads(moving["speed"].to_numpy(float), tolerance=tolerance)):
        found = fit_shear_stress(part, friction_std=friction_std)
        known = found.freedom > 0 or friction_std > 0 or (part["area_std_m2"] > 0).any()
        mean, std = np.exp(np.log(part["speed"]).mean()), found.stress.std if known else np.nan
        rows.append((mean, found.stress.value, std, found.n_points))
    return pd.DataFrame(rows, columns=["velocity_m_s", "stress_Pa", "stress_std_Pa", "n_frames"])
