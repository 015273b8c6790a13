"""Contact radius and force of one asperity as functions of its penetration, dimensionless (E* = 1).

A law takes arrays of penetrations and `Caps` of the same length. For every axisymmetric profile the stiffness
of a contact is ``dp/d delta = 2 E* a``; the solvers rely on this relation. For other contacts, ellipses and
those on a base, a law returns half the stiffness in place of ``a``.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
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
    bends: ndarray, shape (n, 2), or None
        ``T`` and ``c``: the displacement by the neighbours, averaged over all directions, adds
        ``T rho^2/2 + c rho^4`` to the profile.
    """

    radius: Values
    bases: Values | None = None
    bends: Values | None = None

    def __getitem__(self, rows: NDArray[np.intp] | NDArray[np.bool_] | slice) -> "Caps":
        bases, bends = (None if part is None else part[rows] for part in (self.bases, self.bends))
        return Caps(self.radius[rows], bases, bends)

    @property
    def bending(self) -> Values:
        """Relative change of the curvature at the summits."""
        return np.zeros_like(self.radius) if self.bends is None else self.radius * self.bends[:, 0]

    @property
    def flattest(self) -> Values:
        """Radius of a paraboloid that is nowhere steeper."""
        if self.bends is None:
            return self.radius
        return self.radius / (1 + np.minimum(self.bending, 0.0))


class AsperityLaw(Protocol):
    """Force and contact radius of separate contacts."""

    def respond(self, penetration: Values, caps: Caps) -> tuple[Values, Values]:
        """Forces over ``E*`` and contact radii at penetrations; zero where these are negative."""


class HertzLaw:
    """Paraboloid: ``a = sqrt(R delta)``, ``p = (4/3) a^3/R``, on its base where that has a compliance."""

    def respond(self, penetration: Values, caps: Caps) -> tuple[Values, Values]:
        """Forces over ``E*`` and contact radii at penetrations; zero where these are negative."""
        depth = np.maximum(penetration, 0.0)
        if caps.bends is not None:
            return _bent_paraboloid(depth, caps.radius, caps.bends)
        contact_radius = np.sqrt(caps.radius * depth)
        force = (4 / 3) * contact_radius * depth
        if caps.bases is not None:
            rows = np.flatnonzero((caps.bases[:, 0] != 0) & (depth > 0))
            force[rows], contact_radius[rows] = _on_base(depth[rows], caps.radius[rows], caps.bases[rows])
        return force, contact_radius


def total_response(law: AsperityLaw, penetration: Values, caps: Caps) -> tuple[float, float]:
    """Sums of the forces and of the contact radii at penetrations."""
    if isinstance(law, HertzLaw) and caps.bases is None and caps.bends is None:
        force, contact_radius = _paraboloid_totals(penetration, caps.radius)
    else:
        touching = np.flatnonzero(penetration > 0)
        force, contact_radius = (v.sum() for v in law.respond(penetration[touching], caps[touching]))
    return float(force), float(contact_radius)


@njit(cache=True, fastmath={"reassoc", "contract"})
def _paraboloid_totals(penetration, radius):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """`total_response` of paraboloids."""
    force, contact_radius = 0.0, 0.0
    for i in range(penetration.size):
        depth = max(penetration[i], 0.0)
        a = np.sqrt(radius[i] * depth)
        contact_radius += a
        force += a * depth
    return 4 / 3 * force, contact_radius


def _bent_paraboloid(depth: Values, radius: Values, bends: Values) -> tuple[Values, Values]:
    """Forces and contact radii on ``rho^2/(2 R) + T rho^2/2 + c rho^4``, by Sneddon's integrals.

    ``delta = a^2 (1/R + T) + (8/3) c a^4``, solved for ``a^2``.
    """
    curvature, quartic = 1 / radius + bends[:, 0], bends[:, 1]
    squared = 2 * depth / (curvature + np.sqrt(curvature**2 + 32 / 3 * quartic * depth))
    a = np.sqrt(squared)
    return a * squared * (4 / 3 * curvature + 64 / 15 * quartic * squared), a


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
        if caps.bends is None:
            load, ratio = sphere.scaled_response(depth)
        else:
            curvature, quartic = caps.bends.T
            quartic = quartic * radius**3 / self.aspect**2
            load, ratio = sphere.scaled_bent_response(depth, radius * curvature, quartic)
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
