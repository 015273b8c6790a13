"""What leaving an effect out would change: the record that every indicator returns."""

import math
from dataclasses import dataclass

from contactimg.errors import InputError


@dataclass(frozen=True)
class Estimate:
    """What an effect does to the requested output, and what computing it costs.

    Parameters
    ----------
    effect : str
        Its name.
    change : float
        Relative change of the requested output if the effect is left out, not negative; 0 where it cannot
        act.
    reason : str
        Half a sentence with the numbers that decide.
    cost : float
        Time of its stage (solving, rendering, measuring) with the effect over the time without; 1: free.

    Examples
    --------
    >>> Estimate("layer", 0.004, "loaded region over thickness 0.15", cost=1.1).change
    0.004
    """

    effect: str
    change: float
    reason: str
    cost: float = 1.0

    def __post_init__(self) -> None:
        for name, least in (("change", 0.0), ("cost", 1.0)):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= least):
                raise InputError(
                    f"{name} of the effect {self.effect} must be finite and not below {least:g}, "
                    f"got {value!r}"
                )
