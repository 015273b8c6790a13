"""Contacts as CSV files that napari opens as layers: shapes (ellipses) and points with their properties.

napari counts as this package does: rows first, (0, 0) the centre of the top-left pixel.
"""

import csv
import io
from pathlib import Path

import pandas as pd

from contactimg.files.atomic import write_text
from contactimg.tables import flag_names


def write_napari_shapes(contacts: pd.DataFrame, path: Path) -> None:
    """Write the outlines as a shapes layer: an ellipse is given by the four corners around it."""
    rows: list[list[object]] = []
    for index, (x, y, radius) in enumerate(contacts[["x_px", "y_px", "radius_px"]].to_numpy(float).tolist()):
        corners = [(-radius, -radius), (-radius, radius), (radius, radius), (radius, -radius)]
        rows += [[index, "ellipse", vertex, y + dy, x + dx] for vertex, (dy, dx) in enumerate(corners)]
    _write(path, ["index", "shape-type", "vertex-index", "axis-0", "axis-1"], rows)


def write_napari_points(contacts: pd.DataFrame, path: Path) -> None:
    """Write the centres as a points layer, with label, radius, force and flags as properties."""
    columns = ["label", "radius_px", "radius_std_px", "force_N"]
    values = contacts[["y_px", "x_px", *columns]].astype(object)
    cells = values.where(contacts[["y_px", "x_px", *columns]].notna(), "").to_numpy().tolist()
    flags = flag_names(contacts["flags"])
    rows = [[index, *row, names] for index, (row, names) in enumerate(zip(cells, flags, strict=True))]
    _write(path, ["index", "axis-0", "axis-1", *columns, "flags"], rows)


def _write(path: Path, header: list[str], rows: list[list[object]]) -> None:
    """Write a table, whole or not at all."""
    buffer = io.StringIO(newline="")
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    write_text(buffer.getvalue(), path)
