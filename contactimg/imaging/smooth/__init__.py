"""One wide contact of a smooth sphere: its circle to a hundredth of a pixel.

In: the difference image of a frame, the pixel size, the sphere and the lamp. Out: a `find_circle.Circle` with
uncertainties, and how fast the air film around it opens.

Read `find_circle` first (the rough circle, and means of the image along its edge), then `fit_circle` (the fit
of the light across the edge).
"""
