"""`calibrate jkr`: modulus and work of adhesion from the circles of a smooth contact, with notes on them."""

from collections.abc import Iterator
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from contactimg.analysis.load_cell import LoadCell
from contactimg.calibration.coverage_estimate import CoverageEstimate
from contactimg.calibration.jkr import HYSTERESIS, JkrCalibration, calibrate_jkr, check_loads
from contactimg.calibration.jkr_uncertainties import (
    ALLOWED,
    UncertaintySource,
    jkr_uncertainties,
    suggested_layer,
    suggested_zero,
)
from contactimg.files import Experiment
from contactimg.mechanics import jkr
from contactimg.optics.wide_edge import film_opening
from contactimg.pipeline.calibrate.circles import CircleSeries, mean_astigmatism, mean_centre, measure_circles
from contactimg.pipeline.calibrate.result import Advance, Calibrated, cell_notes
from contactimg.plausibility import doubts_about_calibration, settle
from contactimg.plots.calibration import plot_jkr
from contactimg.plots.numbers import number_with_interval
from contactimg.scene import Scene
from contactimg.tables import CIRCLES, UNCERTAINTIES, Status

CURVE_POINTS = 200  # of the fitted curve in the figure

FEW_LOADS = 5
"""Number of different loads below which the fit tests its law with two loads or fewer."""

BEYOND_PRIOR = 3.0
"""Zero over its stated uncertainty from which the two contradict each other. Theory: 0.3 % by chance."""


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
    part, scene = table[chosen], experiment.scene
    calibration = _calibrate(part, scene)
    sphere = calibration.problem.sphere
    doubts = doubts_about_calibration(
        young_modulus=calibration.young_modulus.value,
        work_of_adhesion=calibration.work_of_adhesion.value,
        contact_over_radius=float(part["radius_m"].max()) / sphere.radius,
    )
    settle(doubts, "the calibration")
    sources = list(jkr_uncertainties(calibration))
    if series.rival is not None:
        rival = _calibrate(series.rival[chosen & np.isfinite(series.rival["radius_m"])], scene)
        sources.append(_film_source(calibration, rival, series.doubt))
        calibration = _widened(calibration, rival, series.doubt)
    for column in ("branch", "fitted_N", "residual_N", "used"):
        table.loc[chosen, column] = calibration.points[column].to_numpy()
    notes = calibration_notes(calibration, table, scene)
    modulus = calibration.young_modulus.value / (1 - sphere.poisson_ratio**2)
    record = _jkr_record(calibration, series, modulus) | _conditions(calibration, scene)
    record |= {"uncertainties": [asdict(source) for source in sources], "notes": notes}
    record |= _edge_record(calibration, table)
    record["fitted"] += ["edge_shift"] if "edge_shift" in record else []
    figures = _jkr_figures(calibration, sphere.radius, modulus)
    failed = bool((table["status"] == Status.FAILED).any())
    tables = {
        "circles.csv": (CIRCLES, table),
        "uncertainties.csv": (UNCERTAINTIES, pd.DataFrame([asdict(source) for source in sources])),
    }
    return Calibrated(record, tables, figures, notes, failed=failed)


def _calibrate(circles: pd.DataFrame, scene: Scene) -> JkrCalibration:
    """The fit to the circles under the conditions that the scene states."""
    sphere_radius = scene.need("indenter", "a JKR fit").radius
    elastic = scene.elastic
    layered = elastic is not None and scene.effects.layer != "off"
    return calibrate_jkr(
        circles["load_N"],
        circles["radius_m"],
        radius_std=circles["radius_std_m"],
        sphere_radius=sphere_radius,
        poisson_ratio=0.5 if elastic is None else elastic.poisson_ratio,
        load_cell=LoadCell.stated(scene.load),
        thickness=elastic.thickness if layered and elastic is not None else None,
        sphere_radius_std=sphere_radius * mean_astigmatism(circles).curvature_std,
        pixel_size=scene.need("camera", "a JKR fit").pixel_size,
    )


