"""Label images: the pixels of each contact hold its label."""

from pathlib import Path

import numpy as np
import pandas as pd
import tifffile
from numpy.typing import NDArray
from skimage.measure import grid_points_in_poly

from contactimg.files.atomic import replacing
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
