"""Shapes in a difference image: where contacts may be, and what their outlines tell.

In: a difference image with contacts positive, and a level. Out: tables of components, or disks (x, y,
radius).

Read `components` first (connected components and their sums), then what finds candidates for contacts:
`inscribed_disks` (from above half height), `peaks` (small ones, from residuals) and `arcs` (groups, from
their outline). `overlap` compares disks, `labelled_regions` tells bars from disks, `holes`
measures holes, and `rim_blur` estimates the blur.
"""
