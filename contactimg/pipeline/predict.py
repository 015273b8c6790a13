"""The effects that a scene calls for, and predictions at several loads."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from contactimg.analysis.annuli import FieldOfView
from contactimg.effects.plan import Plan, make_plan
from contactimg.effects.solve_without import MECHANICAL_EFFECTS
from contactimg.engine.parallel import in_parallel
from contactimg.errors import ContactimgError, InputError, finite_number
from contactimg.pipeline.inputs import largest_load, need_asperities, scene_asperities
from contactimg.pipeline.results import write_results
from contactimg.prediction import Coupling, Model, Prediction, load_name, predict_average, predict_contacts
from contactimg.render.contacts import see_contacts
from contactimg.scene import Scene
from contactimg.tables import CONTACTS, FRAMES, PROFILE


def predict_loads(
    scene: Scene, loads: Sequence[float], *, model: Model, coupling: Coupling, annulus: float
) -> list[Prediction]:
    """Predict the contacts of a scene at each load.

    Parameters
    ----------
    scene : Scene
        With asperities. The effects of the interacting model are planned at each load
        (`contactimg.effects.plan`); a switch that ``[effects]`` sets is obeyed.
    loads : sequence of float, N
        Each once.
    model : {"interacting", "gw", "gt"}
        Row by row, or averages over random asperities.
    coupling : str
        "auto" to follow the plan, or a level of coupling: the paper's model with that coupling, in which the
        other effects act only where ``[effects]`` switches them on.
    annulus : float
        Width of the profile's annuli (interacting model), m.

    Returns
    -------
    list of Prediction
        One per load; a load without a solution gives a failed prediction with the reason.

    Raises
    ------
    InputError
        If a load is given twice, the scene lacks what the model needs, or a statistical model is given a
        level of coupling or an effect that it cannot represent.
    ContactimgError
        If no load has a solution: the reason of the first.
    """
    if not loads:
        raise InputError("no load is given; give --load-N")
    repeated = [load for load in loads if list(loads).count(load) > 1]
    if repeated:
        raise InputError(f"{load_name(repeated[0])} is given more than once; give each load once")
    if model == "interacting":
        asperities = need_asperities(scene, "predicting contacts")
        how: dict[str, Any] = {"coupling": coupling, "annulus": annulus}
        predict = partial(predict_contacts, scene, asperities, **how, always_plan=True)
    else:
        _refuse_beyond_averages(scene, model, coupling)
        predict = partial(predict_average, scene, scene_asperities(scene), model=model)
    jobs = [(load,) for load in loads]
    found = list(in_parallel(partial(_found, predict), jobs, count=len(jobs)))
    errors = [one for one in found if isinstance(one, ContactimgError)]
    if len(errors) == len(found):
        raise errors[0]
    return [
        Prediction.failed(load, str(one)) if isinstance(one, ContactimgError) else one
        for load, one in zip(loads, found, strict=True)
    ]


def _refuse_beyond_averages(scene: Scene, model: str, coupling: str) -> None:
    """Raise `InputError` for what a statistical model cannot represent."""
    if coupling != "auto":
        cure = 'leave it out, or take the model "interacting"'
        raise InputError(f'model "{model}" has no levels of coupling, got coupling "{coupling}"; {cure}')
    beyond = (name for name in MECHANICAL_EFFECTS if "coupling" not in name)
    ordered = [name for name in beyond if getattr(scene.effects, name) == "on"]
    if ordered:
        raise InputError(
            f'model "{model}" cannot represent {", ".join(ordered)}, which [effects] switches on; '
            'take the model "interacting", or switch it off'
        )


def _found(predict: Callable[..., Prediction], load: float, **how: Any) -> Prediction | ContactimgError:
    """The prediction for a load, or why there is none."""
    try:
        return predict(load=load, **how)
    except ContactimgError as error:
        return error


def predict_in_view(
    surfaces: Mapping[str, tuple[Scene, pd.DataFrame]],
    jobs: Sequence[tuple[str, str, float, FieldOfView | None]],
    *,
    shown: str = "predicting contacts",
) -> Iterator[Prediction | ContactimgError]:
    """Predict the contacts in the field of view of several frames; without a solution, the reason is given.

    Parameters
    ----------
    surfaces : mapping
        Name -> scene and asperities.
    jobs : sequence of (str, str, float, FieldOfView or None)
        Name of a surface, of a frame, its load (N), and what the camera sees; None sees everything.
    shown
        As for `contactimg.engine.parallel.in_parallel`.
    """

    def seen(name: str, frame: str, load: float, field: FieldOfView | None) -> Prediction | ContactimgError:
        found = _found(partial(predict_contacts, *surfaces[name]), load, frame=frame)
        if isinstance(found, ContactimgError) or field is None:
            return found
        contacts = found.contacts[field.holds(found.contacts["x_m"], found.contacts["y_m"])]
        contacts = see_contacts(contacts, field.pose, shift_px=field.shift_px)
        return replace(found, contacts=contacts.reset_index(drop=True))

    return in_parallel(seen, jobs, count=len(jobs), shown=shown)


def choice_sentence(prediction: Prediction) -> str:
    """One sentence on a planned prediction: level of coupling, effects left out and what that changes."""
    plan, row = prediction.plan, prediction.frames.iloc[0]
    if plan is None:
        return ""
    level = {"none": "no coupling", "asymptotic": "coupling by point forces", "full": "full coupling"}
    what = {"all": "every output"}.get(plan.output, f"the {plan.output}")
    return (
        f"{row['frame']}: {level[plan.coupling]} for {100 * plan.relative:g} % of {what}, "
        f"law {row['law']}; {plan.sentence()}"
    )


def write_predictions(
    predictions: Sequence[Prediction], scene: Scene, folder: Path
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Write contacts.csv, frames.csv and profile.csv.

    The pixel columns of the contacts are filled where the scene has a camera and the size of its frames.

    Returns
    -------
    frames : DataFrame
        The frames table.
    record : dict
        For the provenance: name of the load -> the plan of its effects, and the errors expected of it.
    """
    contacts = CONTACTS.joined(one.contacts for one in predictions)
    frames = FRAMES.joined(one.frames for one in predictions)
    profile = PROFILE.joined(one.profile for one in predictions)
    if scene.camera is not None and scene.simulate is not None:
        contacts = see_contacts(contacts, scene.pose(scene.simulate.shape))
    write_results(folder, [(CONTACTS, contacts), (FRAMES, frames), (PROFILE, profile)])
    planned = zip(frames["frame"], predictions, strict=True)
    plans = {name: one.plan for name, one in planned if one.plan is not None}
    errors = {name: plan.error_record for name, plan in plans.items()}
    return frames, {"plans": {name: plan.record for name, plan in plans.items()}, "expected_errors": errors}


