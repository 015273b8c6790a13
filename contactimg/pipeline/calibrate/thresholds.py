"""Calibrations by a threshold: `calibrate threshold`, `calibrate modulus` and `calibrate plateau`."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import ArrayLike, NDArray

from contactimg.analysis.estimates import CoverageEstimate
from contactimg.analysis.load_cell import LoadCell
from contactimg.calibration.area_plateau import find_plateau
from contactimg.calibration.threshold_and_modulus import calibrate_modulus, calibrate_threshold, load_slope
from contactimg.errors import FrameError, InputError
from contactimg.files import Experiment, FrameTables, Run
from contactimg.frame import Frame
from contactimg.imaging.measure import count_again
from contactimg.pipeline.each_frame import for_each_frame, measured_and_failed
from contactimg.pipeline.frame import MeasuredFrame, count_pixels, frame_row
from contactimg.pipeline.inputs import asperities_and_sites, check_modulus
from contactimg.pipeline.measured_series import MeasuredSeries
from contactimg.pipeline.results import Calibrated, cell_notes, frame_notes
from contactimg.pipeline.series import measure_parts
from contactimg.plausibility import doubts_about_forces, settle
from contactimg.plots.calibration import plot_forces, plot_plateau, plot_slopes
from contactimg.plots.numbers import number_with_interval, plain_number
from contactimg.pose.fit import SIGNIFICANT_FRACTION
from contactimg.tables import CONTACTS, FORCE_SUMS, FRAMES, THRESHOLD_CURVE, Schema, Status

Values = NDArray[np.float64]

THRESHOLDS = np.round(np.arange(0.05, 0.951, 0.025), 3)
"""Fractions of the contrast, from where noise makes contacts to where small contacts are lost. Chosen: curves
of area against threshold are smooth on this grid; sensitivity not measured."""


@dataclass(frozen=True, eq=False)
class ThresholdSeries:
    """Area and force sums of a series' frames at many thresholds.

    Parameters
    ----------
    thresholds : ndarray, shape (m,)
    areas : ndarray, shape (m, n), m^2
    forces : ndarray, shape (m, n), N
        NaN where fewer than half of the contacts have one, as without their asperities' radii.
    frames : DataFrame
        The frames table's rows of the n frames that could be measured.
    failed : DataFrame
        Rows of those that could not.
    """

    thresholds: Values
    areas: Values
    forces: Values
    frames: pd.DataFrame
    failed: pd.DataFrame


def measure_thresholds(experiment: Experiment, thresholds: ArrayLike = THRESHOLDS) -> ThresholdSeries:
    """Count the pixels of every frame above each of many thresholds.

    Parameters
    ----------
    experiment : Experiment
        Of a scene with a camera; forces need the elastic body and the asperities' radii as well.
    thresholds : array_like, shape (m,)
        Fractions of the contact contrast, between 0 and 1.

    Returns
    -------
    ThresholdSeries

    Raises
    ------
    InputError
        If no frame at all could be measured.

    Notes
    -----
    The pose of the camera is found once, at the threshold next to one half.
    """
    levels, scene = np.sort(np.asarray(thresholds, float)), experiment.scene
    scene.need("camera", "a calibration")
    check_modulus(scene)

    def count(frame: Frame, reference: NDArray | None) -> list[MeasuredFrame]:
        """The frame as it is counted at each threshold."""
        measurement = count_pixels(frame, reference, scene)
        if not measurement.contrast:
            raise FrameError(measurement.message or "nothing stands out of the noise")
        row = frame_row(measurement, frame.name) | {"load_N": experiment.load_of(frame.name)}
        row |= {"n_contacts": len(measurement.disks), "smallest_px": np.nan}
        part = MeasuredFrame(row, frame.shape, FrameTables())
        counted = (count_again(measurement.foreground, float(level)).disks for level in levels)
        return [part.with_contacts(CONTACTS.conform(disks.assign(frame=frame.name))) for disks in counted]

    results = for_each_frame(experiment, count, shown="measuring frames")
    measured, failed = measured_and_failed(results, "no frame could be measured")
    half, parts = int(np.abs(levels - 0.5).argmin()), list(zip(*measured, strict=True))
    asperities, sites = asperities_and_sites(experiment)
    posed = MeasuredSeries(scene, parts[half], sites).posed(asperities)
    runs, frames = [replace(posed, parts=counted).run for counted in parts], posed.located.frames
    areas = np.array([run.frames["area_m2"].to_numpy(float) for run in runs])
    forces = np.array([run.frames["force_sum_N"].to_numpy(float) for run in runs])
    forces[:, _lacks_forces(runs[half])] = np.nan
    return ThresholdSeries(levels, areas, forces, frames, FRAMES.conform(pd.DataFrame(failed)))


def _lacks_forces(run: Run) -> pd.Series:
    """Whether fewer than half of the contacts of a frame have a force, for each frame."""
    known = run.contacts["force_N"].notna().groupby(run.contacts["frame"]).mean()
    return run.frames["frame"].map(known) < SIGNIFICANT_FRACTION


# --- the calibrations


def _with_forces(series: ThresholdSeries) -> tuple[ThresholdSeries, Values]:
    """The frames of a series that have a load and forces, and these loads, N; others with a load failed."""
    loaded = series.frames["load_N"].notna().to_numpy(bool)
    known = np.asarray(np.isfinite(series.forces).any(axis=0))
    if not loaded.any():
        raise InputError("no frame has a load; give loads.csv with the columns frame, load_N")
    good, lost = loaded & known, series.frames[loaded & ~known]
    if not good.any():
        raise InputError(
            "no local force is known: give the radii of the asperities ([asperities] file or radius_m); "
            "without them a threshold is found by `calibrate plateau`"
            + "".join(f" ({note})" for note in frame_notes(lost[lost["status"] == Status.NO_POSE])[:1])
        )
    said = "left out: fewer than half of its contacts have a force; "
    failed = pd.concat([series.failed, lost.assign(message=lost["frame"] + ": " + said + lost["message"])])
    forces, kept = np.nan_to_num(series.forces[:, good]), series.frames[good].reset_index(drop=True)
    series = replace(series, areas=series.areas[:, good], forces=forces, frames=kept, failed=failed)
    return series, kept["load_N"].to_numpy(float)


def _stated_modulus(experiment: Experiment) -> CoverageEstimate:
    """The modulus that the scene states."""
    elastic = experiment.scene.need("elastic", "computing local forces")
    return CoverageEstimate.of_normal(elastic.young_modulus, elastic.young_modulus_std)


def _notes(series: ThresholdSeries) -> list[str]:
    """Sentences of the frames' rows; each frame that failed is named."""
    failed = series.failed[["frame", "message"]].itertuples(index=False)
    return frame_notes(series.frames) + [text if name in text else f"{name}: {text}" for name, text in failed]


