"""The law that is wanted: contact area against load."""

import re
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactimg.errors import InputError

Values = NDArray[np.float64]

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
POWER_LAW = re.compile(rf"\s*([AF])\s*=\s*({NUMBER})\s*\*?\s*P\s*(?:(?:\^|\*\*)\s*({NUMBER}))?\s*")


@dataclass(frozen=True, eq=False)
class WantedLaw:
    """Contact area against load, on a range of loads.

    Parameters
    ----------
    load : array_like, shape (k,), N
        Increasing, two at least: the range from the first to the last, and points between.
    area : array_like, shape (k,), m^2
        Increasing. Between the points the law is a straight line.
    power : bool
        Whether it is a straight line in the logarithms instead.

    Examples
    --------
    >>> law = WantedLaw.parse("A = 4e-6 P^0.9", least=0.1, largest=1.0)
    >>> float(law.at(1.0))
    4e-06
    """

    load: Values
    area: Values
    power: bool = False

    def __post_init__(self) -> None:
        for key, name in (("load", "load_N"), ("area", "area_m2")):
            values = np.atleast_1d(np.asarray(getattr(self, key), dtype=np.float64))
            object.__setattr__(self, key, values)
            if not (np.isfinite(values).all() and (values > 0).all()):
                raise InputError(f"a law needs positive numbers, got {name} = {values.tolist()[:9]}")
            if len(values) < 2 or not (np.diff(values) > 0).all():
                raise InputError(
                    f"a law needs two points or more with increasing {name}, got {values.tolist()[:9]}"
                )
        if len(self.load) != len(self.area):
            raise InputError(
                f"a law needs an area for each load, got {len(self.area)} areas and {len(self.load)} loads"
            )

    @classmethod
    def parse(
        cls, text: str, *, least: float, largest: float, shear_strength: float | None = None
    ) -> "WantedLaw":
        """The law that ``A = c P^m`` (m^2, N) or ``F = c P^m`` (N, N) states, for loads in a range.

        Raises
        ------
        InputError
            If the text is no such law, its numbers are not positive, or F comes without a shear strength.
        """
        found = POWER_LAW.fullmatch(text)
        if found is None:
            raise InputError(
                f'the law {text!r} is not understood; write "A = 4e-6 P^0.9" (area in m2, load in N), '
                '"F = 0.8 P" for a friction force in N, or the name of a CSV table'
            )
        kind, factor, exponent = found[1], float(found[2]), float(found[3] or 1.0)
        if not (factor > 0 and exponent > 0):
            raise InputError(
                f"the law {text!r} needs a positive factor and exponent, got {factor:g} and {exponent:g}"
            )
        if not 0 < least < largest < np.inf:
            raise InputError(
                f"a law needs a range of positive loads, the least below the largest, got {least:g} to "
                f"{largest:g} N"
            )
        load = np.array([least, largest])
        with np.errstate(over="ignore", under="ignore"):
            values = factor * load**exponent
        return cls(load, values, power=True).over(shear_strength if kind == "F" else 1.0)

    def over(self, shear_strength: float | None) -> "WantedLaw":
        """The law with areas divided by a strength, for forces that were given in their place."""
        if shear_strength is None:
            raise InputError("a law of friction needs the shear strength (--shear-strength-MPa)")
        if not 0 < shear_strength < np.inf:
            raise InputError(f"the shear strength must be positive, got {shear_strength:g} Pa")
        return WantedLaw(self.load, self.area / shear_strength, self.power)

    def between(self, least: float | None, largest: float | None) -> "WantedLaw":
        """The law on a narrower range of loads, N."""
        first, last = self.load[0] if least is None else least, self.load[-1] if largest is None else largest
        if not self.load[0] <= first < last <= self.load[-1]:
            raise InputError(
                f"the loads {first:g} to {last:g} N are not a range inside that of the law, {self.load[0]:g} "
                f"to {self.load[-1]:g} N"
            )
        load = np.unique(np.concatenate([[first, last], np.clip(self.load, first, last)]))
        return WantedLaw(load, self.at(load), self.power)

    def at(self, load: ArrayLike) -> Values:
        """The area (m^2) at loads (N); beyond the range the last piece goes on."""
        P, (x, y, slopes) = np.asarray(load, dtype=np.float64), self._pieces
        if self.power:
            P = np.log(P)
        k = np.searchsorted(x[1:-1], P, side="right")
        value = y[k] + (P - x[k]) * slopes[k]
        return np.exp(value) if self.power else value

    @cached_property
    def _pieces(self) -> tuple[Values, Values, Values]:
        """Points and slopes of the straight pieces, in the logarithms of a power law."""
        x, y = (np.log(v) if self.power else v for v in (self.load, self.area))
        return x, y, np.diff(y) / np.diff(x)

    def loads(self, count: int) -> Values:
        """Loads over the range (N), evenly in their logarithm."""
        return np.geomspace(self.load[0], self.load[-1], count)
