"""Write the results of `analyse`: tables, and figures."""

from pathlib import Path

import pandas as pd
from matplotlib.axes import Axes

from contactimg.analysis.contacts_against_pressure import QUANTITIES
from contactimg.analysis.estimates import Estimate
from contactimg.analysis.topography import describe_topography
from contactimg.files import write_figures, write_table
from contactimg.pipeline.analyse.analysis import Analysis
from contactimg.pipeline.analyse.results_table import result_rows, topography_rows
from contactimg.plots import (
    caption_of,
    plot_areas,
    plot_friction,
    plot_pressure_law,
    plot_profile,
    plot_topography,
)
from contactimg.tables import (
    AREA,
    FRICTION,
    NORMALISED,
    PRESSURE_LAW,
    PROFILE,
    RESULTS,
    RUN_MODELS,
)


def write_results(results: pd.DataFrame, folder: Path) -> None:
    """Write results.csv."""
    write_table(results, RESULTS, folder / "results.csv")


def write_analysis(analysis: Analysis, folder: Path, *, smooth_stress: Estimate | None) -> pd.DataFrame:
    """Write the tables of an analysis and its figures.

    Parameters
    ----------
    analysis : Analysis
    folder : Path
        Exists.
    smooth_stress : Estimate or None, Pa
        Shear stress of the smooth contact, drawn beside the friction.

    Returns
    -------
    DataFrame
        The numbers of the analysis, for `write_results`.
    """
    write_table(analysis.area, AREA, folder / "area.csv")
    write_table(analysis.profile, PROFILE, folder / "profile.csv")
    write_table(analysis.normalised, NORMALISED, folder / "profile_normalised.csv")
    write_table(analysis.pressure_law, PRESSURE_LAW, folder / "pressure_law.csv")
    if len(analysis.friction):
        write_table(analysis.friction, FRICTION, folder / "friction.csv")
    _draw(analysis, folder, smooth_stress)
    return result_rows(analysis)


def _draw(analysis: Analysis, folder: Path, smooth_stress: Estimate | None) -> None:
    """Draw A(P), profiles, laws against the local pressure and friction, as far as they exist."""
    _save(plot_areas(analysis.area, analysis.area_laws), folder, "area")
    seen = analysis.normalised[
        analysis.normalised["model"].isin(RUN_MODELS) & analysis.normalised["pressure_over_hertz"].notna()
    ]
    loads = seen[["frame", "load_N"]].drop_duplicates()
    for number, frame in enumerate(loads["frame"], start=1):
        part = analysis.normalised[analysis.normalised["frame"] == frame]
        _save(plot_profile(part), folder, f"profile_{number:0{len(str(len(loads)))}d}")
    if len(analysis.pressure_law):
        for quantity in QUANTITIES:
            ax = plot_pressure_law(analysis.pressure_law, analysis.contact_laws, quantity)
            _save(ax, folder, quantity)
    if analysis.shear_stress is not None:
        _save(plot_friction(analysis.friction, analysis.shear_stress, smooth_stress), folder, "friction")


def write_topography(table: pd.DataFrame, folder: Path, *, confidence: float) -> pd.DataFrame:
    """Draw a table of asperities and return its numbers, for `write_results`."""
    topography = describe_topography(table, confidence=confidence)
    _save(plot_topography(table, topography), folder, "topography")
    return topography_rows(topography)


def _save(ax: Axes, folder: Path, name: str) -> None:
    """Write a figure with its caption."""
    write_figures(ax, folder, name, caption=caption_of(name))
