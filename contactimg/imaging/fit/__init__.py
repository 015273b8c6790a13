"""The method "disk": a blurred disk is fitted to each contact.

In: a `contactimg.imaging.reject.foreground.Foreground`, the difference image it comes from, and optionally
the rim that an air film draws. Out: `contactimg.imaging.reject.detections.Detections`.

Read in this order: `method` (the steps), `problem` (the record all steps take), `disks` (one fit of all
disks), `number_of_disks` (how many disks) with `significance`, `covers` and `group_window`,
`residual_light` with `halo`, `shared_optics` (contrast and blur common to all contacts) with
`unseen_contrast`, `quality` (flags and tables). `pooling` combines contrast and blur of a series of frames.
`settings` is the table of the constants that shape the result.
"""
