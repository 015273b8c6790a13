"""The paper's calibrations: a folder of frames in; numbers with uncertainties, tables and figures out.

`jkr`: the contact circle of every frame of the smooth contact, and Young's modulus and work of adhesion from
them. `thresholds`: area and force sum of every frame of rough contacts at many thresholds, the plateau of
thresholds between which the area falls most slowly, the threshold at which the forces add up to the load, the
modulus at which they do.
"""
