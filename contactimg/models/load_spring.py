"""Prescribed conditions: lens, elastic body, and a load, an indentation or a stage behind a load cell."""

from dataclasses import dataclass

import numpy as np

from contactimg.errors import InputError
from contactimg.models.proof import INDENTATION_RANGE_M, LOAD_RANGE_N, MODULUS_RANGE_PA, check_range
from contactimg.surfaces import LENGTH_RANGE_M

STIFFNESS_RANGE_N_M = (1e-40, 1e30)
"""Range of the stiffness. Theory: products with lengths stay within floating-point numbers."""


@dataclass(frozen=True)
class LoadSpring:
    """Prescribes the displacement of the stage, of which a spring takes a part: ``P = k (d - D)``.

    A very stiff cell prescribes the indentation ``D``, a very soft one the load. Adhesive contacts jump in
    and off at other displacements with a soft cell than with a stiff one.

    Parameters
    ----------
    stiffness : float, N/m
        ``k``; infinite for a rigid stage, which prescribes the indentation.
    displacement : float, m
        ``d`` of the stage from where indenter and sample touch for the first time; negative before.

    Examples
    --------
    >>> LoadSpring(stiffness=100.0, displacement=1e-5).load_at(4e-6)
    0.0006
    """

    stiffness: float
    displacement: float

    def __post_init__(self) -> None:
        if not self.stiffness > 0:
            raise InputError(f"the stiffness of a load spring must be positive, got {self.stiffness!r} N/m")
        if not np.isfinite(self.displacement):
            raise InputError(f"the displacement of a load spring must be finite, got {self.displacement!r} m")
        check_range("stiffness of the load spring", self.stiffness, STIFFNESS_RANGE_N_M, "N/m")
        check_range("displacement of the load spring", self.displacement, INDENTATION_RANGE_M, "m")

    def load_at(self, indentation: float) -> float:
        """``P``, N, at an indentation ``D``, m."""
        return self.stiffness * (self.displacement - indentation)

    @property
    def rigid(self) -> bool:
        """Whether the displacement is the indentation."""
        return bool(np.isinf(self.stiffness))

    def imbalance(self, load: float, indentation: float) -> float:
        """``|d - D - P/k|`` over the largest of the three."""
        stretch = load / self.stiffness
        size = max(abs(self.displacement), abs(indentation), abs(stretch)) or 1.0
        return abs(self.displacement - indentation - stretch) / size


def prescribed(
    load: float | LoadSpring | None, indentation: float | None
) -> tuple[float | LoadSpring | None, float | None]:
    """Load and indentation as prescribed: a rigid stage prescribes the indentation."""
    if isinstance(load, LoadSpring) and load.rigid and indentation is None:
        return None, load.displacement
    return load, indentation


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
    load : float, LoadSpring or None
    indentation : float or None
        Exactly one of the two is given.
    poisson_ratio : float
        Of a layer.
    """

    indenter_radius: float
    contact_modulus: float
    apex: tuple[float, float]
    thickness: float
    load: float | LoadSpring | None
    indentation: float | None
    poisson_ratio: float = 0.5

    @property
    def spring(self) -> LoadSpring | None:
        """The load cell, if there is one."""
        return self.load if isinstance(self.load, LoadSpring) else None

    @property
    def force(self) -> float | None:
        """The prescribed load, N; with a load cell that at zero indentation, or None."""
        return self.load.load_at(0.0) if isinstance(self.load, LoadSpring) else self.load

    @property
    def depth(self) -> float | None:
        """The prescribed indentation, m; with a load cell the displacement, or None."""
        return self.load.displacement if isinstance(self.load, LoadSpring) else self.indentation

    def check(self) -> None:
        """Refuse values that define no contact problem."""
        if not (np.isfinite(self.contact_modulus) and self.contact_modulus > 0):
            raise InputError(f"contact_modulus must be a positive modulus, got {self.contact_modulus!r} Pa")
        if not -1 < self.poisson_ratio <= 0.5:
            raise InputError(f"poisson_ratio must lie between -1 and 0.5, got {self.poisson_ratio!r}")
        if not self.thickness > 0:
            raise InputError(f"thickness must be positive (inf for a half-space), got {self.thickness!r} m")
        if (self.load is None) == (self.indentation is None):
            raise InputError(
                f"give exactly one of load and indentation, got load={self.load!r} "
                f"and indentation={self.indentation!r}"
            )
        for name, value in (("load", self.force), ("indentation", self.indentation)):
            if value is not None and not np.isfinite(value):
                raise InputError(f"{name} must be finite, got {value!r}")
        check_range("contact_modulus", self.contact_modulus, MODULUS_RANGE_PA, "Pa")
        check_range("thickness", self.thickness, LENGTH_RANGE_M, "m")
        check_range("load", self.force, LOAD_RANGE_N, "N")
        check_range("indentation", self.indentation, INDENTATION_RANGE_M, "m")
