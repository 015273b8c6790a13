"""Analysis of one or several runs: their folders go in; A(P), profiles, laws and friction come out.

Read in this order: `places` (runs read back, their frames of nearly equal load, and what models see there),
`sheared` (contacts by asperity, and their laws under a tangential load), `analysis` (averages over annuli,
laws, friction; their numbers, tables and figures).
"""
