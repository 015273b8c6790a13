"""Contact radius and force of one asperity as functions of its penetration, dimensionless (E* = 1).

A law takes arrays of penetrations and `Caps` of the same length. For every axisymmetric profile the stiffness
of a contact is ``dp/d delta = 2 E* a``; the solvers rely on this relation. For other contacts, ellipses and
those on a base, a law returns half the stiffness in place of ``a``.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contactimg.mechanics import sphere

Values = NDArray[np.float64]

_MAX_STEPS = 60
"""Most Newton steps for a contact on a base. A safety limit: four to eight suffice."""


@dataclass(frozen=True, eq=False)
class Caps:
    """The caps that contacts are made of.

    Parameters
    ----------
    radius : ndarray, shape (n,)
        Composite radii of curvature.
    bases : ndarray, shape (n, 2), or None
        Compliance of the base and contact radius that covers it (`CapShapes.bases`); None if every cap is of
        the material that it stands on.
    """

    radius: Values
    bases: Values | None = None

    def __getitem__(self, rows: NDArray[np.intp] | NDArray[np.bool_] | slice) -> "Caps":
        return Caps(self.radius[rows], None if self.bases is None else self.bases[rows])


class AsperityLaw(Protocol):
    """Force and contact radius of separate contacts."""

    def respond(self, penetration: Values, caps: Caps) -> tuple[Values, Values]:
        """Forces over ``E*`` and contact radii at penetrations; zero where these are negative."""


class HertzLaw:
    """Paraboloid: ``a = sqrt(R delta)``, ``p = (4/3) a^3/R``, on its base where that has a compliance."""

    def respond(self, penetration: Values, caps: Caps) -> tuple[Values, Values]:
        """Forces over ``E*`` and contact radii at penetrations; zero where these are negative."""
        depth = np.maximum(penetration, 0.0)
        contact_radius = np.sqrt(caps.radius * depth)
        force = (4 / 3) * contact_radius * depth
        if caps.bases is not None:
            rows = np.flatnonzero((caps.bases[:, 0] != 0) & (depth > 0))
            force[rows], contact_radius[rows] = _on_base(depth[rows], caps.radius[rows], caps.bases[rows])
        return force, contact_radius


def _on_base(depth: Values, radius: Values, bases: Values) -> tuple[Values, Values]:
    """Forces and half stiffnesses of caps on bases that give way: ``delta = a^2/R + (4/3) C a^3/R``.

    From where a contact covers its base on, the cap acts as a flat punch.
    """
    compliance, widest = bases.T
    a = np.sqrt(radius * depth)  # scaled with the known sizes: the root lies below 1 for C > 0
    stiff = compliance > 0
    a[stiff] = np.minimum(a, np.cbrt(0.75 * radius * depth / np.where(stiff, compliance, 1.0)))[stiff]
    deepest = widest**2 / radius * (1 + 4 / 3 * compliance * widest)
    a = np.minimum(a, widest)
    for _ in range(_MAX_STEPS):
        excess = a**2 * (1 + 4 / 3 * compliance * a) - radius * np.minimum(depth, deepest)
        step = excess / (2 * a * (1 + 2 * compliance * a))
        a = np.minimum(a - step, widest)
        if np.all(np.abs(step) <= 1e-15 * 4 * a):
            break
    stiffness = a / (1 + 2 * compliance * a)
    return 4 / 3 * a**3 / radius + 2 * stiffness * np.maximum(depth - deepest, 0.0), stiffness


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

    def respond(self, penetration: Values, caps: Caps) -> tuple[Values, Values]:
        """Forces over ``E*`` and contact radii at penetrations; zero where these are negative."""
        radius = caps.radius
        depth = self.aspect**2 * np.maximum(penetration, 0.0) / radius
        load, ratio = sphere.scaled_response(depth)
        return radius**2 / self.aspect**3 * load, radius / self.aspect * ratio


LAWS = ("hertz", "sphere")


def left_out_for(words: str) -> str:
    """What a prediction with asperities that are not spherical caps of one modulus says of itself."""
    return (
        f"the asperities are {words}: full coupling, adhesion and the sphere's law are not defined for them "
        "and left out"
    )


def asperity_law(name: str, *, aspect: float) -> AsperityLaw:
    """The law of a name, for units with the given aspect (height over length)."""
    return HertzLaw() if name == "hertz" else SphereLaw(aspect)
