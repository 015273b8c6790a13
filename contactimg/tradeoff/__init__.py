"""Measure how much computing time accuracy costs.

In: a `case.Case` (a scene at a load). Out: a table of errors and times and one sentence per choice. A choice
between settings is called a knob.

Read in this order: `measure` (the knobs of a case), `knobs` (how one is timed), `image_knobs`, `model_knobs`
and `sum_knob` (their settings), `average_models`, `boundary_elements`, `recommendations` (the sentences),
`choice` (the fastest method for a frame).
"""
