"""Contacts as CSV files that napari opens as layers: shapes (ellipses) and points with their properties.

napari counts as this package does: rows first, (0, 0) the centre of the top-left pixel.
"""

import csv
import io
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.files.atomic import write_text
from contactimg.tables import flag_names
from contactimg.tables.outlines import Outline, contact_outlines


def write_napari_shapes(contacts: pd.DataFrame, outlines: pd.DataFrame, path: Path) -> None:
    """Write the outlines of the contacts of one frame as a shapes layer.

    An ellipse is given by the four corners around it; a free shape is a polygon, each of its holes a path.
    """
    shapes = [shape for outline in contact_outlines(contacts, outlines) for shape in napari_shapes(outline)]
    rows: list[list[object]] = [
        [index, kind, vertex, y, x]
        for index, (kind, points) in enumerate(shapes)
        for vertex, (x, y) in enumerate(points.tolist())
    ]
    _write(path, ["index", "shape-type", "vertex-index", "axis-0", "axis-1"], rows)


def napari_shapes(outline: Outline) -> list[tuple[str, NDArray[np.float64]]]:
    """Napari's shapes for one contact, each its type and points (x, y): the contact, then its holes."""
    if outline.lines:
        holes = [("path", hole) for hole in outline.lines[1:]]
        return [("polygon", outline.lines[0][:-1]), *holes]
    a, b, angle = outline.semi_major, outline.semi_minor, outline.angle
    along = a * np.array([np.cos(angle), np.sin(angle)])
    across = b * np.array([-np.sin(angle), np.cos(angle)])
    corners = np.array([-along - across, along - across, along + across, across - along])
    return [("ellipse", corners + np.array([outline.x, outline.y]))]


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
