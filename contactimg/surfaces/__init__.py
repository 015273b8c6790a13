"""Asperities: their tables, and random patterns of them.

In: a table with one row an asperity, or the name of a surface. Out: the table checked, or the summits that a
lens meets. Read in this order: `asperity_table` (what a table may hold, and the composite summits under a
lens), `patterns` (the random patterns SA, RA- and RA+, or caps of any law).
"""

from contactimg.surfaces.asperity_table import (
    LENGTH_RANGE_M,
    base_radius,
    check_asperities,
    composite_apexes,
    composite_columns,
)
from contactimg.surfaces.patterns import (
    CapLaw,
    DropletCaps,
    GaussianCaps,
    UniformCaps,
    draw_surface,
    generate_asperities,
)

__all__ = [
    "LENGTH_RANGE_M",
    "CapLaw",
    "DropletCaps",
    "GaussianCaps",
    "UniformCaps",
    "base_radius",
    "check_asperities",
    "composite_apexes",
    "composite_columns",
    "draw_surface",
    "generate_asperities",
]
