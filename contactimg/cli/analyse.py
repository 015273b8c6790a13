"""``contactimg analyse``: area laws, profiles, contact laws and friction of one or several runs."""

from dataclasses import asdict, dataclass, replace
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

import click

from contactimg.cli import shared_options as shared
from contactimg.cli.printing import echo_results, progress
from contactimg.timings import stage

if TYPE_CHECKING:
    import pandas as pd

    from contactimg.pipeline.analyse.analysis import AnalysisOptions
    from contactimg.pipeline.analyse.places import Place


@dataclass(frozen=True, kw_only=True)
class AnalyseOptions:
    """Options of the command, in the units of their names."""

    annulus_mm: float
    load_low: float
    load_high: float
    load_tolerance: float
    load_std: float
    load_relative_std: float
    friction_std: float
    min_radius_px: float
    min_contacts: int
    confidence: float
    models: bool
    smooth: str | None
    smooth_stress: float | None
    smooth_stress_std: float


@click.command(short_help="Area laws, profiles, contact laws and friction of one or several runs.")
@click.argument("runs", metavar="RUN [RUN ...]", type=shared.existing_folder, nargs=-1)
@shared.output("the first RUN")
@click.option(
    "--calibration",
    type=shared.existing_file,
    help="Take the centre of the contact from this calibration.json of `calibrate jkr`.",
)
@shared.annulus
@click.option(
    "--load-min-N",
    "load_low",
    type=float,
    default=0.0,
    show_default=True,
    help="Smallest load, in newtons, used to fit the exponent of contact area against load.",
)
@click.option(
    "--load-max-N",
    "load_high",
    type=float,
    default=inf,
    help="Largest load, in newtons, used to fit that exponent.  [default: no limit]",
)
@click.option(
    "--load-tolerance",
    type=shared.non_negative_number,
    default=0.05,
    show_default=True,
    help="Frames whose loads differ by less than this fraction are averaged as one load.",
)
@click.option(
    "--load-std-N",
    "load_std",
    type=shared.non_negative_number,
    default=0.0,
    help="Standard uncertainty of a load, in newtons.  [default: 0]",
)
@click.option(
    "--load-relative-std",
    type=shared.non_negative_number,
    default=0.0,
    help="Standard uncertainty of a load as a fraction of the load; added in quadrature.  [default: 0]",
)
@click.option(
    "--friction-std-N",
    "friction_std",
    type=shared.non_negative_number,
    default=0.0,
    help="Standard uncertainty of a friction force, in newtons.  [default: 0]",
)
@shared.min_radius("smaller contacts, measured or predicted, are left out of the profiles")
@click.option(
    "--min-contacts",
    type=click.IntRange(min=1),
    default=5,
    show_default=True,
    help="Fewest contacts to expect in a ring, by those beside it, for the laws against the local pressure.",
)
@click.option(
    "--confidence",
    type=click.FloatRange(0, 1, min_open=True, max_open=True),
    default=0.95,
    show_default=True,
    help="Confidence level of every interval.",
)
@click.option(
    "--models/--no-models",
    default=True,
    help="Compare with the contact models, solved for the same surfaces and loads.  [default: models]",
)
@click.option(
    "--smooth",
    type=shared.existing_folder,
    help="Output folder of `process` for a smooth lens; its shear stress is the one to compare with.",
)
@click.option(
    "--smooth-stress-MPa",
    "smooth_stress",
    type=float,
    help="Shear stress of a smooth contact, in MPa, instead of --smooth.",
)
@click.option(
    "--smooth-stress-std-MPa",
    "smooth_stress_std",
    type=float,
    default=0.0,
    help="Standard uncertainty of that stress, in MPa.  [default: 0]",
)
@click.option(
    "--topography",
    type=shared.existing_file,
    help="CSV file with measured asperities: columns height_m, radius_m and, if known, height_std_m, "
    "radius_std_m. Their statistics are added to the results.",
)
@shared.workers
@shared.cluster
@shared.quiet
@shared.gather(AnalyseOptions)
def analyse(
    *,
    runs: tuple[str, ...],
    output: str | None,
    calibration: str | None,
    topography: str | None,
    workers: int | None,
    quiet: bool,
    options: AnalyseOptions,
) -> None:
    """Analyse one or several RUNs (output folders of `process` or `predict`) together.

    Several runs are places on one surface, pressed by one lens; their results are averaged.

    Writes area.csv (contact area against load), profile.csv and profile_normalised.csv (pressure against
    distance from the apex), pressure_law.csv (density and mean radius of the contacts against local
    pressure), friction.csv, results.csv (exponents and other numbers with confidence intervals),
    provenance.json, and the figures as PNG and SVG.

    Exit codes: 0 done, 2 nothing done.

    \b
    Examples:
      contactimg analyse results
      contactimg analyse place_*/contactimg_out --calibration jkr/calibration.json -o analysis
      contactimg analyse --topography profilometry.csv -o topography
    """
    with stage("loading"):
        from contactimg.files import OutputFolder, provenance, read_topography
        from contactimg.pipeline.analyse.places import differences, open_place, read_centre
        from contactimg.pipeline.analyse.results_table import write_results

    if not runs and topography is None:
        raise click.UsageError("Missing argument 'RUN': give the output folder of `contactimg process`.")
    settings = _settings(options)
    centre = None if calibration is None else read_centre(calibration)
    places = [open_place(run, centre_px=centre) for run in runs]
    caps = None if topography is None else read_topography(topography)
    record = provenance(
        command=shared.command_line("analyse"),
        options=asdict(options) | {"runs": list(runs), "calibration": calibration, "topography": topography},
        inputs=_inputs(runs, calibration, topography),
    )
    target = shared.output_path(output, runs[0] if runs else Path(str(topography)).parent)
    with OutputFolder(target, record, main_files=["results.csv"]) as out:
        results, notes = _write_analysis(places, caps, settings, out.folder, workers=workers, quiet=quiet)
        write_results(results, out.folder)
        out.record["notes"] = [*differences(places), *notes]
    if not quiet:
        echo_results(results, title=", ".join(runs) or str(topography))
        for note in notes:
            click.echo(note)
        click.echo(f"results in {target}")


