"""Numbers of an analysis as rows: what, its value and interval, over which range, and how it is defined."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from contactimg.analysis.broken_power_laws import BrokenLaw
from contactimg.analysis.contacts_against_pressure import QUANTITIES
from contactimg.analysis.estimates import Estimate
from contactimg.analysis.power_laws import PowerLaw
from contactimg.analysis.topography import Topography, describe_topography
from contactimg.files import write_figures, write_table
from contactimg.pipeline.analyse.analysis import Analysis
from contactimg.plots import (
    caption_of,
    plot_areas,
    plot_friction,
    plot_pressure_law,
    plot_profile,
    plot_topography,
)
from contactimg.tables import AREA, FRICTION, NORMALISED, PRESSURE_LAW, PROFILE, RESULTS, RUN_MODELS

Row = dict[str, Any]


def result_rows(analysis: Analysis) -> pd.DataFrame:
    """The numbers of an analysis.

    Parameters
    ----------
    analysis : Analysis

    Returns
    -------
    DataFrame
        Columns of `contactimg.tables.RESULTS`.
    """
    rows: list[Row] = []
    for model, law in analysis.area_laws.items():
        rows += _area_rows(model, law)
    for (quantity, model), broken in analysis.contact_laws.items():
        rows += _contact_rows(quantity, model, broken)
    rows += _friction_rows(analysis)
    return RESULTS.conform(pd.DataFrame(rows, columns=list(RESULTS.columns)))


@dataclass(frozen=True)
class _Fit:
    """Data behind a number: confidence level, points, places, and the fitted range of the abscissa."""

    confidence: float
    n_points: int
    n_places: float = np.nan
    low: float = np.nan
    high: float = np.nan
    unit: str | float = np.nan

    @classmethod
    def of_law(cls, law: PowerLaw | BrokenLaw, n_places: float, unit: str) -> "_Fit":
        """Of a fitted law."""
        return cls(law.confidence, law.n_points, n_places, law.low, law.high, unit)


def _row(quantity: str, model: str, estimate: Estimate, unit: str, fit: _Fit, *, note: str = "") -> Row:
    """One number."""
    return {
        "quantity": quantity,
        "model": model,
        "value": estimate.value,
        "std": estimate.std,
        "low": estimate.low,
        "high": estimate.high,
        "unit": unit,
        "confidence": fit.confidence,
        "range_low": fit.low,
        "range_high": fit.high,
        "range_unit": fit.unit,
        "n_points": fit.n_points,
        "n_places": fit.n_places,
        "note": note,
    }


def _without_interval(value: float) -> Estimate:
    """A number that has no interval."""
    return Estimate(value, np.nan, np.nan, np.nan)


def _area_rows(model: str, law: PowerLaw) -> Iterator[Row]:
    """A(P)."""
    fit = _Fit.of_law(law, law.n_places, "N")
    source = "scatter between places" if law.n_places > 1 else "stated errors and scatter within the place"
    note = f"A ~ P^m, errors in A and P; of this surface, whatever its places: interval from {source}"
    yield _row("area_exponent", model, law.exponent, "1", fit, note=note)
    if law.here is not None:
        note = "the same exponent, interval from the errors of areas and loads alone: of these very places"
        yield _row("area_exponent_here", model, law.here, "1", fit, note=note)
    yield from _another_surface("area_exponent", model, law, fit)
    note = f"A of that law at {law.reference:.6g} N, the geometric mean of the loads"
    yield _row("area_at_mean_load", model, law.amplitude, "m2", fit, note=note)
    if law.zero:
        note = "mean zero of the load cell, taken off the loads; what is not known of it is in the intervals"
        yield _row("area_load_zero", model, _without_interval(law.zero), "N", fit, note=note)
    note = "relative scatter of A about the law beyond the stated errors"
    yield _row("area_excess_scatter", model, _without_interval(law.scatter), "1", fit, note=note)


def _another_surface(name: str, model: str, law: PowerLaw, fit: _Fit) -> Iterator[Row]:
    """The exponent that another surface of the same kind would give."""
    if law.another_surface is None:
        return
    note = "the same exponent, interval of what another surface of the same kind gives at as many places"
    yield _row(f"{name}_another_surface", model, law.another_surface, "1", fit, note=note)


def _contact_rows(quantity: str, model: str, law: BrokenLaw) -> Iterator[Row]:
    """Density or mean radius against the local pressure; two laws only where the points support a break."""
    fit = _Fit.of_law(law, law.single.n_places, "Pa")
    name = f"{quantity}_exponent"
    note = f"{quantity} ~ p^m, one law; of this surface, whatever its places"
    yield _row(name, model, law.single.exponent, "1", fit, note=note)
    yield from _another_surface(name, model, law.single, fit)
    note = "probability of as much gain by a break that is not there (Davies)"
    yield _row(f"{quantity}_break_p_value", model, _without_interval(law.p_value), "1", fit, note=note)
    if not law.supported:
        return
    yield _row(f"{name}_above", model, law.high_exponent, "1", fit, note="above p*")
    yield _row(f"{name}_below", model, law.low_exponent, "1", fit, note="below p*")
    note = "p*, where the two laws meet; interval from the profile of chi-square"
    yield _row(f"{quantity}_break_pressure", model, law.break_x, "Pa", fit, note=note)


def _friction_rows(analysis: Analysis) -> Iterator[Row]:
    """Shear stress, and its ratio to the smooth contact's."""
    stress = analysis.shear_stress
    if stress is None:
        return
    n_places = analysis.friction["place"].nunique()
    fit = _Fit(stress.confidence, stress.n_points, n_places, stress.low, stress.high, "m2")
    note = "tau0 of Q = tau0 A, least squares through the origin, errors in A and Q"
    yield _row("shear_stress", "measured", stress.stress, "Pa", fit, note=note)
    if analysis.stress_ratio is not None:
        note = "tau0 over that of the smooth contact"
        yield _row("shear_stress_ratio", "measured", analysis.stress_ratio, "1", fit, note=note)
    if analysis.velocity_law is not None:
        law = analysis.velocity_law
        fit = _Fit.of_law(law, n_places, "m/s")
        note = "tau0 ~ v^m, one shear stress at each velocity; 0 where friction does not depend on it"
        yield _row("shear_stress_velocity_exponent", "measured", law.exponent, "1", fit, note=note)


