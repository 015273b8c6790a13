"""``contactimg tradeoff``: what accuracy costs in time."""

import click

from contactimg.cli import shared_options as shared
from contactimg.cli.printing import echo_tradeoff, progress
from contactimg.timings import stage


@click.command(short_help="Measure how much computing time accuracy costs.")
@click.argument("scene", type=click.Path(exists=True))
@shared.output("the folder of SCENE")
@shared.load
@click.option(
    "--knob",
    "knobs",
    multiple=True,
    type=click.Choice(["image", "model", "solver", "sums", "rings", "patterns", "supersampling"]),
    help="Measure only this choice; repeat the option for more.  [default: all that apply to the scene]",
)
@click.option(
    "--tolerance",
    type=shared.positive_number,
    help="Relative error, for example 0.01, for which the fastest setting is recommended.  [default: the "
    "scene's]",
)
@click.option("--fine", is_flag=True, help="Measure slow settings too (takes minutes).")
@shared.quiet
@shared.verbose
def tradeoff(
    *,
    scene: str,
    output: str | None,
    load: float | None,
    knobs: tuple[str, ...],
    tolerance: float | None,
    fine: bool,
    quiet: bool,
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
    """
    with stage("loading"):
        from contactimg.cli.scenes import model_inputs, plausible, with_tolerance
        from contactimg.files import OutputFolder, provenance, read_scene
        from contactimg.pipeline.tradeoff import REPETITION_SECONDS, prepare_tradeoff, write_tradeoff
        from contactimg.tradeoff.measure import run_knobs

    description = with_tolerance(plausible(read_scene(scene)), output=None, relative=tolerance)
    chosen, left_out = prepare_tradeoff(description, load=load, knobs=knobs, fine=fine)
    target = shared.output_path(output, description.folder)
    record = provenance(
        command=shared.command_line("tradeoff"),
        scene=description,
        options={"load_N": load, "knobs": list(knobs), "fine": fine},
        inputs=model_inputs(scene, description),
    )
    with OutputFolder(target, record) as out:
        count = sum(len(knob.settings) for knob in chosen)
        with progress("measuring settings", count, quiet=quiet) as advance, stage("settings"):
            result = run_knobs(
                chosen,
                relative=description.tolerance.relative,
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
