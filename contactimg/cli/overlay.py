"""``contactimg overlay``: predicted and measured contacts on each frame."""

from pathlib import Path

import click

from contactimg.cli.common import (
    command_line,
    echo_scores,
    output_option,
    progress,
    quiet_option,
    verbose_option,
    workers_option,
)
from contactimg.timings import stage


@click.command(short_help="Predicted and measured contacts on each frame, with scores.")
@click.argument("run", type=click.Path(exists=True, file_okay=False))
@output_option
@click.option(
    "--min-radius-px",
    type=float,
    default=1.0,
    show_default=True,
    help="Smaller predicted contacts are not expected to be seen.",
)
@workers_option
@quiet_option
@verbose_option
def overlay(*, run: str, output: str | None, min_radius_px: float, workers: int | None, quiet: bool) -> int:
    """Compare RUN, the output of `process`, with what the model predicts, coupled and uncoupled.

    Writes a picture of each frame with a load (measured contacts blue, predicted ones green with coupling and
    red without, the Hertz circle of the smooth sphere dashed white), matches.csv and scores.csv.

    \b
    Example:
      contactimg overlay results
    """
    with stage("loading"):
        from contactimg.files import OutputFolder, open_experiment, provenance, read_run
        from contactimg.pipeline.inputs import need_asperities
        from contactimg.pipeline.overlay import compare_run, draw_comparison, write_comparison
        from contactimg.pipeline.run import run_of_folder

    measured = run_of_folder(read_run(run))
    experiment = open_experiment(measured.scene)
    asperities = need_asperities(measured.scene, "predicting contacts")
    target = Path(output) if output is not None else Path(run) / "contactimg_out"
    record = provenance(
        command=command_line("overlay"),
        scene=measured.scene,
        options={"min_radius_px": min_radius_px},
        inputs=[*(Path(run) / name for name in ("contacts.csv", "frames.csv")), *experiment.inputs],
    )
    count = len(measured.frames)
    with OutputFolder(target, record, main_files=["scores.csv", "matches.csv"]) as out:
        with progress("predicting contacts", count, quiet=quiet) as advance:
            comparison = compare_run(measured, asperities, min_radius_px=min_radius_px, advance=advance)
        write_comparison(comparison, out.folder)
        with progress("drawing overlays", count, quiet=quiet) as advance:
            draw_comparison(
                comparison, measured, experiment, out.folder / "overlays", workers=workers, advance=advance
            )
    if not quiet:
        echo_scores(comparison.scores, title=f"{run}: predicted against measured contacts")
        click.echo(f"results in {target}")
    for frame, reason in comparison.left_out.items():
        click.echo(f"contactimg: {frame}: no prediction, {reason}", err=True)
    return 1 if comparison.left_out else 0
