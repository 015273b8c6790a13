"""Measure how much computing time accuracy costs.

In: a `knobs.Case` (a scene at a load). Out: a table of errors and times and one sentence per choice. A choice
between settings is called a knob.

Read in this order: `measure` (how the settings of a knob are timed and compared), `knobs` (the table of
knobs), `measured_disks`, `recommendations` (the sentences), `choice` (the fastest method for a frame).
"""
