"""The background of a series, pooled from its frames, in place of the single reference.

Two passes: the frames are measured with the reference as it is; the contacts found are divided out of each
frame, what is left is registered and averaged, the radii are corrected together with it
(`contactimg.imaging.background.pooled`), and every frame is measured again on the mean of the others.

Read in this order: ``second_pass`` (when, and what comes of it), ``looks`` (a frame as a view of the
background), ``anchor`` (the image that the views are placed on), ``pooling`` (their mean), ``measuring`` (a
frame on the mean of the others).
"""
