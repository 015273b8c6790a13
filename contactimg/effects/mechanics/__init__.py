"""Estimate how much the output changes if an effect of the mechanics is left out.

In: scene, asperities, load. Out: an estimate for each of coupling, full coupling, adhesion, layer and sphere
profile.

Read in this order: `mechanical_effects` (one function per effect), `loaded_scene` (the approximate solution
that they share), `approximate_state` (its solver), `adhesive_contacts`, `neighbour_field`, `solve_cost`.
"""
