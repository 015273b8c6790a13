"""Compare a run with the predictions of the models: pairs and scores, frame by frame."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from contactimg.analysis.annuli import FieldOfView
from contactimg.effects.plan import Plan
from contactimg.errors import InputError
from contactimg.files import Experiment
from contactimg.files.runs import Run, frame_shift
from contactimg.forces import local_forces
from contactimg.pipeline.inputs import contact_sites
from contactimg.pipeline.pictures import (
    PREDICTED,
    draw_frames,
    draw_predicted,
    series_stretch,
    view_of,
)
from contactimg.pipeline.predict import predict_in_view
from contactimg.pose.pairs import match_contacts
from contactimg.prediction import COMPARED_MODELS, Prediction, hertz_circle, scene_of_model
from contactimg.tables import FAILED, MATCHES, SCORES
from contactimg.tables.outlines import Outline, contact_outlines


@dataclass(frozen=True)
class Comparison:
    """Measured against predicted contacts.

    Attributes
    ----------
    matches : DataFrame
        Pairs with the coupled model's contacts.
    scores : DataFrame
        One row a frame and model.
    predicted : dict
        Frame -> model -> its prediction, restricted to the field of view.
    left_out : dict
        Frame -> which model has no solution for it, and why.
    min_radius_px : float
        Smaller predicted contacts and their partners do not count.
    """

    matches: pd.DataFrame
    scores: pd.DataFrame
    predicted: dict[str, dict[str, Prediction]]
    left_out: dict[str, str]
    min_radius_px: float

    @property
    def plans(self) -> dict[str, Plan]:
        """Frame -> plan of the coupled model; absent where every switch is set."""
        coupled = ((frame, models.get("coupled")) for frame, models in self.predicted.items())
        return {frame: one.plan for frame, one in coupled if one is not None and one.plan is not None}


def compare_run(
    run: Run, asperities: pd.DataFrame, *, min_radius_px: float = 1.0, workers: int | None = 1
) -> Comparison:
    """Predict the contacts of every frame with a load, coupled and uncoupled, and match them.

    Parameters
    ----------
    run : Run
        With a pose, of a scene with sections ``[indenter]`` and ``[elastic]``.
    asperities : DataFrame
        Asperity table.
    min_radius_px : float
        Smaller predicted contacts are not expected to be visible: they and their partners do not count.
    workers : int or None
        Processes that share the predictions.

    Returns
    -------
    Comparison
        Frames without a measurement or a load are skipped; where a model has no solution for a frame, it is
        left out and the reason is kept.

    Raises
    ------
    InputError
        If the run has no pose, the scene lacks what the models need, or no measured frame has a load.
    """
    pose = run.need_pose()
    for section in ("indenter", "elastic"):
        run.scene.need(section, "comparing with a contact model")
    frames = _comparable(run.frames)
    matches, scores, left_out = [MATCHES.empty()], list[dict[str, Any]](), dict[str, list[str]]()
    sites = contact_sites(asperities, run.scene)
    surfaces = {model: (scene_of_model(run.scene, model), asperities) for model in COMPARED_MODELS}
    jobs = [
        (model, frame, load, FieldOfView(pose, frame_shift(run.frames, frame)))
        for frame, load in zip(frames["frame"], frames["load_N"].tolist(), strict=True)
        for model in COMPARED_MODELS
    ]
    predicted: dict[str, dict[str, Prediction]] = {frame: {} for frame in frames["frame"]}
    for (model, frame, *_), one in zip(jobs, predict_in_view(surfaces, jobs, workers=workers), strict=True):
        if isinstance(one, Prediction):
            predicted[frame][model] = one
        else:
            left_out.setdefault(frame, []).append(f"{model}: {one}")
    for frame, models in predicted.items():
        measured = _in_view(run.contacts[run.contacts["frame"] == frame], pose.shape)
        if "coupled" in models and measured["force_N"].notna().any():
            # both sides follow one law
            plan = models["coupled"].plan
            measured = local_forces(run.scene if plan is None else plan.apply(run.scene), measured, sites)[0]
        for model, prediction in models.items():
            pairs, score = compare_frame(
                measured, prediction.contacts, pixel_size=pose.pixel_size, min_radius_px=min_radius_px
            )
            scores.append({"frame": frame, "model": model, **score})
            if model == "coupled":
                matches.append(pairs)
    table = SCORES.conform(pd.DataFrame(scores)) if scores else SCORES.empty()
    reasons = {name: "; ".join(why) for name, why in left_out.items()}
    return Comparison(MATCHES.conform(pd.concat(matches)), table, predicted, reasons, min_radius_px)


def _comparable(frames: pd.DataFrame) -> pd.DataFrame:
    """The frames that were measured at a known load."""
    loaded, good = frames["load_N"].notna(), frames["status"] != FAILED
    if not loaded.any():
        raise InputError(
            "there is nothing to compare: no frame of the run has a load; run `process` again with a table "
            "of loads, loads.csv or [images] loads"
        )
    if not (loaded & good).any():
        raise InputError("there is nothing to compare: no frame with a load could be measured")
    return frames[loaded & good]


def compare_frame(
    measured: pd.DataFrame, predicted: pd.DataFrame, *, pixel_size: float, min_radius_px: float
) -> tuple[pd.DataFrame, dict[str, float]]:
    """Match one frame's contacts and score the prediction.

    Precision is the matched share of the predicted contacts, recall that of the measured ones. A measured
    contact whose partner is predicted smaller than ``min_radius_px`` counts neither for nor against.
    """
    pairs = match_contacts(measured, predicted, max_distance=3 * pixel_size)
    visible = predicted["radius_m"] >= min_radius_px * pixel_size
    counted = pairs["radius_predicted_m"] >= min_radius_px * pixel_size
    n_measured, n_predicted = len(measured) - int((~counted).sum()), int(visible.sum())
    n_matched, good = int(counted.sum()), pairs[counted]
    apart = good["radius_measured_m"] - good["radius_predicted_m"]
    return pairs, {
        "n_measured": n_measured,
        "n_predicted": n_predicted,
        "n_matched": n_matched,
        "precision": n_matched / n_predicted if n_predicted else np.nan,
        "recall": n_matched / n_measured if n_measured else np.nan,
        "f1": 2 * n_matched / (n_measured + n_predicted) if n_measured + n_predicted else np.nan,
        "position_rms_m": float(np.sqrt((good["distance_m"] ** 2).mean())),
        "radius_rms_m": float(np.sqrt((apart**2).mean())),
    }


def _in_view(contacts: pd.DataFrame, shape: tuple[int, int]) -> pd.DataFrame:
    """Contacts whose centre lies in the image."""
    rows, columns = shape
    inside = contacts["x_px"].between(-0.5, columns - 0.5) & contacts["y_px"].between(-0.5, rows - 0.5)
    return contacts[inside].reset_index(drop=True)


def draw_comparison(
    comparison: Comparison, run: Run, experiment: Experiment, folder: Path, *, workers: int | None
) -> None:
    """Draw measured and predicted contacts on each frame that a model has a solution for, as PNG files."""
    folder.mkdir()
    predicted = {frame: models for frame, models in comparison.predicted.items() if models}
    sources = {source.name: source for source in experiment.frames}
    lost = [frame for frame in predicted if frame not in sources]
    if lost:
        raise InputError(f"frame {lost[0]} of the run is not among the frames of its scene; repeat `process`")
    stretch = series_stretch([sources[frame] for frame in predicted])
    pose = run.need_pose()

    loads, tables = run.frames.set_index("frame")["load_N"], dict(run.by_frame())
    how = {"pixel_size": pose.pixel_size, "min_radius_px": comparison.min_radius_px}

    def jobs() -> Iterator[tuple[Any, ...]]:
        for frame, models in predicted.items():
            shift, view = frame_shift(run.frames, frame), view_of(frame, experiment, stretch, pose.pixel_size)
            found, circle = hertz_circle(run.scene, float(loads[frame])), list[Outline]()
            if found is not None:
                (x, y), radius = np.add(pose.to_pixels(*found[:2]), shift), found[2] / pose.pixel_size
                circle = [Outline(0, float(x), float(y), radius, radius)]
            seen, lines = _in_view(tables[frame].contacts, pose.shape), tables[frame].outlines
            marked = {model: mark_contacts(seen, one.contacts, lines, **how) for model, one in models.items()}
            draw = partial(draw_predicted, marked=marked, hertz_circle=circle, view=view)
            yield sources[frame], draw

    draw_frames(jobs(), folder, count=len(predicted), workers=workers)


def mark_contacts(
    measured: pd.DataFrame,
    predicted: pd.DataFrame,
    lines: pd.DataFrame | None = None,
    *,
    pixel_size: float,
    min_radius_px: float,
) -> dict[str, list[Outline]]:
    """The contacts of one frame by kind (`contactimg.pipeline.pictures.MARKS`), as the scores count them."""
    pairs, _ = compare_frame(measured, predicted, pixel_size=pixel_size, min_radius_px=min_radius_px)
    least = min_radius_px * pixel_size
    matched = measured["label"].isin(pairs.loc[pairs["radius_predicted_m"] >= least, "measured_label"])
    missed = ~measured["label"].isin(pairs["measured_label"])
    false = (predicted["radius_m"] >= least) & ~predicted["asperity"].isin(pairs["asperity"])
    return {
        "matched": contact_outlines(measured[matched], lines),
        "measured, not predicted": contact_outlines(measured[missed], lines),
        "predicted, not measured": contact_outlines(predicted[false]),
        PREDICTED: contact_outlines(predicted),
    }
