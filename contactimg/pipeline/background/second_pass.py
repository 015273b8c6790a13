"""Measure the frames of a series again, on the background that they show together."""

import logging
from array import array
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from contactimg.errors import FrameError
from contactimg.files import Experiment, PartStore
from contactimg.frame import Frame
from contactimg.pipeline.background.anchor import Series
from contactimg.pipeline.background.looks import is_measured
from contactimg.pipeline.background.pooling import SeriesBackground, pool_views
from contactimg.pipeline.frame import FrameOptions, measure_scene_frame
from contactimg.pipeline.measured_frame import MeasuredFrame
from contactimg.pipeline.parallel import FailedFrame, for_each_frame
from contactimg.scene import Scene

logger = logging.getLogger(__name__)


FEWEST_FRAMES = 5
"""Frames from which on the background is pooled without being asked for. Chosen: each has four others."""


FEWEST_GHOSTS = 3
"""Spots like contacts from which on a reference is not used at all. Chosen: a grain that has moved makes
one spot or two, a reference taken in contact many."""

LEAST_GAIN = 1.01
"""Ratio of the noise of the difference before and after, above which the pooled background is used. Chosen:
the noise is known to 0.6 %."""


def measure_on_background(
    experiment: Experiment,
    options: FrameOptions,
    parts: list[MeasuredFrame],
    *,
    workers: int | None,
    store: PartStore | None = None,
) -> tuple[list[MeasuredFrame], SeriesBackground | None]:
    """Measure the frames of a series again, on the background that they show together.

    Parameters
    ----------
    experiment : Experiment
    options : FrameOptions
    parts : list of MeasuredFrame
        The frames as measured with the reference of the scene, or without one.
    workers : int or None
        As for `contactimg.engine.calls.in_parallel`.
    store : PartStore, optional
        As for `contactimg.pipeline.parallel.for_each_frame`.

    Returns
    -------
    parts : list of MeasuredFrame
        As given where the background could not be pooled or, unless the scene asks for it, gains nothing.
    background : SeriesBackground or None
        None if ``parts`` are as given.
    """
    if not _is_wanted(options.scene, parts):
        return parts, None
    series = Series(experiment, options, parts, workers, store=store)
    try:
        background = pool_views(series)
        if background is not None and background.ghosts >= FEWEST_GHOSTS:
            series = _without_reference(series, background.ghosts)
            background = pool_views(series)
    except FrameError as error:  # a file that could be read a moment ago
        logger.warning("the background is not pooled: %s", error)
        return parts, None
    if background is None:
        return parts, None
    numbers = [k for k, part in enumerate(series.parts) if is_measured(part)]
    jobs = [(experiment.frames[k], *background.arguments(k)) for k in numbers]
    again = list(series.parts)
    second = for_each_frame(experiment, background.measure, jobs, workers=workers, store=store)
    ratios = array("d")
    for k, part in zip(numbers, second, strict=True):
        if not isinstance(part, FailedFrame):
            again[k] = part
            if part.row["noise"] > 0:
                ratios.append(parts[k].row["noise"] / part.row["noise"])
    optional = options.scene.images.background == "auto" and not series.reference_fault
    if optional and not (ratios and np.median(ratios) > LEAST_GAIN):
        logger.info("the pooled background gains nothing; the reference is used")
        return parts, None
    for part in again:
        part.log("on the pooled background: ")
    return again, background


def _without_reference(series: Series, ghosts: int) -> Series:
    """The series measured without its reference, which shows contacts where there are none."""
    fault = f"the reference shows {ghosts} spots like contacts that no frame confirms"
    logger.warning("%s; it is not used", fault)
    call = partial(_measure_alone, options=series.options)
    jobs = [(frame,) for frame in series.experiment.frames]
    new = for_each_frame(series.experiment, call, jobs, workers=series.workers, store=series.store)
    parts = [
        old if isinstance(part, FailedFrame) or not is_measured(old) else part
        for old, part in zip(series.parts, new, strict=True)
    ]
    return replace(series, parts=parts, reference_fault=fault)


def _measure_alone(frame: Frame, _reference: NDArray | None, *, options: FrameOptions) -> MeasuredFrame:
    """Measure a frame without its reference."""
    return measure_scene_frame(frame, None, options=options)


def _is_wanted(scene: Scene, parts: list[MeasuredFrame]) -> bool:
    """Whether the scene asks for a pooled background, or leaves the choice and the series is long enough."""
    wish, count = scene.images.background, sum(is_measured(part) for part in parts)
    if wish == "auto":
        return scene.measure.method == "disk" and count >= FEWEST_FRAMES
    return wish == "pooled" and count > 1
