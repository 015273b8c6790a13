"""Brightness of a contact against the distance from its rim.

In: radius and blur, for a film also sphere and light. Out: `blurred_disk.EdgeTable`, for the fit, or
radii at a threshold. Read in this order: `blurred_disk`, `edge_shape` (edges of other shapes), `film_rim`
(with the bright rim of an air film),
`threshold_radius` (where a blurred disk crosses a threshold), `optics` (contrast, blur and halo as a record),
`limits` (the numbers that all steps share: how far an edge reaches, what is significant, what fits).
"""
