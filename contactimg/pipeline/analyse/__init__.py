"""Analysis of one or several runs: their folders go in; A(P), profiles, laws and friction come out.

Read in this order: `places` (runs read back), `group_by_load` (frames of nearly equal load),
`predicted_places` (the same places as a model sees them), `annulus_averages` (one load averaged over annuli),
`analysis` (everything together), `results_table` (its numbers as rows), `write` (tables and figures).
"""
