"""The method "disk": a blurred disk is fitted to each contact.

In: a `contactimg.imaging.foreground.Foreground`, and optionally the rim that an air film draws. Out: a
`method.FrameFit`, on whose disks `contactimg.imaging.evidence` decides.

Read in this order: `method` (the steps), `problem` (the record all steps take), `disks` (one fit of all
disks), `assemble` (how many disks) with `split_and_join`, `residual_light` (the halo, and what is left of
the background), `shared_scores` (what contacts say of what they share), `shared_optics` (contrast and blur
common to all contacts) with `unseen_contrast`, `shapes`, `learned_edge` (the edge that the contacts share),
`film_choice` (the rim of an air film), `contact_pixels` (sums over the pixels of each contact). `pooling`
combines contrast and blur of a series of frames.
"""
