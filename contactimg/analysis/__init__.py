"""What the contacts of a run say together: area against load, radial profiles, power laws, friction.

In: tables of contacts and frames, measured or predicted. Out: tables, and fitted laws with confidence
intervals. Read in this order:

- ``estimates`` and ``curve_fit``: a number with its interval; least squares with errors on both axes;
- ``power_laws`` and ``broken_power_laws``: one exponent, or two and the point where they meet;
- ``area_against_load``: real contact area at each load, and its exponent;
- ``annuli``, ``weighted_counts`` and ``radial_profiles``: contacts summed over annuli around the apparent
  contact's centre, and the intervals of few of them;
- ``contacts_against_pressure``: density and mean radius of the contacts against the local pressure;
- ``ensemble_annuli``: the same sums for simulated patterns;
- ``spatial_order``: pairs of contacts or asperities at each distance, against random patterns;
- ``friction`` (shear stress of the real contact) and ``sliding`` (against velocity; areas in two states);
- ``topography`` (heights and radii of asperities).
"""
