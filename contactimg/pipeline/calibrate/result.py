"""What a calibration leaves behind, and how it is written."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from contactimg.calibration.coverage_estimate import CoverageEstimate
from contactimg.calibration.threshold import load_slope
from contactimg.errors import InputError
from contactimg.files import CALIBRATION_FILE, Experiment, write_figure, write_json, write_table
from contactimg.pipeline.calibrate.thresholds import ThresholdSeries
from contactimg.pipeline.series import measure_experiment
from contactimg.tables import Schema

Advance = Callable[[], None] | None


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
