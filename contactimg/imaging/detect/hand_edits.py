"""Corrections by hand to the disks that were found: exclude, add, split, merge."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.pixels.masks import Values
from contactimg.imaging.profile.limits import LONGEST_RADII

REACH_PX = 2.0
"""A contact is meant by a point in it, or within this distance of its centre. Chosen: a hand on a mouse."""
ACTIONS = ("exclude", "add", "split", "merge")
"""What can be done to contacts by hand."""


@dataclass(frozen=True)
class HandEdit:
    """One correction.

    Parameters
    ----------
    action : str
        "exclude", "add", "split" or "merge".
    row : int
        Number of the row of the table that it comes from, from 1.
    x, y, radius : float, px
        The contact that is meant (its place, or the contact to add); NaN where not needed.
    points : tuple of (float, float), px
        Centres of the parts (split; without them along the long axis), or the contacts to merge.
    """

    action: str
    row: int
    x: float = float("nan")
    y: float = float("nan")
    radius: float = float("nan")
    points: tuple[tuple[float, float], ...] = ()


@dataclass(eq=False)
class EditedDisks:
    """Disks after the corrections: first those that stay, then the new ones.

    Parameters
    ----------
    places : ndarray, shape (n, 3)
        x, y, radius (px).
    source : ndarray of int, shape (n,)
        Row before the corrections; -1 for a new disk.
    excluded : ndarray of bool, shape (n,)
        The disk stays to explain its light, but is no contact.
    origin : list of HandEdit or None, n
        The correction that made a disk; None for those that were there.
    unmatched : list of HandEdit
        Corrections that meet no contact.
    """

    places: NDArray[np.float64]
    source: NDArray[np.int64]
    excluded: NDArray[np.bool_]
    origin: list[HandEdit | None]
    unmatched: list[HandEdit] = field(default_factory=list)

    @property
    def new(self) -> NDArray[np.bool_]:
        """The disks that are new."""
        return self.source < 0

    def find(self, x: float, y: float) -> int | None:
        """The disk that a point means; None if there is none."""
        distance = np.hypot(self.places[:, 0] - x, self.places[:, 1] - y)
        reach = np.maximum(self.places[:, 2], REACH_PX)
        ratio = np.where(self.excluded, np.inf, distance / reach)
        return int(ratio.argmin()) if len(ratio) and ratio.min() <= 1.0 else None

    def vanished(self, kept: NDArray[np.intp]) -> list[HandEdit]:
        """Corrections that made a disk which the pixels do not show: its row is not kept."""
        lost = set(np.flatnonzero(self.new).tolist()) - set(kept.tolist())
        return [edit for row, edit in enumerate(self.origin) if row in lost and edit is not None]

    def replace_disks(self, old: Sequence[int], new: NDArray[np.float64], edit: HandEdit) -> None:
        """Remove disks and append others."""
        kept = np.delete(np.arange(len(self.places)), old)
        self.places = np.vstack([self.places[kept], new])
        self.source = np.concatenate([self.source[kept], np.full(len(new), -1)])
        self.excluded = np.concatenate([self.excluded[kept], np.zeros(len(new), np.bool_)])
        self.origin = [self.origin[row] for row in kept] + [edit] * len(new)


def edit_disks(places: NDArray[np.float64], edits: Sequence[HandEdit], image: Values) -> EditedDisks:
    """Apply corrections one after the other.

    Parameters
    ----------
    places : ndarray, shape (n, 3)
        x, y, radius (px).
    edits : sequence of HandEdit
    image : ndarray, shape (rows, columns)
        Difference image, contacts positive: it shows the long axis of a disk to split.

    Examples
    --------
    >>> edits = [HandEdit("exclude", 1, 5.0, 5.0), HandEdit("add", 2, 9.0, 9.0, 2.0)]
    >>> edited = edit_disks(np.array([[5.0, 5.0, 3.0]]), edits, np.zeros((12, 12), np.float32))
    >>> edited.source.tolist(), edited.excluded.tolist()
    ([0, -1], [True, False])
    """
    count = len(places)
    disks = EditedDisks(np.array(places, float), np.arange(count), np.zeros(count, np.bool_), [None] * count)
    for edit in edits:
        change = _change(disks, edit, image)
        if change is None:
            disks.unmatched.append(edit)
        elif edit.action == "exclude" and disks.source[change[0][0]] >= 0:
            disks.excluded[change[0]] = True
        else:
            disks.replace_disks(*change, edit)
    return disks


def _change(
    disks: EditedDisks, edit: HandEdit, image: NDArray[np.float32]
) -> tuple[list[int], NDArray[np.float64]] | None:
    """Rows of the disks that a correction means, and the disks in their place; None if it meets none."""
    if edit.action == "add":
        # a contact drawn in the place of an excluded one explains its light instead of it
        distance = np.hypot(disks.places[:, 0] - edit.x, disks.places[:, 1] - edit.y)
        covered = disks.excluded & (distance < np.maximum(disks.places[:, 2], edit.radius))
        return np.flatnonzero(covered).tolist(), np.array([[edit.x, edit.y, edit.radius]])
    merged = edit.action == "merge"
    found = [disks.find(x, y) for x, y in (edit.points if merged else [(edit.x, edit.y)])]
    rows = sorted({row for row in found if row is not None})
    if None in found or len(rows) < 1 + merged:
        return None
    if edit.action == "exclude":
        return rows, np.empty((0, 3))
    if merged:
        parts = disks.places[rows]
        area = parts[:, 2] ** 2
        return rows, np.append(area @ parts[:, :2] / area.sum(), np.sqrt(area.sum()))[None]
    x, y, radius = disks.places[rows[0]]
    points = np.array(edit.points) if len(edit.points) > 1 else _halves(x, y, radius, image)
    return rows, np.column_stack([points, np.full(len(points), radius / np.sqrt(len(points)))])


def _halves(x: float, y: float, radius: float, image: NDArray[np.float32]) -> NDArray[np.float64]:
    """Centres of the two halves of a disk along the long axis of its light."""
    reach = LONGEST_RADII * radius
    rows = np.arange(max(int(y - reach), 0), min(int(y + reach) + 2, image.shape[0]))
    columns = np.arange(max(int(x - reach), 0), min(int(x + reach) + 2, image.shape[1]))
    light = np.maximum(image[np.ix_(rows, columns)].astype(float), 0.0)
    dx, dy = np.meshgrid(columns - x, rows - y)
    light[np.hypot(dx, dy) > reach] = 0.0
    moments = [float((light * product).sum()) for product in (dx * dx, dx * dy, dy * dy)]
    angle = 0.5 * np.arctan2(2 * moments[1], moments[0] - moments[2])
    step = 0.5 * radius * np.array([np.cos(angle), np.sin(angle)])
    return np.array([x, y]) + np.array([-step, step])


def remark_on(unmatched: Sequence[HandEdit]) -> str:
    """One sentence on corrections that meet no contact; empty if all do."""
    if not unmatched:
        return ""
    texts = [f"row {edit.row} ({edit.action} at {_place(edit)})" for edit in unmatched]
    return f"these edits match no contact: {', '.join(texts)}"


def _place(edit: HandEdit) -> str:
    """The place that an edit points to."""
    places = edit.points if np.isnan(edit.x) else ((edit.x, edit.y),)
    return " and ".join(f"({x:g}, {y:g})" for x, y in places)
