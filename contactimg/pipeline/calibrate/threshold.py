"""`calibrate threshold`: the optical threshold at which the forces add up to the load."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactimg.calibration.threshold import ThresholdCalibration, calibrate_threshold, load_slope
from contactimg.errors import InputError
from contactimg.files import Experiment
from contactimg.pipeline.calibrate.force_sums import (
    cell_notes,
    common_errors,
    disk_slope,
    force_sum_result,
    frame_messages,
    frames_with_load,
    modulus_relative_std,
    slope_quality,
    stated_modulus,
)
from contactimg.pipeline.calibrate.result import Advance, Calibrated
from contactimg.pipeline.calibrate.threshold_scan import THRESHOLDS, measure_thresholds
from contactimg.plausibility import MAX_SCANNED_FORCES_OVER_LOAD, doubts_about_forces, settle
from contactimg.plots.calibration import plot_forces, plot_slopes


def run_threshold(
    experiment: Experiment, *, workers: int | None = None, advance: Advance = None
) -> Calibrated:
    """The threshold of slope 1 on a sample of known modulus; for the disk method, its slope as a check.

    Parameters
    ----------
    experiment : Experiment
        Of a scene with the modulus and its uncertainty, and asperities of known radii.
    workers : int, optional
    advance : callable, optional

    Returns
    -------
    Calibrated

    Raises
    ------
    InputError
        If no threshold brackets slope 1 and the method is "threshold", or no force is known.
    """
    scene, relative = experiment.scene, modulus_relative_std(experiment)
    scene.need("elastic", "calibrating the threshold")
    series = frames_with_load(measure_thresholds(experiment, THRESHOLDS, workers=workers, advance=advance))
    load = series.frames["load_N"].to_numpy(float)
    errors = common_errors(experiment, relative=relative)
    notes = frame_messages(series) + cell_notes(experiment)
    record: dict[str, Any] = {
        "kind": "threshold",
        "method": scene.measure.method,
        "fixed": {"young_modulus": stated_modulus(experiment).record("Pa")},
    }
    slopes = [load_slope(row, load, **errors) for row in series.forces]
    stds = np.array([slope.std for slope in slopes])
    values = _plausible(np.array([slope.value for slope in slopes]), stated_modulus(experiment).value)
    forces, found, threshold, slope = np.full(len(load), np.nan), None, np.nan, None
    try:
        found = calibrate_threshold(series.thresholds, series.forces, load, **errors)
        forces, threshold, slope = found.forces, found.threshold.value, found.slope
        record |= _found_record(found, modulus_relative_std(experiment))
    except InputError as error:
        if scene.measure.method != "disk":
            raise
        notes.append(str(error))
    if scene.measure.method == "disk":
        slope, forces = disk_slope(experiment, series, errors, workers)
        record["slope"] = slope.record("1")
        notes.append(
            f"method disk: the slope {slope.value:.4f} is a check, no threshold changes it; "
            'the threshold found holds for method = "threshold" only'
        )
    record["fitted"] = ["threshold"] if found is not None else []
    record["quality"] = slope_quality(load, forces, record["slope"]["value"])
    record["notes"] = notes
    areas = series.areas.sum(axis=1)
    curve = {"threshold": series.thresholds, "slope": values, "slope_std": stds, "area_m2": areas}
    figures = {
        "slope_threshold": plot_slopes(series.thresholds, values, stds, found=threshold, areas=areas),
        "forces": plot_forces(load, forces, slope=slope),
    }
    return force_sum_result(record, series, forces, figures, curve=curve)


def _plausible(slopes: NDArray[np.float64], young_modulus: float) -> NDArray[np.float64]:
    """The slopes; refused if even the one closest to 1 is far from it."""
    closest = float(slopes[np.argmin(np.abs(np.log(np.maximum(slopes, np.finfo(float).tiny))))])
    most = MAX_SCANNED_FORCES_OVER_LOAD
    settle(doubts_about_forces(slope=closest, young_modulus=young_modulus, most=most), "the calibration")
    return slopes


def _found_record(found: ThresholdCalibration, modulus_std: float) -> dict[str, Any]:
    """Threshold and slope, and how the errors of threshold and modulus (relative) go together."""
    # a modulus that is too large makes the forces and with them the threshold too large
    share = modulus_std / found.slope.std if found.slope.std else 0.0
    return {
        "threshold": found.threshold.record("1"),
        "slope": found.slope.record("1"),
        "correlation": {"threshold, young_modulus": min(share, 1.0)},
    }