def _result(
    record: dict[str, Any], series: ThresholdSeries, forces: Values, figures: dict[str, Axes], **curve: Any
) -> Calibrated:
    """The result with scatter about the line of the record's slope, and tables of forces and curve."""
    table = series.frames[["frame", "load_N", "message"]].assign(force_sum_N=forces)
    load = table["load_N"].to_numpy(float)
    rest, pressed = forces - record.pop("line") * load, load > 0
    if pressed.sum() == 1:
        said = "one load does not show the scatter, which no uncertainty includes; take three or more"
        record["notes"].append(said)
    record["quality"] = {
        "frames_used": int(pressed.sum()),
        "residual_rms_N": float(np.sqrt(np.mean(rest[pressed] ** 2))),
        "worst_relative_residual": float(np.max(np.abs(rest[pressed] / load[pressed]))),
    }
    tables = [(FORCE_SUMS, table), *([(THRESHOLD_CURVE, pd.DataFrame(curve))] if curve else [])]
    return Calibrated(record, tables, figures, failed=len(series.failed) > 0)


def run_threshold(experiment: Experiment) -> Calibrated:
    """The threshold of slope 1 on a sample of known modulus.

    Parameters
    ----------
    experiment : Experiment
        Of a scene with the modulus and its uncertainty, and asperities of known radii.

    Returns
    -------
    Calibrated

    Raises
    ------
    InputError
        If no threshold brackets slope 1, or no force is known.
    """
    scene, modulus = experiment.scene, _stated_modulus(experiment)
    relative = modulus.std / modulus.value
    series, load = _with_forces(measure_thresholds(experiment, THRESHOLDS))
    errors = LoadCell.stated(scene.load).errors(relative)
    notes = _notes(series) + cell_notes(scene)
    slopes = np.maximum([load_slope(row, load).value for row in series.forces], np.finfo(float).tiny)
    closest = float(slopes[np.argmin(np.abs(np.log(slopes)))])
    settle(doubts_about_forces(slope=closest, young_modulus=modulus.value, scanned=True), "the calibration")
    found = calibrate_threshold(series.thresholds, series.forces, load, **errors)
    if scene.measure.method == "disk":
        notes.append(
            'a threshold acts on [measure] method = "threshold" only, and the scene has "disk": `calibrate '
            "modulus` gives the slope of disks"
        )
    # a modulus that is too large makes the forces and with them the threshold too large
    share = relative / found.slope.std if found.slope.std else 0.0
    record: dict[str, Any] = {
        "kind": "threshold",
        "method": "threshold",
        "threshold": found.threshold.record("1"),
        "slope": found.slope.record("1"),
        "fixed": {"young_modulus": modulus.record("Pa")},
        "fitted": ["threshold"],
        "correlation": {"threshold, young_modulus": min(share, 1.0)},
        "notes": notes,
        "line": found.slope.value,
    }
    line = found.thresholds, found.slopes, found.slope_stds
    figures = {"slope_threshold": plot_slopes(*line, found=found.threshold.value)}
    figures["forces"] = plot_forces(load, found.forces, slope=found.slope)
    curve = dict(zip(("threshold", "slope", "slope_std"), line, strict=True))
    return _result(record, series, found.forces, figures, **curve, area_m2=series.areas.sum(axis=1))


