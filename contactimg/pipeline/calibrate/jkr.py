"""`calibrate jkr`: modulus and work of adhesion from the contact circles of a smooth contact, with notes."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import NDArray

from contactimg.analysis.load_cell import LoadCell
from contactimg.calibration.jkr import (
    FALSE_ALARM_RATE,
    JkrCalibration,
    calibrate_jkr,
    check_loads,
    mean_axis_ratio,
    mean_centre,
)
from contactimg.errors import FrameError, InputError
from contactimg.files import Experiment
from contactimg.frame import Frame
from contactimg.imaging.smooth.find_circle import EdgeSamples, find_circle, sample_edge
from contactimg.imaging.smooth.fit_circle import EdgeModel, Opening, choose_opening, fit_circle
from contactimg.mechanics import jkr
from contactimg.optics.film import excess_table
from contactimg.optics.render_settings import lamp
from contactimg.pipeline.each_frame import FailedFrame, for_each_frame, measured_and_failed
from contactimg.pipeline.frame import count_pixels
from contactimg.pipeline.results import Calibrated, cell_notes, frame_notes
from contactimg.plots.calibration import plot_jkr
from contactimg.plots.laws import LINE_POINTS
from contactimg.plots.numbers import number_with_interval
from contactimg.pose.apex import SIGNIFICANT_STDS
from contactimg.scene import Scene
from contactimg.tables import CIRCLES, FAILED

# --- the circle of each frame

CURVATURE_STD_PER_EXCESS = 0.75 / 3**0.5
"""Relative standard uncertainty of the sphere's radius, of which only one direction may be known, over the
excess of the axis ratio over 1. Theory: the axes of Hertz's ellipse are as the radii of curvature to the
power 2/3, and the geometric mean of these acts on the mean axis; a radius measured along some direction lies
evenly between the two."""

NO_FILM = Opening(np.inf, np.inf, 0.0)


@dataclass(frozen=True, eq=False)
class CircleSeries:
    """Circles of a series.

    Parameters
    ----------
    table : DataFrame
        Columns of `CIRCLES`, one row a frame.
    opening : float, sqrt(m)
        How fast the film opens with the distance from the edge; infinite where no film is visible.
    doubt : float
        Probability that the rival opening is the true one.
    rival : DataFrame or None
        The circles with the next best opening; None if that is very unlikely.
    """

    table: pd.DataFrame
    opening: float
    doubt: float = 0.0
    rival: pd.DataFrame | None = None


def measure_circles(experiment: Experiment) -> CircleSeries:
    """Measure the contact circle of every frame of a smooth contact.

    Parameters
    ----------
    experiment : Experiment
        Of a scene with a camera and an indenter.

    Returns
    -------
    CircleSeries
        A frame without a circle has a row that says why.

    Raises
    ------
    InputError
        If no frame shows a circle; the message gives the first reason.

    Notes
    -----
    The film's opening is found from the images themselves, once for the series, from the smallest, the middle
    and the largest contact; with ``[effects] film = "off"`` the edge is taken as sharp.
    """
    scene = experiment.scene
    camera = scene.need("camera", "measuring a smooth contact")
    indenter = scene.need("indenter", "measuring a smooth contact")
    model = EdgeModel(camera.pixel_size, indenter.radius, excess_table(lamp(scene.light)))

    def sample(frame: Frame, reference: NDArray | None) -> tuple[dict[str, object], EdgeSamples]:
        """The row of a frame, and the pixels about the edge of its contact."""
        measurement = count_pixels(frame, reference, scene)
        contrast, noise = abs(measurement.contrast), measurement.noise
        if not contrast:
            raise FrameError(measurement.message or "nothing stands out of the noise")
        image = measurement.difference * np.float32(np.sign(measurement.contrast))
        seen = measurement.foreground.difference.valid
        valid = None if seen is None else seen > 0
        circle = find_circle(image, contrast, valid=valid)
        for _ in range(2):  # the second time about the circle that a sharp edge gives
            # the film and 12 px of background, chosen by hand; sensitivity not measured
            outside_px = model.film_px(circle.radius_px) + 12.0
            samples = sample_edge(image, circle, outside_px=outside_px, noise=noise, valid=valid)
            circle = fit_circle(samples, model, opening=np.inf)
        names = ("status", "message", "shift_x_px", "shift_y_px")
        row: dict[str, object] = {"frame": frame.name} | {name: getattr(measurement, name) for name in names}
        return row, sample_edge(image, circle, outside_px=outside_px, noise=noise, valid=valid)

    parts = list(for_each_frame(experiment, sample, shown="measuring frames"))
    sampled = [samples for _, samples in measured_and_failed(parts, "no frame shows a contact circle")[0]]
    by_size = sorted(sampled, key=lambda one: one.circle.radius_px)
    # the frames with the middle, the smallest and the largest contact
    chosen = [by_size[k] for k in dict.fromkeys((len(by_size) // 2, 0, len(by_size) - 1))]
    opening = NO_FILM if scene.effects.film == "off" else choose_opening(chosen, model)

    def circles(value: float) -> pd.DataFrame:
        rows = [
            part.row if isinstance(part, FailedFrame) else _with_circle(*part, model, value) for part in parts
        ]
        table = CIRCLES.conform(pd.DataFrame(rows))
        return table.assign(load_N=[experiment.load_of(name) for name in table["frame"]])

    rival = circles(opening.rival) if opening.doubt > FALSE_ALARM_RATE else None
    return CircleSeries(circles(opening.value), opening.value, opening.doubt, rival)


def _with_circle(
    row: dict[str, object], samples: EdgeSamples, model: EdgeModel, opening: float
) -> dict[str, object]:
    """The frame's row with its circle."""
    try:
        circle = fit_circle(samples, model, opening=opening, blur_px=samples.circle.blur_px)
    except Exception as error:  # whatever it is, the other frames are not concerned
        return row | FailedFrame.of(str(row["frame"]), error).row
    same = ("x_px", "y_px", "centre_std_px", "radius_px", "contrast", "blur_px", "arc", "misfit")
    found = {name: getattr(circle, name) for name in same}
    found["radius_m"] = circle.radius_px * model.pixel_size
    found["radius_std_m"] = circle.radius_std_px * model.pixel_size
    along, across = circle.ellipse_px
    excess = float(np.hypot(along, across))
    if excess < circle.radius_px:  # the arc is long enough to tell
        found["axis_ratio"] = (circle.radius_px + excess) / (circle.radius_px - excess)
        found["axis_ratio_std"] = 2 * circle.ellipse_std_px / circle.radius_px
        found["angle_rad"] = float(np.arctan2(across, along)) / 2
    return row | found


