"""Measure how much computing time accuracy costs.

In: a `knobs.Case` (a scene at a load). Out: a table of errors and times and one sentence per choice. A choice
between settings is called a knob.

Read in this order: `measure` (how the settings of a knob are timed, compared and recommended), `knobs` (the
table of knobs).
"""
