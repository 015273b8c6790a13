"""Numbers of an analysis as rows: what, its value and interval, over which range, and how it is defined."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from contactimg.analysis.broken_power_laws import BrokenLaw
from contactimg.analysis.estimates import Estimate
from contactimg.analysis.power_laws import PowerLaw
from contactimg.analysis.topography import Topography
from contactimg.pipeline.analyse.analysis import Analysis
from contactimg.tables import RESULTS

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


def _row(quantity: str, model: str, estimate: Estimate, unit: str, **more: Any) -> Row:
    """One number."""
    numbers = {name: getattr(estimate, name) for name in ("value", "std", "low", "high")}
    return {"quantity": quantity, "model": model, "unit": unit, "note": ""} | numbers | more


def _plain(value: float) -> Estimate:
    """A number that has no interval."""
    return Estimate(value, np.nan, np.nan, np.nan)


def _range(law: PowerLaw | BrokenLaw, unit: str) -> Row:
    """Range and number of points of a law."""
    return {
        "confidence": law.confidence,
        "range_low": law.low,
        "range_high": law.high,
        "range_unit": unit,
        "n_points": law.n_points,
    }


def _area_rows(model: str, law: PowerLaw) -> Iterator[Row]:
    """A(P)."""
    fitted = _range(law, "N") | {"n_places": law.n_places}
    source = "scatter between places" if law.n_places > 1 else "stated errors and counting of contacts"
    note = f"A ~ P^m, errors in A and P; interval from {source}"
    yield _row("area_exponent", model, law.exponent, "1", **fitted, note=note)
    note = f"A of that law at {law.reference!r} N, the geometric mean of the loads"
    yield _row("area_at_mean_load", model, law.amplitude, "m2", **fitted, note=note)
    note = "relative scatter of A about the law beyond the stated errors"
    yield _row("area_excess_scatter", model, _plain(law.scatter), "1", **fitted, note=note)


def _contact_rows(quantity: str, model: str, law: BrokenLaw) -> Iterator[Row]:
    """Density or mean radius against the local pressure; two laws only where the points support a break."""
    fitted = _range(law, "Pa") | {"n_places": law.single.n_places}
    name = f"{quantity}_exponent"
    note = f"{quantity} ~ p^m, one law"
    yield _row(name, model, law.single.exponent, "1", **fitted, note=note)
    note = "probability of as much gain by a break that is not there (Davies)"
    yield _row(f"{quantity}_break_p_value", model, _plain(law.p_value), "1", **fitted, note=note)
    if not law.supported:
        return
    yield _row(f"{name}_above", model, law.high_exponent, "1", **fitted, note="above p*")
    yield _row(f"{name}_below", model, law.low_exponent, "1", **fitted, note="below p*")
    note = "p*, where the two laws meet; interval from the profile of chi-square"
    yield _row(f"{quantity}_break_pressure", model, law.break_x, "Pa", **fitted, note=note)


def _friction_rows(analysis: Analysis) -> Iterator[Row]:
    """Shear stress, and its ratio to the smooth contact's."""
    found = analysis.shear_stress
    if found is None:
        return
    fitted = {
        "confidence": found.confidence,
        "range_low": found.low,
        "range_high": found.high,
        "range_unit": "m2",
        "n_points": found.n_points,
        "n_places": analysis.friction["place"].nunique(),
    }
    note = "tau0 of Q = tau0 A, least squares through the origin, errors in A and Q"
    yield _row("shear_stress", "measured", found.stress, "Pa", **fitted, note=note)
    if analysis.stress_ratio is not None:
        note = "tau0 over that of the smooth contact"
        yield _row("shear_stress_ratio", "measured", analysis.stress_ratio, "1", **fitted, note=note)


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
    found = {"confidence": topography.confidence, "n_points": topography.n_points}
    rows = [
        _row("height_over_radius", "measured", topography.slope, "1", **found, note="h/R through the origin"),
        _row(
            "rank_correlation",
            "measured",
            _plain(topography.correlation),
            "1",
            **found,
            note="Spearman, h and R",
        ),
        _row("rank_correlation_p_value", "measured", _plain(topography.p_value), "1", **found),
    ]
    if topography.one_angle:
        angle = topography.contact_angle
        degrees = Estimate(*np.degrees([angle.value, angle.std, angle.low, angle.high]).tolist())
        note = "theta of h = R (1 - cos theta)"
        rows.append(_row("contact_angle", "measured", degrees, "deg", **found, note=note))
    for name in ("height", "radius"):
        mean, std = (getattr(topography, f"{name}_{kind}") for kind in ("mean", "std"))
        error = Estimate(mean, std / np.sqrt(topography.n_points), np.nan, np.nan)
        rows.append(_row(f"{name}_mean", "measured", error, "m", **found))
        rows.append(_row(f"{name}_std", "measured", _plain(std), "m", **found))
    return RESULTS.conform(pd.DataFrame(rows, columns=list(RESULTS.columns)))
