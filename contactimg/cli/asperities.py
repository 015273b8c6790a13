"""``contactimg asperities``: from a profilometer's height map to a table of asperities."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from contactimg.cli import shared_options as shared
from contactimg.errors import InputError
from contactimg.timings import stage

if TYPE_CHECKING:
    from contactimg.summits import FoundSummits

ASPERITIES_FILE = "asperities.csv"


@dataclass(frozen=True, kw_only=True)
class MapOptions:
    """What the map is and what counts as a summit."""

    pixel_size_um: float | None
    height_unit: str | None
    form: Literal["plane", "sphere", "none"]
    min_height_um: float
    depth: float


@click.command(short_help="Find the asperities on a profilometer's height map.")
@click.argument("map_file", metavar="MAP", type=shared.existing_file)
@shared.output("the folder of MAP")
@click.option(
    "--pixel-size-um",
    type=shared.positive_number,
    help="Distance between neighbouring heights, in micrometres.  [default: what the file says]",
)
@click.option(
    "--height-unit",
    type=click.Choice(["nm", "um", "mm", "m"]),
    help="Unit of the heights.  [default: what the file says]",
)
@click.option(
    "--form",
    type=click.Choice(["plane", "sphere", "none"]),
    default="plane",
    show_default=True,
    help="What is taken off the heights first: a tilt, a tilt and the sphere of a lens, or nothing.",
)
@click.option(
    "--min-height-um",
    type=shared.non_negative_number,
    default=0.0,
    show_default=True,
    help="Least height of a summit above the base, in micrometres; the noise sets another.",
)
@click.option(
    "--depth",
    type=click.FloatRange(min=0, max=1, min_open=True),
    default=0.5,
    show_default=True,
    help="How far down the sphere is fitted, as a share of the height of the summit.",
)
@shared.quiet
@shared.gather(MapOptions)
def asperities(*, map_file: str, output: str | None, quiet: bool, options: MapOptions) -> int:
    """Find the summits on MAP and write their heights and radii of curvature with uncertainties.

    MAP is a matrix of heights (.npy, or text with one line a row), a TIFF of one channel, or a file of an
    instrument (with the extra `maps`). NaN and empty cells are holes. Writes asperities.csv, which
    [asperities] file in a scene and `analyse --topography` read; x and y count from the centre of the map.

    Exit codes: 0 done, 2 nothing done.

    \b
    Examples:
      contactimg asperities map.npy --pixel-size-um 0.5 --height-unit um -o surface
      contactimg asperities map.sur --form sphere --min-height-um 1
    """
    with stage("loading"):
        from contactimg.files import OutputFolder, provenance, write_table
        from contactimg.files.height_maps import HEIGHT_UNITS, MapScale, read_height_map
        from contactimg.summits import SummitSearch, find_summits
        from contactimg.tables import SUMMITS

    pixel = None if options.pixel_size_um is None else options.pixel_size_um * 1e-6
    unit = None if options.height_unit is None else HEIGHT_UNITS[options.height_unit]
    surface = read_height_map(map_file, MapScale(pixel, unit))
    search = SummitSearch(form=options.form, least_height=options.min_height_um * 1e-6, depth=options.depth)
    found = find_summits(surface, search)
    if found.table.empty:
        raise InputError(
            f"{map_file}: no summit found{_counted(found)}; see --form, --min-height-um, --depth"
        )
    target = shared.output_path(output, Path(map_file).parent)
    record = provenance(
        command=shared.command_line("asperities"), options=vars(options), inputs=[Path(map_file)]
    )
    record |= {"left_out": found.left_out, "noise_m": found.noise, "warnings": found.warnings}
    with OutputFolder(target, record, main_files=[ASPERITIES_FILE]) as out:
        write_table(found.table, SUMMITS, out.folder / ASPERITIES_FILE)
    if not quiet:
        _echo(found, target)
    for warning in found.warnings:
        click.echo(f"contactimg: {warning}", err=True)
    return 0


def _counted(found: "FoundSummits") -> str:
    """What was left out, in brackets."""
    parts = [f"{count} {reason}" for reason, count in found.left_out.items()]
    return f" (left out: {', '.join(parts)})" if parts else ""


def _echo(found: "FoundSummits", target: Path) -> None:
    """Print what was found."""
    table = found.table
    click.echo(f"{len(table)} summits{_counted(found)}; noise of the map {found.noise * 1e9:.3g} nm")
    for name, title in (("height", "heights"), ("radius", "radii of curvature")):
        values, stds = table[f"{name}_m"] * 1e6, table[f"{name}_std_m"] * 1e6
        click.echo(
            f"  {title}: {values.min():.4g} to {values.max():.4g} µm, median {values.median():.4g} µm; "
            f"standard uncertainty {stds.median():.2g} µm (median), {stds.max():.2g} µm (largest)"
        )
    click.echo(f"{ASPERITIES_FILE} in {target}")
