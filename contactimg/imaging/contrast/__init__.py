"""Contrast of the contacts of a frame, and the noise they stand in.

In: a difference image. Out: `plateau.Contrast` (how far the contacts rise above the background),
`noise.Noise` with its correlation, and the polarity.

Read `plateau` first, then `noise`; `polarity` decides whether contacts are bright or dark.
"""
