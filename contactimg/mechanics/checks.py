"""Checks at the public door that every closed form shares."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactimg.errors import InputError

__all__ = ["non_negative", "positive"]


def positive(name: str, value: float, unit: str) -> float:
    """``value`` as a float, or an `InputError` unless it is a positive number (infinity allowed)."""
    number = float(value)
    if not number > 0:
        raise InputError(f"{name} must be positive, got {value!r} {unit}")
    return number


def non_negative(name: str, values: ArrayLike, unit: str) -> NDArray[np.float64]:
    """``values`` as a float64 array, or an `InputError` naming the first negative or NaN one."""
    array = np.asarray(values, dtype=np.float64)
    wrong = ~(array >= 0)
    if wrong.any():
        raise InputError(f"{name} must not be negative or NaN, got {array[wrong].flat[0]!r} {unit}")
    return array
