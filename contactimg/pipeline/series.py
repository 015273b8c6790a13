"""Measure a series: each frame alone, some again with the optics of the series, then pose and forces."""

import logging
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from contactimg.errors import FrameError, InputError
from contactimg.files import Experiment, FrameStore, open_experiment
from contactimg.imaging.fit.pooling import FEWEST_SCORES, gain_of_pooling, pool_edges, pool_optics
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.pipeline.background.second_pass import measure_on_background
from contactimg.pipeline.edits import edits_by_frame
from contactimg.pipeline.effects import film_setting, resolve_measurement
from contactimg.pipeline.frame import FrameOptions, MeasuredFrame, measure_scene_frame
from contactimg.pipeline.inputs import contact_sites, scene_asperities, scene_of_defined_laws
from contactimg.pipeline.measured_series import MeasuredSeries
from contactimg.pipeline.parallel import FailedFrame, for_each_frame
from contactimg.pipeline.run import Run
from contactimg.scene import Scene

logger = logging.getLogger(__name__)

MOST_EDGES = 200
"""Frames that the edge is pooled from, evenly spread over the series. Chosen: what all of a long series would
add is below a tenth of the uncertainty of a frame; the time to leave each one out grows with their square."""

POOLING_GAIN = 1.5
"""A frame is measured again with the optics of the series if that makes the uncertainty of its sum of a^3 at
least this many times smaller. Chosen by hand; sensitivity not measured."""


def measure_series(
    scene: Scene, *, workers: int | None = None, advance: Callable[[], None] | None = None
) -> Run:
    """Measure every frame of a scene.

    Parameters
    ----------
    scene : Scene
        From `contactimg.read_scene`, which knows the folder of its files.
    workers : int, optional
        Processes that share the frames; default one per core, or only this one for fewer than four frames.
    advance : callable, optional
        Called once a frame, in order.

    Returns
    -------
    Run
        A frame that cannot be read or measured has a row in ``frames`` that says why, and no contacts.

    Raises
    ------
    InputError
        If no frame at all could be measured; the message gives the first reason.
    """
    return measure_experiment(open_experiment(scene), workers=workers, advance=advance)


def measure_experiment(
    experiment: Experiment,
    *,
    relative: float | None = None,
    workers: int | None = None,
    advance: Callable[[], None] | None = None,
    store: FrameStore | None = None,
) -> Run:
    """Measure every frame of an opened experiment; see `measure_series`.

    With a ``store``, frames that it contains are not measured again.

    With ``relative``, a tolerance of the scene's output, each frame is measured by the cheapest method that
    is estimated to meet it (`contactimg.tradeoff.choice`).
    """
    return measure_parts(experiment, relative=relative, workers=workers, advance=advance, store=store).whole()


def measure_parts(
    experiment: Experiment,
    *,
    relative: float | None = None,
    workers: int | None = None,
    advance: Callable[[], None] | None = None,
    store: FrameStore | None = None,
) -> MeasuredSeries:
    """Measure every frame of an opened experiment, in little memory if there is a store."""
    scene = experiment.scene
    asperities = None if scene.camera is None else scene_asperities(scene)
    sites = None if asperities is None else contact_sites(asperities, scene)
    scene = scene_of_defined_laws(scene, sites)
    resolved = resolve_measurement(scene)
    edits = edits_by_frame(experiment, relative=relative)
    options = FrameOptions(resolved, film_setting(resolved, sites), relative, edits)
    parts, shape = _measure_frames(experiment, options, workers=workers, advance=advance, store=store)
    return MeasuredSeries.of(scene, parts, experiment.loads, sites, shape)


