"""Predictions of a scene at several loads, of its own asperities or averaged over random patterns."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.analysis.annuli import MOMENTS, annulus_moments
from contactimg.analysis.radial_profiles import average_profile
from contactimg.effects.local_law import law_name
from contactimg.effects.plan import Plan
from contactimg.engine.calls import in_parallel
from contactimg.errors import ContactimgError, InputError
from contactimg.files import PartStore, write_table
from contactimg.models.load_spring import LoadSpring
from contactimg.models.proof import CONVERGED
from contactimg.pipeline.inputs import (
    generated_asperities,
    loads_before,
    need_asperities,
    refuse_repeated,
    scene_asperities,
    solver_tolerance,
)
from contactimg.prediction import (
    Coupling,
    Model,
    Prediction,
    Prescribed,
    find_touching_load,
    load_name,
    make_mechanical_plan,
    predict_average,
    predict_contacts,
    scene_level,
    see_contacts,
    solve_around,
    with_coupling,
    with_memory,
)
from contactimg.scene import Scene
from contactimg.tables import CONTACTS, FRAMES, PROFILE, Status

BEYOND_AVERAGES = ("adhesion", "layer", "sphere_profile")
"""Effects that the statistical models cannot represent."""


def predict_loads(
    scene: Scene,
    loads: Sequence[Prescribed],
    *,
    model: Model,
    coupling: Coupling,
    annulus: float,
    relative: float | None = None,
    workers: int | None = 1,
) -> list[Prediction]:
    """Predict the contacts of a scene at each load.

    Parameters
    ----------
    scene : Scene
        With asperities. The effects of the interacting model are planned at each load
        (`contactimg.effects.plan`); a switch that ``[effects]`` sets is obeyed.
    loads : sequence of float, N, or of LoadSpring
        Each once. A `LoadSpring` prescribes the displacement of the stage (interacting model).
    model : {"interacting", "gw", "gt"}
        Row by row, or averages over random asperities.
    coupling : str
        "auto" to follow the plan, or a level of coupling: the paper's model with that coupling, in which the
        other effects act only where ``[effects]`` switches them on.
    annulus : float
        Width of the profile's annuli (interacting model), m.
    relative : float, optional
        Tolerance of the output; the solver stops at a residual of `SOLVER_SHARE` times it. Default: it solves
        to rounding.
    workers : int or None
        Processes that share the loads, as for `contactimg.engine.calls.in_parallel`.

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
    refuse_repeated(loads)
    if model == "interacting":
        asperities = need_asperities(scene, "predicting contacts")
        tolerance = solver_tolerance(relative)
        how: dict[str, Any] = {"coupling": coupling, "annulus": annulus, "tolerance": tolerance}
        predict = partial(predict_contacts, scene, asperities, **how, always_plan=True)
    else:
        _refuse_beyond_averages(scene, loads, model, coupling)
        if relative is not None:
            raise InputError(
                f'model "{model}" has no cheaper method for a larger tolerance; leave the tolerance out'
            )
        predict = partial(predict_average, scene, scene_asperities(scene), model=model)
    jobs = [(load, loads_before(scene, load, loads)) for load in loads]
    found = list(in_parallel(partial(_solve, predict), jobs, count=len(jobs), workers=workers))
    errors = [one for one in found if isinstance(one, ContactimgError)]
    if len(errors) == len(found):
        raise errors[0]
    return [
        Prediction.failed(load, str(one)) if isinstance(one, ContactimgError) else one
        for load, one in zip(loads, found, strict=True)
    ]


def touching_load(scene: Scene, *, model: Model, coupling: Coupling) -> float:
    """`contactimg.prediction.find_touching_load` for the asperities of a scene."""
    asperities = need_asperities(scene, "predicting contacts") if model == "interacting" else None
    return find_touching_load(
        scene,
        asperities if model == "interacting" else scene_asperities(scene),
        model=model,
        coupling=coupling,
    )


