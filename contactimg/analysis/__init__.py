"""What the contacts of a run say together: area against load, radial profiles, power laws, friction.

In: tables of contacts and frames, measured or predicted. Out: tables, and fitted laws with confidence
intervals. Read in this order:

- ``estimates`` and ``linear_fit``: a number with its interval, and the bootstrap; least squares with errors
on
  both axes for every law that is linear in its parameters;
- ``power_laws``: one exponent, or two and the point where they meet;
- ``load_cell`` and ``area_power_law``: real contact area at each load, and its exponent;
- ``annuli`` and ``radial_profiles``: contacts summed over annuli around the apparent contact's centre, of
places
  and of simulated patterns, and the intervals of few of them;
- ``contacts_against_pressure``: density and mean radius of the contacts against the local pressure;
- ``friction``: shear stress of the real contact, against velocity too; areas in two states;
- ``topography``: heights and radii of asperities.
"""
