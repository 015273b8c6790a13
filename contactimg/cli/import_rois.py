"""`contactimg import-rois`: what was changed in ImageJ comes back as edits.csv."""

import click

from contactimg.cli import shared_options as shared
from contactimg.timings import stage


@click.command("import-rois", short_help="Bring regions corrected in ImageJ back as edits.csv.")
@click.argument("run", type=shared.existing_folder)
@click.argument("file", type=shared.existing_file)
@click.option("--frame", help="The frame that the regions belong to.  [default: as the name of FILE says]")
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False),
    help="Table of edits; rows are added to what is there.  [default: the one that the scene of RUN uses, "
    "edits.csv beside the frames]",
)
@click.option("--author", default="", help="For the column author.")
@shared.quiet
def import_rois(
    *, run: str, file: str, frame: str | None, output: str | None, author: str, quiet: bool
) -> int:
    """Compare the ImageJ regions in FILE with the contacts of RUN and write the changes to edits.csv.

    FILE is what `contactimg export --fiji` wrote for one frame and ImageJ saved again (ROI Manager, Save). A
    region that was deleted excludes its contact, a new one adds a contact, a moved one does both. Then run
    `contactimg process` again: it measures the contacts from the pixels.

    \b
    Examples:
      contactimg import-rois results results/export/fiji/frame_1.tif.zip
      contactimg process my_frames
    """
    with stage("loading"):
        from datetime import UTC, datetime
        from pathlib import Path

        import pandas as pd

        from contactimg.files import edits_file, read_edits, read_run, write_edits
        from contactimg.pipeline.export import edits_from_regions

    source = read_run(run)
    time = datetime.now(UTC).isoformat(timespec="seconds")
    edits = edits_from_regions(source, Path(file), frame=frame, author=author, time=time)
    target = Path(output) if output is not None else edits_file(source.scene, source.folder)
    if len(edits):
        present = [read_edits(target)] if target.is_file() else []
        write_edits(pd.concat([*present, edits], ignore_index=True), target)
    if not quiet:
        counts = edits["action"].value_counts()
        told = ", ".join(f"{counts.get(action, 0)} {action}" for action in ("exclude", "add"))
        click.echo(
            f"{told} in {target}; run `contactimg process` again" if len(edits) else "nothing was changed"
        )
    return 0
