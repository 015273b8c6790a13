"""``contactimg tradeoff``: what accuracy costs in time."""

from pathlib import Path

import click

from contactimg.cli.common import (
    command_line,
    echo_tradeoff,
    output_option,
    progress,
    quiet_option,
    verbose_option,
)
from contactimg.timings import stage


@click.command(short_help="What accuracy costs in time: table and figure.")
@click.argument("scene", type=click.Path(exists=True))
@output_option
@click.option("--load-N", "load", type=float, help="Load, N.  [default: the largest of the scene]")
@click.option(
    "--knob",
    "knobs",
    multiple=True,
    type=click.Choice(["image", "model", "solver", "sums", "rings", "patterns", "supersampling"]),
    help="Only this choice; repeatable.  [default: all that apply]",
)
@click.option(
    "--tolerance",
    type=click.FloatRange(min=0, min_open=True),
    help="Relative error that the sentences are for.  [default: the scene's]",
)
@click.option("--fine", is_flag=True, help="Slow settings too.")
@quiet_option
@verbose_option
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
    """Show what accuracy costs in time for SCENE, a scene.toml or the folder that holds one.

    Runs the settings of each choice by turns and compares their answers with a converged one: how a frame is
    measured, the contact model, the solver's tolerance, sums over many contacts, rings of Greenwood-Tripp,
    patterns of an ensemble, sampling of rendered frames. What must be accurate is [tolerance] output of the
    scene. Writes tradeoff.csv, tradeoff.png and tradeoff.svg.

    \b
    Examples:
      contactimg tradeoff sample_data/sa_plus -o tradeoff
      contactimg tradeoff sample_data/sa_plus --knob model --load-N 0.1 -o tradeoff
    """
    with stage("loading"):
        from contactimg.cli.scenes import model_inputs, with_tolerance
        from contactimg.files import OutputFolder, provenance, read_scene
        from contactimg.pipeline.tradeoff import SECONDS, pose_tradeoff, write_tradeoff
        from contactimg.tradeoff.measure import run_knobs

    description = with_tolerance(read_scene(scene), output=None, relative=tolerance)
    chosen, left_out = pose_tradeoff(description, load=load, knobs=knobs, fine=fine)
    target = Path(output) if output is not None else Path(description.folder) / "contactimg_out"
    record = provenance(
        command=command_line("tradeoff"),
        scene=description,
        options={"load_N": load, "knobs": list(knobs), "fine": fine},
        inputs=model_inputs(scene, description),
    )
    with OutputFolder(target, record) as out:
        count = sum(len(knob.settings) for knob in chosen)
        with progress("trying settings", count, quiet=quiet) as advance, stage("settings"):
            found = run_knobs(
                chosen,
                relative=description.tolerance.relative,
                seconds=SECONDS[fine],
                left_out=left_out,
                advance=advance,
            )
        write_tradeoff(found, out.folder)
        out.record["sentences"] = found.sentences
    if not quiet:
        echo_tradeoff(found.table)
        for sentence in found.sentences.values():
            click.echo(sentence)
        for name, reason in left_out.items():
            click.echo(f"{name}: {reason}")
        click.echo(f"results in {target}")
