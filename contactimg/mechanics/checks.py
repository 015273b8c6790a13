"""Checks at the public door that every closed form shares."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactimg.errors import InputError, finite_number


def positive(name: str, value: ArrayLike, unit: str) -> Any:
    """``value`` as float or float64 array, or an `InputError` naming the first that is not positive."""
    number = np.asarray(value, dtype=np.float64)
    wrong = ~(number > 0)
    if wrong.any():
        raise InputError(f"{name} must be positive, got {float(number[wrong].flat[0])!r} {unit}")
    return float(number) if number.ndim == 0 else number


def non_negative(name: str, values: ArrayLike, unit: str) -> NDArray[np.float64]:
    """``values`` as a float64 array, or an `InputError` naming the first negative or NaN one."""
    array = np.asarray(values, dtype=np.float64)
    wrong = ~(array >= 0)
    if wrong.any():
        raise InputError(f"{name} must not be negative or NaN, got {float(array[wrong].flat[0])!r} {unit}")
    return array


def checked_poisson_ratio(value: float) -> float:
    """``value`` as a float, or an `InputError` where no elastic body has this Poisson's ratio."""
    nu = finite_number(value, "poisson_ratio", "1")
    if not -1 < nu <= 0.5:
        raise InputError(f"poisson_ratio must be above -1 and at most 0.5, got {nu!r}")
    return nu
