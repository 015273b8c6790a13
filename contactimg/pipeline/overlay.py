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
from contactimg.pipeline.pictures import MARKS, PREDICTED, draw_frames, draw_predicted
from contactimg.pipeline.predict import predict_in_view
from contactimg.plots.overlay import Picture
from contactimg.pose.pairs import match_contacts
from contactimg.prediction import COMPARED_MODELS, Prediction, hertz_circle, scene_of_model
from contactimg.tables import MATCHES, SCORES
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
    seen : dict
        Frame -> model -> the contacts in the field of view by kind, as `compare_frame` tells them apart.
    plans : dict
        Frame -> plan of the coupled model; absent where every switch is set.
    left_out : dict
        Frame -> which model has no solution for it, and why.
    """

    matches: pd.DataFrame
    scores: pd.DataFrame
    seen: dict[str, dict[str, dict[str, pd.DataFrame]]]
    plans: dict[str, Plan]
    left_out: dict[str, str]


def compare_run(run: Run, asperities: pd.DataFrame, *, min_radius_px: float = 1.0) -> Comparison:
    """Predict the contacts of every frame with a load, coupled and uncoupled, and match them.

    Parameters
    ----------
    run : Run
        With a pose, of a scene with sections ``[indenter]`` and ``[elastic]``.
    asperities : DataFrame
        Asperity table.
    min_radius_px : float
        Smaller predicted contacts are not expected to be visible: they and their partners do not count.

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
    loaded, shown = run.frames["load_N"].notna(), run.frames["n_contacts"].notna()
    if not loaded.any():
        cure = "run `process` again with a table of loads, loads.csv or [images] loads"
        raise InputError(f"there is nothing to compare: no frame of the run has a load; {cure}")
    if not (loaded & shown).any():
        raise InputError("there is nothing to compare: no frame with a load could be measured")
    frames = run.frames[loaded & shown]
    matches, scores, left_out = list[pd.DataFrame](), list[dict[str, Any]](), dict[str, str]()
    seen, plans = dict[str, dict[str, dict[str, pd.DataFrame]]](), dict[str, Plan]()
    sites = contact_sites(asperities, run.scene)
    surfaces = {model: (scene_of_model(run.scene, model), asperities) for model in COMPARED_MODELS}
    jobs = [
        (model, frame, load, FieldOfView(pose, frame_shift(run.frames, frame)))
        for frame, load in zip(frames["frame"], frames["load_N"].tolist(), strict=True)
        for model in COMPARED_MODELS
    ]
    for (model, frame, _, field), found in zip(jobs, predict_in_view(surfaces, jobs), strict=True):
        if not isinstance(found, Prediction):
            left_out[frame] = "; ".join(filter(None, (left_out.get(frame), f"{model}: {found}")))
            continue
        measured = run.contacts[run.contacts["frame"] == frame]
        measured = measured[field.holds(measured["x_m"], measured["y_m"])].reset_index(drop=True)
        if model == "coupled":
            scene = run.scene
            if found.plan is not None:
                scene, plans[frame] = found.plan.apply(scene), found.plan
            if measured["force_N"].notna().any():  # in the matches both sides follow one law
                measured = local_forces(scene, measured, sites)[0]
        lengths = {"pixel_size": pose.pixel_size, "min_radius_px": min_radius_px}
        pairs, kinds, score = compare_frame(measured, found.contacts, **lengths)
        seen.setdefault(frame, {})[model] = kinds
        scores.append({"frame": frame, "model": model, **score})
        matches += [pairs] if model == "coupled" else []
    table = SCORES.conform(pd.DataFrame(scores, columns=list(SCORES.columns)))
    return Comparison(MATCHES.joined(matches), table, seen, plans, left_out)


def compare_frame(
    measured: pd.DataFrame, predicted: pd.DataFrame, *, pixel_size: float, min_radius_px: float
) -> tuple[pd.DataFrame, dict[str, pd.DataFrame], dict[str, float]]:
    """Match one frame's contacts and score the prediction: pairs, contacts by kind, and score.

    The kinds are those of `contactimg.pipeline.pictures.MARKS`, and `PREDICTED`. Precision is the matched
    share of the predicted contacts, recall that of the measured ones. A measured contact whose partner is
    predicted smaller than ``min_radius_px`` counts neither for nor against.
    """
    least = min_radius_px * pixel_size
    pairs = match_contacts(measured, predicted, max_distance=3 * pixel_size)
    good = pairs[pairs["radius_predicted_m"] >= least]
    alone = (predicted["radius_m"] >= least) & ~predicted["asperity"].isin(pairs["asperity"])
    kinds = {
        "matched": measured[measured["label"].isin(good["measured_label"])],
        "measured, not predicted": measured[~measured["label"].isin(pairs["measured_label"])],
        "predicted, not measured": predicted[alone],
        PREDICTED: predicted,
    }
    n_matched, n_missed, n_alone = (len(kinds[kind]) for kind in MARKS)
    n_measured, n_predicted = n_matched + n_missed, n_matched + n_alone
    apart = good["radius_measured_m"] - good["radius_predicted_m"]
    score = {
        "n_measured": n_measured,
        "n_predicted": n_predicted,
        "n_matched": n_matched,
        "precision": n_matched / n_predicted if n_predicted else np.nan,
        "recall": n_matched / n_measured if n_measured else np.nan,
        "f1": 2 * n_matched / (n_measured + n_predicted) if n_measured + n_predicted else np.nan,
        "position_rms_m": float(np.sqrt((good["distance_m"] ** 2).mean())),
        "radius_rms_m": float(np.sqrt((apart**2).mean())),
    }
    return pairs, kinds, score


def draw_comparison(comparison: Comparison, run: Run, experiment: Experiment, folder: Path) -> None:
    """Draw measured and predicted contacts on each frame that a model has a solution for, as PNG files.

    Frames of the run that are no longer there have no picture.
    """
    pose, tables = run.need_pose(), dict(run.by_frame())
    loads = run.frames.set_index("frame")["load_N"]

    def drawings() -> Iterator[tuple[str, partial[Picture]]]:
        for frame, models in comparison.seen.items():
            found, circle = hertz_circle(run.scene, float(loads[frame])), list[Outline]()
            if found is not None:
                x, y = np.add(pose.to_pixels(*found[:2]), frame_shift(run.frames, frame)).tolist()
                radius = found[2] / pose.pixel_size
                circle = [Outline(0, x, y, radius, radius)]
            lines = tables[frame].outlines
            marked = {
                model: {
                    kind: contact_outlines(table, None if kind.startswith(PREDICTED) else lines)
                    for kind, table in kinds.items()
                }
                for model, kinds in models.items()
            }
            yield frame, partial(draw_predicted, marked=marked, hertz_circle=circle)

    names, pixel_size = comparison.seen.keys(), pose.pixel_size
    draw_frames(experiment, names, drawings(), folder, pixel_size=pixel_size)
