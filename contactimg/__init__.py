"""contactimg: from contact micrographs to microcontacts, local forces and contact-model overlays.

Conventions
-----------
Images
    Arrays are indexed ``[row, column]``. Pixel centres are integers, ``(0, 0)`` is the centre of the top-left
    pixel, x runs along the columns to the right, y along the rows **down**. The image centre is
    ``((columns-1)/2, (rows-1)/2)``; the camera's ``centre_m`` is the sample point there. In the sample +x
    points right and +y down, unless the camera is mirrored (+y up). ``shift_*_px`` is position in the frame
    minus position in the reference. A threshold is a fraction: level = background + threshold x contrast,
    with one contrast (plateau minus background) a frame.
Units
    Inside Python SI floats, without a unit in the name; only pixel lengths end in ``_px``. A name that leaves
    Python (column, key, option) carries its unit: ``radius_m``, ``force_N``, ``--pixel-size-um``.
Mechanics
    Compression is positive. Heights are positive towards the other body. ``E* = E/(1 - nu^2)`` (rigid
    partner), ``K = 4 E*/3``. The radius in Hertz's law of a contact is the composite one, ``R Rl/(R + Rl)``.
Chance
    Always a `numpy.random.Generator` handed over as ``rng``.
"""

from typing import Any as _Any

import lazy_loader as _lazy

from contactimg.errors import checking_arguments as _checking_arguments

__version__ = "0.1.0"

_load, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)


def __getattr__(name: str) -> _Any:
    """The public object of a name; a function checks the classes of its arguments."""
    loaded = _load(name)
    found = _checking_arguments(loaded, __name__)
    if found is not loaded:
        globals().pop(name, None)  # what the loader keeps does not check them
    return found
