"""Estimate how much the measured output changes if an effect of optics or sensor is left out.

In: a scene with the section ``[simulate]`` and its contacts. Out: an estimate for each effect, from blur to
dust.

Read in this order: `optical_effects` (the list), `edge_effects`, `illumination_effects` and `sensor_effects`
(one function per effect), `sample_comparison` (the frame with and without an effect), `sample_image` (a small
image of some of the contacts) and `sample_measurement` (the contacts measured on it), `render_cost`.
"""
