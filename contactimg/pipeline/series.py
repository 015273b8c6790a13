"""Measure a series: a sample of its frames, then all with what these show; then pose and forces."""

import logging
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import pandas as pd

from contactimg import files
from contactimg.engine.parallel import sharing
from contactimg.errors import FrameError, InputError
from contactimg.files.atomic import first_names
from contactimg.imaging.detect.hand_edits import ACTIONS, HandEdit, remark_on
from contactimg.imaging.fit.pooling import pool_edges, pool_optics
from contactimg.imaging.profile.limits import FEWEST
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.pipeline import pooled_background as pooling
from contactimg.pipeline.each_frame import FailedFrame, for_each_frame
from contactimg.pipeline.frame import Edits, FrameOptions, MeasuredFrame, film_setting, measure_scene_frame
from contactimg.pipeline.inputs import asperities_and_sites, check_modulus, read_reference
from contactimg.pipeline.measured_series import MeasuredSeries
from contactimg.plausibility import doubts_about_scene, settle
from contactimg.scene import Scene

logger = logging.getLogger(__name__)

Measure = Callable[..., MeasuredFrame]


def measure_series(scene: Scene, *, workers: int | None = None) -> files.Run:
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
    with sharing(workers):
        return measure_parts(files.open_experiment(scene)).run


def measure_parts(experiment: files.Experiment, *, store: files.PartStore | None = None) -> MeasuredSeries:
    """Measure every frame of an opened experiment; see `measure_series`.

    With a ``store``, frames that it contains are not measured again, and a long series takes little memory.
    """
    scene = experiment.scene
    check_modulus(scene)
    asperities, sites = asperities_and_sites(experiment)
    parts = _measure_frames(experiment, FrameOptions(scene, film_setting(scene, sites)), store=store)
    for k, part in enumerate(parts):  # own_optics is the largest part of a frame
        row = part.row | {"load_N": experiment.load_of(part.row["frame"])}
        parts[k] = replace(part, row=row, own_optics=None)
    return MeasuredSeries(scene, parts, sites).posed(asperities)


def edits_by_frame(experiment: files.Experiment) -> dict[str, Edits]:
    """Name of a frame -> corrections by hand to its contacts, in the order of the table.

    An edit of a frame that is not there is logged as a warning.
    """
    edits: dict[str, Edits] = {}
    names = [source.name for source in experiment.frames]
    known = {files.EVERY_FRAME, *names}
    for number, row in enumerate(experiment.edits.to_dict("records"), start=1):
        if row["frame"] not in known:
            said = f"row {number} ({row['action']}) is for the frame {row['frame']}, which is not there"
            logger.warning("edits: %s; the edit has no effect", said)
        elif row["action"] in ACTIONS:
            points = files.edit_points(row["points"])
            edit = HandEdit(row["action"], number, row["x_px"], row["y_px"], row["radius_px"], points)
            for name in names if row["frame"] == files.EVERY_FRAME else [row["frame"]]:
                edits[name] = (*edits.get(name, ()), edit)
    return edits


def _warn_of_unmatched(parts: Sequence[MeasuredFrame], edits: Mapping[str, Edits]) -> None:
    """Log corrections that meet no contact in any of the frames that they are for."""
    asked = Counter(edit.row for own in edits.values() for edit in own)
    for row, edit in sorted({edit.row: edit for part in parts for edit in part.unmatched}.items()):
        names = [part.row["frame"] for part in parts if row in {one.row for one in part.unmatched}]
        if len(names) == asked[row]:
            logger.warning("%s: %s; they have no effect", first_names(names), remark_on([edit]))


