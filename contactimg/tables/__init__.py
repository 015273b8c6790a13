"""The tables that flow through contactimg, and every flag and status that can stand in them.

Read in this order: `schemas` (each table with its columns, their dtype, meaning and unit), `flags` (what
qualifies a contact, why a candidate is none), `statuses` (what can be said of a frame or
load as a whole); `outlines` says how contacts are drawn. The schemas, flags, reasons and
statuses can be imported from here.
"""

from contactimg.tables.flags import Flag, Reason, flag_names
from contactimg.tables.schemas import (
    AREA,
    ASPERITIES,
    CHECK,
    CIRCLES,
    CONTACTS,
    DRAWN,
    EDITS,
    EFFECTS,
    FORCE_SUMS,
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
    SHARED_SHIFTS,
    SUMMITS,
    THRESHOLD_CURVE,
    TOPOGRAPHY,
    TRADEOFF,
    UNCERTAINTIES,
    VARIANTS,
    Schema,
)
from contactimg.tables.statuses import FAILED, NO_RESULT, Status

__all__ = [
    "AREA",
    "ASPERITIES",
    "CHECK",
    "CIRCLES",
    "CONTACTS",
    "DRAWN",
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
    "SHARED_SHIFTS",
    "SUMMITS",
    "THRESHOLD_CURVE",
    "TOPOGRAPHY",
    "TRADEOFF",
    "UNCERTAINTIES",
    "VARIANTS",
    "Flag",
    "Reason",
    "Schema",
    "Status",
    "flag_names",
]
