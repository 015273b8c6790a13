"""Closed forms of contact mechanics for a single contact; no files, no images.

In: lengths, forces and moduli in SI units, numbers or arrays. Out: arrays of the same shape. Read ``hertz``
(sphere without adhesion), then ``jkr`` (with adhesion), ``sphere`` (exact spherical profile) and ``layer``
(elastic layer bonded to a rigid support); ``finite_strain`` estimates what all of them leave out. ``checks``
holds the tests of arguments that they share.
"""

from contactimg.mechanics import hertz, jkr, sphere

__all__ = ["hertz", "jkr", "sphere"]
