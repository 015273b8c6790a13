"""The tables that flow through contactimg, and every flag and status that can stand in them.

Read in this order: `schemas` (each table with its columns, their dtype, meaning and unit; those of asperities
are in `asperity_schemas`, those of `calibrate` in `calibration_schemas`), `flags` (what qualifies a contact),
`reasons` (why a candidate is not a contact), `statuses` (what can be said of a frame or load as a whole). All
names can be imported from here.
"""

from contactimg.tables.asperity_schemas import ASPERITIES, SUMMITS, TOPOGRAPHY
from contactimg.tables.calibration_schemas import CIRCLES, FORCE_SUMS, THRESHOLD_CURVE, UNCERTAINTIES
from contactimg.tables.flags import Flag, flag_names
from contactimg.tables.reasons import Reason
from contactimg.tables.schemas import (
    AREA,
    BOUNDARY_CONTACTS,
    CONTACTS,
    EDITS,
    EFFECTS,
    FRAMES,
    FRICTION,
    LOADS,
    MATCHES,
    NORMALISED,
    OUTLINES,
    PRESSURE_LAW,
    PROFILE,
    REJECTED,
    RESULTS,
    RUN_MODELS,
    SCORES,
    TRADEOFF,
    Schema,
)
from contactimg.tables.statuses import FAILED, NO_RESULT, Status

__all__ = [
    "AREA",
    "ASPERITIES",
    "BOUNDARY_CONTACTS",
    "CIRCLES",
    "CONTACTS",
    "EDITS",
    "EFFECTS",
    "FAILED",
    "FORCE_SUMS",
    "FRAMES",
    "FRICTION",
    "LOADS",
    "MATCHES",
    "NORMALISED",
    "NO_RESULT",
    "OUTLINES",
    "PRESSURE_LAW",
    "PROFILE",
    "REJECTED",
    "RESULTS",
    "RUN_MODELS",
    "SCORES",
    "SUMMITS",
    "THRESHOLD_CURVE",
    "TOPOGRAPHY",
    "TRADEOFF",
    "UNCERTAINTIES",
    "Flag",
    "Reason",
    "Schema",
    "Status",
    "flag_names",
]
