"""Commands on a scene alone: `predict`, `simulate`, `effects` and `tradeoff`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import click

from contactimg.cli import options as shared
from contactimg.cli.options import (
    Annulus,
    Count,
    Existing,
    Load,
    OneWorker,
    Output,
    Quiet,
    SceneOption,
    Stated,
    scene_options,
)
from contactimg.cli.printing import echo_frames, echo_plan, echo_tradeoff, progress
from contactimg.timings import stage

if TYPE_CHECKING:
    from contactimg.scene import Scene

# --- predict


@shared.command()
@scene_options(
    SceneOption(
        "--tolerance",
        "tolerance",
        "relative",
        "Effects, coupling and solver accuracy are the cheapest that meet it.",
        default="the scene's tolerance for the effects, rounding error for the solver",
    )
)
@shared.no_plausibility
@shared.cluster
@shared.verbose
def predict(
    scene: Existing,
    *,
    stated: Stated,
    loads: Annotated[tuple[float, ...], "--load-N"] = (),
    displacements_um: Annotated[tuple[float, ...], "--displacement-um"] = (),
    output: Output = None,
    model: Literal["interacting", "gw", "gt"] = "interacting",
    coupling: Literal["auto", "none", "asymptotic", "hertz", "full"] = "auto",
    patterns: Count | None = None,
    annulus_mm: Annulus = 0.25,
    workers: OneWorker = 1,
    quiet: Quiet = False,
) -> int:
    """Predict the contacts of SCENE, a scene.toml or the folder that holds one, at each load or displacement.

    For each load a plan decides which mechanical effects are computed (see `contactimg effects`).

    Writes contacts.csv (one row per predicted contact), frames.csv (one row per load), profile.csv (pressure
    against distance from the apex) and provenance.json with the plans.

    Exit codes: 0 done, 1 no solution at some of the loads (frames.csv says why), 2 nothing done.

    \b
    Examples:
      contactimg predict sample_data/sa_plus --load-N 0.1 --load-N 0.5 -o coupled
      contactimg predict sample_data/sa_plus --load-N 0.5 --model gt -o averages
      contactimg predict sample_data/sa_plus --load-N 0.5 --tolerance 0.05 -o quick
      contactimg predict ensemble --load-N 0.05 --patterns 8000 --workers 4 -o average

    Parameters
    ----------
    loads
        Normal load in newtons; repeat the option for more loads.
    displacements_um
        Displacement of the stage from first touch, um, instead of a load: the indentation, or with [load]
        stiffness_N_m in the scene what a load cell of this stiffness leaves of it. Can be repeated.
    model
        interacting: every asperity of the table. gw, gt: the averages of Greenwood and Williamson, or of
        Greenwood and Tripp.
    coupling
        Elastic coupling between the asperities. auto: as the plan of the effects decides. Any other level:
        the paper's model with this coupling; other effects only where the scene switches them on.
    patterns
        Average over this many random patterns like the one that [asperities] generates. A run that is ended
        goes on when it is started again.
    """
    with stage("loading"):
        from contactimg.cli.scenes import model_inputs, scene_at
        from contactimg.errors import InputError
        from contactimg.files import RUN_TABLES
        from contactimg.pipeline.ensemble import Calls, predict_ensemble
        from contactimg.pipeline.predict import (
            choice_sentence,
            error_records,
            plan_records,
            predict_loads,
            prescriptions,
            refuse_repeated,
            solver_tolerance,
            write_predictions,
        )
        from contactimg.tables import FAILED

    if patterns is not None and model != "interacting":
        raise InputError(f'model "{model}" is an average over patterns itself; leave out --patterns')
    described = scene_at(scene, stated)
    relative = stated.get("tolerance", {}).get("relative")
    target = shared.output_path(output, described.folder)
    options = {"model": model, "coupling": coupling, "tolerance": relative, "annulus_mm": annulus_mm}
    options |= {"loads_N": list(loads), "displacements_um": list(displacements_um), "patterns": patterns}
    inputs = model_inputs(scene, described)
    prescribed = prescriptions(described, loads, [displacement / 1e6 for displacement in displacements_um])
    settings: dict[str, Any] = {"coupling": coupling, "annulus": annulus_mm * 1e-3}
    with shared.results_in(
        target, scene=described, options=options, inputs=inputs, main_files=RUN_TABLES
    ) as out:
        if patterns is None:
            settings |= {"model": model, "relative": relative, "workers": workers}
            predictions = predict_loads(described, prescribed, **settings)
        else:
            refuse_repeated(prescribed)
            settings |= {"tolerance": None if relative is None else solver_tolerance(relative)}
            with progress("solving patterns", patterns, quiet=quiet) as advance:
                settings |= {"calls": Calls(workers, out.frame_store(), advance)}
                predictions = predict_ensemble(described, prescribed, patterns=patterns, **settings)
        frames = write_predictions(predictions, described, out.folder)
        out.record["plans"] = plan_records(predictions)
        out.record["expected_errors"] = error_records(predictions)
    if not quiet:
        level = f", coupling {coupling}" if model == "interacting" else ""
        many = f", {patterns:,} patterns" if patterns else ""
        echo_frames(frames, title=f"{scene}, model {model}{level}{many}")
        for prediction in predictions:
            if prediction.plan is not None:
                click.echo(choice_sentence(prediction, relative=relative))
        click.echo(f"results in {target}")
    return int((frames["status"] == FAILED).any())


# --- simulate


@shared.command()
@shared.no_plausibility
@shared.cluster
@shared.verbose
def simulate(
    scene: Existing,
    *,
    output: Output = None,
    optics: Annotated[bool, "--plan"] = False,
    workers: OneWorker = 1,
    quiet: Quiet = False,
) -> None:
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

    Parameters
    ----------
    optics
        Render an effect of optics or sensor only if leaving it out would change a requested output by more
        than allowed, instead of all that [simulate] states.
    """
    with stage("loading"):
        from contactimg.cli.scenes import model_inputs, scene_at
        from contactimg.pipeline.inputs import need_asperities
        from contactimg.pipeline.simulate import plan_simulation, write_simulation
        from contactimg.prediction import load_name

    described = scene_at(scene, {})
    smooth = described.asperities is None
    asperities = None if smooth else need_asperities(described, "simulating frames")
    target = shared.output_path(output, described.folder)
    count = 1 + len(described.need("simulate", "simulating frames").loads)
    planned = plan_simulation(described, asperities, optics=optics)
    inputs = model_inputs(scene, described)
    with (
        shared.results_in(
            target, scene=described, inputs=inputs, main_files=["truth.csv", "scene.toml"]
        ) as out,
        progress("making frames", count, quiet=quiet) as advance,
    ):
        out.record["plans"] = {load_name(plan.load): plan.record for plan in planned.plans}
        out.record["expected_errors"] = {load_name(plan.load): plan.error_record for plan in planned.plans}
        out.record["effects"] = planned.scene.effects.switches()
        write_simulation(planned.scene, asperities, out.folder, workers=workers, advance=advance)
    if not quiet:
        for plan in planned.plans:
            click.echo(plan.sentence())
        click.echo(_shown(planned.scene))
        click.echo(f"{count - 1} frames and the true contacts in {target}")


