"""The record that every estimate of an effect returns."""

import math
from dataclasses import dataclass

from contactimg.errors import InputError


@dataclass(frozen=True)
class EffectEstimate:
    """Estimated change of the requested output if an effect is left out, and the cost of computing it.

    Parameters
    ----------
    effect : str
        Its name.
    change : float
        Relative change of the requested output if the effect is left out; never negative, 0 where the effect
        cannot act.
    reason : str
        The numbers that decide, in words.
    cost : float
        Time to solve, render or measure with the effect divided by the time without; 1 means no extra time.

    Examples
    --------
    >>> EffectEstimate("layer", 0.004, "loaded region over thickness 0.15", cost=1.1).change
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
