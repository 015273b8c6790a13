"""Contacts as layers of other programs: label images, and CSV tables that napari opens.

napari counts as this package does: rows first, (0, 0) the centre of the top-left pixel.
"""

from pathlib import Path

import numpy as np
import pandas as pd
import tifffile
from numpy.typing import NDArray
from skimage.measure import grid_points_in_poly

from contactimg.files.atomic import replacing, write_text
from contactimg.tables import flag_names
from contactimg.tables.outlines import Outline, contact_outlines


def label_image(
    contacts: pd.DataFrame, shape: tuple[int, ...], outlines: pd.DataFrame | None = None
) -> NDArray[np.uint16] | NDArray[np.uint32]:
    """The label of the contact in which the centre of each pixel lies, 0 in none.

    Where contacts overlap, they share along the line through the crossings of their rims. A contact without
    the centre of a pixel gets the nearest pixel. ``outlines``: those of the contacts of free shape.

    Examples
    --------
    >>> contacts = pd.DataFrame({"label": [7], "x_px": [2.0], "y_px": [1.0], "radius_px": [1.1]})
    >>> label_image(contacts, (3, 4)).tolist()
    [[0, 0, 7, 0], [0, 7, 7, 7], [0, 0, 7, 0]]
    """
    highest = int(contacts["label"].max()) if len(contacts) else 0
    labels = np.zeros(shape, np.uint16 if highest < 2**16 else np.uint32)
    power = np.full(shape, np.inf, np.float32)
    for outline in contact_outlines(contacts, outlines):
        window = _window(outline, shape)
        rows, cols = (np.arange(size)[part] for size, part in zip(shape, window, strict=True))
        if not (len(rows) and len(cols)):
            continue
        own = _power(outline, cols, rows)
        mine = (own <= max(0.0, float(own.min()))) & (own < power[window])
        power[window][mine] = own[mine]
        labels[window][mine] = outline.label
    return labels


def _window(outline: Outline, shape: tuple[int, ...]) -> tuple[slice, ...]:
    """Rows and columns of the image that a contact may cover."""
    reach = outline.semi_major
    box = np.array([[outline.x - reach, outline.y - reach], [outline.x + reach, outline.y + reach]])
    if outline.lines:
        box = np.stack([outline.lines[0].min(axis=0), outline.lines[0].max(axis=0)])
    low = np.maximum(np.floor(box[0, ::-1] - 1.0).astype(int), 0)
    high = np.maximum(np.ceil(box[1, ::-1] + 1.0).astype(int) + 1, 0)
    return tuple(slice(int(a), min(int(b), size)) for a, b, size in zip(low, high, shape, strict=True))


def _power(outline: Outline, columns: NDArray[np.intp], rows: NDArray[np.intp]) -> NDArray[np.float64]:
    """Power of each pixel with respect to the outline, px^2: negative inside.

    Of a circle: the squared distance from its centre less the squared radius.
    """
    x, y = columns - outline.x, rows[:, None] - outline.y
    a, b = outline.semi_major, outline.semi_minor
    if outline.lines:
        corner = np.array([rows[0], columns[0]])
        points = outline.polygon[:, ::-1] - corner
        return np.where(grid_points_in_poly((len(rows), len(columns)), points), -a * b, 1.0 + x**2 + y**2)
    cosine, sine = np.cos(outline.angle), np.sin(outline.angle)
    along, across = (cosine * x + sine * y) / a, (cosine * y - sine * x) / b
    return np.asarray(a * b * (along**2 + across**2 - 1.0))


def write_labels(contacts: pd.DataFrame, shape: tuple[int, ...], outlines: pd.DataFrame, path: Path) -> None:
    """Write the label image of one frame as a TIFF, whole or not at all."""
    labels = label_image(contacts, shape, outlines)
    with replacing(path) as part:
        tifffile.imwrite(part, labels, compression="zlib", metadata=None, software=False)


def write_napari_shapes(contacts: pd.DataFrame, outlines: pd.DataFrame, path: Path) -> None:
    """Write the outlines of the contacts of one frame as a shapes layer.

    An ellipse is given by the four corners around it; a free shape is a polygon, each of its holes a path.
    """
    shapes = [shape for outline in contact_outlines(contacts, outlines) for shape in napari_shapes(outline)]
    parts = [
        pd.DataFrame({"index": index, "shape-type": kind, "axis-0": points[:, 1], "axis-1": points[:, 0]})
        for index, (kind, points) in enumerate(shapes)
    ]
    columns = ["index", "shape-type", "vertex-index", "axis-0", "axis-1"]
    rows = [part.rename_axis("vertex-index").reset_index()[columns] for part in parts]
    _write(pd.concat(rows) if rows else pd.DataFrame(columns=columns), path)


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
    layer = contacts[["y_px", "x_px", "label", "radius_px", "radius_std_px", "force_N"]].assign(
        flags=flag_names(contacts["flags"])
    )
    layer = layer.rename(columns={"y_px": "axis-0", "x_px": "axis-1"}).reset_index(drop=True)
    _write(layer.rename_axis("index").reset_index(), path)


def _write(table: pd.DataFrame, path: Path) -> None:
    """Write a table, whole or not at all."""
    write_text(table.to_csv(index=False, lineterminator="\n"), path)
