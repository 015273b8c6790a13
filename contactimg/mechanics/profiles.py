"""Axisymmetric indenters of any profile on an elastic half-space (Galin, Sneddon): power law and table.

With the profile ``z = f(r)`` and the contact radius ``a``: ``delta = a int_0^a f'(r)/sqrt(a^2 - r^2) dr`` and
``P = 2 E* int_0^a r^2 f'(r)/sqrt(a^2 - r^2) dr``. Both are linear in ``f``, and ``dP/d delta = 2 E* a``.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.special import gamma

from contactimg.errors import InputError

Values = NDArray[np.float64]

FEWEST_POINTS = 4
"""Points of a tabulated profile. Chosen: fewer leave its curvature open."""


@runtime_checkable
class AxisymmetricProfile(Protocol):
    """The shape of an asperity as a solver needs it: three functions of the contact radius (m)."""

    @property
    def widest(self) -> float:
        """Largest contact radius that the profile describes, m."""

    def indentation(self, radius: Values) -> Values:
        """``delta``, m; it must increase with the radius."""

    def force(self, radius: Values) -> Values:
        """The force over ``E*`` at a contact radius, m^2."""

    def steepness(self, radius: Values) -> Values:
        """The slope ``d delta/d a`` at a contact radius."""


@dataclass(frozen=True)
class PowerLawProfile:
    """``z = drop (r/width)^n``: a cone (1), a paraboloid (2), flatter summits beyond.

    ``delta = kappa z(a)`` with ``kappa = sqrt(pi) Gamma(n/2 + 1)/Gamma((n + 1)/2)``, and
    ``P = 2 E* n/(n + 1) a delta``.

    Parameters
    ----------
    exponent : float
        ``n``, positive.
    width, drop : float, m
        The profile lies ``drop`` below its summit at the distance ``width`` from its axis.

    References
    ----------
    Sneddon, Int. J. Engng Sci. 3 (1965) 47, doi:10.1016/0020-7225(65)90019-4, eqs (6.1) to (6.3).

    Examples
    --------
    >>> cone = PowerLawProfile(1.0, width=1e-5, drop=1e-6)
    >>> a = np.array([1e-5])
    >>> (cone.indentation(a) / 1e-6 * 2 / np.pi).round(12)
    array([1.])
    """

    exponent: float
    width: float
    drop: float

    def __post_init__(self) -> None:
        for name in ("exponent", "width", "drop"):
            if not 0 < getattr(self, name) < np.inf:
                raise InputError(f"{name} of a profile must be positive, got {getattr(self, name)!r}")

    @property
    def widest(self) -> float:
        """Largest contact radius that the profile describes, m."""
        return np.inf

    @cached_property
    def _kappa(self) -> float:
        n = self.exponent
        return float(np.sqrt(np.pi) * gamma(n / 2 + 1) / gamma((n + 1) / 2))

    def indentation(self, radius: Values) -> Values:
        """The indentation ``delta`` at a contact radius, m."""
        return self._kappa * self.drop * (radius / self.width) ** self.exponent

    def force(self, radius: Values) -> Values:
        """The force over ``E*`` at a contact radius, m^2."""
        n = self.exponent
        return 2 * n / (n + 1) * radius * self.indentation(radius)

    def steepness(self, radius: Values) -> Values:
        """The slope ``d delta/d a`` at a contact radius."""
        return self.exponent * self.indentation(radius) / radius


@dataclass(frozen=True)
class TabulatedProfile:
    """A measured profile: distances from the axis and drops below the summit, between which it is monotone.

    Sneddon's integrals are evaluated exactly for the piecewise cubic (PCHIP) through the table.

    Parameters
    ----------
    points : tuple of (float, float), m
        Distance and drop, both increasing from (0, 0); four points or more.

    Examples
    --------
    >>> r = np.linspace(0, 5e-5, 201)
    >>> profile = TabulatedProfile(tuple(zip(r, r**2 / 2e-4)))  # a paraboloid of radius 0.1 mm
    >>> a = np.array([3e-5])
    >>> (profile.indentation(a) / (a**2 / 1e-4)).round(4), (profile.force(a) / (4 * a**3 / 3e-4)).round(4)
    (array([1.]), array([1.]))
    """

    points: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        table = np.asarray(self.points, dtype=float)
        fine = table.ndim == 2 and len(table) >= FEWEST_POINTS and np.isfinite(table).all()
        if not (fine and not table[0].any() and (np.diff(table, axis=0) > 0).all()):
            raise InputError(
                f"a profile needs {FEWEST_POINTS} or more points of distance and drop (m), both increasing "
                f"from (0, 0), got {self.points!r}"
            )

    @property
    def widest(self) -> float:
        """Largest contact radius that the profile describes, m."""
        return float(self.points[-1][0])

    @cached_property
    def _slopes(self) -> tuple[Values, Values]:
        """Knots, and coefficients of the slope between them: ``f' = b0 + b1 r + b2 r^2``; linear beyond."""
        r, drop = np.asarray(self.points, dtype=float).T
        cubic = PchipInterpolator(r, drop)
        c3, c2, c1 = cubic.c[0], cubic.c[1], cubic.c[2]
        at = r[:-1]
        b = np.stack([c1 - 2 * c2 * at + 3 * c3 * at**2, 2 * c2 - 6 * c3 * at, 3 * c3])
        last = np.array([[float(cubic(r[-1], 1))], [0.0], [0.0]])
        return np.append(r, np.inf), np.hstack([b, last])

    def _moments(self, radius: Values) -> Values:
        """``int r^j/sqrt(a^2 - r^2) dr``, j from 0 to 4, over the part of each interval inside ``a``."""
        a = np.asarray(radius, dtype=float)[:, None]
        r = np.minimum(self._slopes[0], a)
        root, angle = np.sqrt(a**2 - r**2), np.arcsin(r / a)
        antiderivatives = (
            angle,
            -root,
            (a**2 * angle - r * root) / 2,
            root**3 / 3 - a**2 * root,
            3 * a**4 / 8 * angle - r * root / 8 * (2 * r**2 + 3 * a**2),
        )
        return np.stack([np.diff(values, axis=1) for values in antiderivatives])

    def indentation(self, radius: Values) -> Values:
        """The indentation ``delta`` at a contact radius, m."""
        m = self._moments(radius)
        return np.asarray(radius) * np.einsum("js,jas->a", self._slopes[1], m[:3])

    def force(self, radius: Values) -> Values:
        """The force over ``E*`` at a contact radius, m^2."""
        return 2 * np.einsum("js,jas->a", self._slopes[1], self._moments(radius)[2:])

    def steepness(self, radius: Values) -> Values:
        """``d delta/d a``: ``delta/a + int r f''/sqrt(a^2 - r^2) dr``."""
        m, b = self._moments(radius), self._slopes[1]
        bent = m[1] @ b[1] + 2 * m[2] @ b[2]
        return np.einsum("js,jas->a", b, m[:3]) + bent


