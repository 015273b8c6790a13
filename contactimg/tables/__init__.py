"""The tables that flow through contactimg, and every flag and status that can stand in them.

Read in this order: `schemas` (each table with its columns, their dtype, meaning and unit), `flags` (what
qualifies a contact, why a candidate is none), `statuses` (what can be said of a frame or
load as a whole); `outlines` says how contacts are drawn. The schemas, flags, reasons and
statuses can be imported from here.
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
