"""The record that every estimate of an effect returns."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from contactimg.errors import InputError


@dataclass(frozen=True)
class EffectEstimate:
    """Estimated change of the outputs if an effect is left out, and the cost of computing it.

    Parameters
    ----------
    effect : str
        Its name.
    change : float
        Largest relative change of the requested outputs if the effect is left out; never negative, 0 where
        the effect cannot act.
    reason : str
        The numbers that decide, in words.
    cost : float
        Time to solve, render or measure with the effect divided by the time without; 1 means no extra time.
    changes : mapping
        Output -> its relative change; empty where ``change`` holds for every one.
    doubtful : mapping
        Output -> its change if every contact that may form or vanish, within the error of the estimate, does.

    Examples
    --------
    >>> EffectEstimate("layer", 0.004, "loaded region over thickness 0.15", cost=1.1).change
    0.004
    """

    effect: str
    change: float
    reason: str
    cost: float = 1.0
    changes: Mapping[str, float] = field(default_factory=dict)
    doubtful: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        numbers = {"change": self.change, "cost": self.cost}
        for name, value in (numbers | {f"change of {key}": v for key, v in self.changes.items()}).items():
            if not (math.isfinite(value) and value >= (1.0 if name == "cost" else 0.0)):
                raise InputError(
                    f"{name} of the effect {self.effect} must be finite and not below "
                    f"{1 if name == 'cost' else 0}, got {value!r}"
                )

    def change_of(self, output: str) -> float:
        """Relative change of one output; that of the requested ones where they are not told apart."""
        return self.changes.get(output, 0.0) if self.changes else self.change
