"""The calibrations of the paper on folders of frames: JKR, threshold, modulus, plateau."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from contactimg.calibration.estimate import CoverageEstimate
from contactimg.calibration.jkr import JkrCalibration, calibrate_jkr, check_loads
from contactimg.calibration.modulus import calibrate_modulus
from contactimg.calibration.plateau import find_plateau
from contactimg.calibration.threshold import calibrate_threshold, load_slope
from contactimg.errors import InputError
from contactimg.files import CALIBRATION_FILE, Experiment, write_figure, write_json, write_table
from contactimg.mechanics import jkr
from contactimg.optics.wide_edge import film_opening
from contactimg.pipeline.circles import CIRCLES, CircleSeries, mean_centre, measure_circles
from contactimg.pipeline.series import FAILED, measure_experiment
from contactimg.pipeline.thresholds import THRESHOLDS, ThresholdSeries, measure_thresholds
from contactimg.plots.calibration import (
    plot_forces,
    plot_jkr,
    plot_jkr_residuals,
    plot_plateau,
    plot_slopes,
)
from contactimg.tables import Schema

__all__ = ["Calibrated", "run_jkr", "run_modulus", "run_plateau", "run_threshold", "write_calibration"]

Advance = Callable[[], None] | None

CURVE = Schema(
    "curve",
    {
        "threshold": ("float64", "fraction of the contact contrast"),
        "slope": ("float64", "of force sums against loads, least squares through the origin"),
        "slope_std": ("float64", "its standard uncertainty"),
        "area_m2": ("float64", "summed contact area of all frames"),
        "fall_rate": ("float64", "-d ln A / d threshold"),
    },
)
FORCES = Schema(
    "forces",
    {
        "frame": ("str", "file name of the frame"),
        "load_N": ("float64", "applied normal load P"),
        "area_m2": ("float64", "contact area at the calibrated threshold"),
        "area_std_m2": ("float64", "half the difference between the ends of the plateau"),
        "force_sum_N": ("float64", "sum of the local forces at the calibrated threshold"),
        "message": ("str", "what a person should know about this frame"),
    },
)


@dataclass(frozen=True)
class Calibrated:
    """What a calibration leaves behind.

    Parameters
    ----------
    record : dict
        Contents of ``calibration.json``.
    tables : dict
        File name -> (schema, table).
    figures : dict
        File name -> axes.
    notes : list of str
        Sentences for a person.
    failed : bool
        Whether a frame could not be measured.
    """

    record: dict[str, Any]
    tables: dict[str, tuple[Schema, pd.DataFrame]]
    figures: dict[str, Axes]
    notes: list[str] = field(default_factory=list)
    failed: bool = False


def run_jkr(experiment: Experiment, *, workers: int | None = None, advance: Advance = None) -> Calibrated:
    """Modulus, work of adhesion and centre from frames of the smooth contact.

    Parameters
    ----------
    experiment : Experiment
        With loads; opened so that negative ones may be.
    workers : int, optional
    advance : callable, optional

    Returns
    -------
    Calibrated

    Raises
    ------
    InputError
        If the loads and circles determine nothing; the message says why.
    """
    check_loads(experiment.loads["load_N"])
    series = measure_circles(experiment, workers=workers, advance=advance)
    table = series.table
    chosen = np.isfinite(table["radius_m"]) & np.isfinite(table["load_N"])
    part = table[chosen]
    scene = experiment.scene
    poisson = scene.elastic.poisson_ratio if scene.elastic is not None else 0.5
    sphere_radius = scene.need("indenter", "a JKR fit").radius

    def calibrate(circles: pd.DataFrame) -> JkrCalibration:
        return calibrate_jkr(
            circles["load_N"],
            circles["radius_m"],
            radius_std=circles["radius_std_m"],
            sphere_radius=sphere_radius,
            poisson_ratio=poisson,
        )

    found = calibrate(part)
    if series.rival is not None:
        there = series.rival[chosen & np.isfinite(series.rival["radius_m"])]
        found = _doubted(found, calibrate(there), series.doubt)
    for column in ("branch", "fitted_N", "residual_N", "used"):
        table.loc[chosen, column] = found.points[column].to_numpy()
    notes = [str(text) for text in table["message"] if text]
    notes += [
        f"{name}: left out of the fit, its load and radius do not go with those of the other frames"
        for name in part["frame"][~found.points["used"].to_numpy()]
    ]
    modulus = found.young_modulus.value / (1 - poisson**2)
    figures = _jkr_figures(found, sphere_radius, modulus)
    record = _jkr_record(found, series, modulus) | {
        "fixed": {"sphere_radius_m": sphere_radius, "poisson_ratio": poisson},
        "notes": notes,
    }
    return Calibrated(
        record,
        {"circles.csv": (CIRCLES, table)},
        figures,
        notes,
        failed=bool((table["status"] == FAILED).any()),
    )


def _doubted(found: JkrCalibration, rival: JkrCalibration, doubt: float) -> JkrCalibration:
    """The calibration with the uncertainty that another opening of the film, of that probability, adds."""
    wider = {
        name: getattr(found, name).widened(
            np.sqrt(doubt) * abs(getattr(rival, name).value - getattr(found, name).value)
        )
        for name in ("young_modulus", "work_of_adhesion")
    }
    return replace(found, **wider)


def _jkr_record(found: JkrCalibration, series: CircleSeries, contact_modulus: float) -> dict[str, Any]:
    """What ``calibration.json`` says of a JKR fit."""
    centre = mean_centre(series.table)
    point = [
        CoverageEstimate(v, centre.std_px, v - 1.96 * centre.std_px, v + 1.96 * centre.std_px)
        for v in (centre.x_px, centre.y_px)
    ]
    record: dict[str, Any] = {
        "kind": "jkr",
        "young_modulus": found.young_modulus.record("Pa"),
        "work_of_adhesion": found.work_of_adhesion.record("J/m^2"),
        "centre_x": point[0].record("px"),
        "centre_y": point[1].record("px"),
        "correlation": {"young_modulus, work_of_adhesion": found.correlation},
        "fitted": ["young_modulus", "work_of_adhesion", "centre_x", "centre_y"],
        "quality": {
            "frames_used": int(found.points["used"].sum()),
            "frames": len(series.table),
            "load_residual_rms_N": found.load_noise,
            "radius_std_median_m": float(series.table["radius_std_m"].median()),
            "film_opening_images_sqrt_m": series.opening,
            "film_opening_doubt": series.doubt,
            "film_opening_fit_sqrt_m": film_opening(
                contact_modulus=contact_modulus, work_of_adhesion=max(found.work_of_adhesion.value, 0.0)
            ),
            "contact_moves_with_sample": centre.moves_with_sample,
        },
    }
    if found.work_of_adhesion_unloading is not None:
        record["work_of_adhesion_unloading"] = found.work_of_adhesion_unloading.record("J/m^2")
    return record


def _jkr_figures(found: JkrCalibration, sphere_radius: float, contact_modulus: float) -> dict[str, Axes]:
    """The fit and its residuals."""
    law = {
        "sphere_radius": sphere_radius,
        "contact_modulus": contact_modulus,
        "work_of_adhesion": found.work_of_adhesion.value,
    }
    lowest = max(
        float(found.points["load_N"].min()),
        jkr.pull_off_load(sphere_radius=sphere_radius, work_of_adhesion=found.work_of_adhesion.value),
    )
    loads = np.linspace(lowest, float(found.points["load_N"].max()), 200)
    curve = pd.DataFrame({"load_N": loads, "radius_m": jkr.radius(loads, **law)})
    return {
        f"{name}.{ending}": ax
        for name, ax in (
            ("jkr", plot_jkr(found.points, curve)),
            ("residuals", plot_jkr_residuals(found.points)),
        )
        for ending in ("png", "svg")
    }


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
    series = _loaded(measure_thresholds(experiment, levels, workers=workers, advance=advance))
    load = series.frames["load_N"].to_numpy(float)
    measured, steepness = _measured_modulus(experiment), 0.0
    if threshold is None:
        _, forces = _disk_slope(experiment, series, 0.0, workers)
    else:
        forces = series.forces[1]
        low, high = (load_slope(series.forces[k], load).value for k in (0, 2))
        steepness = abs(high - low) / 0.04 / max(load_slope(forces, load).value, 1e-12)
    found = calibrate_modulus(
        forces,
        load,
        young_modulus=measured.value,
        young_modulus_std=measured.std,
        relative_std=0.0 if threshold is None else steepness * threshold.std,
    )
    notes = _messages(series) + ([found.message] if found.message else [])
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
    record["quality"] = _slope_quality(load, tuned, 1.0)
    record["notes"] = notes
    return _threshold_result(record, series, tuned, {"forces.png": plot_forces(load, tuned)})


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
    notes = _messages(series)
    if not found.marginal:
        notes.append(
            f"no plateau proper: the area falls by {found.relative_fall:.0%} between {found.threshold_low:g} "
            f"and {found.threshold_high:g}, more than marginally (20 %)"
        )
    exact = {
        "threshold_low": found.threshold_low,
        "threshold_high": found.threshold_high,
        "threshold": found.threshold,
    }
    step = float(np.diff(series.thresholds).max()) / 12**0.5
    record: dict[str, Any] = {
        name: CoverageEstimate(value, step, value - 1.96 * step, value + 1.96 * step).record("1")
        for name, value in exact.items()
    }
    record |= {
        "kind": "plateau",
        "method": "threshold",
        "definition": "thresholds about the slowest fall of the total area A between which "
        "|d ln A/d threshold| is at most 1.5 times its smallest value",
        "fixed": {},
        "fitted": ["threshold_low", "threshold_high", "threshold"],
        "quality": {"relative_fall": found.relative_fall, "marginal": found.marginal},
        "notes": notes,
    }
    table = series.frames.assign(area_m2=found.area, area_std_m2=found.area_std)
    rate = np.interp(series.thresholds, found.thresholds, found.fall_rates, left=np.nan, right=np.nan)
    curve = {"threshold": series.thresholds, "area_m2": series.areas.sum(axis=1), "fall_rate": rate}
    figure = plot_plateau(series.thresholds, series.areas, low=found.threshold_low, high=found.threshold_high)
    columns = [name for name in FORCES.columns if name in table]
    return Calibrated(
        record,
        {"curve.csv": (CURVE, pd.DataFrame(curve)), "areas.csv": (FORCES, table[columns])},
        {"plateau.png": figure},
        notes,
        failed=len(series.failed) > 0,
    )


def write_calibration(result: Calibrated, folder: Path, *, frames: list[Mapping[str, Any]]) -> None:
    """Write calibration.json, the tables and the figures.

    Parameters
    ----------
    result : Calibrated
    folder : Path
        Exists.
    frames : list of mapping
        The inputs with their sha256, as `provenance` lists them.
    """
    write_json(result.record | {"frames": frames}, folder / CALIBRATION_FILE)
    for name, (schema, table) in result.tables.items():
        write_table(table, schema, folder / name)
    for name, ax in result.figures.items():
        write_figure(ax, folder / name)


def _loaded(series: ThresholdSeries) -> ThresholdSeries:
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
    return ThresholdSeries(
        series.thresholds,
        series.areas[:, good],
        np.nan_to_num(forces, nan=0.0),
        series.frames[good].reset_index(drop=True),
        series.failed,
    )


def _measured_modulus(experiment: Experiment) -> CoverageEstimate:
    """The modulus that the scene states."""
    elastic = experiment.scene.need("elastic", "local forces")
    value, std = elastic.young_modulus, elastic.young_modulus_std
    return CoverageEstimate(value, std, value - 1.96 * std, value + 1.96 * std)


def _modulus_relative_std(experiment: Experiment) -> float:
    """Relative uncertainty of the modulus that the scene states."""
    modulus = _measured_modulus(experiment)
    return modulus.std / modulus.value


def _disk_slope(
    experiment: Experiment, series: ThresholdSeries, relative: float, workers: int | None
) -> tuple[CoverageEstimate, np.ndarray]:
    """Slope and force sums that the disk method gives for the frames of a series."""
    frames = measure_experiment(experiment, workers=workers).frames.set_index("frame")
    forces = frames.loc[series.frames["frame"], "force_sum_N"].to_numpy(float)
    load = series.frames["load_N"].to_numpy(float)
    return load_slope(np.nan_to_num(forces), load, relative_std=relative), forces


def _slope_quality(load: np.ndarray, forces: np.ndarray, slope: float) -> dict[str, Any]:
    """Scatter about the line, and the worst frame."""
    rest = forces - slope * load
    pressed = load > 0
    return {
        "frames_used": int(pressed.sum()),
        "residual_rms_N": float(np.sqrt(np.mean(rest[pressed] ** 2))),
        "worst_relative_residual": float(np.max(np.abs(rest[pressed] / load[pressed]))),
    }


def _messages(series: ThresholdSeries) -> list[str]:
    """What the frames' rows have to say."""
    kept = [f"{row['frame']}: {row['message']}" for row in series.frames.to_dict("records") if row["message"]]
    return kept + [str(text) for text in series.failed["message"]]


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
    tables: dict[str, tuple[Schema, pd.DataFrame]] = {"forces.csv": (FORCES, table)}
    if curve is not None:
        tables["curve.csv"] = (CURVE, pd.DataFrame(curve))
    return Calibrated(record, tables, figures, record["notes"], failed=len(series.failed) > 0)
