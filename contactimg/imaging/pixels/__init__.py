"""Images as arrays: what every step of the measurement uses.

In: the arrays of a frame and its reference, of any type and depth. Out: a `frame_pair.FramePair` in grey
levels of order 100 without holes.

Read in this order: `frame_pair` (input and its defects), `field_of_view` (regions without light),
`sensor_defects` (defective pixels, colour mosaics), `masks` (pixels that are left out), `blocks` (means over
blocks), `robust` (robust statistics), `noise` (of the background, with its correlation).
"""
