"""Summits of a measured height map: their positions, heights and radii of curvature, with uncertainties.

In: a `HeightMap` (heights in m, NaN where nothing was measured). Out: a table of asperities.

Read in this order: `base` (the map, the plane or sphere that the asperities stand on, and the noise), `find`
(the sphere through the top of an asperity, and all summits in order).
"""

from contactimg.summits.base import HeightMap
from contactimg.summits.find import FoundSummits, find_summits

__all__ = ["FoundSummits", "HeightMap", "find_summits"]
