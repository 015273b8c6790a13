"""Commands on a scene alone: `predict`, `simulate`, `effects` and `tradeoff`; `selftest` of the models."""

from typing import Annotated, Literal

import click

from contactimg import files, pipeline, plots, tables
from contactimg.cli import options as shared
from contactimg.cli.printing import echo_frames, echo_plan, echo_table, echo_tradeoff, say
from contactimg.cli.scenes import scene_at
from contactimg.scene import Effects

TOLERANCE = "--tolerance", "tolerance", "relative"

# --- predict


@shared.command(
    shared.SceneOption(*TOLERANCE, "Effects and coupling are the cheapest that meet it."),
    shared.NO_PLAUSIBILITY,
    shared.ONE_WORKER,
    shared.CLUSTER,
)
def predict(
    scene: shared.Existing,
    *,
    stated: shared.Stated,
    loads: Annotated[tuple[float, ...], "--load-N"] = (),
    touching_load: bool = False,
    output: shared.Output = None,
    model: Literal["interacting", "gw", "gt"] = "interacting",
    coupling: Literal["auto", "none", "asymptotic", "hertz", "full"] = "auto",
    annulus_mm: shared.Annulus = 0.25,
) -> int:
    """Predict the contacts of SCENE, a scene.toml or the folder that holds one, at each load.

    For each load a plan decides which mechanical effects are computed (see `contactimg effects`).

    Writes contacts.csv (one row per predicted contact), frames.csv (one row per load), profile.csv (pressure
    against distance from the apex) and provenance.json with the plans.

    Exit codes: 0 done, 1 no solution at some of the loads (frames.csv says why), 2 nothing done.

    \b
    Examples:
      contactimg predict sample_data/sa_plus --load-N 0.1 --load-N 0.5 -o coupled
      contactimg predict sample_data/sa_plus --load-N 0.5 --model gt -o averages
      contactimg predict sample_data/sa_plus --load-N 0.5 --tolerance 0.05 -o quick
      contactimg predict sample_data/ra_plus --touching-load -o limit

    Parameters
    ----------
    loads
        Normal load in newtons; repeat the option for more loads.
    touching_load
        Also predict at the load at which the base planes of lens and rubber touch first, and print it.
    model
        interacting: every asperity of the table. gw, gt: the averages of Greenwood and Williamson, or of
        Greenwood and Tripp.
    coupling
        Elastic coupling between the asperities. auto: as the plan of the effects decides. Any other level:
        the paper's model with this coupling; other effects only where the scene switches them on.
    """
    from contactimg.prediction import find_touching_load

    described, inputs = scene_at(scene, stated)
    touching = {}
    if touching_load:
        surface = pipeline.scene_asperities(described)
        if model == "interacting":
            surface = pipeline.need_asperities(described, "predicting contacts")
        planes_touch_at = find_touching_load(described, surface, model=model, coupling=coupling)
        loads = (*loads, *([planes_touch_at] if planes_touch_at > 0 else []))
        touching = {"touching_load_N": planes_touch_at}
        say(f"the base planes touch from {planes_touch_at:.4g} N on")
    with shared.results_in(output, described.folder, described, inputs, main_files=files.RUN_TABLES) as out:
        predictions = pipeline.predict_loads(
            described, loads, model=model, coupling=coupling, annulus=annulus_mm * 1e-3
        )
        frames, record = pipeline.write_predictions(predictions, described, out.folder)
        out.record |= record | touching
        level = f", coupling {coupling}" if model == "interacting" else ""
        echo_frames(frames, title=f"{scene}, model {model}{level}")
        say(*map(pipeline.choice_sentence, predictions))
    return int((frames["status"] == tables.FAILED).any())


# --- simulate


@shared.command(shared.NO_PLAUSIBILITY, shared.ONE_WORKER, shared.CLUSTER)
def simulate(scene: shared.Existing, *, output: shared.Output = None) -> None:
    """Make synthetic frames of SCENE, a scene.toml or the folder that holds one.

    The section [simulate] of the scene describes loads, optics and sensor. Without a section [asperities] the
    rubber is smooth, and each frame shows one circular JKR contact (input for `contactimg calibrate jkr`).

    Optics and sensor are rendered as [simulate] states them, unless [effects] switches them off. A mechanical
    effect that is "auto" is computed if leaving it out would change an output that [tolerance] requests by
    more than allowed there; `contactimg effects SCENE` prints the numbers.

    Writes reference.tif, frame_*.tif, loads.csv, asperities.csv, truth.csv (the contacts.csv that a perfect
    measurement would give), provenance.json and scene.toml, which says for each effect whether the frames
    show it. `contactimg process` reads this folder as it is.

    Exit codes: 0 done, 2 nothing done.

    \b
    Examples:
      contactimg simulate scene.toml -o frames
      contactimg process frames
    """
    from contactimg.prediction import load_name

    described, inputs = scene_at(scene, {})
    smooth = described.asperities is None
    asperities = None if smooth else pipeline.need_asperities(described, "simulating frames")
    count = len(described.need("simulate", "simulating frames").loads)
    planned, plans = pipeline.plan_simulation(described, asperities)
    main_files = ["truth.csv", "scene.toml"]
    with shared.results_in(output, described.folder, described, inputs, main_files=main_files) as out:
        out.record["plans"] = {load_name(plan.load): plan.record for plan in plans}
        out.record["expected_errors"] = {load_name(plan.load): plan.error_record for plan in plans}
        switches = planned.effects.switches()
        out.record["effects"] = switches
        pipeline.write_simulation(planned, asperities, out.folder)
        shown, left_out = ([one for one, switch in switches.items() if switch == on] for on in ("on", "off"))
        sensor = {"shot_noise", "read_noise", "quantisation"} <= set(left_out)
        ideal = "; the frames are floating-point numbers without noise" if sensor else ""
        said = f"computed: {', '.join(shown) or 'none'}; left out: {', '.join(left_out) or 'none'}{ideal}"
        say(*(plan.sentence() for plan in plans), said)
        say(f"{count} frames and the true contacts")


