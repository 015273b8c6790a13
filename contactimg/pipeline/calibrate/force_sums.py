"""What the calibrations of rough contacts share: frames with a load, the stated modulus, force sums."""

from collections.abc import Mapping
from typing import Any, TypedDict

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from contactimg.analysis.load_cell import LoadCell
from contactimg.calibration.coverage_estimate import CoverageEstimate
from contactimg.calibration.threshold import load_slope
from contactimg.errors import InputError
from contactimg.files import Experiment
from contactimg.pipeline.calibrate.result import Calibrated
from contactimg.pipeline.calibrate.threshold_scan import ThresholdSeries
from contactimg.pipeline.series import measure_experiment
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
    return ThresholdSeries(
        series.thresholds,
        series.areas[:, good],
        np.nan_to_num(forces, nan=0.0),
        series.frames[good].reset_index(drop=True),
        series.failed,
    )


def stated_modulus(experiment: Experiment) -> CoverageEstimate:
    """The modulus that the scene states."""
    elastic = experiment.scene.need("elastic", "local forces")
    return CoverageEstimate.of_normal(elastic.young_modulus, elastic.young_modulus_std)


def modulus_relative_std(experiment: Experiment) -> float:
    """Relative uncertainty of the modulus that the scene states."""
    modulus = stated_modulus(experiment)
    return modulus.std / modulus.value


class CommonErrors(TypedDict):
    """Standard uncertainties that all force sums, or all loads, of a series share."""

    relative_std: float
    zero_std: float


def common_errors(experiment: Experiment, *, relative: float = 0.0) -> CommonErrors:
    """Those of the load cell, and a relative one of the forces."""
    cell = LoadCell.stated(experiment.scene.load)
    return {"relative_std": float(np.hypot(relative, cell.gain_std)), "zero_std": cell.zero_std}


def cell_notes(experiment: Experiment) -> list[str]:
    """What was assumed about the load cell because the scene does not state it."""
    if experiment.scene.load.gain_std is not None:
        return []
    gain = LoadCell.stated(experiment.scene.load).gain_std
    return [f"load cell: gain_std = {gain:g} assumed; state it in [load]"]


def disk_slope(
    experiment: Experiment, series: ThresholdSeries, errors: CommonErrors, workers: int | None
) -> tuple[CoverageEstimate, np.ndarray]:
    """Slope and force sums that the disk method gives for the frames of a series."""
    frames = measure_experiment(experiment, workers=workers).frames.set_index("frame")
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
