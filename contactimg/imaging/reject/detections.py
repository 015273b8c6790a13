"""The result of both methods: contacts, rejected candidates with the reason, and the optics they share."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.profile.optics import SharedOptics
from contactimg.imaging.shapes.hand_edits import HandEdit

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


def no_detections(optics: SharedOptics) -> Detections:
    """Of a frame in which nothing stands out: neither contacts nor rejected candidates."""
    nothing = np.empty(0)
    return Detections(
        dict.fromkeys(CONTACT_COLUMNS, nothing), dict.fromkeys((*PLACE, "reason"), nothing), optics, optics
    )
