"""``contactimg analyse``: what the contacts of one or several runs say together."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from contactimg.cli.common import (
    command_line,
    echo_results,
    output_option,
    progress,
    quiet_option,
    workers_option,
)
from contactimg.timings import stage

if TYPE_CHECKING:
    from contactimg.pipeline.analyse.places_together import AnalysisOptions

folder = click.Path(exists=True, file_okay=False)
file = click.Path(exists=True, dir_okay=False)


@click.command(short_help="A(P), profiles, contact laws and friction of one or several runs.")
@click.argument("runs", metavar="RUN [RUN ...]", type=folder, nargs=-1)
@output_option
@click.option("--calibration", type=file, help="calibration.json of `calibrate jkr`: the centre.")
@click.option("--annulus-mm", type=float, default=0.25, show_default=True, help="Width of profile annuli.")
@click.option(
    "--load-min-N", "load_low", type=float, default=0.0, help="Lowest load in the exponent of A(P)."
)
@click.option("--load-max-N", "load_high", type=float, default=float("inf"), help="Highest one.")
@click.option(
    "--load-tolerance",
    type=click.FloatRange(min=0),
    default=0.05,
    show_default=True,
    help="Loads that differ by less, relatively, are averaged as one.",
)
@click.option(
    "--load-std-N", "load_std", type=click.FloatRange(min=0), default=0.0, help="Uncertainty of a load."
)
@click.option(
    "--load-relative-std", type=click.FloatRange(min=0), default=0.0, help="The same, over the load."
)
@click.option(
    "--friction-std-N", "friction_std", type=click.FloatRange(min=0), default=0.0, help="Of a friction force."
)
@click.option(
    "--min-radius-px",
    type=click.FloatRange(min=0),
    default=1.0,
    show_default=True,
    help="Smallest contacts, measured or predicted, that count in annuli.",
)
@click.option(
    "--min-contacts",
    type=click.IntRange(min=1),
    default=5,
    show_default=True,
    help="Fewest contacts of an annulus in the laws against the local pressure.",
)
@click.option(
    "--confidence",
    type=click.FloatRange(0, 1, min_open=True, max_open=True),
    default=0.95,
    show_default=True,
    help="Of every interval.",
)
@click.option("--models/--no-models", default=True, help="Solve the models for the same places.")
@click.option("--smooth", type=folder, help="Run with a smooth lens: the reference of the shear stress.")
@click.option("--smooth-stress-MPa", "smooth_stress", type=float, help="The same as a number.")
@click.option(
    "--smooth-stress-std-MPa", "smooth_stress_std", type=float, default=0.0, help="Its uncertainty."
)
@click.option("--topography", type=file, help="CSV with height_m, radius_m of asperities, and their _std_m.")
@workers_option
@quiet_option
def analyse(
    *,
    runs: tuple[str, ...],
    output: str | None,
    calibration: str | None,
    topography: str | None,
    workers: int | None,
    quiet: bool,
    **options: Any,
) -> None:
    """Analyse RUNs, outputs of `process` (or of `predict`): places of one surface under one lens.

    Writes area.csv (A against P, L/a, a/R), profile.csv and profile_normalised.csv (p against r),
    pressure_law.csv (density and mean radius against p), friction.csv, results.csv (exponents and other
    numbers with their intervals), and the figures as PNG and SVG.

    \b
    Examples:
      contactimg analyse results
      contactimg analyse place_*/contactimg_out --calibration jkr/calibration.json -o analysis
      contactimg analyse --topography profilometry.csv -o topography
    """
    with stage("loading"):
        import pandas as pd

        from contactimg.files import OutputFolder, provenance, read_topography
        from contactimg.pipeline.analyse.files import write_analysis, write_results, write_topography
        from contactimg.pipeline.analyse.model_places import MODEL_COUPLINGS, count_solutions
        from contactimg.pipeline.analyse.places import open_place, read_centre
        from contactimg.pipeline.analyse.places_together import analyse_places

    if not runs and topography is None:
        raise click.UsageError("Missing argument 'RUN': give the output folders of `process`.")
    settings = _options(options)
    centre = None if calibration is None else read_centre(calibration)
    places = [open_place(run, centre_px=centre) for run in runs]
    caps = None if topography is None else read_topography(topography)
    target = Path(output) if output is not None else _home(runs, topography) / "contactimg_out"
    record = provenance(**_origin(runs, calibration, topography, options))
    with OutputFolder(target, record, main_files=["results.csv"]) as out:
        tables: list[pd.DataFrame] = []
        notes: tuple[str, ...] = ()
        if places:
            count = len(MODEL_COUPLINGS) * count_solutions(places) if settings.models else 0
            with progress("solving models", count, quiet=quiet or not count) as advance:
                analysis = analyse_places(places, settings, workers=workers, advance=advance)
            tables.append(write_analysis(analysis, out.folder, smooth_stress=settings.smooth_stress))
            notes = analysis.notes
        if caps is not None:
            tables.append(write_topography(caps, out.folder, confidence=settings.confidence))
        results = pd.concat(tables, ignore_index=True)
        write_results(results, out.folder)
        out.record["notes"] = list(notes)
    if not quiet:
        echo_results(results, title=", ".join(runs) or str(topography))
        for note in notes:
            click.echo(note)
        click.echo(f"results in {target}")


def _home(runs: tuple[str, ...], topography: str | None) -> Path:
    """The folder that the output goes into by default."""
    return Path(runs[0]) if runs else Path(str(topography)).parent


def _origin(
    runs: tuple[str, ...], calibration: str | None, topography: str | None, options: dict[str, Any]
) -> dict[str, Any]:
    """What the provenance says of the input."""
    tables = [Path(run) / name for run in runs for name in ("contacts.csv", "frames.csv", "provenance.json")]
    files = [Path(name) for name in (calibration, topography) if name is not None]
    return {
        "command": command_line("analyse"),
        "options": options | {"runs": list(runs), "calibration": calibration, "topography": topography},
        "inputs": [*tables, *files],
    }


def _options(given: dict[str, Any]) -> "AnalysisOptions":
    """The settings of the analysis."""
    from contactimg.analysis.estimates import Estimate
    from contactimg.pipeline.analyse.places import open_place
    from contactimg.pipeline.analyse.places_together import AnalysisOptions, smooth_shear_stress

    if given["smooth"] is not None and given["smooth_stress"] is not None:
        raise click.UsageError("--smooth and --smooth-stress-MPa are both given; keep one of the two.")
    names = (
        "load_tolerance",
        "load_std",
        "load_relative_std",
        "friction_std",
        "min_contacts",
        "confidence",
        "min_radius_px",
    )
    options = AnalysisOptions(
        annulus=given["annulus_mm"] * 1e-3,
        load_range=(given["load_low"], given["load_high"]),
        models=given["models"],
        **{name: given[name] for name in names},
    )
    if given["smooth"] is not None:
        return replace(options, smooth_stress=smooth_shear_stress(open_place(given["smooth"]), options))
    if given["smooth_stress"] is not None:
        stress, std = given["smooth_stress"] * 1e6, given["smooth_stress_std"] * 1e6
        return replace(options, smooth_stress=Estimate(stress, std, stress, stress))
    return options
