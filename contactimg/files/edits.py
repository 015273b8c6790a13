"""Corrections by hand, edits.csv: read and checked, and written."""

import math
from pathlib import Path

import numpy as np
import pandas as pd

from contactimg.errors import InputError
from contactimg.files.corrections import EVERY_FRAME, MaskedArea
from contactimg.files.csv_tables import read_table, write_table
from contactimg.files.imagej import Region
from contactimg.tables import EDITS

EDITS_FILE = "edits.csv"
"""Name of the table of corrections in a folder of frames."""
MASK = "mask"
_FEWEST_POINTS = {"merge": 2, "split": 2, MASK: 3}
_ACTIONS = ("exclude", "add", "split", "merge", MASK)


def read_edits(path: str | Path) -> pd.DataFrame:
    """Read corrections by hand.

    Parameters
    ----------
    path : str or Path
        CSV with the columns of `contactimg.tables.EDITS`; frame and action in every row.

    Returns
    -------
    DataFrame
        Columns of `contactimg.tables.EDITS`, rows in order.

    Raises
    ------
    InputError
        For a missing column, an unknown action, or a row that lacks what its action needs.
    """
    table = read_table(path, EDITS, required=("frame", "action"))
    for name in ("frame", "action"):
        table[name] = table[name].str.strip()
    check_edits(table, str(path))
    return table


def check_edits(table: pd.DataFrame, name: str) -> None:
    """Raise `InputError` for an unknown action or a row that lacks what its action needs."""
    for number, row in enumerate(table.to_dict("records"), start=1):
        complaint = _complaint(row)
        if complaint:
            raise InputError(f"{name}: row {number} ({row['action']}) {complaint}")


def write_edits(table: pd.DataFrame, path: str | Path) -> None:
    """Write corrections by hand, whole or not at all."""
    write_table(table, EDITS, path)


def edit_points(text: str) -> tuple[tuple[float, float], ...]:
    """Points of a cell ``x y;x y;...``.

    Raises
    ------
    ValueError
        If it has another form.

    Examples
    --------
    >>> edit_points("1 2;3.5 4")
    ((1.0, 2.0), (3.5, 4.0))
    """
    points = []
    for pair in filter(None, (part.strip() for part in text.split(";"))):
        x, y = (float(number) for number in pair.split())
        if not (math.isfinite(x) and math.isfinite(y)):
            raise ValueError(text)
        points.append((x, y))
    return tuple(points)


def masked_areas(edits: pd.DataFrame) -> tuple[MaskedArea, ...]:
    """The areas that the edits mask."""
    areas = []
    for row in edits[edits["action"] == MASK].to_dict("records"):
        points = edit_points(row["points"])
        if not points:
            disk = Region("", row["x_px"], row["y_px"], row["radius_px"], row["radius_px"])
            points = tuple((float(x), float(y)) for x, y in disk.outline)
        areas.append(MaskedArea(row["frame"], points=points))
    return tuple(areas)


def _complaint(row: dict) -> str:
    """What a row lacks; empty if nothing."""
    action = row["action"]
    if action not in _ACTIONS:
        return f"has an unknown action; the actions are {', '.join(_ACTIONS)}"
    if not row["frame"]:
        return f"names no frame; give its file name, or {EVERY_FRAME} for all"
    try:
        points = edit_points(row["points"])
    except ValueError:
        return f"must have points of the form 'x y;x y', got {row['points']!r}"
    fewest = _FEWEST_POINTS.get(action, 0)
    if (points and len(points) < fewest) or (action == "merge" and not points):
        return f"needs at least {fewest} points, got {len(points)}"
    place = bool(np.isfinite([row["x_px"], row["y_px"]]).all())
    if action != "merge" and not (place or (action == MASK and points)):
        return "needs x_px and y_px"
    if (action == "add" or (action == MASK and not points)) and not row["radius_px"] > 0:
        return f"needs a positive radius_px, got {row['radius_px']:g}"
    return ""
