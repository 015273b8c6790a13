"""A background pooled from several frames, each place in the frames that show it.

In: frames, an anchor image (the reference, say) and the contacts of the frames. Out: sums, from which the
background for each frame follows without that frame itself: its own noise would cancel in the difference.

Read in this order: ``views`` (a frame in the coordinates and in the light of the anchor), ``agreement``
(where the views contradict each other), ``sums`` (their mean), ``rims`` (contacts that were divided out:
their radii follow together with the background), ``references`` (the mean of several references).
"""
