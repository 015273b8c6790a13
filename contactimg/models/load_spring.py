"""A load cell of finite stiffness between the stage and the indenter."""

from dataclasses import dataclass

import numpy as np

from contactimg.errors import InputError
from contactimg.models.proof import INDENTATION_RANGE_M, check_range

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
