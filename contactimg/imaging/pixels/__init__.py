"""Images as arrays: what every step of the measurement uses.

In: the arrays of a frame and its reference, of any type and depth. Out: a ``FramePair`` in grey levels of
order 100 without holes.

Read in this order: ``frame_pair`` (input and its defects), ``masks`` (pixels that are left out), ``blocks``
(means over blocks), ``binned_image`` (half the resolution), ``robust`` (robust statistics).
"""