def topography_rows(topography: Topography) -> pd.DataFrame:
    """The numbers of a table of asperities.

    Parameters
    ----------
    topography : Topography

    Returns
    -------
    DataFrame
        Columns of `contactimg.tables.RESULTS`; the contact angle in degrees, and only if height grows with
        radius.
    """
    fit = _Fit(topography.confidence, topography.n_points)
    correlation = _without_interval(topography.correlation)
    p_value = _without_interval(topography.p_value)
    rows = [
        _row("height_over_radius", "measured", topography.slope, "1", fit, note="h/R through the origin"),
        _row("rank_correlation", "measured", correlation, "1", fit, note="Spearman, h and R"),
        _row("rank_correlation_p_value", "measured", p_value, "1", fit),
    ]
    if topography.one_angle:
        angle = topography.contact_angle
        degrees = Estimate(*np.degrees([angle.value, angle.std, angle.low, angle.high]).tolist())
        rows.append(
            _row("contact_angle", "measured", degrees, "deg", fit, note="theta of h = R (1 - cos theta)")
        )
    for name in ("height", "radius"):
        mean, std = (getattr(topography, f"{name}_{kind}") for kind in ("mean", "std"))
        error = Estimate(mean, std / np.sqrt(topography.n_points), np.nan, np.nan)
        rows.append(_row(f"{name}_mean", "measured", error, "m", fit))
        rows.append(_row(f"{name}_std", "measured", _without_interval(std), "m", fit))
        normality = _without_interval(getattr(topography, f"{name}_normality"))
        note = "probability that normal values deviate as much from a normal law (Shapiro, Wilk)"
        rows.append(_row(f"{name}_normality_p_value", "measured", normality, "1", fit, note=note))
    return RESULTS.conform(pd.DataFrame(rows, columns=list(RESULTS.columns)))


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