def _conditions(calibration: JkrCalibration, scene: Scene) -> dict[str, Any]:
    """What was fixed in the fit, and what was assumed about the errors of the loads."""
    problem = calibration.problem
    fixed = {"sphere_radius_m": problem.sphere.radius, "poisson_ratio": problem.sphere.poisson_ratio}
    if problem.sphere.thickness is not None:
        fixed["thickness_m"] = problem.sphere.thickness
    assumed = {
        "load_zero_std_N": problem.series.zero_std,
        "load_gain_std": problem.cell.gain_std,
        "stated": scene.load.zero_std is not None and scene.load.gain_std is not None,
    }
    return {"fixed": fixed, "assumed": assumed}


def _edge_record(calibration: JkrCalibration, circles: pd.DataFrame) -> dict[str, Any]:
    """What the reference contact tells of edges: their blur, and their shift where the loads settle it."""
    blur = circles["blur_px"].dropna().to_numpy(float)
    record: dict[str, Any] = {}
    if len(blur) > 1:
        spread = float(np.std(blur, ddof=1) / np.sqrt(len(blur)))
        record["edge_blur"] = CoverageEstimate.of_normal(float(np.mean(blur)), spread).record("px")
    if calibration.edge is not None and calibration.edge.settled:
        record["edge_shift"] = calibration.edge.shift.record("px")
    return record


def _film_source(calibration: JkrCalibration, rival: JkrCalibration, doubt: float) -> UncertaintySource:
    """What the doubt about the opening of the film does, as `_widened` allows for it."""
    changes = [
        float(np.sqrt(doubt)) * (other.value / one.value - 1)
        for one, other in (
            (calibration.young_modulus, rival.young_modulus),
            (calibration.work_of_adhesion, rival.work_of_adhesion),
        )
        if one.value
    ]
    return UncertaintySource("opening of the film", doubt, "1", changes[0], changes[-1], ALLOWED)


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
    if calibration.load_zero_seen:
        record["fitted"].append("load_zero")
    if calibration.drift is not None:
        record["drift"] = calibration.drift.record("N" if calibration.departure.endswith("zero") else "1")
        record["fitted"].append("drift")
    record["quality"] |= {
        "departure": calibration.departure,
        "departure_rival": calibration.rival,
        "axis_ratio": mean_astigmatism(series.table).axis_ratio,
    }
    if calibration.work_of_adhesion_unloading is not None:
        record["work_of_adhesion_unloading"] = calibration.work_of_adhesion_unloading.record("J/m^2")
    return record


def _jkr_figures(
    calibration: JkrCalibration, sphere_radius: float, contact_modulus: float
) -> dict[str, Axes]:
    """The fit with its residuals."""
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
    fitted = [
        f"E = {number_with_interval(calibration.young_modulus, factor=1e-6)} MPa",
        f"w = {number_with_interval(calibration.work_of_adhesion, factor=1e3)} mJ/m²",
    ]
    return {"jkr": plot_jkr(calibration.points, curve, fitted=fitted)}


def calibration_notes(calibration: JkrCalibration, circles: pd.DataFrame, scene: Scene) -> list[str]:
    """Sentences for a person.

    Parameters
    ----------
    calibration : JkrCalibration
    circles : DataFrame
        Columns of `contactimg.tables.CIRCLES`, all frames.
    scene : Scene

    Returns
    -------
    list of str
    """
    left_out = circles[circles["radius_m"].notna() & (circles["used"] == 0)]
    return [
        *(str(text) for text in circles["message"] if text),
        *(
            f"{name}: left out of the fit, its load and radius do not go with those of the other frames"
            for name in left_out["frame"]
        ),
        *_zero_notes(calibration),
        *_edge_notes(calibration),
        *_departure_notes(calibration),
        *_series_notes(calibration),
        *_lens_notes(circles),
        *_layer_notes(calibration),
        *cell_notes(scene),
    ]