def _refuse_beyond_averages(scene: Scene, loads: Sequence[Prescribed], model: str, coupling: str) -> None:
    """Raise `InputError` for what a statistical model cannot represent."""
    if coupling != "auto":
        raise InputError(
            f'model "{model}" has no levels of coupling, got coupling "{coupling}"; leave it out, or '
            'take the model "interacting"'
        )
    if scene.shaped:
        raise InputError(
            f'model "{model}" takes a flat sample under an upright lens; take the model "interacting"'
        )
    ordered = [name for name in BEYOND_AVERAGES if getattr(scene.effects, name) == "on"]
    if ordered:
        raise InputError(
            f'model "{model}" cannot represent {", ".join(ordered)}, which [effects] switches on; '
            'take the model "interacting", or switch it off'
        )
    if any(isinstance(load, LoadSpring) for load in loads):
        raise InputError(f'model "{model}" takes loads, no displacements; take the model "interacting"')


def _solve(
    predict: Callable[..., Prediction], load: Prescribed, history: Sequence[Prescribed]
) -> Prediction | ContactimgError:
    """The prediction for a load, or why there is none."""
    try:
        return predict(load=load, history=history) if history else predict(load=load)
    except ContactimgError as error:
        return error


def choice_sentence(prediction: Prediction, *, relative: float | None = None) -> str:
    """One sentence on a prediction: level of coupling, effects left out and what that changes.

    ``relative`` is the tolerance of the solver, where one was asked for.
    """
    plan, row = prediction.plan, prediction.frames.iloc[0]
    if plan is None:
        return f"{row['frame']}: {row['message'] or 'averages over random patterns'}"
    level = {"none": "no coupling", "asymptotic": "coupling by point forces", "full": "full coupling"}
    what = {"all": "every output"}.get(plan.output, f"the {plan.output}")
    solver = "" if relative is None else f", to a residual of {solver_tolerance(relative):.0e}"
    return (
        f"{row['frame']}: {level[plan.coupling]} for {100 * plan.relative:g} % of {what}, "
        f"law {row['law']}{solver}; {plan.sentence()}"
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
    contacts = pd.concat([prediction.contacts for prediction in predictions], ignore_index=True)
    if scene.camera is not None and scene.simulate is not None:
        contacts = see_contacts(contacts, scene.pose(scene.simulate.shape))
    frames = pd.concat([prediction.frames for prediction in predictions], ignore_index=True)
    profiles = pd.concat([prediction.profile for prediction in predictions], ignore_index=True)
    write_table(contacts, CONTACTS, folder / "contacts.csv")
    write_table(frames, FRAMES, folder / "frames.csv")
    write_table(profiles, PROFILE, folder / "profile.csv")
    planned = [(name, one.plan) for name, one in zip(frames["frame"], predictions, strict=True)]
    plans = {name: plan for name, plan in planned if plan is not None}
    errors = {name: plan.error_record for name, plan in plans.items()}
    return frames, {"plans": {name: plan.record for name, plan in plans.items()}, "expected_errors": errors}


def prescriptions(
    scene: Scene, loads: Sequence[float], displacements: Sequence[float] = ()
) -> list[Prescribed]:
    """Loads (N) and displacements of the stage (m), these through the load cell of the scene.

    Raises
    ------
    InputError
        If there is neither.

    Examples
    --------
    >>> from contactimg.scene import scene_from_dict
    >>> prescriptions(scene_from_dict({"load": {"stiffness_N_m": 500.0}}), [0.1], [1e-5])
    [0.1, LoadSpring(stiffness=500.0, displacement=1e-05)]
    """
    if not loads and not displacements:
        raise InputError("no load is given; give --load-N, or --displacement-um")
    stiffness = scene.load.stiffness if scene.load.stiffness is not None else float("inf")
    return [*loads, *(LoadSpring(stiffness, displacement) for displacement in displacements)]


# --- averages over random patterns

GROUPS = 32
"""Groups of patterns whose scatter gives the uncertainty of the profile. Theory: 32 know a standard deviation
to 1/sqrt(2 31) = 13 %."""

PatternSums = tuple[tuple[float, ...], NDArray[np.float64]]
"""What one pattern gives at one load: area, force, number of contacts, indentation, load, gap and whether the
solution is approximate only, SI units; and of each annulus `contactimg.analysis.annuli.MOMENTS`."""

LoadSums = tuple[list[tuple[float, ...]], dict[int, NDArray[np.float64]], list[str]]
"""Of the patterns at one load: numbers, sums of the annuli of each group, and why some have no solution."""


@dataclass(frozen=True)
class Ensemble:
    """What the patterns of an ensemble have in common.

    Parameters
    ----------
    scenes : tuple of Scene
        One a load, with the effects switched; ``[asperities]`` generates the patterns.
    loads : tuple of float, N, or of LoadSpring
    histories : tuple of tuple
        The loads that came before each.
    coupling : str
        "hertz", or "auto" for what the effects say.
    edges : tuple of float, m
        Of annuli around the apex.
    tolerance : float or None
        Of the solver.
    """

    scenes: tuple[Scene, ...]
    loads: tuple[Prescribed, ...]
    histories: tuple[tuple[Prescribed, ...], ...]
    coupling: str
    edges: tuple[float, ...]
    tolerance: float | None

    def solve(self, index: int) -> list[PatternSums | str]:
        """Pattern ``index`` at each load, or why it has no solution; depends on the seed and on it alone."""
        asperities, results = generated_asperities(self.scenes[0], index), list[PatternSums | str]()
        for scene, load, history in zip(self.scenes, self.loads, self.histories, strict=True):
            how: dict[str, Any] = {"level": scene_level(scene, self.coupling), "tolerance": self.tolerance}
            try:
                found, _ = solve_around(scene, asperities, load=load, history=history, **how)
            except ContactimgError as error:
                results.append(str(error))
                continue
            contacts = found.contacts("")
            centre = scene.need("indenter", "an ensemble").apex
            moments = annulus_moments(contacts, centre=centre, edges=self.edges)[list(MOMENTS)].to_numpy(
                float
            )
            sums = contacts[["area_m2", "force_N"]].sum().tolist()
            last = found.load, found.base_gap.least, float(found.status != CONVERGED)
            results.append(((*sums, float(len(contacts)), found.indentation, *last), moments))
        return results


def predict_ensemble(
    scene: Scene,
    loads: Sequence[Prescribed],
    *,
    patterns: int,
    coupling: Coupling,
    annulus: float,
    relative: float | None = None,
    workers: int | None = 1,
    store: PartStore | None = None,
    advance: Callable[[], None] | None = None,
) -> list[Prediction]:
    """Predict the averages over random patterns at each load.

    Parameters
    ----------
    scene : Scene
        Sections ``[indenter]`` and ``[elastic]`` are needed, and ``[asperities]`` with ``generate``. Its own
        pattern decides which effects are computed.
    loads : sequence of float, N, or of LoadSpring
        Each once.
    patterns : int
        Their number. Pattern ``k`` depends only on ``[asperities] seed`` and on ``k``.
    coupling : str
        As for `contactimg.prediction.predict_contacts`.
    annulus : float
        Width of the annuli around ``[indenter] apex_m``, m.
    relative : float, optional
        Tolerance of the output, as for `predict_loads`.
    workers : int or None
        As for `contactimg.engine.calls.in_parallel`.
    store : PartStore, optional
        Patterns that it holds are taken from it, the others are added.
    advance : callable, optional
        Called once a pattern, in order.

    Returns
    -------
    list of Prediction
        In order, without contacts. Uncertainties are standard errors of the mean.

    Raises
    ------
    InputError
        If the scene generates no patterns.
    """
    section = scene.asperities
    if section is None or section.generate is None:
        raise InputError("an ensemble needs random patterns: state generate in [asperities]")
    refuse_repeated(loads)
    if patterns < 1:
        raise InputError(f"an ensemble needs one pattern at least, got {patterns}")
    if not (np.isfinite(annulus) and annulus > 0):
        raise InputError(f"the width of an annulus must be positive, got {annulus!r} m")
    typical, scene = need_asperities(scene, "an ensemble"), with_coupling(scene, coupling)
    planned: dict[int, tuple[Scene, Plan]] = {}
    failed: dict[int, ContactimgError] = {}
    histories = [loads_before(scene, load, loads) for load in loads]
    for k, load in enumerate(loads):
        remembering = with_memory(scene, histories[k])
        try:
            plan = make_mechanical_plan(remembering, typical, load=load)
            planned[k] = plan.apply(remembering), plan
        except ContactimgError as error:
            failed[k] = error
    if not planned:
        raise failed[0]
    apex = np.array(scene.need("indenter", "an ensemble").apex)
    farthest = float(np.hypot(*np.maximum(np.abs(apex), np.abs(section.side - apex))))
    ensemble = Ensemble(
        tuple(one for one, _ in planned.values()),
        tuple(loads[k] for k in planned),
        tuple(histories[k] for k in planned),
        "hertz" if coupling == "hertz" else "auto",
        tuple((annulus * np.arange(int(farthest // annulus) + 2)).tolist()),
        solver_tolerance(relative),
    )
    found: list[LoadSums] = [([], {}, []) for _ in planned]
    for index, pattern in enumerate(_solved(ensemble, patterns, workers=workers, store=store)):
        for (scalars, groups, failures), part in zip(found, pattern, strict=True):
            if isinstance(part, str):
                failures.append(part)
            else:
                scalars.append(part[0])
                groups[index % GROUPS] = groups.get(index % GROUPS, 0.0) + part[1]
        if advance is not None:
            advance()
    averages = {
        k: _average(loads[k], *planned[k], ensemble.edges, one) for k, one in zip(planned, found, strict=True)
    }
    return [
        averages[k] if k in planned else Prediction.failed(load, f"no plan of the effects: {failed[k]}")
        for k, load in enumerate(loads)
    ]


def _solved(
    ensemble: Ensemble, patterns: int, *, workers: int | None, store: PartStore | None
) -> Iterator[list[PatternSums | str]]:
    """The patterns in order, a few in memory at a time."""
    jobs = [(k,) for k in range(patterns)]
    how: dict[str, Any] = {"workers": workers, "lost": partial(_lost, len(ensemble.loads))}
    if store is None:
        return in_parallel(ensemble.solve, jobs, count=patterns, **how)
    common = store.common(["ensemble", ensemble])
    names = [store.name(common, None, k) for k in range(patterns)]
    said = "%s of %s patterns were done by a run that was ended; the others are solved"
    return store.results(ensemble.solve, jobs, names, said=said, **how)


def _lost(loads: int, error: Exception, _index: int) -> list[PatternSums | str]:
    """The failure of a pattern whose workers were ended."""
    return [f"its solution {error}"] * loads


def _average(
    load: Prescribed,
    scene: Scene,
    plan: Plan,
    edges: tuple[float, ...],
    sums: LoadSums,
) -> Prediction:
    """The averages at a load."""
    scalars, groups, failures = sums
    if not scalars:
        return Prediction.failed(load, f"no pattern has a solution; the first: {failures[0]}")
    name, n, values = load_name(load), len(scalars), np.array(scalars)
    area, force, contacts, indentation, borne, gap, _ = values.mean(axis=0).tolist()
    touching, approximate = int(np.sum(values[:, 5] < 0)), int(values[:, 6].sum())
    notes = [f"average over {n:,} random patterns, {contacts:.4g} contacts each", *plan.messages]
    if touching:
        notes.append(f"in {touching:,} of them the planes touch; the load that they carry is left out")
    if approximate:
        notes.append(f"in {approximate:,} of them the solution is approximate only")
    if failures:
        notes.append(f"{len(failures):,} patterns without a solution are left out: {failures[0]}")
    row = {
        "frame": name,
        "status": Status.APPROXIMATE if failures or approximate or touching else Status.OK,
        "load_N": borne if isinstance(load, LoadSpring) else load,
        "area_m2": area,
        "area_std_m2": np.std(values[:, 0], ddof=1) / np.sqrt(n) if n > 1 else np.nan,
        "force_sum_N": force,
        "indentation_m": indentation,
        "min_gap_m": gap,
        "law": law_name(scene),
        "message": "; ".join(notes),
    }
    ends = {"inner": edges[:-1], "outer": edges[1:]}
    places = [pd.DataFrame(ends | dict(zip(MOMENTS, moments.T, strict=True))) for moments in groups.values()]
    model = "uncoupled" if scene_level(scene, "auto") == "none" else "coupled"
    profile = average_profile(places, frame=name, model=model)
    last = int(np.flatnonzero(profile["density_per_m2"].to_numpy() > 0).max(initial=0))
    frames = FRAMES.conform(pd.DataFrame([row]))
    return Prediction(CONTACTS.empty(), frames, PROFILE.conform(profile.iloc[: last + 1]), plan)
