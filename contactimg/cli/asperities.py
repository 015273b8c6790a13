"""``contactimg asperities``: from a profilometer's height map to a table of asperities."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import click

from contactimg import files, tables
from contactimg.cli import options as shared
from contactimg.cli.printing import say
from contactimg.errors import InputError

if TYPE_CHECKING:
    from contactimg.summits import FoundSummits

ASPERITIES_FILE = "asperities.csv"


@shared.command()
def asperities(
    map_file: Annotated[shared.ExistingFile, "MAP"],
    *,
    output: shared.Output = None,
    pixel_size_um: shared.Positive | None = None,
    height_unit: Literal["nm", "um", "mm", "m"] | None = None,
    form: Literal["plane", "sphere", "none"] = "plane",
    min_height_um: shared.NonNegative = 0.0,
    depth: Annotated[float, click.FloatRange(min=0, max=1, min_open=True)] = 0.5,
) -> int:
    """Find the summits on MAP and write their heights and radii of curvature with uncertainties.

    MAP is a matrix of heights (.npy, or text with one line a row), or a TIFF of one channel. NaN and empty
    cells are holes. Writes asperities.csv, which [asperities] file in a scene reads; x and y count from the
    centre of the map.

    Exit codes: 0 done, 2 nothing done.

    \b
    Examples:
      contactimg asperities map.npy --pixel-size-um 0.5 --height-unit um -o surface
      contactimg asperities map.tif --height-unit um --form sphere --min-height-um 1

    Parameters
    ----------
    pixel_size_um
        Distance between neighbouring heights, in micrometres.  [default: what the file says]
    height_unit
        Unit of the heights.
    form
        What is taken off the heights first: a tilt, a tilt and the sphere of a lens, or nothing.
    min_height_um
        Least height of a summit above the base, in micrometres; the noise sets another.
    depth
        How far down the sphere is fitted, as a share of the height of the summit.
    """
    from contactimg.summits import SummitSearch, find_summits

    pixel = None if pixel_size_um is None else pixel_size_um * 1e-6
    unit = None if height_unit is None else files.METRES[height_unit]
    surface = files.read_height_map(map_file, pixel_size=pixel, height_unit=unit)
    found = find_summits(surface, SummitSearch(form=form, least_height=min_height_um * 1e-6, depth=depth))
    if found.table.empty:
        raise InputError(
            f"{map_file}: no summit found{_counted(found)}; see --form, --min-height-um, --depth"
        )
    file = Path(map_file)
    with shared.results_in(output, file.parent, None, [file], main_files=[ASPERITIES_FILE]) as out:
        out.record |= {"left_out": found.left_out, "noise_m": found.noise, "warnings": found.warnings}
        files.write_table(found.table, tables.SUMMITS, out.folder / ASPERITIES_FILE)
        _echo(found)
    for warning in found.warnings:
        click.echo(f"contactimg: {warning}", err=True)
    return 0


def _counted(found: "FoundSummits") -> str:
    """The sentence part on summits that were left out, in brackets."""
    parts = [f"{count} {reason}" for reason, count in found.left_out.items()]
    return f" (left out: {', '.join(parts)})" if parts else ""


def _echo(found: "FoundSummits") -> None:
    """Print what was found."""
    table = found.table
    say(f"{len(table)} summits{_counted(found)}; noise of the map {found.noise * 1e9:.3g} nm")
    for name, title in (("height", "heights"), ("radius", "radii of curvature")):
        values, stds = table[f"{name}_m"] * 1e6, table[f"{name}_std_m"] * 1e6
        say(
            f"  {title}: {values.min():.4g} to {values.max():.4g} µm, median {values.median():.4g} µm; "
            f"standard uncertainty {stds.median():.2g} µm (median), {stds.max():.2g} µm (largest)"
        )
