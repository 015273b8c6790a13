"""Units in which a person reads a number: MPa instead of Pa, mm² instead of m²."""

from collections.abc import Mapping
from typing import Any

import pandas as pd

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
