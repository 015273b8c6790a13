"""The outline of each contact as it was measured: a circle, an ellipse, or closed lines."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Line = NDArray[np.float64]
"""Closed line, shape (k, 2): x and y of its points, px; the last is the first again."""


@dataclass(frozen=True, eq=False)
class Outline:
    """Outline of one contact.

    Parameters
    ----------
    label : int
    x, y : float, px
        Centre.
    semi_major, semi_minor : float, px
        Half-axes of the circle or ellipse; of a free shape both the radius of the circle of equal area.
    angle : float, rad
        Of the major axis, from +x towards +y; 0 for a circle.
    lines : tuple of ndarray, shape (k, 2)
        Of a free shape: the outer line, then those of its holes; empty for others.
    """

    label: int
    x: float
    y: float
    semi_major: float
    semi_minor: float
    angle: float = 0.0
    lines: tuple[Line, ...] = ()

    @property
    def polygon(self) -> Line:
        """One closed line about a free shape without its holes: each is joined to the rim by a cut."""
        outer = self.lines[0]
        for hole in self.lines[1:]:
            outer = _joined(outer, hole)
        return outer


def contact_outlines(contacts: pd.DataFrame, outlines: pd.DataFrame | None = None) -> list[Outline]:
    """The outlines of the contacts of one frame.

    Parameters
    ----------
    contacts : DataFrame
        Columns of `contactimg.tables.CONTACTS`; without those of shapes all contacts are disks.
    outlines : DataFrame, optional
        Of the same frame, columns of `contactimg.tables.OUTLINES`.

    Examples
    --------
    >>> contacts = pd.DataFrame({"label": [7], "x_px": [2.0], "y_px": [1.0], "radius_px": [1.5]})
    >>> contact_outlines(contacts)
    [Outline(label=7, x=2.0, y=1.0, semi_major=1.5, semi_minor=1.5, angle=0.0, lines=())]
    """
    lines = dict(_lines(outlines)) if outlines is not None and len(outlines) else {}
    columns = [contacts[name].to_numpy(float) for name in ("label", "x_px", "y_px")]
    rows = np.column_stack([*columns, half_axes(contacts)]).tolist()
    return [
        Outline(int(label), x, y, semi_major, semi_minor, angle, lines.get(int(label), ()))
        for label, x, y, semi_major, semi_minor, angle in rows
    ]


def half_axes(contacts: pd.DataFrame) -> NDArray[np.float64]:
    """Half-axes (px) and angle (rad) of ellipses; of all other contacts the radius twice, and 0.

    Returns
    -------
    ndarray, shape (n, 3)
    """
    radius = contacts["radius_px"].to_numpy(float)
    axes = np.column_stack([radius, radius, np.zeros(len(radius))])
    if "shape" in contacts:
        ellipses = (contacts["shape"] == "ellipse").to_numpy(bool)
        names = ["semi_major_px", "semi_minor_px", "angle_rad"]
        axes[ellipses] = contacts.loc[ellipses, names].to_numpy(float)
    return axes


def _lines(outlines: pd.DataFrame) -> Iterator[tuple[int, tuple[Line, ...]]]:
    """Label and lines of each contact that has any."""
    for label, table in outlines.groupby("label"):
        parts = table.groupby("outline")
        yield int(str(label)), tuple(part[["x_px", "y_px"]].to_numpy(float) for _, part in parts)


def _joined(outer: Line, hole: Line) -> Line:
    """One closed line about what is inside the one and outside the other, which turns the other way."""
    distance = np.hypot(*(outer[:, None] - hole).transpose(2, 0, 1))
    i, j = np.unravel_index(np.argmin(distance), distance.shape)
    around = np.vstack([hole[j:-1], hole[: j + 1]])
    return np.vstack([outer[: i + 1], around, outer[i:]])
