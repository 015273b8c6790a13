"""Calibrations by a threshold: `calibrate threshold`, `calibrate modulus` and `calibrate plateau`."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from contactimg.analysis.load_cell import LoadCell
from contactimg.calibration.coverage_estimate import CoverageEstimate
from contactimg.calibration.modulus import calibrate_modulus
from contactimg.calibration.plateau import Plateau, find_plateau
from contactimg.calibration.threshold import calibrate_threshold, load_slope
from contactimg.errors import InputError
from contactimg.files import Experiment
from contactimg.pipeline.calibrate.result import Advance, Calibrated, cell_notes
from contactimg.pipeline.calibrate.threshold_scan import THRESHOLDS, ThresholdSeries, measure_thresholds
from contactimg.pipeline.series import measure_parts
from contactimg.plausibility import MAX_SCANNED_FORCES_OVER_LOAD, doubts_about_forces, settle
from contactimg.plots.calibration import plot_forces, plot_plateau, plot_slopes
from contactimg.plots.numbers import number_with_interval, plain_number
from contactimg.tables import FORCE_SUMS, THRESHOLD_CURVE, Schema


def frames_with_load(series: ThresholdSeries) -> ThresholdSeries:
    """The frames of a series that have a load and forces."""
    good = np.isfinite(series.frames["load_N"].to_numpy(float))
    if not good.any():
        raise InputError("no frame has a load; give loads.csv with the columns frame, load_N")
    forces = series.forces[:, good]
    known = np.isfinite(forces).any(axis=0)
    if not known.any():
        raise InputError(
            "no local force is known: give the radii of the asperities ([asperities] file or radius_m); "
            "without them a threshold is found by `calibrate plateau`"
        )
    kept = series.frames[good].reset_index(drop=True)
    return replace(series, areas=series.areas[:, good], forces=np.nan_to_num(forces), frames=kept)


def stated_modulus(experiment: Experiment) -> CoverageEstimate:
    """The modulus that the scene states."""
    elastic = experiment.scene.need("elastic", "local forces")
    return CoverageEstimate.of_normal(elastic.young_modulus, elastic.young_modulus_std)


def common_errors(experiment: Experiment, *, relative: float = 0.0) -> dict[str, float]:
    """Standard uncertainties that all force sums or all loads share: of load cell and forces (relative)."""
    cell = LoadCell.stated(experiment.scene.load)
    return {"relative_std": float(np.hypot(relative, cell.gain_std)), "zero_std": cell.zero_std}


def disk_slope(
    experiment: Experiment, series: ThresholdSeries, errors: dict[str, float], workers: int | None
) -> tuple[CoverageEstimate, np.ndarray]:
    """Slope and force sums that the disk method gives for the frames of a series."""
    frames = measure_parts(experiment, workers=workers).whole().frames.set_index("frame")
    forces = frames.loc[series.frames["frame"], "force_sum_N"].to_numpy(float)
    load = series.frames["load_N"].to_numpy(float)
    return load_slope(np.nan_to_num(forces), load, **errors), forces


def slope_quality(load: np.ndarray, forces: np.ndarray, slope: float) -> dict[str, Any]:
    """Scatter about the line, and the worst frame."""
    rest = forces - slope * load
    pressed = load > 0
    return {
        "frames_used": int(pressed.sum()),
        "residual_rms_N": float(np.sqrt(np.mean(rest[pressed] ** 2))),
        "worst_relative_residual": float(np.max(np.abs(rest[pressed] / load[pressed]))),
    }


def frame_messages(series: ThresholdSeries) -> list[str]:
    """What the frames' rows have to say."""
    kept = [f"{row['frame']}: {row['message']}" for row in series.frames.to_dict("records") if row["message"]]
    return kept + [str(text) for text in series.failed["message"]]