# --- the calibration


def run_jkr(experiment: Experiment) -> Calibrated:
    """Modulus, work of adhesion and centre from frames of the smooth contact.

    Parameters
    ----------
    experiment : Experiment
        With loads; opened so that negative ones may be.

    Returns
    -------
    Calibrated

    Raises
    ------
    InputError
        If the loads and circles determine nothing; the message says why.
    """
    check_loads(experiment.loads["load_N"])
    series, scene = measure_circles(experiment), experiment.scene
    table = series.table
    chosen = np.isfinite(table["radius_m"]) & np.isfinite(table["load_N"])
    failed = table["message"][table["status"] == FAILED]
    try:
        calibration = _calibrate(table[chosen], scene)
    except InputError as error:
        lost = f"; {len(failed)} frames without a circle, the first: {failed.iloc[0]}" if len(failed) else ""
        raise InputError(f"{error}{lost}") from None
    if series.rival is not None:
        rival = _calibrate(series.rival[chosen & np.isfinite(series.rival["radius_m"])], scene)
        calibration = calibration.widened(rival, series.doubt)
    for column in ("branch", "fitted_N", "residual_N", "used"):
        table.loc[chosen, column] = calibration.points[column].to_numpy()
    notes = calibration_notes(calibration, table, scene)
    record = _jkr_record(calibration, series) | {"notes": notes}
    figures = {"jkr": _jkr_figure(calibration)}
    return Calibrated(record, [(CIRCLES, table)], figures, failed=len(failed) > 0)


