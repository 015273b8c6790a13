"""How contacts are drawn: the outline of each as it was measured, colours and dashes by their flags.

An outline is a circle, an ellipse, or closed lines. All colours are of the palette of Okabe and Ito, which
colour-blind eyes tell apart; dashes are for eyes and printers without colours.
"""

from dataclasses import asdict, dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.tables.flags import Flag

Line = NDArray[np.float64]
"""Closed line, shape (k, 2): x and y of its points, px; the last is the first again."""

RIM_POINTS = 180
"""Corners of the polygon for an ellipse. Theory: its area is smaller by 2 pi^2/(3 n^2) = 0.02 %."""


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
        """One closed line about the contact without its holes: each is joined to the rim by a cut."""
        if not self.lines:
            turn = 2 * np.pi * np.arange(RIM_POINTS + 1) / RIM_POINTS
            along = np.array([np.cos(self.angle), np.sin(self.angle)])
            rim = np.outer(self.semi_major * np.cos(turn), along)
            rim += np.outer(self.semi_minor * np.sin(turn), [-along[1], along[0]])
            return rim + np.array([self.x, self.y])
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
    lines: dict[object, tuple[Line, ...]] = {}
    for (label, _), part in () if outlines is None else outlines.groupby(["label", "outline"]):
        lines[label] = (*lines.get(label, ()), part[["x_px", "y_px"]].to_numpy(float))
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


def _joined(outer: Line, hole: Line) -> Line:
    """One closed line about what is inside the one and outside the other, which turns the other way."""
    distance = np.hypot(*(outer[:, None] - hole).transpose(2, 0, 1))
    i, j = np.unravel_index(np.argmin(distance), distance.shape)
    around = np.vstack([hole[j:-1], hole[: j + 1]])
    return np.vstack([outer[: i + 1], around, outer[i:]])


# --- how they are drawn

CONTACT_COLOUR, FLAGGED_COLOUR, MANUAL_COLOUR, REJECTED_COLOUR = "#56b4e9", "#f0e442", "#cc79a7", "#d55e00"
"""Colours of contacts, flagged ones, those drawn by hand and rejected candidates."""


@dataclass(frozen=True)
class Kind:
    """How contacts of one kind are drawn.

    Parameters
    ----------
    name : str
    colour : str
        As ``#rrggbb``.
    dashes : tuple of float, px
        Lengths of dash and gap; empty for a full line.
    flags : Flag
        A contact is of the first kind with one of its flags; the last kind has none.
    """

    name: str
    colour: str
    dashes: tuple[float, ...]
    flags: Flag

    @property
    def record(self) -> dict[str, object]:
        """The kind as the page of `review` takes it."""
        return asdict(self) | {"flags": int(self.flags), "flag_names": [flag.name for flag in self.flags]}


_DOUBTFUL = Flag.POOR_FIT | Flag.DISAGREES | Flag.LOW_SIGNAL | Flag.NO_PLATEAU | Flag.COUNTED
KINDS_OF_CONTACTS = (
    Kind("by hand", MANUAL_COLOUR, (), Flag.MANUAL),
    Kind("doubtful", FLAGGED_COLOUR, (8, 4), _DOUBTFUL),
    Kind("cut or not resolved", "#e69f00", (4, 4), Flag.EDGE | Flag.SATURATED | Flag.TOO_SMALL),
    Kind("touching", "#009e73", (14, 4), Flag.MERGED | Flag.OVERLAP),
    Kind("beyond Hertz", CONTACT_COLOUR, (6, 3), Flag.BEYOND_HERTZ),
    Kind("contact", CONTACT_COLOUR, (), Flag(0)),
)
"""Kinds of contacts; one is of the first kind with one of its flags."""
REJECTED_KIND = Kind("rejected", REJECTED_COLOUR, (), Flag(0))
"""How rejected candidates are drawn."""


def kind_of(flags: int) -> Kind:
    """The kind of a contact with these flags."""
    return next(kind for kind in KINDS_OF_CONTACTS if flags & kind.flags or not kind.flags)
