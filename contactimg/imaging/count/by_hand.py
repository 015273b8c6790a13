"""Corrections by hand in the pixel count: the pixels around a changed contact are shared out anew."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.detect.hand_edits import HandEdit, edit_disks
from contactimg.imaging.evidence.rules import PLACE, Columns
from contactimg.imaging.profile.limits import ROUNDS
from contactimg.tables import Flag, Reason


def edit_counts(
    contacts: Columns, edits: Sequence[HandEdit], image: NDArray[np.float32], level: float
) -> tuple[Columns, Columns, list[HandEdit]]:
    """Contacts after the corrections, the excluded ones, and corrections that meet no contact.

    Parameters
    ----------
    contacts : dict of arrays
        Columns x_px, y_px, radius_px, flags.
    edits : sequence of HandEdit
    image : ndarray, shape (rows, columns)
        Difference image, contacts positive.
    level : float
        Pixels above it are counted.
    """
    if not edits:
        return contacts, dict.fromkeys(PLACE, np.empty(0)) | {"reason": np.empty(0, "U1")}, []
    places = np.column_stack([contacts[name] for name in PLACE])
    edited = edit_disks(places, edits, image)
    _, labels, boxes, _ = cv2.connectedComponentsWithStats((image > level).astype(np.uint8), connectivity=8)
    for _ in range(ROUNDS):
        for row in np.flatnonzero(edited.new).tolist():
            edited.places[row] = _count_around(edited.places, row, labels, boxes)
    filled = edited.places[:, 2] > 0
    kept = ~edited.excluded & filled
    source, radius = edited.source[kept], edited.places[kept, 2]
    disk = {"shape": "disk", "semi_major_px": radius, "semi_minor_px": radius, "flags": int(Flag.MANUAL)}
    after = {  # each from its row before; those drawn by hand (-1) are disks
        name: np.where(source < 0, disk.get(name, np.nan), np.resize(values, len(values) + 1)[source])
        for name, values in contacts.items()
    } | dict(zip(PLACE, edited.places[kept].T, strict=True))
    excluded = dict(zip(PLACE, edited.places[edited.excluded].T, strict=True))
    excluded["reason"] = np.full(int(edited.excluded.sum()), Reason.BY_HAND)
    return after, excluded, edited.unmatched + edited.vanished(np.flatnonzero(filled))


def _count_around(
    places: NDArray[np.float64], row: int, labels: NDArray, boxes: NDArray
) -> tuple[float, float, float]:
    """Centroid and radius of the connected pixels that are closer to this contact than to any other.

    Distances are powers ``d^2 - a^2``: two contacts share along the line through the crossings of their rims.
    """
    x, y, radius = places[row].tolist()
    rows, columns = np.ogrid[
        max(int(y - radius), 0) : min(int(y + radius) + 2, labels.shape[0]),
        max(int(x - radius), 0) : min(int(x + radius) + 2, labels.shape[1]),
    ]
    found = np.setdiff1d(labels[rows, columns][np.hypot(columns - x, rows - y) <= max(radius, 1.0)], [0])
    if not (radius > 0 and len(found)):
        return x, y, 0.0
    left, top, width, height = boxes[found, :4].T
    rows, columns = np.ogrid[top.min() : (top + height).max(), left.min() : (left + width).max()]
    mine = np.isin(labels[rows, columns], found)
    power = (columns - x) ** 2 + (rows - y) ** 2 - radius**2
    others = np.delete(places, row, axis=0)
    gap = np.hypot(others[:, 0] - x, others[:, 1] - y) - others[:, 2]
    for other in others[gap < max(mine.shape)]:
        mine &= power <= (columns - other[0]) ** 2 + (rows - other[1]) ** 2 - other[2] ** 2
    if not mine.any():
        return x, y, 0.0
    inside_y, inside_x = np.nonzero(mine)
    centre = float(inside_x.mean() + left.min()), float(inside_y.mean() + top.min())
    return *centre, float(np.sqrt(len(inside_x) / np.pi))
