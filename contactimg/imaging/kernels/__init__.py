"""Compiled loops of the fit of disks.

In: image, mask, starting values, noise, prior and profile table as arrays. Out: fitted disks, uncertainties,
misfit and model image. Read in this order: `normal_equations` (sums over
pixels), `rim_pixels` (which pixels, and the profile there), `pairs` and `disk_union` (disks that overlap),
`solve` (the coupled linear system). `contact_light` sums pixels without a model, for the second opinion.

Numerical constants stand with the loop that uses them; the words for their origin are those of
`contactimg.imaging.fit.settings`.
"""