def _shown(scene: "Scene") -> str:
    """One line: which effects the frames show and which were left out."""
    switches = scene.effects.switches()
    shown, left_out = ([name for name, switch in switches.items() if switch == on] for on in ("on", "off"))
    sensor = {"shot_noise", "read_noise", "quantisation"}
    ideal = "; the frames are floating-point numbers without noise" if sensor <= set(left_out) else ""
    return f"computed: {', '.join(shown) or 'none'}; left out: {', '.join(left_out) or 'none'}{ideal}"


# --- effects


@shared.command()
@scene_options(
    SceneOption("--tolerance", "tolerance", "relative"), SceneOption("--output", "tolerance", "output")
)
@shared.no_plausibility
@shared.verbose
def effects(
    scene: Existing,
    *,
    stated: Stated,
    load: Load = None,
    folder: Annotated[str | None, click.Path(file_okay=False), "-o"] = None,
    quiet: Quiet = False,
) -> None:
    """Decide which physical effects matter for SCENE, a scene.toml or the folder that holds one.

    Prints for each effect of the mechanics, the optics and the sensor: the relative change of the output if
    it were left out, whether it is computed, and how much longer the computation takes with it. All effects
    that are left out change the output together by less than the tolerance. Effects that the section
    [effects] of the scene switches "on" or "off" stay so.

    Writes nothing, unless -o names a folder: then effects.csv and provenance.json.

    Exit codes: 0 done, 2 nothing done.

    \b
    Examples:
      contactimg effects sample_data/sa_plus --load-N 0.5
      contactimg effects sample_data/sa_plus --output force --tolerance 0.0001 -o plan

    Parameters
    ----------
    folder
        Folder for effects.csv; without it nothing is written.
    """
    with stage("loading"):
        from contactimg.cli.scenes import model_inputs, scene_at
        from contactimg.files import write_table
        from contactimg.pipeline.effects import plan_effects
        from contactimg.tables import EFFECTS

    described = scene_at(scene, stated)
    plan = plan_effects(described, load=load)
    if folder is not None:
        inputs = model_inputs(scene, described)
        with shared.results_in(Path(folder), scene=described, inputs=inputs) as out:
            write_table(plan.table(), EFFECTS, out.folder / "effects.csv")
    if not quiet:
        echo_plan(plan, title=f"{scene} at {plan.load:g} N: {plan.output} to {100 * plan.relative:g} %")
        if folder is not None:
            click.echo(f"results in {folder}")


