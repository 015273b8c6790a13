"""The result of both methods: contacts, rejected candidates with the reason, and the optics they share."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ellipe

from contactimg.imaging.profile.optics import SharedOptics
from contactimg.imaging.detect.hand_edits import HandEdit

Columns = dict[str, NDArray]
"""Columns of a table, arrays of the same length."""

PLACE = ("x_px", "y_px", "radius_px")
CONTACT_COLUMNS = {
    "x_px": "float64",
    "y_px": "float64",
    "radius_px": "float64",
    "radius_std_px": "float64",
    "flags": "int64",
    "contrast_shift_px": "float64",
    "blur_shift_px": "float64",
    "edge_shift_px": "float64",
}
"""Columns of the contacts, with their types."""

SHAPE_COLUMNS = {
    "shape": "str",
    "area_px2": "float64",
    "area_std_px2": "float64",
    "semi_major_px": "float64",
    "semi_minor_px": "float64",
    "angle_rad": "float64",
    "semi_major_std_px": "float64",
    "semi_minor_std_px": "float64",
    "angle_std_rad": "float64",
    "perimeter_px": "float64",
    "holes": "Int64",
}
"""Further columns of contacts whose shape was asked for, with their types."""


LEAST_RADIUS_SHARE = 0.1
"""Share of a radius that is left when the shift of its edge is taken off. By hand: keeps radii positive."""


@dataclass(frozen=True, eq=False)
class Detections:
    """Contacts and rejected candidates of a frame.

    Parameters
    ----------
    contacts : dict of arrays, shape (n,)
        Columns `CONTACT_COLUMNS`, see `contactimg.tables.CONTACTS`.
    rejected : dict of arrays, shape (m,)
        Columns x_px, y_px, radius_px, reason (`contactimg.tables.Reason`).
    optics : SharedOptics
        Contrast and blur on which the radii are based.
    own_optics : SharedOptics
        The same with the uncertainties that this frame alone gives, without prior knowledge.
    smallest_px : float
        Radius of the smallest contact that the method detects; NaN if that is not known.
    unmatched : sequence of HandEdit
        Corrections by hand that meet no contact.
    unresolved_groups : int
        Groups that no disks explain within the work that a frame may cost, left as they are.
    remark : str
        What to say of the edges of the contacts; empty for plain ones.
    status : str
        Status that these give the frame; empty where they are measured as they are.
    """

    contacts: Columns
    rejected: Columns
    optics: SharedOptics
    own_optics: SharedOptics
    smallest_px: float = float("nan")
    unmatched: Sequence[HandEdit] = ()
    unresolved_groups: int = 0
    remark: str = ""
    status: str = ""


@dataclass(frozen=True, eq=False)
class CountedDetections(Detections):
    """Detections whose radii are those of counted pixels.

    Parameters
    ----------
    rim_blur_px : float
        Blur of the rims, pixel included, for which ``edge_shift_px`` states how far the threshold is off.
    """

    rim_blur_px: float = float("nan")


def no_detections(optics: SharedOptics) -> Detections:
    """Of a frame in which nothing stands out: neither contacts nor rejected candidates."""
    nothing = np.empty(0)
    return Detections(
        dict.fromkeys(CONTACT_COLUMNS, nothing), dict.fromkeys((*PLACE, "reason"), nothing), optics, optics
    )


def without_edge_shift(contacts: Columns, shift_px: float) -> Columns:
    """The contacts with the shift of their edges taken off the radii and half-axes.

    Examples
    --------
    >>> without_edge_shift({"radius_px": np.array([2.0, 0.5])}, 0.5)["radius_px"]
    array([1.5 , 0.05])
    """
    radii = ("radius_px", "semi_major_px", "semi_minor_px")
    moved = {
        name: np.maximum(contacts[name] - shift_px, LEAST_RADIUS_SHARE * contacts[name])
        for name in radii
        if name in contacts
    }
    return contacts | moved


def shape_columns(contacts: Columns) -> Columns:
    """The columns of contacts with those of their shapes: those given, else disks.

    Examples
    --------
    >>> disk = {"radius_px": np.array([2.0]), "radius_std_px": np.array([0.1])}
    >>> shape_columns(disk)["area_px2"].round(3)
    array([12.566])
    """
    radius, std = contacts["radius_px"], contacts["radius_std_px"]
    n, unknown = len(radius), np.full(len(radius), np.nan)
    disks: Columns = {
        "shape": np.full(n, "disk", object),
        "semi_major_px": radius,
        "semi_minor_px": radius,
        "perimeter_px": 2.0 * np.pi * radius,
        "holes": np.zeros(n, np.int64),
    }
    disks |= dict.fromkeys(("angle_rad", "semi_major_std_px", "semi_minor_std_px", "angle_std_rad"), unknown)
    areas = {"area_px2": np.pi * radius**2, "area_std_px2": 2.0 * np.pi * radius * std}
    return {name: values.copy() for name, values in (disks | contacts | areas).items()}


def perimeter_of_ellipse(major: float, minor: float) -> float:
    """Circumference ``4 a E(1 - b^2/a^2)`` of an ellipse.

    Examples
    --------
    >>> round(perimeter_of_ellipse(2.0, 2.0) / np.pi, 6)
    4.0
    """
    return 4.0 * major * float(ellipe(1.0 - (minor / major) ** 2)) if major > 0 else 0.0
