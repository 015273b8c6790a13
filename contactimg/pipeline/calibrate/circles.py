"""The contact circles of a series of frames of a smooth contact."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import FrameError, InputError
from contactimg.files import Experiment
from contactimg.frame import Frame
from contactimg.imaging.measure import ImageMeasurement
from contactimg.imaging.smooth.find_circle import Circle, EdgeSamples, find_circle, sample_edge
from contactimg.imaging.smooth.fit_circle import EdgeModel, Opening, choose_opening, fit_circle
from contactimg.optics.film import excess_table
from contactimg.optics.render_settings import lamp
from contactimg.pipeline.frame import measure_prepared
from contactimg.pipeline.parallel import FailedFrame, for_each_frame
from contactimg.pose.fit import MAD_TO_STD
from contactimg.scene import Scene
from contactimg.tables import CIRCLES

BEYOND_FILM_PX = 12.0
"""Width of the background that is sampled outside the film. Chosen by hand; sensitivity not measured."""

ELLIPSE_SIGMA = 3.72
"""Excess of the axis ratio over 1, in standard deviations, from which it is no chance. Theory: a circle's
excess follows Rayleigh's law, beyond 3.72 with a false-alarm rate of 1e-3."""

LEAST_ELLIPSE_STD = 1e-4
"""Least uncertainty of an axis ratio, so that no frame outweighs all others. Chosen by hand."""

NO_FILM = Opening(np.inf, np.inf, 0.0)

NEGLIGIBLE_DOUBT = 0.01
"""Probability of a rival opening below which its circles are not fitted. Chosen by hand: the uncertainty
grows by at most a tenth of the difference between the two openings."""

OUTLIER_SIGMA = 4.0
"""Distance of a centre, in standard deviations, at which it has lost half its weight. Chosen by hand;
sensitivity not measured."""


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


@dataclass(frozen=True)
class Centre:
    """Centre of the apparent contact with its standard uncertainty, px.

    In the pixels of the reference if the contact moves with the sample, else in those of the frames.
    """

    x_px: float
    y_px: float
    std_px: float
    moves_with_sample: bool


def measure_circles(
    experiment: Experiment, *, workers: int | None = None, advance: Callable[[], None] | None = None
) -> CircleSeries:
    """Measure the contact circle of every frame of a smooth contact.

    Parameters
    ----------
    experiment : Experiment
        Of a scene with a camera and an indenter.
    workers : int, optional
        Processes that share the frames.
    advance : callable, optional
        Called once a frame.

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
    measure = partial(_sample_frame, scene=scene, model=model)
    parts = [
        (part.row, None) if isinstance(part, FailedFrame) else part
        for part in for_each_frame(experiment, measure, workers=workers, advance=advance)
    ]
    sampled = [samples for _, samples in parts if samples is not None]
    if not sampled:
        raise InputError(f"no frame shows a contact circle; the first: {parts[0][0]['message']}")
    by_size = sorted(sampled, key=lambda one: one.circle.radius_px)
    # the frames with the middle, the smallest and the largest contact
    chosen = [by_size[k] for k in dict.fromkeys((len(by_size) // 2, 0, len(by_size) - 1))]
    opening = NO_FILM if scene.effects.film == "off" else choose_opening(chosen, model)

    def circles(value: float) -> pd.DataFrame:
        rows = [_with_circle(row, samples, model, value) for row, samples in parts]
        loads = [experiment.load_of(str(row["frame"])) for row, _ in parts]
        return CIRCLES.conform(pd.DataFrame(rows)).assign(load_N=loads)

    rival = circles(opening.rival) if opening.doubt > NEGLIGIBLE_DOUBT else None
    return CircleSeries(circles(opening.value), opening.value, opening.doubt, rival)


def _sample_frame(
    frame: Frame, reference: NDArray | None, *, scene: Scene, model: EdgeModel
) -> tuple[dict[str, object], EdgeSamples | None]:
    """The row of one frame and samples of its edge; without samples if it shows no circle."""
    measurement = measure_prepared(frame, reference, scene, count_at=0.5)
    row: dict[str, object] = {
        "frame": frame.name,
        "status": measurement.status,
        "message": measurement.message,
        "shift_x_px": measurement.shift_x_px,
        "shift_y_px": measurement.shift_y_px,
    }
    try:
        return row, _sample_edge(frame, measurement, model)
    except FrameError as error:
        return row | FailedFrame.of(frame.name, error).row, None


def _sample_edge(frame: Frame, measurement: ImageMeasurement, model: EdgeModel) -> EdgeSamples:
    """Samples of the light across the edge of the contact."""
    contrast, noise = abs(measurement.contrast), measurement.noise
    if not contrast:
        raise FrameError(measurement.message or "nothing stands out of the noise")
    image = measurement.difference * np.float32(np.sign(measurement.contrast))
    valid = np.isfinite(frame.image) if frame.image.dtype.kind == "f" else None
    circle = find_circle(image, contrast)
    for _ in range(2):  # the second time about the circle that a sharp edge gives
        outside_px = model.film_px(circle.radius_px) + BEYOND_FILM_PX
        samples = sample_edge(image, circle, outside_px=outside_px, noise=noise, valid=valid)
        circle = fit_circle(samples, model, opening=np.inf)
    return sample_edge(image, circle, outside_px=outside_px, noise=noise, valid=valid)


def _with_circle(
    row: dict[str, object], samples: EdgeSamples | None, model: EdgeModel, opening: float
) -> dict[str, object]:
    """The frame's row with its circle."""
    if samples is None:
        return row
    try:
        circle: Circle = fit_circle(samples, model, opening=opening, blur_px=samples.circle.blur_px)
    except Exception as error:  # whatever it is, the other frames are not concerned
        return row | FailedFrame.of(str(row["frame"]), error).row
    return row | {
        "x_px": circle.x_px,
        "y_px": circle.y_px,
        "centre_std_px": circle.centre_std_px,
        "radius_px": circle.radius_px,
        "radius_m": circle.radius_px * model.pixel_size,
        "radius_std_m": circle.radius_std_px * model.pixel_size,
        **_axes(circle),
        "contrast": circle.contrast,
        "blur_px": circle.blur_px,
        "arc": circle.arc,
        "misfit": circle.misfit,
    }


