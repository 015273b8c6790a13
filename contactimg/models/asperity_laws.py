"""Contact radius, force and penetration of one asperity, dimensionless (E* = 1): Hertz, sphere, layer, JKR.

A law takes arrays of penetrations and `Caps` of the same length. For every axisymmetric profile the stiffness
of a contact is ``dp/d delta = 2 E* a``; the solvers rely on this relation. For contacts on a layer a law
returns half the stiffness in place of ``a``.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contactimg.mechanics import sphere
from contactimg.mechanics.layer import LARGEST_RATIO, factor_table

Values = NDArray[np.float64]

_MAX_STEPS = 60
"""Most steps of a scalar iteration. Theory: a convergence by halves reaches rounding in 53; Newton's
method takes four to eight."""


@dataclass(frozen=True, eq=False)
class Caps:
    """The caps that contacts are made of.

    Parameters
    ----------
    radius : ndarray, shape (n,)
        Composite radii of curvature.
    bends: ndarray, shape (n, 2), or None
        ``T`` and ``c``: the displacement by the neighbours, averaged over all directions, adds
        ``T rho^2/2 + c rho^4`` to the profile.
    """

    radius: Values
    bends: Values | None = None

    def __getitem__(self, rows: NDArray[np.intp] | NDArray[np.bool_] | slice) -> "Caps":
        return Caps(self.radius[rows], None if self.bends is None else self.bends[rows])

    @property
    def flattest(self) -> Values:
        """Radius of a paraboloid that is nowhere steeper."""
        if self.bends is None:
            return self.radius
        return self.radius / (1 + np.minimum(self.radius * self.bends[:, 0], 0.0))


class AsperityLaw(Protocol):
    """Force and contact radius of separate contacts."""

    def respond(self, penetration: Values, caps: Caps) -> tuple[Values, Values]:
        """Forces over ``E*`` and contact radii at penetrations; zero where these are negative."""


class HertzLaw:
    """Paraboloid: ``a = sqrt(R delta)``, ``p = (4/3) a^3/R``."""

    def respond(self, penetration: Values, caps: Caps) -> tuple[Values, Values]:
        """Forces over ``E*`` and contact radii at penetrations; zero where these are negative."""
        depth = np.maximum(penetration, 0.0)
        if caps.bends is not None:
            # Sneddon: delta = a^2 (1/R + T) + (8/3) c a^4 on rho^2/(2 R) + T rho^2/2 + c rho^4
            curvature, quartic = 1 / caps.radius + caps.bends[:, 0], caps.bends[:, 1]
            squared = 2 * depth / (curvature + np.sqrt(curvature**2 + 32 / 3 * quartic * depth))
            force = np.sqrt(squared) * squared * (4 / 3 * curvature + 64 / 15 * quartic * squared)
            return force, np.sqrt(squared)
        contact_radius = np.sqrt(caps.radius * depth)
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


def asperity_law(name: str, *, aspect: float) -> AsperityLaw:
    """The law of a name, for units with the given aspect (height over length)."""
    return HertzLaw() if name == "hertz" else SphereLaw(aspect)


@dataclass(frozen=True)
class AdhesiveLaw:
    """JKR's law in terms of the contact radius.

    Parameters
    ----------
    adhesion : float
        ``w``.
    aspect : float
        Unit of height over unit of length for a sphere; zero for a paraboloid.
    thickness : float
        Of the layer: factors of `contactimg.mechanics.layer` act on the parts with and without
        adhesion of force and penetration. Exact for a paraboloid. Infinite for a half-space.
    poisson_ratio : float
        Of the layer.

    References
    ----------
    Maugis, Langmuir 11 (1995) 679, doi:10.1021/la00002a055, for the sphere's exact profile.

    Examples
    --------
    Contacts of zero penetration have ``a^3 = 2 pi w R^2``:

    >>> law = AdhesiveLaw(0.5)
    >>> cap = Caps(np.ones(1))
    >>> a = law.touch_radius(cap)
    >>> round(float(a[0] ** 3 / np.pi), 9), abs(float(law.penetration(a, cap)[0])) < 1e-12
    (1.0, True)
    """

    adhesion: float
    aspect: float = 0.0
    thickness: float = np.inf
    poisson_ratio: float = 0.5

    def force(self, contact_radius: Values, caps: Caps) -> Values:
        """Force at a contact radius."""
        pressing, pull, _, _ = self._parts(contact_radius, caps)[0]
        return pressing - pull

    def penetration(self, contact_radius: Values, caps: Caps) -> Values:
        """Penetration at a contact radius."""
        _, _, depth, rise = self._parts(contact_radius, caps)[0]
        return depth - rise

    def slopes(self, contact_radius: Values, caps: Caps) -> tuple[Values, Values]:
        """Derivatives of force and penetration with the contact radius."""
        pressing, pull, depth, rise = self._parts(contact_radius, caps)[1]
        return pressing - pull, depth - rise

    def _parts(self, a: Values, caps: Caps) -> tuple[Values, Values]:
        """Force and penetration at a radius ``a``, and their derivatives; shape (4, n) each.

        Both as the part without adhesion and that by which adhesion lowers it.
        """
        w, (force, depth, steepness) = self.adhesion, self._profile(a, caps)
        parts = np.stack([force, np.sqrt(8 * np.pi * w * a**3), depth, np.sqrt(2 * np.pi * w * a)])
        pull, rise = np.sqrt(18 * np.pi * w * a), np.sqrt(np.pi * w / (2 * a))
        slopes = np.stack([2 * a * steepness, pull, steepness, rise])
        if np.isinf(self.thickness):
            return parts, slopes
        ratio, table = np.minimum(a / self.thickness, LARGEST_RATIO), factor_table(self.poisson_ratio)
        factors, growth = table(ratio).T, table(ratio, 1).T / self.thickness
        return factors * parts, factors * slopes + growth * parts

    def _profile(self, a: Values, caps: Caps) -> tuple[Values, Values, Values]:
        """Force, penetration and its derivative without adhesion on a half-space."""
        radius = caps.radius
        if self.aspect:
            s = self.aspect * a / radius
            force = radius**2 / self.aspect**3 * sphere.scaled_load(s)
            depth = radius / self.aspect**2 * sphere.scaled_indentation(s)
            steepness = (np.arctanh(s) + s / (1 - s**2)) / self.aspect
        else:
            force, depth, steepness = (4 / 3) * a**3 / radius, a**2 / radius, 2 * a / radius
        if caps.bends is None:
            return force, depth, steepness
        curvature, quartic = caps.bends.T
        force = force + a**3 * (4 / 3 * curvature + 64 / 15 * quartic * a**2)
        depth = depth + a**2 * (curvature + 8 / 3 * quartic * a**2)
        return force, depth, steepness + a * (2 * curvature + 32 / 3 * quartic * a**2)

    def widest(self, caps: Caps) -> Values:
        """Upper bound on the contact radius: the equator of a sphere, two thicknesses of a layer."""
        equator = caps.radius / self.aspect * (1 - 1e-9) if self.aspect else np.full_like(caps.radius, np.inf)
        return np.minimum(equator, LARGEST_RATIO * self.thickness)

    def touch_radius(self, caps: Caps) -> Values:
        """Contact radius at zero penetration, to which a contact jumps when it forms."""
        if self._plain(caps):
            return np.cbrt(2 * np.pi * self.adhesion * caps.radius**2)
        return self.contact_radius(np.zeros_like(caps.radius), caps)

    def fold(self, caps: Caps) -> Values:
        """Contact radius at which an isolated contact breaks under an imposed displacement."""
        a = np.minimum(np.cbrt(np.pi * self.adhesion * caps.flattest**2 / 8), 0.9 * self.widest(caps))
        if not self._plain(caps):
            # solve steepness(a) = sqrt(pi w/(2 a)) by a fixed point from above: the paraboloid is less steep
            for _ in range(_MAX_STEPS):
                _, _, steepness, rise = self._parts(a, caps)[1]
                before, a = a, a * np.cbrt(rise / steepness)
                if np.all(np.abs(a - before) <= 1e-12 * a):
                    break
        return a

    def contact_radius(self, penetration: Values, caps: Caps) -> Values:
        """Stable contact radius at a penetration not below that of the fold.

        The penetration is a convex function of the contact radius: Newton's method descends to the larger
        root.
        """
        pulled = np.cbrt(2 * np.pi * self.adhesion * caps.flattest**2)
        shallow = 1.0 if np.isinf(self.thickness) else factor_table(self.poisson_ratio)(LARGEST_RATIO)[2]
        pressed = np.sqrt(caps.flattest * np.maximum(penetration, 0.0) / shallow)
        a = np.minimum(pressed + pulled, self.widest(caps))
        for _ in range(_MAX_STEPS):
            step = (self.penetration(a, caps) - penetration) / self.slopes(a, caps)[1]
            a = np.minimum(a - step, self.widest(caps))
            if np.all(np.abs(step) <= 1e-14 * a):
                break
        return a

    def _plain(self, caps: Caps) -> bool:
        """Whether the caps are paraboloids, for which there are closed forms."""
        return not self.aspect and caps.bends is None and np.isinf(self.thickness)


@dataclass(frozen=True)
class LayerLaw:
    """Contacts without adhesion on a bonded layer, as a law of the penetration.

    Parameters
    ----------
    contact : AdhesiveLaw
        Of the layer, with ``adhesion`` 0.
    """

    contact: AdhesiveLaw

    def respond(self, penetration: Values, caps: Caps) -> tuple[Values, Values]:
        """Forces over ``E*`` and half the stiffnesses at penetrations; zero where these are negative.

        A contact of the widest radius is a flat punch from there on, so that every load has a solution.
        """
        force, half_stiffness = np.zeros_like(penetration), np.zeros_like(penetration)
        rows = np.flatnonzero(penetration > 0)
        touching = caps[rows]
        a = self.contact.contact_radius(penetration[rows], touching)
        slope, steepness = self.contact.slopes(a, touching)
        beyond = np.maximum(penetration[rows] - self.contact.penetration(a, touching), 0.0)
        beyond[a < self.contact.widest(touching)] = 0.0
        half_stiffness[rows] = 0.5 * slope / steepness
        force[rows] = self.contact.force(a, touching) + 2 * half_stiffness[rows] * beyond
        return force, half_stiffness

    def contact_radius(self, penetration: Values, caps: Caps) -> Values:
        """Contact radii at penetrations; zero where these are negative."""
        result = np.zeros_like(penetration)
        rows = np.flatnonzero(penetration > 0)
        result[rows] = self.contact.contact_radius(penetration[rows], caps[rows])
        return result
