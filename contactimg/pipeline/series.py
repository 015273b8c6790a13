"""Measure a series: each frame alone, some again with the optics of the series, then pose and forces."""

import logging
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from contactimg.errors import FrameError, InputError
from contactimg.files import EVERY_FRAME, Experiment, PartStore, Run, edit_points, open_experiment
from contactimg.imaging.detect.hand_edits import ACTIONS, HandEdit
from contactimg.imaging.fit.pooling import FEWEST_SCORES, pool_edges, pool_optics
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.pipeline.background import (
    FEWEST_FALSE_SPOTS,
    is_measured,
    measure_on_pool,
    noise_and_std,
    pool_background,
)
from contactimg.pipeline.frame import Edits, FrameOptions, MeasuredFrame, measure_scene_frame
from contactimg.pipeline.inputs import asperities_and_sites, check_modulus
from contactimg.pipeline.measured_series import MeasuredSeries
from contactimg.pipeline.parallel import FailedFrame, for_each_frame
from contactimg.plausibility import doubts_about_scene, settle
from contactimg.scene import Scene

logger = logging.getLogger(__name__)

MOST_EDGES = 200
"""Frames that the edge is pooled from, evenly spread over the series. Chosen: what all of a long series would
add is below a tenth of the uncertainty of a frame; the time to leave each one out grows with their square."""

POOLING_GAIN = 1.5
"""A frame is measured again with the optics of the series if these know its contrast or blur so many times
better. Chosen by hand: what the frame knows itself is then below a third of what it is lent."""


def measure_series(scene: Scene, *, workers: int | None = None) -> Run:
    """Measure every frame of a scene.

    Parameters
    ----------
    scene : Scene
        From `contactimg.read_scene`, which knows the folder of its files.
    workers : int, optional
        Processes that share the frames; default: this one, and one per core as soon as that saves time.

    Returns
    -------
    Run
        A frame that cannot be read or measured has a row in ``frames`` that says why, and no contacts.

    Raises
    ------
    InputError
        If no frame at all could be measured; the message gives the first reason. For a value of the scene
        that is no plausible one (`contactimg.plausibility`).
    """
    settle(doubts_about_scene(scene), scene.folder)
    return measure_parts(open_experiment(scene), workers=workers).whole()


def measure_parts(
    experiment: Experiment, *, workers: int | None = None, store: PartStore | None = None
) -> MeasuredSeries:
    """Measure every frame of an opened experiment; see `measure_series`.

    With a ``store``, frames that it contains are not measured again, and a long series takes little memory.
    """
    scene = experiment.scene
    check_modulus(scene)
    asperities, sites = asperities_and_sites(experiment)
    edits = edits_by_frame(experiment)
    options = FrameOptions.of(scene, sites)
    parts, shape = _measure_frames(experiment, options, edits, workers=workers, store=store)
    for k, part in enumerate(parts):  # own_optics is the largest part of a frame
        row = part.row | {"load_N": experiment.load_of(part.row["frame"])}
        parts[k] = replace(part, row=row, own_optics=None)
    return MeasuredSeries(scene, parts, sites, workers=workers).posed(shape, asperities)


def edits_by_frame(experiment: Experiment) -> dict[str, Edits]:
    """Name of a frame -> corrections by hand to its contacts, in the order of the table.

    An edit of a frame that is not there is logged as a warning.
    """
    edits: dict[str, Edits] = {}
    names = [source.name for source in experiment.frames] if len(experiment.edits) else []
    known = {EVERY_FRAME, *names}
    for number, row in enumerate(experiment.edits.to_dict("records"), start=1):
        if row["frame"] not in known:
            logger.warning(
                "edits: row %s (%s) is for the frame %s, which is not there; the edit has no effect",
                number, row["action"], row["frame"],
            )  # fmt: skip
        elif row["action"] in ACTIONS:
            points = edit_points(row["points"])
            edit = HandEdit(row["action"], number, row["x_px"], row["y_px"], row["radius_px"], points)
            for name in names if row["frame"] == EVERY_FRAME else [row["frame"]]:
                edits[name] = (*edits.get(name, ()), edit)
    return edits


