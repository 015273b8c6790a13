"""Compute how the optics and the sensor image a contact.

In: contacts in pixels and the settings of a scene. Out: light and grey levels on the pixels.

Read in this order: `render_settings` (which effects are rendered), `spots` (contacts and their outlines to
light on the pixels), `coverage`, `film` and `wide_edge` (the edge of a contact), `psf` (blur),
`synthetic_background` (texture, dust, vignetting), `sensor` (noise, quantisation, saturation, response).
"""
