"""Asperities: their tables, and random patterns of them.

In: a table with one row an asperity, or the name of a surface. Out: the table checked, or the summits that a
lens meets. Read in this order: `asperity_table` (what a table may hold, and the composite summits under a
lens), `patterns` (the random patterns SA, RA- and RA+, or caps of any law).
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
