"""Decide which physical effects matter for a scene, each with the number that decides.

In: a scene, its asperities, a load. Out: a `plan.Plan`, which says of each effect whether it is computed.

Read in this order: `plan` (the decision, and what no switch decides), `solve_without` and
`render_without` (by how much the output changes if a mechanical or an optical effect is left out),
`output_change` (how two answers are compared, and the record that both return), `local_law` (the law of a
single contact).
"""
