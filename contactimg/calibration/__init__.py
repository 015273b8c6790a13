"""From measured series to the constants that forces rest on: modulus, adhesion, threshold.

In: loads with contact radii, force sums or contact areas, one value a frame. Out: each constant with its 95 %
interval. Read in the order of the experiment: ``jkr`` (modulus and work of adhesion from a smooth sphere),
``threshold_and_modulus`` (the optical threshold at which local forces add up to the load; the modulus of
another sample at that threshold), ``area_plateau`` (thresholds for surfaces of unknown radii).
"""