def _measure_frames(
    experiment: Experiment,
    options: FrameOptions,
    edits: dict[str, Edits],
    *,
    workers: int | None,
    store: PartStore | None,
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
    frames = experiment.frames
    measure = partial(measure_scene_frame, options=options)
    by_hand = [edits.get(frame.name, ()) for frame in frames]
    parts: list[MeasuredFrame] = []
    everything = [(frame, None, own) for frame, own in zip(frames, by_hand, strict=True)]
    for measured in for_each_frame(
        experiment, measure, everything, workers=workers, store=store, shown="measuring frames"
    ):
        parts.append(MeasuredFrame.of(measured))
        parts[-1].log()
    shape = _refuse_other_sizes(parts)

    def again(
        parts: list[MeasuredFrame], call: Callable[..., MeasuredFrame], given: dict[int, tuple[Any, ...]]
    ) -> list[MeasuredFrame]:
        """The parts, some of them measured again; a frame that fails now is left as it was."""
        new, jobs = list(parts), [(frames[k], *job) for k, job in given.items()]
        results = for_each_frame(experiment, call, jobs, workers=workers, store=store)
        for k, result in zip(given, results, strict=True):
            if not isinstance(result, FailedFrame):
                new[k] = result
                result.log("again: ")
        return new

    def lend(parts: list[MeasuredFrame]) -> dict[int, SharedOptics]:
        """Number of a frame that gains by it -> what the frames of the series share, in its grey levels."""
        lent = _lent_optics(parts, options.scene.measure.method)
        return {k: optics.scaled(parts[k].level or 1.0) for k, optics in lent.items()}

    shown = [k for k, part in enumerate(parts) if is_measured(part)]
    pool = pool_background(experiment, options, parts, workers=workers)
    if pool is not None and pool.spots >= FEWEST_FALSE_SPOTS:
        fault = f"the reference shows {pool.spots} spots like contacts that no frame confirms"
        logger.warning("%s; it is not used", fault)
        experiment = replace(experiment, references=())
        parts = again(parts, measure, {k: (None, by_hand[k]) for k in shown})
        pool = pool_background(experiment, options, parts, workers=workers, fault=fault)
    if pool is not None:
        on_pool = partial(measure_on_pool, pool=pool)
        # without a reference the frames alone know their contrast badly
        lent = {} if pool.source else lend(parts)
        jobs = {k: (lent.get(k), by_hand[k], noise_and_std(parts[k])) for k in shown}
        better = again(parts, on_pool, jobs)
        if pool.gains(parts, better):
            if pool.source:
                jobs = {k: (optics, *jobs[k][1:]) for k, optics in lend(better).items()}
                better = again(better, on_pool, jobs)
            return [part.with_remarks(text) for part, text in zip(better, pool.remarks, strict=True)], shape
        logger.info("the pooled background gains nothing; the reference is used")
    return again(parts, measure, {k: (optics, by_hand[k]) for k, optics in lend(parts).items()}), shape


def _lent_optics(parts: Sequence[MeasuredFrame], method: str) -> dict[int, SharedOptics]:
    """Number of a frame that gains by it -> contrast, blur and edge that the frames of the series share.

    Contrast and blur are those of all frames; of the edge a frame gets what the others of a
    pool show: its own adds nothing to it. Nothing is lent where no frame determines its contrast.
    """
    if method != "disk":  # a pixel count takes each frame's own plateau
        return {}
    own = (part.relative_optics for part in parts)
    pooled = pool_optics(replace(optics, edge=None) for optics in own if optics is not None)
    if pooled is None:
        return {}
    edges = [None if part.own_optics is None else part.own_optics.edge for part in parts]
    seen = [k for k, edge in enumerate(edges) if edge is not None and edge.count >= FEWEST_SCORES]
    places = np.linspace(0, len(seen) - 1, min(MOST_EDGES, len(seen)))
    chosen = [seen[k] for k in np.unique(np.rint(places).astype(int))]
    pool = {k: edge for k in chosen if (edge := edges[k]) is not None}
    common = replace(pooled, edge=pool_edges(list(pool.values())))
    lent = {}
    for k, part in enumerate(parts):
        optics = common
        if k in pool:
            optics = replace(pooled, edge=pool_edges([edge for other, edge in pool.items() if other != k]))
        if _gains_by_pooling(part, optics):
            lent[k] = optics
    return lent


def _gains_by_pooling(part: MeasuredFrame, pooled: SharedOptics) -> bool:
    """Whether the series knows contrast or blur better than the frame, or an edge that the frame missed.

    A frame without a contact is measured again too: a faint contact may be detected once its contrast is
    known.
    """
    if part.shape is None or pd.isna(part.row["n_contacts"]):
        return False
    own = part.relative_optics
    if own is None or not part.row["n_contacts"]:
        return True
    stds = (own.contrast_relative_std, pooled.contrast_relative_std), (own.blur_std_px, pooled.blur_std_px)
    if not all(alone <= POOLING_GAIN * together for alone, together in stds):
        return True
    if own.edge is None or pooled.edge is None:
        return False
    # with fewer contacts to see it
    return own.edge.families != pooled.edge.families and 2 * own.edge.count < pooled.edge.count


def _refuse_other_sizes(parts: list[MeasuredFrame]) -> tuple[int, int]:
    """Make failures of the frames of an unusual size, and return the usual one."""
    sizes = Counter(part.shape for part in parts if part.shape is not None)
    if not sizes:
        raise InputError(f"no frame could be measured; the first: {parts[0].row['message']}")
    (rows, columns), _ = sizes.most_common(1)[0]
    for k, part in enumerate(parts):
        if part.shape not in (None, (rows, columns)):
            odd = f"has {part.shape[1]} x {part.shape[0]} pixels, the other frames {columns} x {rows}"
            parts[k] = MeasuredFrame.of(FailedFrame.of(part.row["frame"], FrameError(odd)))
    return rows, columns