def _measure_frames(
    experiment: files.Experiment, options: FrameOptions, *, store: files.PartStore | None
) -> list[MeasuredFrame]:
    """Measure the frames, on a pooled background where that gains; some again with optics of the others.

    Only the frames that the background is pooled from are measured with the reference before.

    Returns
    -------
    list of MeasuredFrame
        In order; a frame that cannot be measured has a row that says why.

    Raises
    ------
    InputError
        If no frame at all could be measured; the message gives the first reason.
    """
    frames, edits, method = experiment.frames, edits_by_frame(experiment), options.scene.measure.method
    numbers, alone = range(len(frames)), partial(measure_scene_frame, options=options)
    parts: dict[int, MeasuredFrame] = {}

    def measured(call: Measure, optics: Mapping[int, SharedOptics | None]) -> dict[int, MeasuredFrame]:
        """The frames of these numbers with optics of others, but for failures of those measured before."""
        again = "again: " if optics.keys() & parts.keys() else ""
        jobs = [(frames[k], own, edits.get(frames[k].name, ())) for k, own in optics.items()]
        shown = "" if again else "measuring frames"
        results = for_each_frame(experiment, call, jobs, store=store, shown=shown)
        found: dict[int, MeasuredFrame] = {}
        for k, result in zip(optics, results, strict=True):
            part = MeasuredFrame.of(result)
            part.log(again)
            if part.shape is None and k in parts and parts[k].shape is not None:
                logger.warning("%s; its measurement before is kept", part.row["message"])
            else:
                found[k] = part
        return found

    parts |= measured(alone, dict.fromkeys(pooling.evenly_spread(numbers, pooling.MOST_VIEWS)))
    shapes = Counter(part.shape for part in parts.values() if part.shape)
    if len(shapes) != 1 or shapes.total() < pooling.FEWEST_FRAMES:
        parts |= measured(alone, {k: None for k in numbers if k not in parts})
    usual = _of_usual_shape(parts)
    if not usual:
        raise InputError(f"no frame could be measured; the first: {parts[0].row['message']}")
    stated = experiment.scene.images.background == "reference"
    if fault := "" if stated else pooling.fault_of_reference(usual.values(), read_reference(experiment)):
        logger.warning("%s; it is not used", fault)
        experiment = replace(experiment, references=())
        parts |= measured(alone, dict.fromkeys(parts))
        usual = _of_usual_shape(parts)
    pool = pooling.pool_background(experiment, options, usual, fault=fault)
    call, (common, lent) = alone, _lent_optics(usual, method)
    if pool is not None:
        on_pool = partial(pooling.measure_on_pool, pool=pool)
        # without a reference the frames alone know their contrast badly
        known = (k for k, part in usual.items() if pooling.is_measured(part))
        better = measured(on_pool, {k: None if pool.source else lent.get(k) for k in known})
        if pool.gains(better):
            call, parts = on_pool, parts | better
            common, lent = _lent_optics(better, method) if pool.source else (common, {})
        else:
            logger.info("the pooled background gains nothing; the reference is used")
            pool = None
    parts |= measured(call, lent)
    others = [k for k in numbers if k not in parts]
    parts |= measured(call, dict.fromkeys(others, common))
    if pool is not None:  # frames of which the pool tells nothing
        parts |= measured(alone, {k: None for k in others if parts[k].shape is None})
    elif fault:
        parts = {k: part.with_remarks(f"{fault}: not used") for k, part in parts.items()}
    _warn_of_unmatched([parts[k] for k in numbers], edits)
    return _in_order(parts, frames)


def _lent_optics(
    parts: Mapping[int, MeasuredFrame], method: str
) -> tuple[SharedOptics | None, dict[int, SharedOptics]]:
    """Contrast, blur and edge that frames share: for any other frame, and for those of them that gain by it.

    Contrast and blur are those of all frames; of the edge a frame gets what the others
    show: its own adds nothing to it. Nothing is lent where no frame determines its contrast.
    """
    # a pixel count takes each frame's own plateau
    own = [part.relative_optics for part in parts.values()] if method == "disk" else []
    pooled = pool_optics(replace(optics, edge=None) for optics in own if optics is not None)
    if pooled is None:
        return None, {}
    edges = {k: optics.edge for k in sorted(parts) if (optics := parts[k].own_optics) is not None}
    seen = {k: edge for k, edge in edges.items() if edge is not None and edge.count >= FEWEST}
    pool = {k: seen[k] for k in pooling.evenly_spread(list(seen), pooling.MOST_VIEWS)}
    edge_of_others = {k: pool_edges([edge for other, edge in pool.items() if other != k]) for k in pool}
    common = replace(pooled, edge=pool_edges(list(pool.values())))
    lent = {k: replace(common, edge=edge_of_others.get(k, common.edge)) for k in parts}
    return common, {k: optics for k, optics in lent.items() if _gains_by_pooling(parts[k], optics)}


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
    # 1.5 by hand: what the frame knows itself is then below a third of what it is lent
    better = not all(alone <= 1.5 * together for alone, together in stds)
    if better or own.edge is None or pooled.edge is None:
        return better
    # with fewer contacts to see it
    return own.edge.families != pooled.edge.families and 2 * own.edge.count < pooled.edge.count


def _of_usual_shape(parts: Mapping[int, MeasuredFrame]) -> dict[int, MeasuredFrame]:
    """The frames that have as many rows and columns as most; none if all failed."""
    counts = Counter(part.shape for part in parts.values() if part.shape)
    usual = max(counts, key=counts.__getitem__, default=())
    return {k: part for k, part in parts.items() if part.shape == usual}


def _in_order(parts: Mapping[int, MeasuredFrame], frames: Sequence[files.FrameSource]) -> list[MeasuredFrame]:
    """All frames; those of another shape than most are failures."""
    whole, usual = dict(parts), _of_usual_shape(parts)
    rows, columns = next(iter(usual.values())).shape or (0, 0)
    for k, part in parts.items():
        if part.shape is not None and k not in usual:
            odd = f"has {part.shape[1]} x {part.shape[0]} pixels, the other frames {columns} x {rows}"
            whole[k] = MeasuredFrame.of(FailedFrame.of(frames[k].name, FrameError(odd)))
    return [whole[k] for k in range(len(frames))]
