"""Prescribed conditions: lens, elastic body, and a load or an indentation."""

from dataclasses import dataclass

import numpy as np

from contactimg.errors import InputError
from contactimg.mechanics.checks import checked_poisson_ratio
from contactimg.models.convergence import INDENTATION_RANGE_M, LOAD_RANGE_N, MODULUS_RANGE_PA, check_range
from contactimg.surfaces import LENGTH_RANGE_M

CELLS_PER_SPACING = 2.0
"""Cells of a grid along the mean spacing of the asperities. Chosen: one hollow holds a few."""


@dataclass(frozen=True)
class ContactConditions:
    """Indenter, elastic body and prescribed load or indentation, in SI units.

    Parameters
    ----------
    indenter_radius : float, m
    contact_modulus : float, Pa
    apex : (float, float), m
    thickness : float, m
        Infinite for a half-space.
    load : float or None
    indentation : float or None
        Exactly one of the two is given.
    poisson_ratio : float
        Of a layer.
    """

    indenter_radius: float
    contact_modulus: float
    apex: tuple[float, float]
    thickness: float
    load: float | None
    indentation: float | None
    poisson_ratio: float = 0.5

    def check(self) -> None:
        """Refuse values that define no contact problem."""
        if not (np.isfinite(self.contact_modulus) and self.contact_modulus > 0):
            raise InputError(f"contact_modulus must be a positive modulus, got {self.contact_modulus!r} Pa")
        checked_poisson_ratio(self.poisson_ratio)
        if not self.thickness > 0:
            raise InputError(f"thickness must be positive (inf for a half-space), got {self.thickness!r} m")
        if (self.load is None) == (self.indentation is None):
            raise InputError(
                f"give exactly one of load and indentation, got load={self.load!r} "
                f"and indentation={self.indentation!r}"
            )
        for name, value in (("load", self.load), ("indentation", self.indentation)):
            if value is not None and not np.isfinite(value):
                raise InputError(f"{name} must be finite, got {value!r}")
        check_range("contact_modulus", self.contact_modulus, MODULUS_RANGE_PA, "Pa")
        check_range("thickness", self.thickness, LENGTH_RANGE_M, "m")
        check_range("load", self.load, LOAD_RANGE_N, "N")
        check_range("indentation", self.indentation, INDENTATION_RANGE_M, "m")
