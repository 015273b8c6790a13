"""Onset of sliding: shear forces of elastically coupled contacts, and which of them slip first.

In: a table of contacts of one frame or load, the elastic constants and the shear strength. Out: a
`SlidingOnset`, or the shear forces that measured displacements tell.

Read `onset`: contacts that reach their strength one after the other, the displacement of each contact by all
shear forces, and its inverse.
"""