def _axes(circle: Circle) -> dict[str, float]:
    """Axis ratio and direction of the ellipse; empty where the arc is too short to tell."""
    along, across = circle.ellipse_px
    excess = float(np.hypot(along, across))
    if not excess < circle.radius_px:
        return {}
    return {
        "axis_ratio": (circle.radius_px + excess) / (circle.radius_px - excess),
        "axis_ratio_std": 2 * circle.ellipse_std_px / circle.radius_px,
        "angle_rad": float(np.arctan2(across, along)) / 2,
    }


@dataclass(frozen=True)
class Astigmatism:
    """The ellipse that the contacts of a series have in common.

    Parameters
    ----------
    axis_ratio : float
        Larger over smaller axis; 1 if no frame tells.
    axis_ratio_std : float
    angle_rad : float
        Of the larger axis, from +x towards +y.
    """

    axis_ratio: float
    axis_ratio_std: float
    angle_rad: float

    @property
    def curvature_std(self) -> float:
        """Relative standard uncertainty of the sphere's radius, of which only one direction may be known.

        The axes of Hertz's ellipse are as the radii of curvature to the power 2/3, and the geometric mean of
        these acts on the mean axis; a radius measured along some direction lies evenly between the two.
        """
        return 0.75 * (self.axis_ratio - 1) / np.sqrt(3)

    @property
    def seen(self) -> bool:
        """Whether circular contacts would show it less often than once in a thousand series."""
        return self.axis_ratio - 1 > ELLIPSE_SIGMA * self.axis_ratio_std


def mean_astigmatism(table: pd.DataFrame) -> Astigmatism:
    """The mean of the contacts' ellipses, each weighted by its uncertainty.

    Parameters
    ----------
    table : DataFrame
        Columns of `CIRCLES`.

    Returns
    -------
    Astigmatism
        Under a lens of unequal curvature the ellipse is the same at all loads. The uncertainty includes the
        scatter between frames.
    """
    good = table[np.isfinite(table["axis_ratio"])]
    if good.empty:
        return Astigmatism(1.0, 0.0, 0.0)
    excess, own = good["axis_ratio"].to_numpy(float) - 1, good["axis_ratio_std"].to_numpy(float)
    vectors = excess * np.exp(2j * good["angle_rad"].to_numpy(float))
    weight = 1 / np.maximum(own, LEAST_ELLIPSE_STD) ** 2
    mean = complex(weight @ vectors / weight.sum())
    n = len(good)
    scatter = float(np.sqrt(weight @ np.abs(vectors - mean) ** 2 / weight.sum() / max(2 * (n - 1), 1)))
    std = float(np.hypot(1 / np.sqrt(weight.sum()), scatter))
    return Astigmatism(1 + abs(mean), std, float(np.angle(mean)) / 2)


def mean_centre(table: pd.DataFrame) -> Centre:
    """Centre of the apparent contact over all frames of a series.

    Parameters
    ----------
    table : DataFrame
        Columns of `CIRCLES`.

    Returns
    -------
    Centre
        In the pixels of the reference where the contact moves with the sample, else in those of the frames:
        whichever centres scatter less.

    Notes
    -----
    Weighted by the uncertainties of the circles; outlying centres have less weight. The uncertainty includes
    the scatter of the centres.
    """
    good = table[np.isfinite(table["x_px"])]
    still = good[["x_px", "y_px"]].to_numpy(float)
    shift = good[["shift_x_px", "shift_y_px"]].fillna(0.0).to_numpy(float)
    own = good["centre_std_px"].to_numpy(float)
    candidates = [
        (*_weighted_mean(points, own), moves) for points, moves in ((still, False), (still - shift, True))
    ]
    middle, std, moves = min(candidates, key=lambda candidate: candidate[1])
    return Centre(float(middle[0]), float(middle[1]), float(std), moves and bool(shift.any()))


def _weighted_mean(
    points: NDArray[np.float64], own: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Mean of points weighted by their own uncertainty and their common scatter, and its uncertainty."""
    median = np.median(points, axis=0)
    scatter = MAD_TO_STD * float(np.median(np.abs(points - median)))
    variance = own**2 + scatter**2
    far = np.sum((points - median) ** 2, axis=1) / np.maximum(variance, 1e-12)
    weight = 1 / np.maximum(variance, 1e-12) / (1 + far / OUTLIER_SIGMA**2)
    mean = weight @ points / weight.sum()
    return mean, float(np.sqrt(1 / weight.sum()))