@dataclass(frozen=True)
class ProfileUnderLens:
    """An asperity and the paraboloid of the lens that presses on it: Sneddon's integrals add up.

    Parameters
    ----------
    profile : AxisymmetricProfile
        Of the asperity.
    indenter_radius : float, m
        Of the lens; infinite for a flat.

    Examples
    --------
    >>> cap = PowerLawProfile(2.0, width=1e-4, drop=5e-5)  # a paraboloid of radius 0.1 mm
    >>> both = ProfileUnderLens(cap, indenter_radius=1e-4)  # acts as one of 0.05 mm
    >>> both.indentation(np.array([1e-5])) * 5e-5 / 1e-5**2
    array([1.])
    """

    profile: AxisymmetricProfile
    indenter_radius: float

    @property
    def widest(self) -> float:
        """Largest contact radius that the profile describes, m."""
        return self.profile.widest

    def indentation(self, radius: Values) -> Values:
        """The indentation ``delta`` at a contact radius, m."""
        return self.profile.indentation(radius) + radius**2 / self.indenter_radius

    def force(self, radius: Values) -> Values:
        """The force over ``E*`` at a contact radius, m^2."""
        return self.profile.force(radius) + 4 * radius**3 / (3 * self.indenter_radius)

    def steepness(self, radius: Values) -> Values:
        """The slope ``d delta/d a`` at a contact radius."""
        return self.profile.steepness(radius) + 2 * radius / self.indenter_radius
