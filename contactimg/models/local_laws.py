"""What one asperity does: contact radius and force as functions of its penetration, dimensionless (E* = 1).

A law works on arrays of penetrations and composite radii of one shape. Whatever the axisymmetric profile,
the stiffness of a contact is ``dp/d delta = 2 E* a``; the solvers rely on it.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contactimg.mechanics import sphere

__all__ = ["LAWS", "HertzLaw", "LocalLaw", "SphereLaw", "local_law"]

Values = NDArray[np.float64]


_EQUATOR = 1 - 2.0**-53
"""Largest a/R below one: the sphere's own radius is reached only at infinite indentation."""


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


@dataclass(frozen=True)
class SphereLaw:
    """Exact sphere (Sneddon): ``a`` stays below ``R``.

    Parameters
    ----------
    aspect : float
        Unit of height over unit of length along the surface; a sphere, unlike a paraboloid, does not keep
        its shape when the two differ.
    """

    aspect: float

    def contact_radius(self, penetration: Values, radius: Values) -> Values:
        """Contact radius at penetrations; zero where they are negative."""
        depth = self.aspect**2 * np.maximum(penetration, 0.0) / radius
        return radius / self.aspect * sphere.scaled_radius(depth)

    def force(self, contact_radius: Values, radius: Values) -> Values:
        """Force over ``E*`` at contact radii."""
        ratio = np.minimum(self.aspect * contact_radius / radius, _EQUATOR)
        return radius**2 / self.aspect**3 * sphere.scaled_load(ratio)


LAWS = ("hertz", "sphere")


def local_law(name: str, *, aspect: float) -> LocalLaw:
    """The law of the given name in units of the given aspect (height over length)."""
    return HertzLaw() if name == "hertz" else SphereLaw(aspect)
