"""``contactimg analyse``: area laws, profiles, contact laws and friction of one or several runs."""

from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Annotated

import click

from contactimg import files, pipeline
from contactimg.cli import options as shared
from contactimg.cli.printing import echo_results, say


@shared.command(shared.NO_PLAUSIBILITY, shared.CLUSTER)
def analyse(
    runs: Annotated[tuple[shared.ExistingFolder, ...], "RUN [RUN ...]"],
    *,
    output: shared.Output = None,
    calibration: shared.ExistingFile | None = None,
    annulus_mm: shared.Annulus = 0.25,
    load_min_N: float = 0.0,
    load_max_N: float | None = None,
    load_tolerance: shared.NonNegative = 0.05,
    load_std_N: shared.NonNegative = 0.0,
    load_relative_std: shared.NonNegative = 0.0,
    friction_std_N: shared.NonNegative = 0.0,
    min_radius_px: shared.NonNegative = 1.0,
    min_contacts: shared.Count = 5,
    confidence: Annotated[float, click.FloatRange(0, 1, min_open=True, max_open=True)] = 0.95,
    models: Annotated[bool, "--models/--no-models"] = True,
    smooth: shared.ExistingFolder | None = None,
    workers: shared.Workers = None,
) -> None:
    """Analyse one or several RUNs (output folders of `process` or `predict`) together.

    Several runs are places on one surface, pressed by one lens; their results are averaged.

    Writes area.csv (contact area against load), profile.csv and profile_normalised.csv (pressure against
    distance from the apex), pressure_law.csv (density and mean radius of the contacts against local
    pressure), friction.csv, asperities.csv (each asperity in each frame, with displacement or upper limit),
    results.csv (exponents and other numbers with confidence intervals), provenance.json, and the figures as
    PNG, SVG and PDF.

    Exit codes: 0 done, 2 nothing done, also where fewer than half of the contacts match those of the model.

    \b
    Examples:
      contactimg analyse results
      contactimg analyse place_*/contactimg_out --calibration jkr/calibration.json -o analysis

    Parameters
    ----------
    calibration
        Take the centre of the contact from this calibration.json of `calibrate jkr`.
    load_min_N
        Smallest load, in newtons, used to fit the exponent of contact area against load.
    load_max_N
        Largest load, in newtons, used to fit that exponent.  [default: no limit]
    load_tolerance
        Frames whose loads differ by less than this fraction are averaged as one load.
    load_std_N
        Standard uncertainty of a load, in newtons.
    load_relative_std
        Standard uncertainty of a load as a fraction of the load; added in quadrature.
    friction_std_N
        Standard uncertainty of a friction force, in newtons.
    min_radius_px
        Smallest contact radius that counts, in pixels: smaller contacts, measured or predicted, are left out
        of the profiles.
    min_contacts
        Fewest contacts to expect in a ring, by those beside it, for the laws against the local pressure.
    confidence
        Confidence level of every interval.
    models
        Compare with the contact models, solved for the same surfaces and loads.
    smooth
        Output folder of `process` for a smooth lens; its shear stress is the one to compare with.
    """
    settings = pipeline.AnalysisOptions(
        annulus=annulus_mm * 1e-3,
        confidence=confidence,
        load_range=(load_min_N, inf if load_max_N is None else load_max_N),
        load_tolerance=load_tolerance,
        load_relative_std=load_relative_std,
        load_std=load_std_N,
        friction_std=friction_std_N,
        min_radius_px=min_radius_px,
        min_contacts=min_contacts,
        models=models,
    )
    if smooth is not None:
        stress = pipeline.smooth_shear_stress(pipeline.open_place(smooth), settings)
        settings = replace(settings, smooth_stress=stress)
    centre = None if calibration is None else pipeline.read_centre(calibration)
    places = [pipeline.open_place(run, centre_px=centre) for run in runs]
    folders = [Path(run) for run in runs]
    inputs = [path for one in folders for path in (*files.main_tables([one]), one / files.PROVENANCE_FILE)]
    inputs += [] if calibration is None else [Path(calibration)]
    then = "report" if len(runs) == 1 else ""
    with shared.results_in(output, runs[0], None, inputs, main_files=["results.csv"], then=then) as out:
        analysis = pipeline.analyse_places(places, settings, workers=workers)
        results = pipeline.write_analysis(analysis, out.folder, smooth_stress=settings.smooth_stress)
        out.record["notes"] = [*pipeline.differences(places), *analysis.notes]
        echo_results(results, title=", ".join(runs))
        say(*analysis.notes)
