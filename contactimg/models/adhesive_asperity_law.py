"""Force and penetration of one adhesive asperity, dimensionless (E* = 1): JKR on a paraboloid or a sphere.

For any profile, JKR's state at contact radius ``a`` is the one without adhesion minus that of a flat punch of
the same radius: ``delta = delta_0(a) - sqrt(2 pi w a)``, ``p = p_0(a) - sqrt(8 pi w a^3)``.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.mechanics import sphere
from contactimg.models.asperity_laws import Caps

Values = NDArray[np.float64]

_MAX_STEPS = 60
"""Most steps of a scalar iteration. Theory: a convergence by halves reaches rounding in 53."""


@dataclass(frozen=True)
class AdhesiveLaw:
    """JKR's law in terms of the contact radius.

    Parameters
    ----------
    adhesion : float
        ``w``.
    aspect : float
        Unit of height over unit of length for a sphere; zero for a paraboloid.

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

    def force(self, contact_radius: Values, caps: Caps) -> Values:
        """Force at a contact radius."""
        a, radius = contact_radius, caps.radius
        if self.aspect:
            plain = radius**2 / self.aspect**3 * sphere.scaled_load(self.aspect * a / radius)
        else:
            plain = (4 / 3) * a**3 / radius
        if caps.bends is not None:
            curvature, quartic = caps.bends.T
            plain = plain + a**3 * (4 / 3 * curvature + 64 / 15 * quartic * a**2)
        return plain - np.sqrt(8 * np.pi * self.adhesion * a**3)

    def penetration(self, contact_radius: Values, caps: Caps) -> Values:
        """Penetration at a contact radius."""
        a, radius = contact_radius, caps.radius
        if self.aspect:
            plain = radius / self.aspect**2 * sphere.scaled_indentation(self.aspect * a / radius)
        else:
            plain = a**2 / radius
        if caps.bends is not None:
            curvature, quartic = caps.bends.T
            plain = plain + a**2 * (curvature + 8 / 3 * quartic * a**2)
        return plain - np.sqrt(2 * np.pi * self.adhesion * a)

    def slopes(self, contact_radius: Values, caps: Caps) -> tuple[Values, Values]:
        """Derivatives of force and penetration with the contact radius."""
        a, w = contact_radius, self.adhesion
        steepness = self._steepness(a, caps)
        return 2 * a * steepness - np.sqrt(18 * np.pi * w * a), steepness - np.sqrt(np.pi * w / (2 * a))

    def _steepness(self, a: Values, caps: Caps) -> Values:
        """``d delta_0/d a`` without adhesion."""
        if self.aspect:
            s = self.aspect * a / caps.radius
            steepness = (np.arctanh(s) + s / (1 - s**2)) / self.aspect
        else:
            steepness = 2 * a / caps.radius
        if caps.bends is None:
            return steepness
        curvature, quartic = caps.bends.T
        return steepness + a * (2 * curvature + 32 / 3 * quartic * a**2)

    def widest(self, caps: Caps) -> Values:
        """Upper bound on the contact radius: the equator of the sphere, infinite for a paraboloid."""
        return caps.radius / self.aspect * (1 - 1e-9) if self.aspect else np.full_like(caps.radius, np.inf)

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
                before, a = (
                    a,
                    a * np.cbrt(np.sqrt(np.pi * self.adhesion / (2 * a)) / self._steepness(a, caps)),
                )
                if np.all(np.abs(a - before) <= 1e-12 * a):
                    break
        return a

    def contact_radius(self, penetration: Values, caps: Caps) -> Values:
        """Stable contact radius at a penetration not below that of the fold.

        The penetration is a convex function of the contact radius: Newton's method descends to the larger
        root.
        """
        pulled = np.cbrt(2 * np.pi * self.adhesion * caps.flattest**2)
        a = np.minimum(np.sqrt(caps.flattest * np.maximum(penetration, 0.0)) + pulled, self.widest(caps))
        for _ in range(_MAX_STEPS):
            step = (self.penetration(a, caps) - penetration) / self.slopes(a, caps)[1]
            a = np.minimum(a - step, self.widest(caps))
            if np.all(np.abs(step) <= 1e-14 * a):
                break
        return a

    def _plain(self, caps: Caps) -> bool:
        """Whether the caps are paraboloids, for which there are closed forms."""
        return not self.aspect and caps.bends is None