def _calibrate(circles: pd.DataFrame, scene: Scene) -> JkrCalibration:
    """The fit to the circles under the conditions that the scene states."""
    sphere_radius, elastic = scene.need("indenter", "a JKR fit").radius, scene.elastic
    return calibrate_jkr(
        circles["load_N"],
        circles["radius_m"],
        radius_std=circles["radius_std_m"],
        sphere_radius=sphere_radius,
        poisson_ratio=0.5 if elastic is None else elastic.poisson_ratio,
        load_cell=LoadCell.stated(scene.load),
        thickness=None if elastic is None or scene.effects.layer == "off" else elastic.thickness,
        sphere_radius_std=sphere_radius * CURVATURE_STD_PER_EXCESS * (mean_axis_ratio(circles)[0] - 1),
        pixel_size=scene.need("camera", "a JKR fit").pixel_size,
    )


def _jkr_record(calibration: JkrCalibration, series: CircleSeries) -> dict[str, Any]:
    """The content of ``calibration.json`` of a JKR fit: results, quality, what was fixed and fitted."""
    (x, y, moves), sphere, table = mean_centre(series.table), calibration.sphere, series.table
    edge = calibration.edge if calibration.edge is not None and calibration.edge.settled else None
    found = {
        "young_modulus": (calibration.young_modulus, "Pa"),
        "work_of_adhesion": (calibration.work_of_adhesion, "J/m^2"),
        "centre_x": (x, "px"),
        "centre_y": (y, "px"),
        "load_zero": (calibration.load_zero, "N"),
        "drift": (calibration.drift, "N" if calibration.departure.endswith("zero") else "1"),
        "work_of_adhesion_unloading": (calibration.work_of_adhesion_unloading, "J/m^2"),
        "edge_shift": (None if edge is None else edge.shift, "px"),
    }
    numbers = {name: one.record(unit) for name, (one, unit) in found.items() if one is not None}
    unfitted = {"work_of_adhesion_unloading"} | (set() if calibration.load_zero_seen else {"load_zero"})
    fixed = {"sphere_radius_m": sphere.radius, "poisson_ratio": sphere.poisson_ratio}
    return numbers | {
        "kind": "jkr",
        "correlation": {"young_modulus, work_of_adhesion": calibration.correlation},
        "fitted": [name for name in numbers if name not in unfitted],
        "quality": {
            "frames_used": int(calibration.points["used"].sum()),
            "frames": len(table),
            "load_residual_rms_N": calibration.load_noise,
            "radius_std_median_m": float(table["radius_std_m"].median()),
            "film_opening_images_sqrt_m": series.opening,
            "film_opening_doubt": series.doubt,
            "contact_moves_with_sample": moves,
            "departure": calibration.departure,
            "departure_rival": calibration.rival,
            "axis_ratio": mean_axis_ratio(table)[0],
        },
        "fixed": fixed if sphere.thickness is None else fixed | {"thickness_m": sphere.thickness},
    }


def _jkr_figure(calibration: JkrCalibration) -> Axes:
    """The fit with its residuals."""
    w = calibration.work_of_adhesion
    sphere = {"sphere_radius": calibration.sphere.radius, "work_of_adhesion": w.value}
    measured = calibration.points["load_N"]
    loads = np.linspace(max(measured.min(), jkr.pull_off_load(**sphere)), measured.max(), LINE_POINTS)
    modulus = calibration.young_modulus.value / (1 - calibration.sphere.poisson_ratio**2)
    radius = jkr.radius(loads, contact_modulus=modulus, **sphere)
    fitted = [
        f"E = {number_with_interval(calibration.young_modulus, factor=1e-6)} MPa",
        f"w = {number_with_interval(w, factor=1e3)} mJ/m²",
    ]
    curve = pd.DataFrame({"load_N": loads, "radius_m": radius})
    return plot_jkr(calibration.points, curve, fitted=fitted)


