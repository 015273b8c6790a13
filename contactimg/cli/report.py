"""``contactimg report``: one self-contained HTML page of a run."""

from pathlib import Path

import click

from contactimg.cli import shared_options as shared
from contactimg.timings import stage


@click.command(short_help="Write one self-contained HTML page about a run.")
@click.argument("run", type=shared.existing_folder)
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False),
    help="HTML file to write.  [default: report.html in RUN]",
)
@click.option(
    "--with",
    "others",
    type=shared.existing_folder,
    multiple=True,
    help="Include this output folder of overlay, analyse or calibrate; repeat the option for more. Those "
    "inside RUN are included anyway.",
)
@click.option(
    "--max-pictures",
    type=click.IntRange(min=1),
    default=40,
    show_default=True,
    help="Largest number of frames to show; of a longer series, evenly spaced ones.",
)
@shared.quiet
def report(*, run: str, output: str | None, others: tuple[str, ...], max_pictures: int, quiet: bool) -> None:
    """Write an HTML page about RUN, an output folder of `process`, that needs no network and no other file.

    It shows the summary of the run, contact area against load, the overlays (with zoom), the flags, failed
    frames and the provenance; scores, analysis and calibration from folders inside RUN or named by --with.

    Exit codes: 0 done, 2 nothing done.

    \b
    Examples:
      contactimg report results
      contactimg report results --with analysis --with jkr -o run.html
    """
    with stage("loading"):
        from contactimg.files import remove_leftovers, write_text
        from contactimg.report import build_report

    target = Path(output) if output is not None else Path(run) / "report.html"
    remove_leftovers(target)
    write_text(build_report(run, others=others, max_pictures=max_pictures), target)
    if not quiet:
        click.echo(f"report in {target}")