# --- effects


@shared.command(
    shared.SceneOption(*TOLERANCE),
    shared.SceneOption("--output", "tolerance", "output"),
    shared.NO_PLAUSIBILITY,
)
def effects(
    scene: shared.Existing,
    *,
    stated: shared.Stated,
    load: shared.Load = None,
    auto: bool = False,
    folder: Annotated[str | None, click.Path(file_okay=False), "-o"] = None,
) -> None:
    """Decide which physical effects matter for SCENE, a scene.toml or the folder that holds one.

    Prints for each effect of the mechanics, the optics and the sensor: the number that decides, whether it is
    computed, and the relative change of the output if it were left out. All effects that are left out change
    the output together by less than the tolerance. Effects that the section [effects] of the scene switches
    "on" or "off" stay so, unless --auto.

    Writes nothing, unless -o names a folder: then effects.csv and provenance.json.

    Exit codes: 0 done, 2 nothing done.

    \b
    Examples:
      contactimg effects sample_data/sa_plus --auto
      contactimg effects sample_data/sa_plus --output force --tolerance 0.0001 -o plan

    Parameters
    ----------
    auto
        Let the plan decide on every effect, whatever [effects] of the scene says.
    folder
        Folder for effects.csv; without it nothing is written.
    """
    described, inputs = scene_at(scene, stated)
    if auto:
        described = described.model_copy(update={"effects": Effects()})
    plan = pipeline.plan_effects(described, load=load)
    echo_plan(plan, title=f"{scene} at {plan.load:g} N: {plan.output} to {100 * plan.relative:g} %")
    if folder is not None:
        with shared.results_in(folder, described.folder, described, inputs) as out:
            files.write_table(plan.table(), tables.EFFECTS, out.folder / "effects.csv")


# --- tradeoff

Knob = Literal["image", "model"]


@shared.command(
    shared.SceneOption(*TOLERANCE, "The fastest setting that meets it is recommended."),
    shared.NO_PLAUSIBILITY,
)
def tradeoff(
    scene: shared.Existing,
    *,
    stated: shared.Stated,
    output: shared.Output = None,
    load: shared.Load = None,
    knobs: Annotated[tuple[Knob, ...], "--knob"] = (),
) -> None:
    """Measure how much computing time accuracy costs for SCENE, a scene.toml or the folder that holds one.

    Each choice is run with several settings, in turn, and the results are compared with a converged one. The
    choices are: image (method that measures a frame) and model (contact model). The result that must be
    accurate is "output" in the section [tolerance] of the scene.

    Writes tradeoff.csv (one row per setting: error and time), tradeoff.png (.svg, .pdf) and provenance.json.

    Exit codes: 0 done, 2 nothing done.

    \b
    Examples:
      contactimg tradeoff sample_data/sa_plus -o tradeoff
      contactimg tradeoff sample_data/sa_plus --knob model --load-N 0.1 -o tradeoff

    Parameters
    ----------
    knobs
        Measure only this choice; repeat the option for more.  [default: all that apply to the scene]
    """
    described, inputs = scene_at(scene, stated)
    with shared.results_in(output, described.folder, described, inputs) as out:
        result = pipeline.measure_tradeoff(described, load=load, knobs=knobs)
        ax = plots.plot_tradeoff(result.table, relative=result.relative)
        pipeline.write_results(out.folder, [(tables.TRADEOFF, result.table)], {"tradeoff": ax})
        out.record["sentences"] = result.sentences
        echo_tradeoff(result.table)
        say(*result.sentences.values(), *(f"{knob}: {reason}" for knob, reason in result.left_out.items()))


# --- selftest


@shared.command()
def selftest() -> int:
    """Solve numerically hard contact problems and compare each with what is known of its answer.

    Among them an adhesive contact near pull-off, caps that nearly touch or stand at one place, a thin layer
    and a pattern of 1845 asperities. The truth is a closed form, the equations summed one by one, or a stored
    solution of the whole contact problem. Takes seconds, the first time about a minute; writes nothing.

    Exit codes: 0 every case holds, 1 one does not.

    \b
    Example:
      contactimg selftest
    """
    from contactimg.models.hard_cases import CASES, run_cases

    table = run_cases(CASES)
    shown = table.assign(
        answer=table["said"].str[:60],  # of a refusal so much that a row stays a line
        verdict=table["passed"].map({True: "", False: "FAILS"}),
        allowed=table["allowed"].where(table["truth"] != ""),
    )[["case", "answer", "verdict", "residual", "error", "allowed", "truth"]]
    forms = {"residual": ".1g", "error": ".2g", "allowed": ".2g"}
    echo_table("hard cases", shown, left=3, forms=forms)
    failed = int((~table["passed"]).sum())
    say(f"{len(table) - failed} of {len(table)} hold" + (f", {failed} do not" if failed else ""))
    return int(failed > 0)
