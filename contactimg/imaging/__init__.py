"""From a frame and its reference to a table of contacts.

In: two arrays of grey levels. Out: a `measure.ImageMeasurement`, with contacts, rejected candidates and a
status.

Read `measure` first: its steps are the other packages. `background` subtracts the reference, `foreground`
collects what is known before contacts are measured, `detect` finds candidates, `fit` or `count` measures
them, `evidence` keeps, flags or rejects each and judges the frame. Below them are `profile` (a blurred edge),
`kernels` (compiled loops of the fit) and `pixels` (frames, masks, blocks, noise). `pooled` takes the
background from the frames of a series together. `smooth` measures the one wide contact of a smooth sphere.
"""
