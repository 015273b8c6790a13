"""Contact models: from an asperity table and a load to forces, contact radii and mean pressures.

In: a table of asperities (`contactimg.surfaces`) or a height distribution, the radius of the indenter, the
contact modulus and the load or the indentation; SI units. Out: an `InteractingSolution` with one row an
asperity, or a `RingSolution` with averages over rings around the axis.

Read in this order:

- ``solution``, ``convergence`` and ``validity``: what a solved problem is, the checks that its numbers must
  pass, and how far it is from the limits of the models;
- ``interacting``: every contact of a pattern, elastically coupled. Below it ``composite_summits``
  (asperities and lens combined, for all loads), ``scaled_problem`` (removes the dimensions),
  ``asperity_laws`` (one contact), ``coupling`` and ``fast_coupling`` (displacement by the neighbours),
  ``full_coupling`` (their field over the width of a contact), ``newton_iteration``, ``contact_solver`` (puts
  these together);
- ``base_gap``: whether the base planes touch between the asperities; ``surroundings``: what a pattern that
  goes on beyond the table would carry;
- ``dense_balance``: Newton's method for few contacts in one variable each, which the next ones share;
- ``adhesive``: the same with JKR adhesion, along loading and unloading (contacts break and form);
- ``height_distributions``, ``greenwood_williamson``, ``greenwood_tripp``: averages over random surfaces;
- ``ensemble``: many random patterns, one after the other;
- ``hard_cases``: problems whose answers are known from elsewhere, for `contactimg selftest`.
"""
