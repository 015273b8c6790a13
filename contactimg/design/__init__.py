"""Designed surfaces: heights of equal caps whose contact area follows a wanted law of the load.

In: a `WantedLaw` (area, or friction over a shear strength, against load), radius, number and spacing of the
caps, and the elastic constants. Out: a `DesignedSurface` with the table of asperities and the laws.

Read in this order: `laws` (what is wanted), `independent` (the density of heights of caps that do not
displace each other, and whether a law is possible), `refine` (heights corrected until the coupled contacts
follow), `surface` (all of it together).
"""