# --- tradeoff

Knob = Literal["image", "model", "solver", "sums", "rings", "patterns", "supersampling"]


@shared.command()
@scene_options(
    SceneOption("--tolerance", "tolerance", "relative", "The fastest setting that meets it is recommended.")
)
@shared.no_plausibility
@shared.verbose
def tradeoff(
    scene: Existing,
    *,
    stated: Stated,
    output: Output = None,
    load: Load = None,
    knobs: Annotated[tuple[Knob, ...], "--knob"] = (),
    fine: bool = False,
    quiet: Quiet = False,
) -> None:
    """Measure how much computing time accuracy costs for SCENE, a scene.toml or the folder that holds one.

    Each choice is run with several settings, in turn, and the results are compared with a converged one. The
    choices are: image (method that measures a frame), model (contact model), solver (its tolerance), sums
    (accuracy of sums over many contacts), rings (of the Greenwood-Tripp model), patterns (number of random
    surfaces that are averaged), supersampling (of rendered frames). The result that must be accurate is
    "output" in the section [tolerance] of the scene.

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
    fine
        Measure slow settings too (takes minutes).
    """
    with stage("loading"):
        from contactimg.cli.scenes import model_inputs, scene_at
        from contactimg.pipeline.tradeoff import REPETITION_SECONDS, prepare_tradeoff, write_tradeoff
        from contactimg.tradeoff.measure import run_knobs

    described = scene_at(scene, stated)
    chosen, left_out = prepare_tradeoff(described, load=load, knobs=knobs, fine=fine)
    target = shared.output_path(output, described.folder)
    options = {"load_N": load, "knobs": list(knobs), "fine": fine}
    inputs = model_inputs(scene, described)
    with shared.results_in(target, scene=described, options=options, inputs=inputs) as out:
        count = sum(len(knob.settings) for knob in chosen)
        with progress("measuring settings", count, quiet=quiet) as advance, stage("settings"):
            result = run_knobs(
                chosen,
                relative=described.tolerance.relative,
                seconds=REPETITION_SECONDS[fine],
                left_out=left_out,
                advance=advance,
            )
        write_tradeoff(result, out.folder)
        out.record["sentences"] = result.sentences
    if not quiet:
        echo_tradeoff(result.table)
        for sentence in result.sentences.values():
            click.echo(sentence)
        for knob, reason in left_out.items():
            click.echo(f"{knob}: {reason}")
        click.echo(f"results in {target}")
