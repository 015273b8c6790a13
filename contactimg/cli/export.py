"""`contactimg export`: a run in the formats of other programs."""

from dataclasses import dataclass

import click

from contactimg.cli import shared_options as shared
from contactimg.cli.printing import progress
from contactimg.timings import stage


@dataclass(frozen=True, kw_only=True)
class Formats:
    """What to write; everything if nothing is chosen."""

    fiji: bool
    napari: bool
    labels: bool
    xlsx: bool

    @property
    def names(self) -> tuple[str, ...]:
        """Those that are chosen."""
        chosen = tuple(name for name, on in vars(self).items() if on)
        return chosen or tuple(vars(self))


@click.command(short_help="Write a run for ImageJ, napari and Excel.")
@click.argument("run", type=shared.existing_folder)
@click.option(
    "-o",
    "--output",
    type=click.Path(file_okay=False),
    help="Folder for the files; created if needed.  [default: export inside RUN]",
)
@click.option(
    "--fiji", is_flag=True, help="ImageJ: regions of each frame (.zip), frames with overlay (.tif)."
)
@click.option("--napari", is_flag=True, help="napari: a shapes and a points layer of each frame (.csv).")
@click.option(
    "--labels", is_flag=True, help="Label images: the pixels of each contact hold its label (.tif)."
)
@click.option("--xlsx", is_flag=True, help="An Excel workbook with one sheet a table.")
@click.option(
    "--units",
    type=click.Choice(["um", "mm", "m"]),
    default="um",
    show_default=True,
    help="Lengths and areas of the workbook; forces are in mN, with m in N.",
)
@shared.quiet
@shared.gather(Formats)
def export(*, run: str, output: str | None, units: str, quiet: bool, options: Formats) -> int:
    """Write RUN, an output folder of `process`, in the formats of ImageJ, napari and Excel.

    Without a choice of formats all of them are written. Regions that were moved, deleted or added in ImageJ
    come back with `contactimg import-rois`.

    \b
    Examples:
      contactimg export results --fiji
      contactimg export results --xlsx --units mm -o for_excel
    """
    with stage("loading"):
        from pathlib import Path

        from contactimg.files import OutputFolder, main_tables, provenance, read_run
        from contactimg.pipeline.export import export_run

    source = read_run(run)
    target = Path(output) if output is not None else Path(run) / "export"
    tables = main_tables([source.folder])
    record = provenance(command=shared.command_line("export"), scene=source.scene, inputs=tables)
    main_files = ["contacts.xlsx"] if "xlsx" in options.names else []
    with OutputFolder(target, record, main_files=main_files) as out:  # noqa: SIM117
        with progress("exporting frames", len(source.frames), quiet=quiet) as advance:
            export_run(source, out.folder, formats=options.names, units=units, advance=advance)
    if not quiet:
        click.echo(f"{', '.join(options.names)} in {target}")
    return 0
