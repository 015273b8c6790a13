"""``contactimg report``: one self-contained HTML page of a run."""

from pathlib import Path

import click

from contactimg.cli.common import quiet_option
from contactimg.timings import stage

folder = click.Path(exists=True, file_okay=False)


@click.command(short_help="One self-contained HTML page of a run.")
@click.argument("run", type=folder)
@click.option("-o", "--output", type=click.Path(dir_okay=False), help="The page.  [default: RUN/report.html]")
@click.option("--with", "others", type=folder, multiple=True, help="Output of overlay, analyse or calibrate.")
@click.option(
    "--max-pictures",
    type=click.IntRange(min=1),
    default=40,
    show_default=True,
    help="Most frames shown; of more, as many evenly chosen.",
)
@quiet_option
def report(*, run: str, output: str | None, others: tuple[str, ...], max_pictures: int, quiet: bool) -> None:
    """Write a page on RUN, the output of `process`, that needs no network and no other file.

    Summary, A(P), overlays that one can zoom, flags, failed frames and provenance; scores, analysis and
    calibration from folders inside RUN or named by --with.

    \b
    Examples:
      contactimg report results
      contactimg report results --with analysis --with jkr -o run.html
    """
    with stage("loading"):
        from contactimg.files import write_text
        from contactimg.report import build_report

    target = Path(output) if output is not None else Path(run) / "report.html"
    write_text(build_report(run, others=others, max_pictures=max_pictures), target)
    if not quiet:
        click.echo(f"page in {target}")
