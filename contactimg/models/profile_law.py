"""Asperities of a stated axisymmetric profile under a lens, as a law for the solvers."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.errors import InputError, ModelRangeError
from contactimg.mechanics.profiles import (
    AxisymmetricProfile,
    PowerLawProfile,
    ProfileUnderLens,
    TabulatedProfile,
)
from contactimg.models.asperity_laws import Caps
from contactimg.scene import Scene

Values = NDArray[np.float64]

_MAX_STEPS = 100
"""Most Newton steps for a contact radius. A safety limit: power laws take one."""


PROFILED = "of a stated profile"
"""What asperities of a stated profile are, in words."""


def stated_profile(scene: Scene) -> AxisymmetricProfile | None:
    """The profile of the asperities that a scene states; None for caps.

    Raises
    ------
    InputError
        If the points of the profile do not increase from (0, 0), or the sample is curved.
    """
    section = scene.asperities
    if section is None or not section.profiled:
        return None
    if scene.sample is not None and not scene.sample.flat:
        raise InputError(
            "[sample] is curved, but asperities of a stated profile stand on a flat; leave it out"
        )
    if section.profile_points is not None:
        return TabulatedProfile(tuple(section.profile_points))
    exponent, width, drop = section.profile_exponent, section.profile_width, section.profile_drop
    if exponent is None or width is None or drop is None:
        return None
    return PowerLawProfile(exponent, width=width, drop=drop)


def pressed_profile(scene: Scene) -> ProfileUnderLens | None:
    """The profile that a scene states, under its lens; None for caps."""
    profile = stated_profile(scene)
    if profile is None:
        return None
    return ProfileUnderLens(profile, np.inf if scene.indenter is None else scene.indenter.radius)


@dataclass(frozen=True)
class ProfileLaw:
    """Force and contact radius of a profile under a lens, without dimensions.

    The slope of the lens shifts the summit as that of a paraboloid of the asperity's radius of curvature.

    Parameters
    ----------
    profile : ProfileUnderLens
    length, depth : float, m
        Units along the surface and of heights.
    """

    profile: ProfileUnderLens
    length: float
    depth: float

    def respond(self, penetration: Values, caps: Caps) -> tuple[Values, Values]:
        """Forces over ``E*`` and contact radii at penetrations; zero where these are negative."""
        force, contact_radius = np.zeros_like(penetration), np.zeros_like(penetration)
        rows = np.flatnonzero(penetration > 0)
        if not rows.size:
            return force, contact_radius
        guess = np.sqrt(caps.radius[rows] * penetration[rows]) * self.length
        a = self._contact_radius(penetration[rows] * self.depth, guess)
        force[rows] = self.profile.force(a) / (self.length * self.depth)
        contact_radius[rows] = a / self.length
        return force, contact_radius

    def _contact_radius(self, depth: Values, guess: Values) -> Values:
        """Contact radius at an indentation: Newton's method between their logarithms."""
        a = guess
        for _ in range(_MAX_STEPS):
            reached = self.profile.indentation(a)
            step = np.log(reached / depth) * reached / (a * self.profile.steepness(a))
            a = a * np.exp(-np.clip(step, -2, 2))
            if np.all(np.abs(step) <= 1e-15 * 8):
                break
        return a

    def check(self, contact_radius: Values, coupling: str) -> None:
        """Refuse full coupling, which is that of Hertz's pressure, and contacts wider than the profile."""
        if coupling in ("hertz", "full"):
            raise InputError(
                f'coupling "{coupling}" is defined for the pressure of paraboloids, not for a stated '
                'profile; take "asymptotic"'
            )
        widest = float(contact_radius.max(initial=0.0))
        if widest > self.profile.widest:
            raise ModelRangeError(
                f"a contact would have a radius of {widest * 1e6:.4g} um, beyond the end of the profile at "
                f"{self.profile.widest * 1e6:.4g} um; lower the load or continue the profile"
            )