def force_sum_result(
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
    scene, modulus = experiment.scene, stated_modulus(experiment)
    relative = modulus.std / modulus.value
    series = frames_with_load(measure_thresholds(experiment, THRESHOLDS, workers=workers, advance=advance))
    load = series.frames["load_N"].to_numpy(float)
    errors = common_errors(experiment, relative=relative)
    notes = frame_messages(series) + cell_notes(experiment.scene)
    record: dict[str, Any] = {
        "kind": "threshold",
        "method": scene.measure.method,
        "fixed": {"young_modulus": modulus.record("Pa")},
    }
    slopes = [load_slope(row, load, **errors) for row in series.forces]
    stds = np.array([slope.std for slope in slopes])
    values = np.array([slope.value for slope in slopes])
    closest = float(values[np.argmin(np.abs(np.log(np.maximum(values, np.finfo(float).tiny))))])
    most = MAX_SCANNED_FORCES_OVER_LOAD
    doubts = doubts_about_forces(slope=closest, young_modulus=modulus.value, most=most)
    settle(doubts, "the calibration")
    forces, found, threshold, slope = np.full(len(load), np.nan), None, np.nan, None
    try:
        found = calibrate_threshold(series.thresholds, series.forces, load, **errors)
        forces, threshold, slope = found.forces, found.threshold.value, found.slope
        # a modulus that is too large makes the forces and with them the threshold too large
        share = relative / slope.std if slope.std else 0.0
        record |= {"threshold": found.threshold.record("1"), "slope": slope.record("1")}
        record["correlation"] = {"threshold, young_modulus": min(share, 1.0)}
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
    notes = frame_messages(series) + cell_notes(experiment.scene) + ([found.message] if found.message else [])
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


def run_plateau(experiment: Experiment, *, workers: int | None = None, advance: Advance = None) -> Calibrated:
    """The two thresholds between which the total area changes marginally, and areas with error bars.

    Parameters
    ----------
    experiment : Experiment
        Of a scene with a camera; loads are not needed.
    workers : int, optional
    advance : callable, optional

    Returns
    -------
    Calibrated
    """
    series = measure_thresholds(experiment, THRESHOLDS, workers=workers, advance=advance)
    found = find_plateau(series.thresholds, series.areas)
    notes = frame_messages(series)
    if not found.marginal:
        notes.append(
            f"no plateau proper: the area falls by {found.relative_fall:.0%} between {found.threshold_low:g} "
            f"and {found.threshold_high:g}, more than marginally (20 %)"
        )
    record = _record(found, float(np.diff(series.thresholds).max()) / 12**0.5, notes)
    table = series.frames.assign(area_m2=found.area, area_std_m2=found.area_std)
    rate = np.interp(series.thresholds, found.thresholds, found.fall_rates, left=np.nan, right=np.nan)
    curve = {"threshold": series.thresholds, "area_m2": series.areas.sum(axis=1), "fall_rate": rate}
    loads = [f"P = {plain_number(1e3 * load)} mN" for load in series.frames["load_N"]]
    known = series.frames["load_N"].notna()
    names = np.where(known, loads, series.frames["frame"].astype(str)).tolist()
    figure = plot_plateau(
        series.thresholds,
        series.areas,
        low=found.threshold_low,
        high=found.threshold_high,
        names=names,
        fall_rates=rate,
    )
    columns = [name for name in FORCE_SUMS.columns if name in table]
    return Calibrated(
        record,
        {"curve.csv": (THRESHOLD_CURVE, pd.DataFrame(curve)), "areas.csv": (FORCE_SUMS, table[columns])},
        {"plateau": figure},
        notes,
        failed=len(series.failed) > 0,
    )


def _record(found: Plateau, step: float, notes: list[str]) -> dict[str, Any]:
    """Record of a plateau for ``calibration.json``; its ends are known to a step of the thresholds."""
    exact = {
        "threshold_low": found.threshold_low,
        "threshold_high": found.threshold_high,
        "threshold": found.threshold,
    }
    record: dict[str, Any] = {
        name: CoverageEstimate.of_normal(value, step).record("1") for name, value in exact.items()
    }
    return record | {
        "kind": "plateau",
        "method": "threshold",
        "definition": "thresholds about the slowest fall of the total area A between which "
        "|d ln A/d threshold| is at most 1.5 times its smallest value",
        "fixed": {},
        "fitted": ["threshold_low", "threshold_high", "threshold"],
        "quality": {"relative_fall": found.relative_fall, "marginal": found.marginal},
        "notes": notes,
    }
