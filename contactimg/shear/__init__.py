"""Contacts under a tangential load: contacts of a series go in; followed asperities and laws come out.

Read in this order: `laws` (closed forms and fits of contact area, half-axes and friction against tangential
load, and contacts of a model sheared by these laws), `followed` (the contact of each asperity in each frame),
`unseen` (how large a contact may be where none is seen).
"""
