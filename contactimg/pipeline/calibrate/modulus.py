"""`calibrate modulus`: the modulus at which the forces add up to the load."""

from typing import Any

import numpy as np

from contactimg.calibration.coverage_estimate import CoverageEstimate
from contactimg.calibration.modulus import calibrate_modulus
from contactimg.calibration.threshold import load_slope
from contactimg.errors import InputError
from contactimg.files import Experiment
from contactimg.pipeline.calibrate.force_sums import (
    cell_notes,
    common_errors,
    disk_slope,
    force_sum_result,
    frame_messages,
    frames_with_load,
    slope_quality,
    stated_modulus,
)
from contactimg.pipeline.calibrate.result import Advance, Calibrated
from contactimg.pipeline.calibrate.threshold_scan import THRESHOLDS, measure_thresholds
from contactimg.plausibility import doubts_about_forces, settle
from contactimg.plots.calibration import plot_forces
from contactimg.plots.numbers import number_with_interval


def run_modulus(
    experiment: Experiment,
    *,
    threshold: CoverageEstimate | None,
    workers: int | None = None,
    advance: Advance = None,
) -> Calibrated:
    """The modulus of slope 1 at a threshold that is kept; for the disk method, without one.

    Parameters
    ----------
    experiment : Experiment
        Of a scene with asperities of known radii; its modulus and uncertainty are those measured before.
    threshold : CoverageEstimate or None
        The calibrated threshold; None for the disk method.
    workers : int, optional
    advance : callable, optional

    Returns
    -------
    Calibrated
    """
    levels = THRESHOLDS if threshold is None else threshold.value + np.array([-0.02, 0.0, 0.02])
    if levels.min() <= 0 or levels.max() >= 1:
        raise InputError(f"the threshold must lie between 0.02 and 0.98, got {threshold}")
    series = frames_with_load(measure_thresholds(experiment, levels, workers=workers, advance=advance))
    load = series.frames["load_N"].to_numpy(float)
    measured, steepness = stated_modulus(experiment), 0.0
    if threshold is None:
        _, forces = disk_slope(experiment, series, common_errors(experiment), workers)
    else:
        forces = series.forces[1]
        low, high = (load_slope(series.forces[k], load).value for k in (0, 2))
        steepness = abs(high - low) / 0.04 / max(load_slope(forces, load).value, 1e-12)
    found = calibrate_modulus(
        forces,
        load,
        young_modulus=measured.value,
        young_modulus_std=measured.std,
        **common_errors(experiment, relative=0.0 if threshold is None else steepness * threshold.std),
    )
    settle(doubts_about_forces(slope=found.slope.value, young_modulus=measured.value), "the calibration")
    notes = frame_messages(series) + cell_notes(experiment) + ([found.message] if found.message else [])
    record: dict[str, Any] = {
        "kind": "modulus",
        "method": "disk" if threshold is None else "threshold",
        "young_modulus": found.young_modulus.record("Pa"),
        "slope": found.slope.record("1"),
        "fixed": {"young_modulus_measured": measured.record("Pa")},
        "fitted": ["young_modulus"],
        "compatible": found.compatible,
        "distance_std": found.distance,
    }
    if threshold is not None:
        record["threshold"] = threshold.record("1")
        record["fixed"]["threshold"] = threshold.record("1")
    tuned = forces * found.young_modulus.value / measured.value
    record["quality"] = slope_quality(load, tuned, 1.0)
    record["notes"] = notes
    fitted = [f"E = {number_with_interval(found.young_modulus, factor=1e-6)} MPa"]
    return force_sum_result(record, series, tuned, {"forces": plot_forces(load, tuned, fitted=fitted)})