def _edge_notes(calibration: JkrCalibration) -> Iterator[str]:
    """An edge that is shifted, or whose shift the loads do not determine."""
    edge = calibration.edge
    if edge is None:
        return
    stated = f"{edge.shift.value:+.3g} +- {edge.shift.std:.2g} px"
    if edge.seen:
        yield (
            f"the edge seems to lie {stated} outside the true one: the radii were corrected; `process "
            "--calibration` takes it off the radii of other contacts"
        )
    else:
        used = "" if edge.settled else "; too uncertain to act on other contacts"
        yield f"the edge lies where it seems, to {stated}{used}"


def _zero_notes(calibration: JkrCalibration) -> Iterator[str]:
    """A zero of the loads that the frames show to be off."""
    zero, stated = calibration.load_zero, calibration.problem.series.zero_std
    asked = suggested_zero(calibration) if zero is None else None
    if asked is not None:
        yield (
            f"the frames ask for a zero of the loads of {1e3 * asked:.3g} mN, which was not fitted: state "
            "zero_std_N in [load] if the load cell may be off so far, or correct the loads"
        )
    if zero is None or not calibration.load_zero_seen:
        return
    note = (
        f"the loads are off by {1e3 * zero.value:.3g} +- {1e3 * zero.std:.2g} mN: their zero was fitted and "
        "taken off; correct the loads of the other folders of this load cell too"
    )
    if abs(zero.value) > BEYOND_PRIOR * stated:
        note += f". This is far more than the {1e3 * stated:.2g} mN stated: check the loads"
    yield note


def _departure_notes(calibration: JkrCalibration) -> Iterator[str]:
    """The cause of a difference between unloading and loading."""
    name, rival = calibration.departure, calibration.rival
    if not name:
        return
    note = f"the order of the loads matters: a {name} was fitted"
    if name == HYSTERESIS:
        note = "unloading adheres more or less than loading: each branch has its own work of adhesion"
    if rival:
        note += (
            f"; a {rival} explains the frames nearly as well, and the difference is in the uncertainties; "
            "repeat the first load at the end to tell them apart"
        )
    yield note


def _series_notes(calibration: JkrCalibration) -> Iterator[str]:
    """The limits of a short series, or of one of a single branch."""
    points = calibration.points[calibration.points["used"].astype(bool)]
    count, branches = points["load_N"].nunique(), set(points["branch"])
    if count < FEW_LOADS:
        yield (
            f"{count} different loads: they hardly test the law, and the zero of the loads is not checked; "
            "five or more do"
        )
    if branches == {"unloading"}:
        yield (
            "the loads only fall: the work of adhesion is that of unloading, which for rubber often exceeds "
            "that of loading; E does not depend on it"
        )
    elif branches == {"loading"}:
        yield (
            "the loads only rise: hysteresis of adhesion and drift of the load cell cannot be seen; "
            "w is that of loading"
        )


def _lens_notes(circles: pd.DataFrame) -> Iterator[str]:
    """Contacts that are ellipses."""
    lens = mean_astigmatism(circles)
    if lens.seen:
        curvatures = 100 * 1.5 * (lens.axis_ratio - 1)
        yield (
            f"the contacts are ellipses, axes {lens.axis_ratio:.4f} +- {lens.axis_ratio_std:.1g} to 1: the "
            f"lens's radii of curvature differ by {curvatures:.2g} % (or pixels are not square); radius_m "
            f"must be their geometric mean, and E is uncertain by {100 * lens.curvature_std:.2g} % unless it "
            "is"
        )


def _layer_notes(calibration: JkrCalibration) -> Iterator[str]:
    """The thickness of the layer."""
    thickness = calibration.problem.sphere.thickness
    hint = suggested_layer(calibration) if thickness is None else None
    if thickness is not None:
        ratio = float(calibration.points["radius_m"].max()) / thickness
        yield f"the contact reaches {ratio:.2g} of the layer's thickness; the law is that of the layer"
    elif hint is not None:
        yield (
            f"the loads ask for an elastic layer about {1e3 * hint.thickness:.2g} mm thick instead of a "
            f"half-space, which would change E by {100 * hint.young_modulus:+.2g} %: measure it and state "
            "thickness_m in [elastic]"
        )
