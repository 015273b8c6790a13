"""Contact radius and force of one asperity as functions of its penetration, dimensionless (E* = 1).

A law takes arrays of penetrations and composite radii of the same shape. For every axisymmetric profile the
stiffness of a contact is ``dp/d delta = 2 E* a``; the solvers rely on this relation.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contactimg.mechanics import sphere

Values = NDArray[np.float64]


class AsperityLaw(Protocol):
    """Force and contact radius of separate axisymmetric contacts."""

    def respond(self, penetration: Values, radius: Values) -> tuple[Values, Values]:
        """Forces over ``E*`` and contact radii at penetrations; zero where these are negative."""


class HertzLaw:
    """Paraboloid: ``a = sqrt(R delta)``, ``p = (4/3) a^3/R``."""

    def respond(self, penetration: Values, radius: Values) -> tuple[Values, Values]:
        """Forces over ``E*`` and contact radii at penetrations; zero where these are negative."""
        depth = np.maximum(penetration, 0.0)
        contact_radius = np.sqrt(radius * depth)
        return (4 / 3) * contact_radius * depth, contact_radius


@dataclass(frozen=True)
class SphereLaw:
    """Exact sphere (Sneddon): ``a`` stays below ``R``.

    Parameters
    ----------
    aspect : float
        Unit of height over unit of length along the surface: a sphere, unlike a paraboloid, changes its
        shape when the two units differ.
    """

    aspect: float

    def respond(self, penetration: Values, radius: Values) -> tuple[Values, Values]:
        """Forces over ``E*`` and contact radii at penetrations; zero where these are negative."""
        depth = self.aspect**2 * np.maximum(penetration, 0.0) / radius
        load, ratio = sphere.scaled_response(depth)
        return radius**2 / self.aspect**3 * load, radius / self.aspect * ratio


LAWS = ("hertz", "sphere")


def asperity_law(name: str, *, aspect: float) -> AsperityLaw:
    """The law of a name, for units with the given aspect (height over length)."""
    return HertzLaw() if name == "hertz" else SphereLaw(aspect)
