"""What one asperity does: contact radius and force as functions of its penetration, dimensionless (E* = 1).

A law works on arrays of penetrations and composite radii of one shape. Whatever the axisymmetric profile,
the stiffness of a contact is ``dp/d delta = 2 E* a``; the solvers rely on it.
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contactimg.mechanics import sphere

__all__ = ["HertzLaw", "LocalLaw", "SphereLaw"]

Values = NDArray[np.float64]


class LocalLaw(Protocol):
    """Contact radius and force of separate axisymmetric contacts."""

    def contact_radius(self, penetration: Values, radius: Values) -> Values:
        """Contact radius at penetrations; zero where they are negative."""

    def force(self, contact_radius: Values, radius: Values) -> Values:
        """Force over ``E*`` at contact radii."""


class HertzLaw:
    """Paraboloid: ``a = sqrt(R delta)``, ``p = (4/3) a^3/R``."""

    def contact_radius(self, penetration: Values, radius: Values) -> Values:
        """Contact radius at penetrations; zero where they are negative."""
        return np.sqrt(radius * np.maximum(penetration, 0.0))

    def force(self, contact_radius: Values, radius: Values) -> Values:
        """Force over ``E*`` at contact radii."""
        return (4 / 3) * contact_radius**3 / radius


class SphereLaw:
    """Exact sphere (Sneddon): stiffer profile, ``a`` stays below ``R``."""

    def contact_radius(self, penetration: Values, radius: Values) -> Values:
        """Contact radius at penetrations; zero where they are negative."""
        depth = np.maximum(penetration, 0.0) / radius
        return radius * sphere.scaled_radius(depth)

    def force(self, contact_radius: Values, radius: Values) -> Values:
        """Force over ``E*`` at contact radii."""
        return radius**2 * sphere.scaled_load(contact_radius / radius)
