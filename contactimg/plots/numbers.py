"""Numbers as a person writes them: digits as the uncertainty leaves, MPa instead of Pa, no powers of ten."""

from collections.abc import Mapping
from math import floor, isfinite, log10
from typing import Any

import numpy as np
import pandas as pd

from contactimg.analysis.estimates import CoverageEstimate, Estimate

UNCERTAINTY_DIGITS = 2
"""Digits of an uncertainty. Standard: Guide to the expression of uncertainty in measurement, 7.2.6."""
PLAIN_FROM, PLAIN_TO = 1e-4, 1e7
"""Numbers outside are written with a power of ten."""
MOST_DECIMALS = 8
"""Smaller uncertainties are written with a power of ten."""
DISPLAY_UNITS: dict[str, tuple[tuple[float, float, str], ...]] = {
    "Pa": ((1e5, 1e-6, "MPa"), (1e3, 1e-3, "kPa"), (0.0, 1.0, "Pa")),
    "m": ((1e-3, 1e3, "mm"), (0.0, 1e6, "µm")),
    "m2": ((0.0, 1e6, "mm²"),),
    "N": ((0.0, 1e3, "mN"),),
    "J/m^2": ((0.0, 1e3, "mJ/m²"),),
    "deg": ((0.0, 1.0, "°"),),
    "1": ((0.0, 1.0, ""),),
}
"""Unit of a table -> smallest value, factor and unit for display; the first entry that fits is used."""


def plain_number(value: float, *, digits: int = 4) -> str:
    """A number with so many significant digits; four are those of a number without uncertainty.

    Examples
    --------
    >>> plain_number(0.0195), plain_number(3011234.0), plain_number(2.0e-7)
    ('0.0195', '3011000', '2 × 10^-7')
    """
    if not isfinite(value):
        return str(value).replace("inf", "∞")
    value = float(f"{value:.{digits}g}")
    if value and not PLAIN_FROM <= abs(value) < PLAIN_TO:
        power = floor(log10(abs(value)))
        return f"{plain_number(value / 10.0**power, digits=digits)} × 10^{power}"
    return np.format_float_positional(value, trim="-")


def number_with_std(value: float, std: float) -> str:
    """A number with its standard uncertainty.

    Examples
    --------
    >>> number_with_std(3.01345, 0.0212), number_with_std(1520.0, 134.0), number_with_std(1.5, float("nan"))
    ('3.013 ± 0.021', '1520 ± 130', '1.5')
    """
    if not (isfinite(value) and isfinite(std) and std > 0):
        return plain_number(value)
    places = decimals(std)
    if places > MOST_DECIMALS or max(abs(value), std) >= PLAIN_TO:
        return f"{plain_number(value)} ± {plain_number(std, digits=UNCERTAINTY_DIGITS)}"
    return f"{_fixed(value, places)} ± {_fixed(std, places)}"


def number_with_interval(estimate: Estimate | CoverageEstimate, *, factor: float = 1.0) -> str:
    """A number times a factor, and its interval; with too few data for one, it says so.

    Examples
    --------
    >>> number_with_interval(Estimate(0.9481, 0.0123, 0.9216, 0.9746))
    '0.948 (0.922 to 0.975)'
    """
    value, low, high = (factor * number for number in (estimate.value, estimate.low, estimate.high))
    if not (isfinite(low) and isfinite(high)):
        return f"{number_with_std(value, factor * estimate.std)} (no interval)"
    if not high > low:
        return plain_number(value)
    places = decimals((high - low) / 4)
    if places > MOST_DECIMALS or max(abs(low), abs(high)) >= PLAIN_TO:
        ends = plain_number(low), plain_number(high)
        return plain_number(value) if ends[0] == ends[1] else f"{plain_number(value)} ({' to '.join(ends)})"
    return f"{_fixed(value, places)} ({_fixed(low, places)} to {_fixed(high, places)})"


def decimals(std: float) -> int:
    """Decimal places that a number with this uncertainty is written with; negative for tens and hundreds."""
    rounded = float(f"{std:.{UNCERTAINTY_DIGITS - 1}e}")  # 0.0999 has the two digits of 0.10
    return UNCERTAINTY_DIGITS - 1 - floor(log10(rounded))


def _fixed(value: float, places: int) -> str:
    return f"{round(value, places) + 0.0:.{max(places, 0)}f}"  # the sum with 0 has no minus before a zero


def display_unit(value: float, unit: str) -> tuple[float, str]:
    """Factor and unit in which a value is shown.

    Examples
    --------
    >>> display_unit(3.0e6, "Pa"), display_unit(50.0, "Pa"), display_unit(12.5, "px")
    ((1e-06, 'MPa'), (1.0, 'Pa'), (1.0, 'px'))
    """
    choices = DISPLAY_UNITS.get(unit, ((0.0, 1.0, unit),))
    return next(((factor, name) for least, factor, name in choices if abs(value) >= least), choices[-1][1:])


def numbers_of(record: Mapping[str, Any]) -> pd.DataFrame:
    """Make a table of a calibration: one row for each number in the content of its ``calibration.json``."""
    rows = [
        {"quantity": name, "value": entry["value"], "std": entry.get("std"), "unit": entry["unit"]}
        for name, entry in record.items()
        if isinstance(entry, dict) and {"value", "unit"} <= set(entry)
    ]
    return pd.DataFrame(rows, columns=["quantity", "value", "std", "unit"])


def in_display_units(table: pd.DataFrame) -> pd.DataFrame:
    """A table with the columns ``value`` and ``unit`` (and ``std, low, high``) in units for display.

    Examples
    --------
    >>> table = pd.DataFrame({"value": [3.01e6], "std": [2e4], "unit": ["Pa"]})
    >>> in_display_units(table).to_dict("records")
    [{'value': 3.01, 'std': 0.02, 'unit': 'MPa'}]
    """
    shown = [display_unit(value, unit) for value, unit in zip(table["value"], table["unit"], strict=True)]
    factors = pd.Series([factor for factor, _ in shown], index=table.index, dtype=float)
    columns = [name for name in ("value", "std", "low", "high") if name in table]
    scaled = {name: table[name].astype(float) * factors for name in columns}
    return table.assign(**scaled, unit=[unit for _, unit in shown])