def plan_effects(scene: Scene, *, load: float | None = None) -> Plan:
    """Decide which effects a scene calls for, each with the number that decides.

    Parameters
    ----------
    scene : Scene
        With asperities and sections ``[indenter]`` and ``[elastic]``; ``[tolerance]`` states which output
        must be accurate and how accurate, ``[effects]`` may switch effects on or off.
    load : float, optional, N
        By default the largest of the scene: of ``[simulate] loads_N``, else of its table of loads.

    Returns
    -------
    Plan

    Raises
    ------
    InputError
        If the scene lacks what the estimates need, or a load.
    ModelRangeError
        If the indenter reaches the plane between the asperities.

    Examples
    --------
    >>> from contactimg.scene import scene_from_dict
    >>> scene = scene_from_dict(
    ...     {
    ...         "indenter": {"radius_m": 0.1288, "apex_m": [0.002, 0.002]},
    ...         "elastic": {"young_modulus_Pa": 3e6},
    ...         "asperities": {"generate": "SA", "side_m": 0.004},
    ...         "tolerance": {"output": "force"},
    ...     }
    ... )
    >>> plan = plan_effects(scene, load=0.05)
    >>> plan.coupling, plan.is_on("layer")
    ('asymptotic', False)
    """
    asperities = need_asperities(scene, "planning the effects")
    chosen = largest_load(scene) if load is None else finite_number(load, "load", "N")
    return make_plan(scene, asperities, load=chosen)
