"""`calibrate threshold`: the optical threshold at which the forces add up to the load."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from contactimg.calibration.threshold import calibrate_threshold, load_slope
from contactimg.errors import InputError
from contactimg.files import Experiment
from contactimg.pipeline.calibrate.result import (
    Advance,
    Calibrated,
    _disk_slope,
    _loaded,
    _measured_modulus,
    _messages,
    _modulus_relative_std,
    _slope_quality,
)
from contactimg.pipeline.calibrate.thresholds import THRESHOLDS, ThresholdSeries, measure_thresholds
from contactimg.plots.calibration import plot_forces, plot_slopes
from contactimg.tables import FORCE_SUMS, THRESHOLD_CURVE, Schema


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
    scene, relative = experiment.scene, _modulus_relative_std(experiment)
    scene.need("elastic", "calibrating the threshold")
    series = _loaded(measure_thresholds(experiment, THRESHOLDS, workers=workers, advance=advance))
    load = series.frames["load_N"].to_numpy(float)
    notes = _messages(series)
    record: dict[str, Any] = {
        "kind": "threshold",
        "method": scene.measure.method,
        "fixed": {"young_modulus": _measured_modulus(experiment).record("Pa")},
    }
    slopes = [load_slope(row, load, relative_std=relative) for row in series.forces]
    stds = np.array([slope.std for slope in slopes])
    values = np.array([slope.value for slope in slopes])
    forces, found, threshold = np.full(len(load), np.nan), None, np.nan
    try:
        found = calibrate_threshold(series.thresholds, series.forces, load, relative_std=relative)
        forces, threshold = found.forces, found.threshold.value
        record |= {"threshold": found.threshold.record("1"), "slope": found.slope.record("1")}
    except InputError as error:
        if scene.measure.method != "disk":
            raise
        notes.append(str(error))
    if scene.measure.method == "disk":
        slope, forces = _disk_slope(experiment, series, relative, workers)
        record["slope"] = slope.record("1")
        notes.append(
            f"method disk: the slope {slope.value:.4f} is a check, no threshold changes it; "
            'the threshold found holds for method = "threshold" only'
        )
    record["fitted"] = ["threshold"] if found is not None else []
    record["quality"] = _slope_quality(load, forces, record["slope"]["value"])
    record["notes"] = notes
    curve = {
        "threshold": series.thresholds,
        "slope": values,
        "slope_std": stds,
        "area_m2": series.areas.sum(axis=1),
    }
    figures = {
        "slope_threshold.png": plot_slopes(series.thresholds, values, stds, found=threshold),
        "forces.png": plot_forces(load, forces),
    }
    return _threshold_result(record, series, forces, figures, curve=curve)


def _threshold_result(
    record: dict[str, Any],
    series: ThresholdSeries,
    forces: np.ndarray,
    figures: dict[str, Axes],
    *,
    curve: Mapping[str, Any] | None = None,
) -> Calibrated:
    """The result with the tables that threshold and modulus share."""
    table = series.frames[["frame", "load_N", "message"]].assign(force_sum_N=forces)
    tables: dict[str, tuple[Schema, pd.DataFrame]] = {"forces.csv": (FORCE_SUMS, table)}
    if curve is not None:
        tables["curve.csv"] = (THRESHOLD_CURVE, pd.DataFrame(curve))
    return Calibrated(record, tables, figures, record["notes"], failed=len(series.failed) > 0)
