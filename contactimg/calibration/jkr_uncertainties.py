"""What each source of error does to the modulus and the work of adhesion of a JKR fit.

The fit is repeated with each source changed: with an exact zero, with a drift, with another thickness.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.calibration.jkr import JkrCalibration, JkrEstimates, SmoothSphere, solve_series
from contactimg.calibration.jkr_departures import Departure, ramp
from contactimg.calibration.jkr_fit import average_noises

THICKNESS_STEP = 0.1
"""Relative change of a stated thickness in the table of uncertainties."""
UNSTATED_RATIO = 0.1
"""Largest contact radius over the thickness of a layer of which nothing is stated, in the same table."""

LAYER_RATIOS = (0.15, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 1.5)
"""Largest contact radius over the thicknesses that are tried. Chosen: the loads cannot tell a thicker one."""
LAYER_ODDS = 20.0
"""Ratio of likelihoods from which a layer is suggested. Chosen: usual for strong evidence."""

PIXEL_CHANGES, SPHERE_CHANGES, GAIN_CHANGES = (-3.0, 0.0), (1.0, -1.0), (1.0, 1.0)
"""Relative changes of modulus and adhesion per relative change of the pixel size, the sphere's radius and the
gain. Theory: ``K ~ P R/a^3`` and ``w = S^2/K`` with ``S ~ P/a^{3/2}``, so that ``w ~ P/R``."""

ALLOWED, FITTED, LEFT_OUT = "allowed for", "fitted", "not included"


@dataclass(frozen=True)
class UncertaintySource:
    """What one source of error does to modulus and adhesion.

    Parameters
    ----------
    source : str
    size : float
        Standard uncertainty, or the change that is assumed.
    unit : str
    young_modulus, work_of_adhesion : float
        Relative changes by that size.
    state : str
        "fitted", "allowed for" (both are in the uncertainties) or "not included".
    """

    source: str
    size: float
    unit: str
    young_modulus: float
    work_of_adhesion: float
    state: str


def jkr_uncertainties(calibration: JkrCalibration) -> tuple[UncertaintySource, ...]:
    """What each source of error does to modulus and adhesion.

    Parameters
    ----------
    calibration : JkrCalibration

    Returns
    -------
    tuple of UncertaintySource
        What is in the stated uncertainties first; the others are not, and each is given by an error of stated
        size.
    """
    problem = calibration.problem
    found, used, sphere = problem.found, problem.used, problem.sphere
    here = solve_series(found.series, used, sphere)
    rows = [
        *_noise_and_zero(calibration, here),
        _proportional("gain of the load cell", problem.cell.gain_std, GAIN_CHANGES, ALLOWED),
        _proportional("curvature of the sphere, by direction", sphere.radius_std, SPHERE_CHANGES, ALLOWED),
    ]
    if found.rival is not None:
        change = here.change_to(solve_series(found.rival.series, used, sphere))
        rows.append(UncertaintySource(f"{found.rival.name} instead", found.doubt, "1", *change, ALLOWED))
    rows += [
        _drift_source(found, used, sphere, here),
        _thickness_source(found, used, sphere, here),
        _proportional("pixel size", 0.01, PIXEL_CHANGES, LEFT_OUT),
        _proportional("radius of the sphere", 0.01, SPHERE_CHANGES, LEFT_OUT),
    ]
    return tuple(rows)


def _noise_and_zero(calibration: JkrCalibration, here: JkrEstimates) -> list[UncertaintySource]:
    """The noise of loads and radii alone, and what the zero of the loads adds to it."""
    problem = calibration.problem
    series = problem.found.series
    exact = solve_series(replace(series, zero_std=0.0), problem.used, problem.sphere)
    E, w = here.modulus.value, max(here.work[0].value, np.finfo(float).tiny)
    noise = np.minimum([exact.modulus.std, exact.work[0].std], [here.modulus.std, here.work[0].std])
    zero = np.sqrt(np.array([here.modulus.std, here.work[0].std]) ** 2 - noise**2)
    state = FITTED if calibration.load_zero_seen else ALLOWED
    return [
        UncertaintySource("noise of loads and radii", 1.0, "std", noise[0] / E, noise[1] / w, ALLOWED),
        UncertaintySource("zero of the loads", series.zero_std, "N", zero[0] / E, zero[1] / w, state),
    ]


def _proportional(source: str, size: float, changes: tuple[float, float], state: str) -> UncertaintySource:
    """A relative error that changes modulus and adhesion in proportion."""
    return UncertaintySource(source, size, "1", changes[0] * size, changes[1] * size, state)


def _drift_source(
    found: Departure, used: NDArray[np.bool_], sphere: SmoothSphere, here: JkrEstimates
) -> UncertaintySource:
    """A drift of the zero over the series by its own standard uncertainty."""
    series = found.series
    if here.drift is not None:
        unit = "N" if found.name.endswith("zero") else "1"
        plain = replace(series, drift=series.drift[:, :0])
        change = solve_series(plain, used, sphere).change_to(here)
        return UncertaintySource(found.name, here.drift.value, unit, *change, FITTED)
    size = series.zero_std
    drifted = replace(series, load=series.load + size * ramp(len(series.load)))
    change = here.change_to(solve_series(drifted, used, sphere))
    return UncertaintySource("drift of the zero over the series", size, "N", *change, LEFT_OUT)


def _thickness_source(
    found: Departure, used: NDArray[np.bool_], sphere: SmoothSphere, here: JkrEstimates
) -> UncertaintySource:
    """A layer that is thinner than stated, or that is there although none is stated."""
    series = found.series
    if series.thickness is not None:
        name, size, unit = "thickness of the layer", -THICKNESS_STEP, "1"
        thinner = (1 - THICKNESS_STEP) * series.thickness
    else:
        thinner = float(series.radius.max()) / UNSTATED_RATIO
        name, size, unit = "layer of ten contact radii, not stated", thinner, "m"
    change = here.change_to(solve_series(replace(series, thickness=thinner), used, sphere))
    return UncertaintySource(name, size, unit, *change, LEFT_OUT)


@dataclass(frozen=True)
class LayerHint:
    """A layer that the loads ask for although none is stated.

    Parameters
    ----------
    thickness : float, m
    young_modulus : float
        Relative change of Young's modulus by it.
    """

    thickness: float
    young_modulus: float


def suggested_layer(calibration: JkrCalibration) -> LayerHint | None:
    """The layer that explains the frames far better than a half-space does.

    Parameters
    ----------
    calibration : JkrCalibration

    Returns
    -------
    LayerHint or None
        None where a thickness is stated, or the odds for a layer are below `LAYER_ODDS`.
    """
    problem = calibration.problem
    series, used, sphere = problem.found.series, problem.used, problem.sphere
    if series.thickness is not None:
        return None
    layers = [replace(series, thickness=float(series.radius.max()) / ratio) for ratio in LAYER_RATIOS]
    without, *logs = (average_noises(one.part(used)).evidence for one in (series, *layers))
    best = int(np.argmax(logs))
    if logs[best] - without < np.log(LAYER_ODDS):
        return None
    here, layered = (solve_series(one, used, sphere) for one in (series, layers[best]))
    thickness = float(series.radius.max()) / LAYER_RATIOS[best]
    return LayerHint(thickness, here.change_to(layered)[0])
