"""Summits of a measured height map: their positions, heights and radii of curvature, with uncertainties.

In: a `HeightMap` (heights in m, NaN where nothing was measured). Out: a table of asperities.

Read in this order: `height_map` (the record), `base` (the plane or sphere that the asperities stand on, and
the noise), `sphere_fit` (the sphere through the top of an asperity), `find` (all summits in order).
"""

from contactimg.summits.find import FoundSummits, SummitSearch, find_summits
from contactimg.summits.height_map import HeightMap

__all__ = ["FoundSummits", "HeightMap", "SummitSearch", "find_summits"]
