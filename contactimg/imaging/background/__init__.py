"""From a frame and its reference to the difference image: the background is found, aligned and divided out.

In: a `contactimg.imaging.pixels.frame_pair.FramePair`. Out: an `illumination.DifferenceImage`, zero on the
background, with the illumination, the blocks that are background, and the alignment of the frame with its
reference.

Read in this order:

- ``subtract``: the steps with a reference. Which blocks are background and how the illumination
  changed (``find_illumination``, which fits an ``Illumination``); where the frame lies (``register``, with an
  ``Alignment`` as the result), by which the reference is moved; the frame divided by it (``divide``).
- ``no_reference``: the background of a frame without reference, from the frame itself.
- ``even_out``: the last step of both. Flicker, steps, patches and slow waves that no polynomial describes.
  Where it leaves much with a reference, ``no_reference`` estimates the light from the difference image.
"""