def _write_analysis(
    places: "list[Place]",
    caps: "pd.DataFrame | None",
    settings: "AnalysisOptions",
    folder: Path,
    *,
    workers: int | None,
    quiet: bool,
) -> "tuple[pd.DataFrame, tuple[str, ...]]":
    """Analyse the places and the topography, write tables and figures; return the results and the notes."""
    import pandas as pd

    from contactimg.pipeline.analyse.analysis import analyse_places
    from contactimg.pipeline.analyse.group_by_load import count_solutions
    from contactimg.pipeline.analyse.results_table import write_analysis, write_topography
    from contactimg.prediction import COMPARED_MODELS

    results: list[pd.DataFrame] = []
    notes: tuple[str, ...] = ()
    if places:
        count = len(COMPARED_MODELS) * count_solutions(places) if settings.models else 0
        with progress("solving models", count, quiet=quiet or not count) as advance:
            analysis = analyse_places(places, settings, workers=workers, advance=advance)
        results.append(write_analysis(analysis, folder, smooth_stress=settings.smooth_stress))
        notes = analysis.notes
    if caps is not None:
        results.append(write_topography(caps, folder, confidence=settings.confidence))
    return pd.concat(results, ignore_index=True), notes


def _inputs(runs: tuple[str, ...], calibration: str | None, topography: str | None) -> list[Path]:
    """The files that the analysis depends on."""
    from contactimg.files import PROVENANCE_FILE, main_tables

    tables = [path for run in runs for path in (*main_tables([Path(run)]), Path(run) / PROVENANCE_FILE)]
    return [*tables, *(Path(name) for name in (calibration, topography) if name is not None)]


def _settings(options: AnalyseOptions) -> "AnalysisOptions":
    """The options in SI units, with the shear stress of the smooth contact measured or as given."""
    from contactimg.analysis.estimates import Estimate
    from contactimg.pipeline.analyse.analysis import AnalysisOptions, smooth_shear_stress
    from contactimg.pipeline.analyse.places import open_place

    if options.smooth is not None and options.smooth_stress is not None:
        raise click.UsageError("--smooth and --smooth-stress-MPa both give the stress; keep one of the two.")
    settings = AnalysisOptions(
        annulus=options.annulus_mm * 1e-3,
        confidence=options.confidence,
        load_range=(options.load_low, options.load_high),
        load_tolerance=options.load_tolerance,
        load_relative_std=options.load_relative_std,
        load_std=options.load_std,
        friction_std=options.friction_std,
        min_radius_px=options.min_radius_px,
        min_contacts=options.min_contacts,
        models=options.models,
    )
    if options.smooth is not None:
        return replace(settings, smooth_stress=smooth_shear_stress(open_place(options.smooth), settings))
    if options.smooth_stress is not None:
        stress, std = options.smooth_stress * 1e6, options.smooth_stress_std * 1e6
        return replace(settings, smooth_stress=Estimate(stress, std, stress, stress))
    return settings
