"""The contact circles of a series of frames of a smooth contact."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import FrameError, InputError
from contactimg.files import Experiment, FrameSource
from contactimg.imaging.measure import measure_image
from contactimg.imaging.smooth.find_circle import Circle, EdgeSamples, find_circle, sample_edge
from contactimg.imaging.smooth.fit_circle import EdgeModel, Opening, choose_opening, fit_circle
from contactimg.optics.film import excess_table
from contactimg.optics.recipe import lamp
from contactimg.pipeline.frame_options import failed_row, frame_options
from contactimg.pipeline.parallel import in_parallel
from contactimg.scene import Scene, Simulate
from contactimg.tables import CIRCLES

BEYOND_FILM_PX = 12.0  # background that is sampled outside the film
OPENING_FRAMES = 3  # frames from which the opening of the film is found
NO_FILM = Opening(np.inf, np.inf, 0.0)
CERTAIN = 0.01  # probability of another opening that need not be looked into
FAR = 4.0  # standard deviations at which a centre has lost half its weight


@dataclass(frozen=True, eq=False)
class CircleSeries:
    """Circles of a series.

    Parameters
    ----------
    table : DataFrame
        Columns of `CIRCLES`, one row a frame.
    opening : float, sqrt(m)
        How fast the film opens; infinity where none is seen.
    doubt : float
        Probability that the film opens as in the rival.
    rival : DataFrame or None
        The circles with the next best opening; None where that is out of the question.
    """

    table: pd.DataFrame
    opening: float
    doubt: float = 0.0
    rival: pd.DataFrame | None = None


@dataclass(frozen=True)
class Centre:
    """Centre of the apparent contact and its standard uncertainty, px; and in whose pixels."""

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
    model = _edge_model(scene)
    reference = experiment.reference.read().image if experiment.reference is not None else None
    jobs = ((source, reference, scene, model) for source in experiment.frames)
    parts = []
    for part in in_parallel(_sample_source, jobs, count=len(experiment.frames), workers=workers):
        parts.append(part)
        if advance is not None:
            advance()
    seen = [samples for _, samples in parts if samples is not None]
    if not seen:
        raise InputError(f"no frame shows a contact circle; the first: {parts[0][0]['message']}")
    found = NO_FILM if scene.effects.film == "off" else choose_opening(_spread_out(seen), model)

    def circles(opening: float) -> pd.DataFrame:
        rows = [_with_circle(row, samples, model, opening) for row, samples in parts]
        loads = [experiment.load_of(str(row["frame"])) for row, _ in parts]
        return CIRCLES.conform(pd.DataFrame(rows)).assign(load_N=loads)

    rival = circles(found.rival) if found.doubt > CERTAIN else None
    return CircleSeries(circles(found.value), found.value, found.doubt, rival)


def _edge_model(scene: Scene) -> EdgeModel:
    """What the scene says about the light at the edge; without a lamp, a white LED, glass and PDMS."""
    camera = scene.need("camera", "measuring a smooth contact")
    indenter = scene.need("indenter", "measuring a smooth contact")
    simulate = scene.simulate if scene.simulate is not None else Simulate()
    return EdgeModel(camera.pixel_size, indenter.radius, excess_table(lamp(simulate)))


def _sample_source(
    source: FrameSource, reference: NDArray | None, scene: Scene, model: EdgeModel
) -> tuple[dict[str, object], EdgeSamples | None]:
    """Read one frame and sample its edge; a failure becomes a row without samples."""
    row: dict[str, object] = {"frame": source.name, "status": "ok", "message": ""}
    try:
        frame = source.read()
        seen = measure_image(frame.image, reference, method="threshold", **frame_options(frame, scene))
        row |= {"shift_x_px": seen.shift_x_px, "shift_y_px": seen.shift_y_px, "status": seen.status}
        row["message"] = seen.message
        if not seen.contrast:
            raise FrameError(seen.message or "nothing stands out of the noise")
        image = seen.difference * np.float32(np.sign(seen.contrast))
        valid = np.isfinite(frame.image) if frame.image.dtype.kind == "f" else None
        circle = find_circle(image, abs(seen.contrast))
        for _ in range(2):  # the second time about the circle that a sharp edge gives
            outside = model.film_px(circle.radius_px) + BEYOND_FILM_PX
            samples = sample_edge(image, circle, outside_px=outside, noise=seen.noise, valid=valid)
            circle = fit_circle(samples, model, opening=np.inf)
        return row, sample_edge(image, circle, outside_px=outside, noise=seen.noise, valid=valid)
    except Exception as error:  # whatever it is, the other frames are not concerned
        return row | failed_row(source.name, error), None


def _spread_out(samples: list[EdgeSamples]) -> list[EdgeSamples]:
    """The frames with the middle, the smallest and the largest contact."""
    by_size = sorted(samples, key=lambda one: one.circle.radius_px)
    places = dict.fromkeys((len(by_size) // 2, 0, len(by_size) - 1))
    return [by_size[k] for k in list(places)[:OPENING_FRAMES]]


def _with_circle(
    row: dict[str, object], samples: EdgeSamples | None, model: EdgeModel, opening: float
) -> dict[str, object]:
    """The frame's row with its circle."""
    if samples is None:
        return row
    try:
        circle: Circle = fit_circle(samples, model, opening=opening, blur_px=samples.circle.blur_px)
    except Exception as error:  # whatever it is, the other frames are not concerned
        return row | failed_row(str(row["frame"]), error)
    return row | {
        "x_px": circle.x_px,
        "y_px": circle.y_px,
        "centre_std_px": circle.centre_std_px,
        "radius_px": circle.radius_px,
        "radius_m": circle.radius_px * model.pixel_size,
        "radius_std_m": circle.radius_std_px * model.pixel_size,
        "contrast": circle.contrast,
        "blur_px": circle.blur_px,
        "arc": circle.arc,
        "misfit": circle.misfit,
    }


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
    Weighted by the circles' own uncertainties, stray centres tamed; the uncertainty includes the scatter.
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
    scatter = 1.4826 * float(np.median(np.abs(points - median)))
    variance = own**2 + scatter**2
    far = np.sum((points - median) ** 2, axis=1) / np.maximum(variance, 1e-12)
    weight = 1 / np.maximum(variance, 1e-12) / (1 + far / FAR**2)
    mean = weight @ points / weight.sum()
    return mean, float(np.sqrt(1 / weight.sum()))
