"""From measured series to the constants that forces rest on: modulus, adhesion, threshold."""
