"""A second opinion on counted contacts: the light of some of them, against the rims that were counted."""

import numpy as np

from contactimg.imaging.judge.agreement import Agreement, compare_counted
from contactimg.imaging.judge.second_opinion import (
    REGION_BLUR_WIDTHS,
    RING_PX,
    SURROUNDINGS_BLUR_WIDTHS,
    Scenery,
    measure_again,
)
from contactimg.imaging.kernels.pairs import find_pairs
from contactimg.imaging.reject.detections import CountedDetections
from contactimg.tables import Flag

MOST_CONTACTS = 64
"""Contacts that are looked at, evenly among those that stand alone. Chosen, for time: a shift that they share
is then known to an eighth of its scatter."""
LARGEST_ELONGATION = 1.2
"""Half-axis of the ellipse with the same moments over the radius, above which the pixels around a contact are
not laid out for its light. Chosen: a fifth of the radius is less than a blur for most."""


def compare_some(scenery: Scenery, detections: CountedDetections) -> Agreement:
    """Compare the light of some contacts that stand alone with their areas behind the counted rims."""
    contacts, blur = detections.contacts, detections.rim_blur_px
    true = contacts["radius_px"] - contacts["edge_shift_px"]
    disks = np.column_stack([contacts["x_px"], contacts["y_px"], true])
    usable = contacts["semi_major_px"] < LARGEST_ELONGATION * np.maximum(contacts["radius_px"], 1.0)
    usable &= (contacts["flags"] & int(Flag.MERGED | Flag.EDGE | Flag.SATURATED)) == 0
    near = (REGION_BLUR_WIDTHS + SURROUNDINGS_BLUR_WIDTHS) * blur + RING_PX
    usable[find_pairs(disks, near / 2).ravel()] = False
    rows = np.flatnonzero(usable)
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), MOST_CONTACTS)).astype(int)]
    area, std = np.full((2, len(disks)), np.nan)
    relative = 0.0
    if len(rows):
        opinion = measure_again(scenery, disks[rows], blur_px=blur)
        area[rows], std[rows] = opinion.light_area, opinion.light_area_std
        relative = float(np.nan_to_num(opinion.common_contrast_std / opinion.common_contrast))
    return compare_counted((area, std), contacts, contrast_relative_std=relative)
