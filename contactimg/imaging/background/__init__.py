"""From a frame and its reference to the difference image: the background is found, aligned and divided out.

In: a `contactimg.imaging.pixels.frame_pair.FramePair`. Out: a `DifferenceImage`, zero on the background, with
the illumination, the blocks that are background, and the alignment of the frame with its reference.

Read in this order:

- ``subtract``: the steps with a reference. Which blocks are background and how the illumination
  changed (``find_illumination``, which fits an ``Illumination``); where the frame lies (``align``, and
  ``align_far`` if it lies far away; the result is an ``Alignment``); the reference moved there
  (``resample``); the frame divided by it (``divide``, with its compiled pass ``divide_rows``).
- ``no_reference``: the background of a frame without reference, from the frame itself.
- ``difference_image``: the result.
"""
