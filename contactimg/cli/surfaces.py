"""Commands that make tables of asperities: `asperities` from a height map, `design` for a wanted law."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import click

from contactimg import files, pipeline, plots, tables
from contactimg.cli import options as shared
from contactimg.cli.printing import echo_table, say
from contactimg.cli.scenes import scene_at
from contactimg.errors import InputError
from contactimg.scene import scene_from_dict

if TYPE_CHECKING:
    from contactimg.design.laws import WantedLaw
    from contactimg.design.surface import DesignedSurface

ASPERITIES_FILE, LAW_FILE = "asperities.csv", "law.csv"


# --- asperities


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

    Exit codes: 0 done; 1 done, but pixel size or unit is probably a slip; 2 nothing done.

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
    from contactimg.plausibility import doubts_about_scene, warn_of
    from contactimg.summits import find_summits

    pixel = None if pixel_size_um is None else pixel_size_um * 1e-6
    unit = None if height_unit is None else files.METRES[height_unit]
    surface = files.read_height_map(map_file, pixel_size=pixel, height_unit=unit)
    found = find_summits(surface, form=form, least_height=min_height_um * 1e-6, depth=depth)
    parts = ", ".join(f"{count} {reason}" for reason, count in found.left_out.items())
    left_out = f" (left out: {parts})" if parts else ""
    if found.table.empty:
        raise InputError(f"{map_file}: no summit found{left_out}; see --form, --min-height-um, --depth")
    file = Path(map_file)
    with shared.results_in(output, file.parent, None, [file], main_files=[ASPERITIES_FILE]) as out:
        out.record |= {"left_out": found.left_out, "noise_m": found.noise, "warnings": found.warnings}
        files.write_table(found.table, tables.SUMMITS, out.folder / ASPERITIES_FILE)
        say(f"{len(found.table)} summits{left_out}; noise of the map {found.noise * 1e9:.3g} nm")
        for name, title in (("height", "heights"), ("radius", "radii of curvature")):
            values, stds = found.table[f"{name}_m"] * 1e6, found.table[f"{name}_std_m"] * 1e6
            say(
                f"  {title}: {values.min():.4g} to {values.max():.4g} µm, median {values.median():.4g} µm; "
                f"standard uncertainty {stds.median():.2g} µm (median), {stds.max():.2g} µm (largest)"
            )
    for warning in found.warnings:
        click.echo(f"contactimg: {warning}", err=True)
    return int(warn_of(doubts_about_scene(scene_from_dict({}), found.table), map_file))


# --- design


@shared.command(
    shared.SceneOption("--young-modulus-MPa", "elastic", "young_modulus_Pa", default="the scene's"),
    shared.SceneOption("--poisson-ratio", "elastic", "poisson_ratio"),
    shared.NO_PLAUSIBILITY,
)
def design(
    scene: shared.Existing | None = None,
    *,
    stated: shared.Stated,
    law: Annotated[str, "--law"],
    caps: shared.Count = 64,
    cap_radius_um: shared.Positive,
    spacing_mm: shared.Positive,
    max_load_n: Annotated[shared.Positive | None, "--max-load-N"] = None,
    min_load_n: Annotated[shared.Positive | None, "--min-load-N"] = None,
    shear_strength_mpa: Annotated[shared.Positive | None, "--shear-strength-MPa"] = None,
    lowest_um: shared.Positive | None = None,
    height_error_um: shared.NonNegative = 1.0,
    tolerance: Annotated[float, click.FloatRange(min=0, max=1, min_open=True, max_open=True)] = 0.01,
    nearest: bool = False,
    seed: Annotated[int, click.IntRange(min=0)] = 0,
    output: Annotated[
        shared.NewFolder | None, f"Folder for the results.  [default: {shared.DEFAULT_FOLDER}]"
    ] = None,
) -> int:
    """Design a surface whose contact area with a flat plate follows a wanted law of the load.

    The surface has equal spherical caps on a square grid; what is designed is the height of each. The elastic
    constants are those of SCENE (a scene.toml or the folder that holds one) or of the options. The heights
    are found for independent Hertz contacts first, then corrected for exact spheres that displace each
    other. A friction law becomes an area law by the shear strength, which is assumed not to depend on the
    load.

    Writes asperities.csv (x, y, height, radius of each cap, in m), law.csv (wanted and designed areas, and
    their scatter from errors of the heights), law.png (.svg, .pdf), provenance.json, and scene.toml, which
    `contactimg predict` reads.

    Exit codes: 0 done, 1 done but the surface misses the law by more than the tolerance, 2 nothing done (the
    law is not possible, for example).

    \b
    Examples:
      contactimg design --law "A = 5e-6 P" --max-load-N 0.3 --cap-radius-um 500 --spacing-mm 1.5
          --young-modulus-MPa 1.36 -o designed
      contactimg predict designed --load-N 0.1 -o predicted
      contactimg design scene.toml --law friction.csv --shear-strength-MPa 0.3 --cap-radius-um 500
          --spacing-mm 1.5

    Parameters
    ----------
    law
        "A = c P^m": area in m2 for a load in N; "F = c P^m": friction force in N, with --shear-strength-MPa;
        or a CSV table with the columns load_N and area_m2 or friction_N, straight lines between the rows.
    caps
        Number of caps. Those that the law does not need stand lower than all others.
    cap_radius_um
        Radius of curvature of the caps, in micrometres.
    spacing_mm
        Distance between neighbouring caps, in millimetres.
    max_load_n
        Largest load at which the law holds, in newtons.  [default: the last row of a table]
    min_load_n
        Smallest one.  [default: the first row of a table; of a formula a tenth of the largest]
    shear_strength_mpa
        Friction force over contact area, in MPa.
    lowest_um
        Height of the lowest cap above the plane between the caps.  [default: a tenth of the radius]
    height_error_um
        Standard deviation of the errors of the milled heights, for the scatter of the law.
    tolerance
        Largest relative difference from the wanted area that is accepted.
    nearest
        If the law is not possible, design the nearest possible one.
    seed
        Of the random numbers that decide which cap has which height.
    """
    import numpy as np

    from contactimg.design.surface import design_heights

    described, inputs = (scene_from_dict(stated), []) if scene is None else scene_at(scene, stated)
    elastic = described.need("elastic", "the design of a surface (or --young-modulus-MPa)")
    strength = None if shear_strength_mpa is None else shear_strength_mpa * 1e6
    wanted = _wanted(law, least=min_load_n, largest=max_load_n, strength=strength)
    found = design_heights(
        wanted,
        count=caps,
        cap_radius=cap_radius_um * 1e-6,
        spacing=spacing_mm * 1e-3,
        contact_modulus=elastic.contact_modulus,
        lowest=None if lowest_um is None else lowest_um * 1e-6,
        height_std=height_error_um * 1e-6,
        tolerance=tolerance,
        nearest=nearest,
        rng=np.random.default_rng(seed),
    )
    inputs += [Path(law)] if Path(law).suffix == ".csv" else []
    main_files = [ASPERITIES_FILE, LAW_FILE, "scene.toml"]
    with shared.results_in(output, ".", described, inputs, main_files=main_files) as out:
        out.record |= {"status": found.status, "residual": found.residual}
        made = [(tables.ASPERITIES, found.asperities), (tables.DESIGNED, found.law)]
        pipeline.write_results(out.folder, made, {"law": plots.plot_design(found.law)})
        source = described.source["elastic"]
        kept = {key: source[key] for key in ("young_modulus_Pa", "poisson_ratio") if key in source}
        body = {"indenter": {"radius_m": "flat"}, "elastic": kept, "asperities": {"file": ASPERITIES_FILE}}
        files.write_scene(body, out.folder / "scene.toml")
        _echo_law(found, height_error_um)
    return int(found.residual > tolerance)


def _wanted(law: str, least: float | None, largest: float | None, strength: float | None) -> "WantedLaw":
    """The law that the options state."""
    from contactimg.design.laws import WantedLaw

    if Path(law).suffix != ".csv":
        if largest is None:
            raise InputError("a law in words needs --max-load-N, the largest load at which it holds")
        least = least or largest / 10
        return WantedLaw.parse(law, least=least, largest=largest, shear_strength=strength)
    table = files.read_table(law, tables.WANTED_LAW, required=("load_N",))
    areas = table["area_m2"].notna().all()
    column = table["area_m2" if areas else "friction_N"].to_numpy(float)
    with files.naming(law):
        whole = WantedLaw(table["load_N"].to_numpy(float), column).over(1.0 if areas else strength)
        return whole.between(least, largest)


def _echo_law(found: "DesignedSurface", height_error_um: float) -> None:
    """Print the laws at five loads, and how good the surface is."""
    table, shown = found.law, found.law.iloc[:: len(found.law) // 4]
    columns = {
        "load mN": 1e3 * shown["load_N"],
        "contacts": shown["n_contacts"],
        "wanted mm²": 1e6 * shown["wanted_area_m2"],
        "designed mm²": 1e6 * shown["coupled_area_m2"],
        "scatter": (100 * shown["coupled_std_m2"] / shown["coupled_area_m2"]).map("{:.2g} %".format),
    }
    forms = dict.fromkeys(("load mN", "wanted mm²", "designed mm²"), ".4g")
    echo_table("area against load", columns, left=0, forms=forms)
    heights = found.asperities["height_m"] * 1e6
    off = (table["coupled_area_m2"] / table["wanted_area_m2"] - 1).abs().max()
    say(
        f"{len(heights)} caps with heights from {heights.min():.1f} to {heights.max():.1f} µm: "
        f"the area is within {100 * off:.2g} % of the wanted law",
        f"designed for independent contacts they would be off by {100 * found.independent_residual:.2g} %",
        f"scatter: root mean square change of the area if the heights have errors of {height_error_um:g} µm",
        "" if found.status == "ok" else found.status,
    )
