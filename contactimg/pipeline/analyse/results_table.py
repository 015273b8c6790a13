"""Numbers of an analysis as rows: what, its value and interval, over which range, and how it is defined."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from contactimg.analysis.contacts_against_pressure import QUANTITIES
from contactimg.analysis.estimates import Estimate
from contactimg.analysis.friction import ShearStress
from contactimg.analysis.power_laws import BrokenLaw, PowerLaw
from contactimg.files import write_figures, write_table
from contactimg.pipeline.analyse.analysis import Analysis
from contactimg.plots import (
    caption_of,
    plot_areas,
    plot_friction,
    plot_pressure_law,
    plot_profile,
)
from contactimg.tables import AREA, FRICTION, NORMALISED, PRESSURE_LAW, PROFILE, RESULTS, RUN_MODELS

Row = dict[str, Any]


ANOTHER_SURFACE = (
    "the same exponent, interval of what another surface of the same kind gives at as many places"
)


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


def _row(quantity: str, model: str, found: Estimate | float, unit: str, note: str = "", **fit: Any) -> Row:
    """One number, with its interval if it has one, and what it was fitted to."""
    estimate = found if isinstance(found, Estimate) else Estimate(found, np.nan, np.nan, np.nan)
    interval = {name: getattr(estimate, name) for name in ("value", "std", "low", "high")}
    return {"quantity": quantity, "model": model, "unit": unit, "note": note} | interval | fit


def _fit(law: PowerLaw | ShearStress, unit: str, n_places: float) -> Row:
    """The data behind a law: confidence level, points, places, and the fitted range of the abscissa."""
    ends = {"range_low": law.low, "range_high": law.high, "range_unit": unit}
    return ends | {"confidence": law.confidence, "n_points": law.n_points, "n_places": n_places}


def _area_rows(model: str, law: PowerLaw) -> Iterator[Row]:
    """A(P)."""
    fit = _fit(law, "N", law.n_places)
    source = "scatter between places" if law.n_places > 1 else "stated errors and scatter within the place"
    note = f"A ~ P^m, errors in A and P; of this surface, whatever its places: interval from {source}"
    yield _row("area_exponent", model, law.exponent, "1", note, **fit)
    if law.here is not None:
        note = "the same exponent, interval from the errors of areas and loads alone: of these very places"
        yield _row("area_exponent_here", model, law.here, "1", note, **fit)
    yield _row("area_exponent_another_surface", model, law.another_surface, "1", ANOTHER_SURFACE, **fit)
    note = f"A of that law at {law.reference:.6g} N, the geometric mean of the loads"
    yield _row("area_at_mean_load", model, law.amplitude, "m2", note, **fit)
    if law.zero:
        note = "zero of the load cell, fitted because the scene states zero_std_N, and taken off the loads"
        yield _row("area_load_zero", model, law.zero, "N", note, **fit)
    note = "relative scatter of A about the law beyond the stated errors"
    yield _row("area_excess_scatter", model, law.scatter, "1", note, **fit)


def _contact_rows(quantity: str, model: str, law: BrokenLaw) -> Iterator[Row]:
    """Density or mean radius against the local pressure; two laws only where the points support a break."""
    fit, name = _fit(law.single, "Pa", law.single.n_places), f"{quantity}_exponent"
    note = f"{quantity} ~ p^m, one law; of this surface, whatever its places"
    yield _row(name, model, law.single.exponent, "1", note, **fit)
    yield _row(f"{name}_another_surface", model, law.single.another_surface, "1", ANOTHER_SURFACE, **fit)
    note = "probability of as much gain by a break that is not there (Davies)"
    yield _row(f"{quantity}_break_p_value", model, law.p_value, "1", note, **fit)
    if law.supported:
        yield _row(f"{name}_above", model, law.high_exponent, "1", "above p*", **fit)
        yield _row(f"{name}_below", model, law.low_exponent, "1", "below p*", **fit)
        note = "p*, where the two laws meet; interval from the bootstrap"
        yield _row(f"{quantity}_break_pressure", model, law.break_x, "Pa", note, **fit)


def _friction_rows(analysis: Analysis) -> Iterator[Row]:
    """Shear stress, and its ratio to the smooth contact's."""
    stress, law = analysis.shear_stress, analysis.velocity_law
    if stress is None:
        return
    n_places = analysis.friction["place"].nunique()
    fit = _fit(stress, "m2", n_places)
    note = "tau0 of Q = tau0 A, least squares through the origin, errors in A and Q"
    yield _row("shear_stress", "measured", stress.stress, "Pa", note, **fit)
    if analysis.stress_ratio is not None:
        note = "tau0 over that of the smooth contact"
        yield _row("shear_stress_ratio", "measured", analysis.stress_ratio, "1", note, **fit)
    if law is not None:
        note = "tau0 ~ v^m, one shear stress at each velocity; 0 where friction does not depend on it"
        fit = _fit(law, "m/s", n_places)
        yield _row("shear_stress_velocity_exponent", "measured", law.exponent, "1", note, **fit)


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
        The numbers of the analysis, results.csv.
    """
    tables = [
        (analysis.area, AREA),
        (analysis.profile, PROFILE),
        (analysis.normalised, NORMALISED),
        (analysis.pressure_law, PRESSURE_LAW),
        *([(analysis.friction, FRICTION)] if len(analysis.friction) else []),
    ]
    for table, schema in tables:
        write_table(table, schema, folder / f"{schema.name}.csv")
    _save(plot_areas(analysis.area, analysis.area_laws), folder, "area")
    normalised = analysis.normalised
    known = normalised["model"].isin(RUN_MODELS) & normalised["pressure_over_hertz"].notna()
    frames = normalised["frame"][known].unique()
    for number, frame in enumerate(frames, start=1):
        part = normalised[normalised["frame"] == frame]
        _save(plot_profile(part), folder, f"profile_{number:0{len(str(len(frames)))}d}")
    for quantity in QUANTITIES if len(analysis.pressure_law) else ():
        ax = plot_pressure_law(analysis.pressure_law, analysis.contact_laws, quantity)
        _save(ax, folder, quantity)
    if analysis.shear_stress is not None:
        _save(plot_friction(analysis.friction, analysis.shear_stress, smooth_stress), folder, "friction")
    results = result_rows(analysis)
    write_table(results, RESULTS, folder / "results.csv")
    return results


def _save(ax: Axes, folder: Path, name: str) -> None:
    """Write a figure with its caption."""
    write_figures(ax, folder, name, caption=caption_of(name))
