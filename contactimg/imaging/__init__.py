"""From a frame and its reference to a table of contacts.

In: two arrays of grey levels. Out: an `measure.ImageMeasurement`, with contacts, rejected candidates and a
status.

Read `measure` first: its steps are the other packages. `background` subtracts the reference, `reject` finds
the foreground (with `contrast`), `count` or `fit` measures the contacts, `judge` judges the frame. Below
them are `shapes` (where contacts may be), `profile` (a blurred edge), `kernels` (compiled loops of the fit)
and `pixels` (frames, masks, blocks). `smooth` measures the one wide contact of a smooth sphere.
"""
