"""Memory for images: pages that were used once are used again.

Every step of a measurement takes some arrays of the size of the frame and frees them. The C library of Linux
returns a large freed array to the system, and the next one comes as new pages, which the system must clear:
a tenth of the time of a measurement.
"""

from functools import lru_cache

import numpy as np

LARGEST_KEPT_BYTES = 31 * 2**20
"""Largest array that is kept. Theory: glibc keeps none beyond 32 MB, 8 megapixels in single precision."""


@lru_cache(maxsize=1)
def keep_freed_memory() -> None:
    """Let the process keep up to twice `LARGEST_KEPT_BYTES` that it has freed.

    glibc keeps freed arrays up to the size of the largest that was ever freed: one that is never written to
    tells it. It has no memory of its own, and other C libraries take no notice.
    """
    np.empty(LARGEST_KEPT_BYTES, np.uint8)
