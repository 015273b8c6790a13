"""The load cell as a scene states it: how far its zero and its gain may be off, in every frame alike.

``P_true = (P_read - zero) (1 + gain)``. A zero is fitted only where its standard uncertainty is stated; no
fit tells a gain, whose uncertainty is added to what is in proportion to the load.
"""

from dataclasses import dataclass

import numpy as np

from contactimg.errors import InputError
from contactimg.scene import Load


@dataclass(frozen=True)
class LoadCell:
    """Standard uncertainties that all loads of a series share.

    Parameters
    ----------
    zero_std : float, N
        Of what the cell reads without load; 0 for loads whose zero is right.
    gain_std : float
        Of the gain, relative. The default is chosen: typical of a load cell that was calibrated once with
        weights.

    Raises
    ------
    InputError
        If one is negative or not finite.
    """

    zero_std: float = 0.0
    gain_std: float = 0.01

    def __post_init__(self) -> None:
        for name, value in (("zero", self.zero_std), ("gain", self.gain_std)):
            if not 0 <= value < np.inf:
                what = f"the uncertainty of a load cell's {name}"
                raise InputError(f"{what} must not be negative, got {value!r}")

    @classmethod
    def stated(cls, load: Load) -> "LoadCell":
        """The load cell as a scene states it: without ``zero_std_N`` the zero is taken for right."""
        return cls(load.zero_std or 0.0, cls.gain_std if load.gain_std is None else load.gain_std)

    def errors(self, relative: float) -> dict[str, float]:
        """Standard uncertainties of a slope against loads, with a relative one that all forces share."""
        return {"relative_std": float(np.hypot(relative, self.gain_std)), "zero_std": self.zero_std}


EXACT_LOADS = LoadCell(zero_std=0.0, gain_std=0.0)
"""A load cell without error."""