def run_modulus(experiment: Experiment, *, threshold: CoverageEstimate | None) -> Calibrated:
    """The modulus of slope 1 of the forces that `process` finds; they are proportional to it.

    Parameters
    ----------
    experiment : Experiment
        Of a scene with asperities of known radii; its modulus and uncertainty are those measured before.
    threshold : CoverageEstimate or None
        The calibrated threshold, which is kept; None for the disk method.

    Returns
    -------
    Calibrated
    """
    scene, measured = experiment.scene, _stated_modulus(experiment)
    kept: dict[str, Any] = {}
    if threshold is not None:
        kept = {"method": "threshold", "threshold": threshold.value, "threshold_std": threshold.std}
    parts = {"measure": kept, "elastic": {"young_modulus_std": 0.0}}  # the forces as such, not those of E
    sought = {name: getattr(scene, name).model_copy(update=keys) for name, keys in parts.items()}
    fixed = replace(experiment, scene=scene.model_copy(update=sought))
    run = measure_parts(fixed).run
    good = run.frames["contrast"].fillna(0.0) != 0  # negative of dark contacts
    forces = np.where(_lacks_forces(run), np.nan, run.frames["force_sum_N"].to_numpy(float))[good]
    areas, frames = run.frames.loc[good, "area_m2"].to_numpy(float), run.frames[good].reset_index(drop=True)
    level = np.array([0.5 if threshold is None else threshold.value])
    series, load = _with_forces(ThresholdSeries(level, areas[None], forces[None], frames, run.frames[~good]))
    forces, std = series.forces[0], series.frames["force_sum_std_N"].fillna(0.0).to_numpy(float)
    relative = float(load @ std / max(load @ forces, np.finfo(float).tiny))
    stated = {"young_modulus": measured.value, "young_modulus_std": measured.std}
    errors = LoadCell.stated(experiment.scene.load).errors(relative)
    found = calibrate_modulus(forces, load, **stated, **errors)
    settle(doubts_about_forces(slope=found.slope.value, young_modulus=measured.value), "the calibration")
    kept = {} if threshold is None else {"threshold": threshold.record("1")}
    record: dict[str, Any] = {
        "kind": "modulus",
        "method": fixed.scene.measure.method,
        "young_modulus": found.young_modulus.record("Pa"),
        "slope": found.slope.record("1"),
        "fixed": {"young_modulus_measured": measured.record("Pa")} | kept,
        "fitted": ["young_modulus"],
        "compatible": found.compatible,
        "distance_std": found.distance,
        "notes": _notes(series) + cell_notes(experiment.scene) + ([found.message] if found.message else []),
        "line": 1.0,
    } | kept
    tuned = forces * found.young_modulus.value / measured.value
    fitted = [f"E = {number_with_interval(found.young_modulus, factor=1e-6)} MPa"]
    return _result(record, series, tuned, {"forces": plot_forces(load, tuned, fitted=fitted)})


def run_plateau(experiment: Experiment) -> Calibrated:
    """The two thresholds between which the total area changes marginally, and areas with error bars.

    Parameters
    ----------
    experiment : Experiment
        Of a scene with a camera; loads are not needed.

    Returns
    -------
    Calibrated
    """
    series = measure_thresholds(experiment, THRESHOLDS)
    found, notes = find_plateau(series.thresholds, series.areas), _notes(series)
    if not found.marginal:
        notes.append(
            f"no plateau proper: the area falls by {found.relative_fall:.0%} between {found.threshold_low:g} "
            f"and {found.threshold_high:g}, more than marginally (20 %)"
        )
    fitted = ["threshold_low", "threshold_high", "threshold"]
    step = float(np.diff(series.thresholds).max()) / 12**0.5  # its ends are known to a step of the thresholds
    record = {name: CoverageEstimate.of_normal(getattr(found, name), step).record("1") for name in fitted} | {
        "kind": "plateau",
        "method": "threshold",
        "definition": "thresholds about the slowest fall of the total area A between which "
        "|d ln A/d threshold| is at most 1.5 times its smallest value",
        "fixed": {},
        "fitted": fitted,
        "quality": {"relative_fall": found.relative_fall, "marginal": found.marginal},
        "notes": notes,
    }
    table = series.frames.assign(area_m2=found.area, area_std_m2=found.area_std)
    rate = np.interp(series.thresholds, found.thresholds, found.fall_rates, left=np.nan, right=np.nan)
    curve = {"threshold": series.thresholds, "area_m2": series.areas.sum(axis=1), "fall_rate": rate}
    loads = table["load_N"].map(lambda load: f"P = {plain_number(1e3 * load)} mN")
    names = loads.where(table["load_N"].notna(), table["frame"].astype(str)).tolist()
    ends: dict[str, Any] = {"low": found.threshold_low, "high": found.threshold_high}
    figure = plot_plateau(series.thresholds, series.areas, **ends, names=names)
    areas = Schema("areas", FORCE_SUMS.description, **FORCE_SUMS.first)
    tables = [(THRESHOLD_CURVE, pd.DataFrame(curve)), (areas, table[list(areas.columns)])]
    return Calibrated(record, tables, {"plateau": figure}, failed=len(series.failed) > 0)
