"""A run as an Excel workbook: one sheet a table, units in the headers, in units that people use."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from openpyxl import Workbook
from openpyxl.cell import WriteOnlyCell
from openpyxl.cell.cell import ILLEGAL_CHARACTERS_RE
from openpyxl.worksheet._write_only import WriteOnlyWorksheet

from contactimg.errors import InputError
from contactimg.files.atomic import replacing
from contactimg.tables import Schema, flag_names

MOST_ROWS = 1_048_576
"""Of a sheet, header included (theory: the limit of Excel)."""

_FORCE, _STRESS = ("mN", 1e3), ("MPa", 1e-6)
UNITS = {
    "um": {"_m": ("µm", 1e6), "_m2": ("µm²", 1e12), "_N": _FORCE, "_Pa": _STRESS},
    "mm": {"_m": ("mm", 1e3), "_m2": ("mm²", 1e6), "_N": _FORCE, "_Pa": _STRESS},
    "m": {"_m": ("m", 1.0), "_m2": ("m²", 1.0), "_N": ("N", 1.0), "_Pa": ("Pa", 1.0)},
}
"""Name of a system of units -> ending of a column's name -> unit, how many are one of the column's."""
_SAME = {"_px": ("px", 1.0), "_px2": ("px²", 1.0), "_rad": ("rad", 1.0)}


def heading(column: str, units: str) -> tuple[str, float]:
    """Header of a column, and the factor of its values.

    Examples
    --------
    >>> heading("radius_std_m", "um"), heading("x_px", "um"), heading("flags", "um")
    (('radius std (µm)', 1000000.0), ('x (px)', 1.0), ('flags', 1.0))
    """
    for ending, (unit, factor) in (UNITS[units] | _SAME).items():
        if column.endswith(ending):
            return f"{column.removesuffix(ending).replace('_', ' ')} ({unit})", factor
    return column.replace("_", " "), 1.0


def write_workbook(
    tables: Sequence[tuple[Schema, pd.DataFrame]], about: Mapping[str, str], path: Path, *, units: str
) -> None:
    """Write tables as a workbook, whole or not at all.

    Parameters
    ----------
    tables : sequence of (Schema, DataFrame)
        One sheet each, in order, then a sheet that explains the columns.
    about : mapping
        What the first sheet says of the run.
    path : Path
        The file, with the extension .xlsx.
    units : {"um", "mm", "m"}
        Units of lengths, areas and forces.

    Raises
    ------
    InputError
        If a table has more rows than a sheet can hold.
    """
    sheets = {"about": pd.DataFrame(about.items(), columns=["", ""])}
    meanings = []
    for schema, table in tables:
        if len(table) >= MOST_ROWS:
            raise InputError(
                f"{path}: {len(table):,} rows of {schema.name} do not fit into a sheet; use the CSV"
            )
        cells = schema.conform(table)
        if "flags" in cells:
            cells = cells.assign(flags=flag_names(cells["flags"]))
        for name, (dtype, meaning) in schema.columns.items():
            head, factor = heading(name, units)
            meanings.append([schema.name, head, name, meaning])
            if dtype == "float64":
                cells[name] *= factor
        sheets[schema.name] = cells.set_axis(
            [heading(name, units)[0] for name in schema.columns], axis="columns"
        )
    sheets["columns"] = pd.DataFrame(meanings, columns=["sheet", "column", "name in the CSV", "meaning"])
    book = Workbook(write_only=True)
    for name, cells in sheets.items():
        _write_sheet(book.create_sheet(name), cells)
    with replacing(path) as part, part.open("wb") as file:
        book.save(file)


def _write_sheet(sheet: WriteOnlyWorksheet, cells: pd.DataFrame) -> None:
    """Write a header that stays in view, and rows below it."""
    sheet.freeze_panes = "A2"
    rows = cells.astype(object).where(cells.notna(), None).to_numpy().tolist()
    for row in [list(cells.columns), *rows]:
        sheet.append([_cell(sheet, value) for value in row])


def _cell(sheet: WriteOnlyWorksheet, value: Any) -> Any:
    """A cell, text as text even if it looks like a formula."""
    if not isinstance(value, str):
        return value
    text = ILLEGAL_CHARACTERS_RE.sub("\ufffd", value.encode("utf-8", "replace").decode())
    cell = WriteOnlyCell(sheet, text)
    cell.data_type = "s"
    return cell
