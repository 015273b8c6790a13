"""Compiled loops of the fit of disks.

In: image, mask, disks, noise, prior and profile table as arrays. Out: sums over pixels, and model images.
Read in this order: `normal_equations` (sums over pixels), `rim_pixels` (which pixels, and the profile there),
`model_image` (disks drawn and erased), `pairs` (disks that overlap), `solve` (the coupled linear system),
`ellipse_equations` (the same of one ellipse), `radial_sums` (residuals against the distance from the centre).
"""
