"""The calibrations of the paper on folders of frames: JKR, threshold, modulus, plateau."""

from typing import Any

import numpy as np
import pandas as pd

from contactimg.calibration.coverage_estimate import CoverageEstimate
from contactimg.calibration.plateau import Plateau, find_plateau
from contactimg.files import Experiment
from contactimg.pipeline.calibrate.force_sums import frame_messages
from contactimg.pipeline.calibrate.result import Advance, Calibrated
from contactimg.pipeline.calibrate.threshold_scan import THRESHOLDS, measure_thresholds
from contactimg.plots.calibration import plot_plateau
from contactimg.plots.numbers import plain_number
from contactimg.tables import FORCE_SUMS, THRESHOLD_CURVE


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
    figure = plot_plateau(
        series.thresholds,
        series.areas,
        low=found.threshold_low,
        high=found.threshold_high,
        names=_curve_names(series.frames),
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
    """What ``calibration.json`` says of a plateau whose ends are known to a step of the thresholds."""
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


def _curve_names(frames: pd.DataFrame) -> list[str]:
    """The loads of the frames; their names where these are not known."""
    known = frames["load_N"].notna()
    loads = [f"P = {plain_number(1e3 * load)} mN" for load in frames["load_N"]]
    return np.where(known, loads, frames["frame"].astype(str)).tolist()
