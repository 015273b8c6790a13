"""The paper's calibrations: a folder of frames in; numbers with uncertainties, tables and figures out.

Read in this order. For the smooth contact: `circles` (the contact circle of every frame), `jkr` (Young's
modulus and work of adhesion from them). For rough contacts: `threshold_scan` (area and force sum of every
frame at many thresholds), `force_sums` (the plateau of thresholds between which the area hardly changes, the
threshold at which the forces add up to the load, the modulus at which they do). `result` is what each returns
and how it is written.
"""
