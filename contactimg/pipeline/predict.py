"""Predictions of a scene at several loads, and their files."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from contactimg.effects.mechanics.mechanical_effects import MECHANICAL_EFFECTS
from contactimg.effects.plan import Decision, make_plan
from contactimg.errors import ContactimgError, InputError
from contactimg.files import write_table
from contactimg.pipeline.inputs import need_asperities, scene_asperities
from contactimg.prediction import (
    Coupling,
    Model,
    Prediction,
    predict_average,
    predict_contacts,
    see_contacts,
)
from contactimg.scene import Scene
from contactimg.tables import CONTACTS, FRAMES, PROFILE

SOLVER_SHARE = 0.01
"""Share of a tolerance that the solver's residual may take; the plan's effects have the rest."""

MODEL_ERROR = 2.5e-4
"""Relative difference of the area with full coupling from boundary elements (pattern SA+ at 0.5 N)."""

BEYOND_AVERAGES = ("adhesion", "layer", "sphere_profile")
"""Effects that the statistical models do not know."""

ROUNDING = 1e-11
"""Least residual asked for, that every solver reaches."""


def predict_loads(
    scene: Scene,
    loads: Sequence[float],
    *,
    model: Model,
    coupling: Coupling,
    annulus: float,
    relative: float | None = None,
) -> list[Prediction]:
    """Predict the contacts of a scene at each load.

    Parameters
    ----------
    scene : Scene
        With asperities. Which effects the interacting model computes is planned at each load
        (`contactimg.effects.plan`); what ``[effects]`` orders is obeyed.
    loads : sequence of float
        N, each once.
    model : {"interacting", "gw", "gt"}
        Row by row, or averages over random asperities.
    coupling : str
        "auto" to follow the plan, or a level of coupling: the paper's model with that coupling, in which the
        other effects act only where ``[effects]`` switches them on.
    annulus : float
        Width of the profile's annuli (interacting model), m.
    relative : float, optional
        Tolerance of the output that the solver need not exceed by more than `SOLVER_SHARE`; default: it
        solves to rounding.

    Returns
    -------
    list of Prediction
        One a load; where a load has no answer a failed one, with the reason.

    Raises
    ------
    InputError
        If a load is given twice, the scene lacks what the model needs, or a statistical model is given a
        level of coupling or an effect that it does not know.
    ContactimgError
        If no load has an answer: the reason of the first.
    """
    repeated = [load for load in loads if list(loads).count(load) > 1]
    if repeated:
        raise InputError(f"load {repeated[0]!r} N is given more than once; give each load once")
    if model == "interacting":
        asperities = need_asperities(scene, "predicting contacts")
        tolerance = None if relative is None else solver_tolerance(relative)
        predict = partial(
            _predict_planned, scene, asperities, coupling=coupling, annulus=annulus, tolerance=tolerance
        )
    else:
        if relative is not None:
            raise InputError(
                f'model "{model}" has no cheaper method for a larger tolerance; leave the tolerance out'
            )
        if coupling != "auto":
            raise InputError(
                f'model "{model}" knows no level of coupling, got coupling "{coupling}"; leave it out, or '
                'take the model "interacting"'
            )
        ordered = [name for name in BEYOND_AVERAGES if getattr(scene.effects, name) == "on"]
        if ordered:
            raise InputError(
                f'model "{model}" knows no {", ".join(ordered)}, which [effects] switches on; take the model '
                '"interacting", or switch it off'
            )
        predict = partial(predict_average, scene, scene_asperities(scene), model=model)
    predictions, errors = [], []
    for load in loads:
        try:
            predictions.append(predict(load=load))
        except ContactimgError as error:
            errors.append(error)
            predictions.append(Prediction.failed(load, str(error)))
    if len(errors) == len(predictions):
        raise errors[0]
    return predictions


def solver_tolerance(relative: float) -> float:
    """Residual of the solver that takes up a small share of a relative tolerance."""
    return max(SOLVER_SHARE * relative, ROUNDING)


def choice_sentence(prediction: Prediction, *, relative: float) -> str:
    """What a tolerance led to at a load: the level of coupling, what is left out and by how much it acts."""
    plan = prediction.plan
    if plan is None:
        return str(prediction.frames["message"].iloc[0])
    off = [d for d in plan.decisions if d.effect in MECHANICAL_EFFECTS and not d.on and d.change > 0]
    level = {"none": "no coupling", "asymptotic": "coupling by point forces", "full": "full coupling"}
    beyond = (
        f"; full coupling itself is within about {100 * MODEL_ERROR:g} % of boundary elements "
        "(area of SA+ at 0.5 N)"
        if plan.coupling == "full" and relative < MODEL_ERROR
        else ""
    )
    return (
        f"{prediction.frames['frame'].iloc[0]}: {level[plan.coupling]} for {100 * relative:g} % of the "
        f"{plan.output}, to a residual of {solver_tolerance(relative):.0e}"
        + _listed("left out", (d for d in off if d.switch == "auto"))
        + _listed("off by order", (d for d in off if d.switch == "off"))
        + beyond
    )


def _listed(why: str, decisions: Iterable[Decision]) -> str:
    """Effects with what they change; nothing of none."""
    effects = ", ".join(f"{d.effect} ({100 * d.change:.2g} %)" for d in decisions)
    return f"; {why}: {effects}" if effects else ""


def _predict_planned(
    scene: Scene,
    asperities: pd.DataFrame,
    *,
    load: float,
    coupling: Coupling,
    annulus: float,
    tolerance: float | None,
) -> Prediction:
    """Plan the effects at a load and predict the contacts with them."""
    scene = _ordered(scene, coupling)
    mechanical = scene.model_copy(update={"simulate": None})  # no frames are rendered
    plan = make_plan(mechanical, asperities, load=load)
    level: Coupling = "hertz" if coupling == "hertz" else "auto"
    prediction = predict_contacts(
        plan.apply(scene), asperities, load=load, coupling=level, annulus=annulus, tolerance=tolerance
    )
    notes = [note for note in (*prediction.frames["message"], *plan.messages) if note]
    return replace(prediction, frames=prediction.frames.assign(message="; ".join(notes)), plan=plan)


def _ordered(scene: Scene, coupling: Coupling) -> Scene:
    """The scene with the switches that a level of coupling given by option amounts to."""
    if coupling == "auto":
        return scene
    switches: dict[str, str] = {
        name: "off" for name in MECHANICAL_EFFECTS if getattr(scene.effects, name) == "auto"
    }
    switches |= {
        "coupling": "off" if coupling == "none" else "on",
        "full_coupling": "on" if coupling == "full" else "off",
    }
    return scene.model_copy(update={"effects": scene.effects.model_copy(update=switches)})


def plan_records(predictions: Sequence[Prediction]) -> dict[str, list[dict[str, Any]]]:
    """What the provenance keeps of the plans: name of the load -> effect, change, decision, reason."""
    return {p.frames["frame"].iloc[0]: p.plan.record for p in predictions if p.plan is not None}


def write_predictions(predictions: Sequence[Prediction], scene: Scene, folder: Path) -> pd.DataFrame:
    """Write contacts.csv, frames.csv and profile.csv; return the frames table.

    The pixel columns of the contacts are filled where the scene has a camera and the size of its frames.
    """
    contacts = pd.concat([prediction.contacts for prediction in predictions], ignore_index=True)
    if scene.camera is not None and scene.simulate is not None:
        contacts = see_contacts(contacts, scene.pose(scene.simulate.shape))
    frames = pd.concat([prediction.frames for prediction in predictions], ignore_index=True)
    profiles = pd.concat([prediction.profile for prediction in predictions], ignore_index=True)
    write_table(contacts, CONTACTS, folder / "contacts.csv")
    write_table(frames, FRAMES, folder / "frames.csv")
    write_table(profiles, PROFILE, folder / "profile.csv")
    return frames