# --- sentences for a person


def calibration_notes(calibration: JkrCalibration, circles: pd.DataFrame, scene: Scene) -> list[str]:
    """Sentences for a person on frames, load zero, order of the loads, edge, lens and layer."""
    left_out = circles[circles["radius_m"].notna() & (circles["used"] == 0)]
    failed = circles["status"] == FAILED
    notes = [
        *frame_notes(circles[~failed]),
        *circles["message"][failed],
        *(left_out["frame"] + ": left out of the fit, its load and radius do not go with the others'"),
    ]
    zero, stated = calibration.load_zero, calibration.load_cell.zero_std
    if calibration.zero_asked is not None:
        instead = " instead of a shift of the edge" if calibration.edge and calibration.edge.seen else ""
        notes.append(
            f"the frames ask for a zero of {1e3 * calibration.zero_asked:.3g} mN{instead}, which was not "
            "fitted: state zero_std_N in [load] if the load cell may be off so far, or correct the loads"
        )
    if zero is not None and calibration.load_zero_seen:
        far = f". This is far more than the {1e3 * stated:.2g} mN stated: check the loads"
        notes.append(
            f"the loads are off by {1e3 * zero.value:.3g} +- {1e3 * zero.std:.2g} mN: their zero was fitted "
            "and taken off; correct the loads of the other folders of this load cell too"
            f"{far if abs(zero.value) > SIGNIFICANT_STDS * stated else ''}"
        )
    if calibration.departure:
        rival = calibration.rival and (
            f"; a {calibration.rival} explains the frames nearly as well, and the difference is in the "
            "uncertainties; repeat the first load at the end to tell them apart"
        )
        notes.append(f"the order of the loads matters: a {calibration.departure} was fitted{rival}")
    points = calibration.points[calibration.points["used"].astype(bool)]
    count, branches = points["load_N"].nunique(), set(points["branch"])
    if count < 5:
        notes.append(f"{count} different loads: they hardly test the law and the zero of loads; take five")
    if len(branches) == 1 and branches != {""}:
        notes.append(f"w is that of {branches.pop()} only; hysteresis of adhesion and drift cannot be seen")
    edge = calibration.edge
    if edge is not None:
        used = "" if edge.settled else "; too uncertain to act on other contacts"
        if edge.seen:
            used = ": the radii were corrected; `process --calibration` takes it off those of other contacts"
        shift = f"{edge.shift.value:+.3g} +- {edge.shift.std:.2g} px"
        notes.append(f"the edge seems to lie {shift} outside the true one{used}")
    ratio, std = mean_axis_ratio(circles)
    percent = 100 * (ratio - 1)
    if ratio - 1 > 3.72 * std:  # the excess of a circle follows Rayleigh's law: farther 1 time in 1000
        notes.append(
            f"the contacts are ellipses, axes {ratio:.4f} +- {std:.1g} to 1: the lens's radii of curvature "
            f"differ by {1.5 * percent:.2g} % (or pixels are not square); radius_m must be their geometric "
            f"mean, and E is uncertain by {CURVATURE_STD_PER_EXCESS * percent:.2g} % unless it is"
        )
    if calibration.sphere.thickness is not None:
        ratio = float(calibration.points["radius_m"].max()) / calibration.sphere.thickness
        notes.append(f"the contact reaches {ratio:.2g} of the layer's thickness; the law is that of a layer")
    elif calibration.layer_asked is not None:
        thickness, change = calibration.layer_asked
        notes.append(
            f"the loads ask for an elastic layer about {1e3 * thickness:.2g} mm thick, which would change E "
            f"by {100 * change:+.2g} %: measure it and state thickness_m in [elastic]"
        )
    return [*notes, *cell_notes(scene)]
