"""Decide which physical effects matter for a scene, each with the number that decides.

In: a scene, its asperities, a load. Out: a `plan.Plan`, which says of each effect whether it is computed.

Read in this order: `plan` (the decision), `mechanics` and `optics` (by how much the output changes if an
effect is left out), `effect_estimate` (the record both return), `output_change` (how two answers are
compared).
"""
