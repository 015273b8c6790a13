"""Ellipsoidal caps and caps of unequal modulus: which paraboloids stand for them in the solvers.

Every Hertz contact follows ``p = (4/3) E* sqrt(Rd) delta^(3/2)`` and ``p = (4/3) E* c^3/Ra``, ``pi c^2`` its
area. A cap with the equivalent radius ``Re`` and a contact modulus ``m E*`` has ``Rd = m^2 Re/F2^3`` and ``Ra
= Re F1^3/m`` (`contactimg.mechanics.hertz_ellipse`); for a sphere of the scene's modulus both are R.

A cap of unequal modulus stands on a body that is not of its own material. Hertz's half-space, of modulus
``m E*`` throughout, is exchanged for that body beyond the base of the cap, a disc of radius b, and the
indentation changes by ``p (1 - 1/m)/(2 b E*)``: rigid punches of radius b on either of the two.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import ModelRangeError
from contactimg.mechanics import hertz_ellipse
from contactimg.surfaces import CAP_BASE_COLUMN, MODULUS_COLUMN, RATIO_COLUMN

Values = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CapShapes:
    """Shapes and moduli of caps, one value an asperity.

    Parameters
    ----------
    radius : ndarray, m
        ``Re``: geometric mean of the composite principal radii of curvature.
    radius_ratio : ndarray
        The larger of these radii over the smaller one.
    azimuth : ndarray, rad
        Direction of the larger radius, and so of the major axis of the contact.
    modulus_ratio : ndarray
        ``m``: contact modulus of the contact over that of the scene.
    base_radius : ndarray, m
        ``b``; it counts where ``m`` is not 1.
    """

    radius: Values
    radius_ratio: Values
    azimuth: Values
    modulus_ratio: Values
    base_radius: Values

    @classmethod
    def of(cls, apexes: pd.DataFrame | Mapping[str, Values]) -> "CapShapes | None":
        """The shapes of composite summits (`contactimg.surfaces.composite_apexes`).

        None for spheres of one modulus.
        """
        if RATIO_COLUMN not in apexes and MODULUS_COLUMN not in apexes:
            return None
        usual = {RATIO_COLUMN: 1.0, "azimuth_rad": 0.0, MODULUS_COLUMN: 1.0, CAP_BASE_COLUMN: np.inf}
        radius = np.asarray(apexes["radius_m"], dtype=np.float64)
        found = (
            np.asarray(apexes[name], dtype=np.float64) if name in apexes else np.full(radius.size, value)
            for name, value in usual.items()
        )
        shapes = cls(radius, *found)
        return shapes if shapes.elliptic or shapes.unequal else None

    @property
    def elliptic(self) -> bool:
        """Whether any cap is an ellipsoid."""
        return bool((self.radius_ratio > 1).any())

    @property
    def unequal(self) -> bool:
        """Whether any modulus differs from that of the scene."""
        return bool((self.modulus_ratio != 1).any())

    @property
    def words(self) -> str:
        """In what the caps differ from spheres of one modulus, for a sentence."""
        kinds = (("of ellipsoidal shape", self.elliptic), ("of unequal modulus", self.unequal))
        return " and ".join(kind for kind, there in kinds if there)

    @cached_property
    def axis_ratio(self) -> Values:
        """``b/a`` of each contact, the same at every load."""
        return hertz_ellipse.axis_ratio(self.radius_ratio)

    @cached_property
    def depth_radius(self) -> Values:
        """``Rd``, m: a sphere of this radius and of the scene's modulus bears the same force as deep."""
        return self.modulus_ratio**2 * self.radius / hertz_ellipse.depth_factor(self.axis_ratio) ** 3

    @cached_property
    def area_radius(self) -> Values:
        """``Ra``, m: a sphere of this radius and of the scene's modulus has the same area under a force."""
        return self.radius * hertz_ellipse.area_factor(self.axis_ratio) / self.modulus_ratio

    @cached_property
    def strain_radius(self) -> Values:
        """Radius (m) over which the contact radius is the larger of ``a/R'`` and ``b/R"``."""
        return self.radius / np.sqrt(self.axis_ratio * self.radius_ratio)

    @property
    def bases(self) -> Values | None:
        """Compliance of each base times ``E*`` (1/m), and the stiffness radius with the base covered (m).

        Shape (n, 2), with compliance 0 for caps of the scene's modulus; None if all are.
        """
        if not self.unequal:
            return None
        compliance = (1 - 1 / self.modulus_ratio) / (2 * self.base_radius)
        return np.column_stack([compliance, self.modulus_ratio * self.base_radius])

    def contact_radius(self, force: Values) -> Values:
        """``c`` (m) under forces over ``E*`` (m^2)."""
        return np.cbrt(0.75 * force * self.area_radius)

    def check(self, contact_radius: Values) -> None:
        """Raise `ModelRangeError` if a contact covers the base of a cap of unequal modulus."""
        wide = np.flatnonzero((self.modulus_ratio != 1) & (contact_radius > self.base_radius))
        if wide.size:
            row = int(wide[0])
            raise ModelRangeError(
                f"asperities: row {row} has a modulus of its own, and its contact, of radius "
                f"{contact_radius[row] * 1e6:.4g} um, would cover its base, of radius "
                f"{self.base_radius[row] * 1e6:.4g} um; lower the load"
            )
