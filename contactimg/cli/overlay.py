"""``contactimg overlay``: measured against predicted contacts on each frame."""

from pathlib import Path

import click

from contactimg.cli import shared_options as shared
from contactimg.cli.printing import echo_scores, progress
from contactimg.timings import stage


@click.command(short_help="Compare measured with predicted contacts, frame by frame.")
@click.argument("run", type=shared.existing_folder)
@shared.output("RUN")
@shared.min_radius("smaller predicted contacts need not be found on the frame")
@shared.workers
@shared.quiet
@shared.verbose
def overlay(*, run: str, output: str | None, min_radius_px: float, workers: int | None, quiet: bool) -> int:
    """Compare the contacts of RUN, an output folder of `process`, with those that the model predicts.

    The contacts are predicted at the load of each frame, once with elastic coupling between the asperities
    and once without.

    Writes scores.csv (precision and recall of each frame and model), matches.csv (pairs of a measured and a
    predicted contact), provenance.json, and a picture of each frame in overlays/: measured contacts blue,
    predicted ones dashed, orange with coupling and yellow without, the Hertz circle of the smooth lens white.

    Exit codes: 0 done, 1 no prediction for some frames (each is named, with the reason), 2 nothing done.

    \b
    Example:
      contactimg overlay results
    """
    with stage("loading"):
        from contactimg.cli.scenes import plausible
        from contactimg.files import OutputFolder, main_tables, open_experiment, provenance, read_run
        from contactimg.pipeline.inputs import need_asperities
        from contactimg.pipeline.overlay import compare_run, draw_comparison, write_comparison

    measured = read_run(run)
    measured.need_pose()
    experiment = open_experiment(plausible(measured.scene))
    asperities = need_asperities(measured.scene, "predicting contacts")
    target = shared.output_path(output, run)
    record = provenance(
        command=shared.command_line("overlay"),
        scene=measured.scene,
        options={"min_radius_px": min_radius_px},
        inputs=[*main_tables([Path(run)]), *experiment.inputs],
    )
    count = len(measured.frames)
    with OutputFolder(target, record, main_files=["scores.csv", "matches.csv"]) as out:
        with progress("predicting contacts", count, quiet=quiet) as advance:
            comparison = compare_run(measured, asperities, min_radius_px=min_radius_px, advance=advance)
        write_comparison(comparison, out.folder)
        out.record["expected_errors"] = {frame: plan.error_record for frame, plan in comparison.plans.items()}
        with progress("drawing overlays", count, quiet=quiet) as advance:
            draw_comparison(
                comparison, measured, experiment, out.folder / "overlays", workers=workers, advance=advance
            )
    if not quiet:
        echo_scores(comparison.scores, title=f"{run}: measured against predicted contacts")
        for frame, plan in comparison.plans.items():
            click.echo(f"{frame}: {plan.sentence()}")
        click.echo(f"results in {target}")
    for frame, reason in comparison.left_out.items():
        click.echo(f"contactimg: {frame}: no prediction, {reason}", err=True)
    return 1 if comparison.left_out else 0
