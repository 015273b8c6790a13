"""`calibrate jkr`: modulus and work of adhesion from the circles of a smooth contact."""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from contactimg.calibration.coverage_estimate import CoverageEstimate
from contactimg.calibration.jkr import JkrCalibration, calibrate_jkr, check_loads
from contactimg.effects.local_law import support_error
from contactimg.files import Experiment
from contactimg.mechanics import jkr
from contactimg.optics.wide_edge import film_opening
from contactimg.pipeline.calibrate.circles import CircleSeries, mean_centre, measure_circles
from contactimg.pipeline.calibrate.result import Advance, Calibrated
from contactimg.plausibility import doubts_about_calibration, settle
from contactimg.plots.calibration import plot_jkr, plot_jkr_residuals
from contactimg.scene import Scene
from contactimg.tables import CIRCLES, Status

IF_OFF = {
    "gain of the load cell, +1 %": {"young_modulus": 0.01, "work_of_adhesion": 0.01},
    "pixel size, +1 %": {"young_modulus": -0.03, "work_of_adhesion": 0.0},
    "radius of the sphere, +1 %": {"young_modulus": 0.01, "work_of_adhesion": -0.01},
}
"""Relative changes by errors that the fit cannot see. Theory: ``K ~ P R/a^3`` and ``w = S^2/K`` with ``S ~
P/a^{3/2}``, so that ``w ~ P/R``."""

CURVE_POINTS = 200  # of the fitted curve in the figure


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

    calibration = calibrate(part)
    _check_plausible(calibration, part, sphere_radius)
    if series.rival is not None:
        rival_part = series.rival[chosen & np.isfinite(series.rival["radius_m"])]
        calibration = _widened(calibration, calibrate(rival_part), series.doubt)
    for column in ("branch", "fitted_N", "residual_N", "used"):
        table.loc[chosen, column] = calibration.points[column].to_numpy()
    notes = [str(text) for text in table["message"] if text]
    notes += [
        f"{name}: left out of the fit, its load and radius do not go with those of the other frames"
        for name in part["frame"][~calibration.points["used"].to_numpy()]
    ]
    notes += [*_zero_notes(calibration), *_support_notes(scene, part)]
    modulus = calibration.young_modulus.value / (1 - poisson**2)
    record = _jkr_record(calibration, series, modulus) | {
        "fixed": {"sphere_radius_m": sphere_radius, "poisson_ratio": poisson},
        "if_off": IF_OFF,
        "notes": notes,
    }
    figures = _jkr_figures(calibration, sphere_radius, modulus)
    failed = bool((table["status"] == Status.FAILED).any())
    return Calibrated(record, {"circles.csv": (CIRCLES, table)}, figures, notes, failed=failed)


def _check_plausible(calibration: JkrCalibration, circles: pd.DataFrame, sphere_radius: float) -> None:
    """Raise if the result is that of no material; see `contactimg.plausibility`."""
    doubts = doubts_about_calibration(
        young_modulus=calibration.young_modulus.value,
        work_of_adhesion=calibration.work_of_adhesion.value,
        contact_over_radius=float(circles["radius_m"].max()) / sphere_radius,
    )
    settle(doubts, "the calibration")


def _zero_notes(calibration: JkrCalibration) -> list[str]:
    """What to say of a zero of the loads that was fitted."""
    zero = calibration.load_zero
    if zero is None:
        return []
    note = (
        f"the loads are off by {1e3 * zero.value:.3g} +- {1e3 * zero.std:.2g} mN: their zero was fitted and "
        "taken off; correct the loads of the other folders of this load cell too"
    )
    return [note]


def _support_notes(scene: Scene, circles: pd.DataFrame) -> list[str]:
    """What a layer of finite thickness does to the modulus, which the law of a half-space leaves out."""
    thickness = None if scene.elastic is None else scene.elastic.thickness
    if thickness is None or not len(circles):
        return []
    ratio = float(circles["radius_m"].max()) / thickness
    note = (
        f"the contact reaches {ratio:.2g} of the layer's thickness, but the law is that of a half-space: the "
        f"modulus comes out too high by up to about {100 * 3 * support_error(ratio):.2g} %"
    )
    return [note]


def _widened(calibration: JkrCalibration, rival: JkrCalibration, doubt: float) -> JkrCalibration:
    """The calibration with the uncertainty added by a rival opening of the film, of probability ``doubt``."""

    def widened(estimate: CoverageEstimate, other: CoverageEstimate) -> CoverageEstimate:
        return estimate.widened(np.sqrt(doubt) * abs(other.value - estimate.value))

    return replace(
        calibration,
        young_modulus=widened(calibration.young_modulus, rival.young_modulus),
        work_of_adhesion=widened(calibration.work_of_adhesion, rival.work_of_adhesion),
    )


def _jkr_record(calibration: JkrCalibration, series: CircleSeries, contact_modulus: float) -> dict[str, Any]:
    """What ``calibration.json`` says of a JKR fit."""
    centre = mean_centre(series.table)
    record: dict[str, Any] = {
        "kind": "jkr",
        "young_modulus": calibration.young_modulus.record("Pa"),
        "work_of_adhesion": calibration.work_of_adhesion.record("J/m^2"),
        "centre_x": CoverageEstimate.of_normal(centre.x_px, centre.std_px).record("px"),
        "centre_y": CoverageEstimate.of_normal(centre.y_px, centre.std_px).record("px"),
        "correlation": {"young_modulus, work_of_adhesion": calibration.correlation},
        "fitted": ["young_modulus", "work_of_adhesion", "centre_x", "centre_y"],
        "quality": {
            "frames_used": int(calibration.points["used"].sum()),
            "frames": len(series.table),
            "load_residual_rms_N": calibration.load_noise,
            "radius_std_median_m": float(series.table["radius_std_m"].median()),
            "film_opening_images_sqrt_m": series.opening,
            "film_opening_doubt": series.doubt,
            "film_opening_fit_sqrt_m": film_opening(
                contact_modulus=contact_modulus, work_of_adhesion=max(calibration.work_of_adhesion.value, 0.0)
            ),
            "contact_moves_with_sample": centre.moves_with_sample,
        },
    }
    if calibration.load_zero is not None:
        record["load_zero"] = calibration.load_zero.record("N")
        record["fitted"].append("load_zero")
    record["quality"]["load_zero_doubt"] = calibration.load_zero_doubt
    if calibration.work_of_adhesion_unloading is not None:
        record["work_of_adhesion_unloading"] = calibration.work_of_adhesion_unloading.record("J/m^2")
    return record


def _jkr_figures(
    calibration: JkrCalibration, sphere_radius: float, contact_modulus: float
) -> dict[str, Axes]:
    """The fit and its residuals."""
    work = calibration.work_of_adhesion.value
    lowest = max(
        float(calibration.points["load_N"].min()),
        jkr.pull_off_load(sphere_radius=sphere_radius, work_of_adhesion=work),
    )
    loads = np.linspace(lowest, float(calibration.points["load_N"].max()), CURVE_POINTS)
    radius = jkr.radius(
        loads, sphere_radius=sphere_radius, contact_modulus=contact_modulus, work_of_adhesion=work
    )
    curve = pd.DataFrame({"load_N": loads, "radius_m": radius})
    return {
        f"{name}.{ending}": ax
        for name, ax in (
            ("jkr", plot_jkr(calibration.points, curve)),
            ("residuals", plot_jkr_residuals(calibration.points)),
        )
        for ending in ("png", "svg")
    }