def _measure_frames(
    experiment: Experiment,
    options: FrameOptions,
    *,
    workers: int | None,
    advance: Callable[[], None] | None,
    store: FrameStore | None,
) -> tuple[list[MeasuredFrame], tuple[int, int]]:
    """Measure every frame on its own, then again those that need contrast and blur of the others.

    Returns
    -------
    parts : list of MeasuredFrame
        In order; a frame that cannot be measured has a row that says why.
    shape : (int, int)
        Rows and columns of the frames.

    Raises
    ------
    InputError
        If no frame at all could be measured; the message gives the first reason.
    """
    measure: Callable[..., MeasuredFrame] = partial(measure_scene_frame, options=options)
    parts = []
    for measured in for_each_frame(experiment, measure, workers=workers, advance=advance, store=store):
        part = MeasuredFrame.failed(measured) if isinstance(measured, FailedFrame) else measured
        logger.info("%s", part.summary())
        parts.append(part)
    parts, shape = _same_size(parts)
    parts, background = measure_on_background(experiment, options, parts, workers=workers, store=store)
    method = options.scene.measure.method
    # a pixel count takes each frame's own plateau
    fitted = [(part.choice.method if part.choice else method) == "disk" for part in parts]
    own_optics = [part.relative_optics for part, disks in zip(parts, fitted, strict=True) if disks]
    pooled = pool_optics([optics for optics in own_optics if optics is not None])
    if pooled is None:
        return parts, shape
    again, jobs = list[int](), list[tuple[Any, ...]]()
    for k, optics in enumerate(_with_edges_of_others(pooled, parts)):
        if fitted[k] and _gains_by_pooling(parts[k].whole(), optics):
            again.append(k)
            jobs.append((experiment.frames[k], optics.scaled(parts[k].level or 1.0)))
    if background is not None:
        measure = background.measure
        jobs = [background.job(*job) for job in jobs]
    second_pass = for_each_frame(experiment, measure, jobs, workers=workers, store=store)
    for k, measured in zip(again, second_pass, strict=True):
        part = MeasuredFrame.failed(measured) if isinstance(measured, FailedFrame) else measured
        logger.info("with the contrast, the blur and the edge of the series: %s", part.summary())
        parts[k] = part.with_choice(parts[k].choice)
    return parts, shape


def _with_edges_of_others(pooled: SharedOptics, parts: list[MeasuredFrame]) -> Iterator[SharedOptics]:
    """The pooled optics for each frame, with the edge that the others show: its own adds nothing to it."""
    own = [None if part.own_optics is None else part.own_optics.edge for part in parts]
    seen = [edge for edge in own if edge is not None and edge.count >= FEWEST_SCORES]
    places = np.linspace(0, len(seen) - 1, min(MOST_EDGES, len(seen)))
    pool = [seen[k] for k in np.unique(np.rint(places).astype(int))]
    of_all, in_pool = replace(pooled, edge=pool_edges(pool)), {id(edge) for edge in pool}
    for edge in own:
        if id(edge) in in_pool:
            yield replace(pooled, edge=pool_edges([other for other in pool if other is not edge]))
        else:
            yield of_all


def _gains_by_pooling(part: MeasuredFrame, pooled: SharedOptics) -> bool:
    """Whether the optics of the series make the uncertainty of the sum of a^3 much smaller or its edge right.

    A frame without a contact is measured again too: a faint contact may be detected once its contrast is
    known.
    """
    own = part.relative_optics
    if part.shape is None or pd.isna(part.row["n_contacts"]):
        return False
    if own is None or not len(part.contacts):
        return True
    contacts = part.contacts
    slope = 3.0 * contacts["radius_px"].to_numpy(float) ** 2
    shifts = contacts[["contrast_shift_px", "blur_shift_px"]].to_numpy(float)
    edge = contacts["edge_shift_px"].to_numpy(float)
    shared = np.sum(shifts**2, axis=1) + edge**2
    alone = np.maximum(contacts["radius_std_px"].to_numpy(float) ** 2 - shared, 0.0)
    own_part, edge_part = float(np.sqrt(slope**2 @ alone)), float(slope @ edge)
    gain = gain_of_pooling(slope @ shifts, own_part, own, pooled, edge_part=edge_part)
    return gain > POOLING_GAIN or _lacks_edge(own, pooled)


def _lacks_edge(own: SharedOptics, pooled: SharedOptics) -> bool:
    """Whether the frame missed the edge that the others have, with fewer contacts to see it."""
    if own.edge is None or pooled.edge is None:
        return False
    return own.edge.families != pooled.edge.families and 2 * own.edge.count < pooled.edge.count


def _same_size(parts: list[MeasuredFrame]) -> tuple[list[MeasuredFrame], tuple[int, int]]:
    """The parts, those of an unusual frame size as failures, and the usual size."""
    sizes = Counter(part.shape for part in parts if part.shape is not None)
    if not sizes:
        raise InputError(f"no frame could be measured; the first: {parts[0].row['message']}")
    (rows, columns), _ = sizes.most_common(1)[0]
    checked = []
    for part in parts:
        if part.shape not in (None, (rows, columns)):
            odd = f"has {part.shape[1]} x {part.shape[0]} pixels, the other frames {columns} x {rows}"
            checked.append(MeasuredFrame.failed(FailedFrame.of(part.row["frame"], FrameError(odd))))
        else:
            checked.append(part)
    return checked, (rows, columns)
