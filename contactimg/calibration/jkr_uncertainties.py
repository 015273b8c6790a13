"""What each source of error does to the modulus and the work of adhesion of a JKR fit.

The fit is repeated with each source changed: with an exact zero, with a drift, with another thickness.
"""

from dataclasses import dataclass, replace

import numpy as np

from contactimg.calibration.jkr import (
    JkrCalibration,
    JkrEstimates,
    JkrProblem,
    is_asked_for,
    ramp,
    solve_series,
)

THICKNESS_STEP = 0.1
"""Relative change of a stated thickness in the table of uncertainties."""
UNSTATED_RATIO = 0.1
"""Largest contact radius over the thickness of a layer of which nothing is stated, in the same table."""

UNSTATED_ZERO = 0.005
"""Zero of the loads over the largest of them where nothing is stated of it, in the same table. Chosen:
typical data sheets state 0.1-1 % of the full scale for zero and creep together."""

LAYER_RATIOS = (0.15, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 1.5)
"""Largest contact radius over the thicknesses that are tried. Chosen: the loads cannot tell a thicker one."""

LAYER_FALSE_ALARM_RATE = 0.05
"""Probability that a layer is suggested where there is none. Chosen: a hint costs a look at the sample; with
1 % five loads would need one that they fit a hundred times better."""

PIXEL_CHANGES, SPHERE_CHANGES, GAIN_CHANGES = (-3.0, 0.0), (1.0, -1.0), (1.0, 1.0)
"""Relative changes of modulus and adhesion per relative change of the pixel size, the sphere's radius and the
gain. Theory: ``K ~ P R/a^3`` and ``w = S^2/K`` with ``S ~ P/a^{3/2}``, so that ``w ~ P/R``."""

ALLOWED, FITTED, LEFT_OUT = "allowed for", "fitted", "not included"


@dataclass(frozen=True)
class UncertaintySource:
    """Changes of modulus and adhesion by one source of error.

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
    series, used, sphere = problem.series, problem.used, problem.sphere
    here = solve_series(series, used, sphere)
    rows = [
        *_noise_and_zero(calibration, here),
        _proportional("gain of the load cell", problem.cell.gain_std, GAIN_CHANGES, ALLOWED),
        _proportional("curvature of the sphere, by direction", sphere.radius_std, SPHERE_CHANGES, ALLOWED),
    ]
    if problem.rival is not None:
        name, rival = problem.rival
        change = here.change_to(solve_series(rival, used, sphere))
        rows.append(UncertaintySource(f"{name} instead", problem.doubt, "1", *change, ALLOWED))
    rows += [
        _drift_source(calibration, here),
        _thickness_source(problem, here),
        _proportional("pixel size", 0.01, PIXEL_CHANGES, LEFT_OUT),
        _proportional("radius of the sphere", 0.01, SPHERE_CHANGES, LEFT_OUT),
    ]
    return tuple(rows)


def _noise_and_zero(calibration: JkrCalibration, here: JkrEstimates) -> list[UncertaintySource]:
    """The noise of loads and radii alone, and what the zero of the loads adds to it or would change."""
    problem = calibration.problem
    series, sizes = problem.series, (here.modulus.value, max(here.work[0].value, np.finfo(float).tiny))
    stds = np.array([here.modulus.std, here.work[0].std])
    name, noise = "zero of the loads", stds
    if series.zero_std:
        exact = solve_series(replace(series, zero_std=0.0), problem.used, problem.sphere)
        noise = np.minimum([exact.modulus.std, exact.work[0].std], stds)
        state = FITTED if calibration.load_zero_seen else ALLOWED
        added = np.sqrt(stds**2 - noise**2) / sizes
        zero = UncertaintySource(name, series.zero_std, "N", float(added[0]), float(added[1]), state)
    else:
        size = UNSTATED_ZERO * float(np.abs(series.load).max())
        moved = solve_series(replace(series, load=series.load - size), problem.used, problem.sphere)
        zero = UncertaintySource(name, size, "N", *here.change_to(moved), LEFT_OUT)
    own = noise / sizes
    first = UncertaintySource("noise of loads and radii", 1.0, "std", float(own[0]), float(own[1]), ALLOWED)
    return [first, zero]


def _proportional(source: str, size: float, changes: tuple[float, float], state: str) -> UncertaintySource:
    """A relative error that changes modulus and adhesion in proportion."""
    return UncertaintySource(source, size, "1", changes[0] * size, changes[1] * size, state)


def _drift_source(calibration: JkrCalibration, here: JkrEstimates) -> UncertaintySource:
    """The drift that was fitted, or one of the zero over the series as large as its uncertainty."""
    problem = calibration.problem
    series, used, sphere = problem.series, problem.used, problem.sphere
    if calibration.drift is not None:
        unit = "N" if calibration.departure.endswith("zero") else "1"
        plain = replace(series, extra=series.extra[:, 1:])
        change = solve_series(plain, used, sphere).change_to(here)
        return UncertaintySource(calibration.departure, calibration.drift.value, unit, *change, FITTED)
    size = series.zero_std or UNSTATED_ZERO * float(np.abs(series.load).max())
    drifted = replace(series, load=series.load + size * ramp(len(series.load)))
    change = here.change_to(solve_series(drifted, used, sphere))
    return UncertaintySource("drift of the zero over the series", size, "N", *change, LEFT_OUT)


def _thickness_source(problem: JkrProblem, here: JkrEstimates) -> UncertaintySource:
    """A layer that is thinner than stated, or that is there although none is stated."""
    series = problem.series
    if series.thickness is not None:
        name, size, unit = "thickness of the layer", -THICKNESS_STEP, "1"
        thinner = (1 - THICKNESS_STEP) * series.thickness
    else:
        thinner = float(series.radius.max()) / UNSTATED_RATIO
        name, size, unit = "layer of ten contact radii, not stated", thinner, "m"
    other = solve_series(replace(series, thickness=thinner), problem.used, problem.sphere)
    return UncertaintySource(name, size, unit, *here.change_to(other), LEFT_OUT)


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
    """The layer that explains the frames where a half-space does not.

    Parameters
    ----------
    calibration : JkrCalibration

    Returns
    -------
    LayerHint or None
        None where a thickness is stated, or an F test at 5 % does not ask for a layer.
    """
    problem = calibration.problem
    series, used, sphere = problem.series, problem.used, problem.sphere
    if series.thickness is not None:
        return None
    layers = [replace(series, thickness=float(series.radius.max()) / ratio) for ratio in LAYER_RATIOS]
    best = min(layers, key=lambda one: one.part(used).misfit())
    if not is_asked_for(series.part(used), best.part(used), more=1, false_alarm_rate=LAYER_FALSE_ALARM_RATE):
        return None
    here, layered = (solve_series(one, used, sphere) for one in (series, best))
    return LayerHint(float(best.thickness or 0.0), here.change_to(layered)[0])


def suggested_zero(calibration: JkrCalibration) -> float | None:
    """The zero of the loads (N) that the frames ask for, by an F test at 1 %, although none is stated."""
    problem = calibration.problem
    series = problem.series.part(problem.used)
    if series.zero_std:
        return None
    free = replace(series, zero_std=1.0)
    return float(free.fit(prior=False).parameters[-1]) if is_asked_for(series, free) else None
