"""Prove a solution before it is returned: finite numbers, forces that bear the load, complementarity.

The checks recompute the equations from the final numbers in SI units. Status ``converged`` means that all of
them hold; otherwise a solver raises an exception, or the status is a sentence that says what does not hold.
"""

import functools
from collections.abc import Callable, Mapping
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from contactimg.errors import ConvergenceError, ModelRangeError

Arguments = ParamSpec("Arguments")
Solution = TypeVar("Solution")

MODULUS_RANGE_PA = (1e-6, 1e18)
LOAD_RANGE_N = (1e-60, 1e40)
INDENTATION_RANGE_M = (1e-40, 1e9)
ADHESION_RANGE_J_M2 = (1e-20, 1e9)
"""Ranges of the arguments, with `contactimg.surfaces.LENGTH_RANGE_M` for other lengths. Theory: within them
the powers that the solvers form, up to the sixth, stay within floating-point numbers, 1e-308 to 1e308."""

CONVERGED = "converged"
"""Status of a solution that has passed every check."""

MAX_RELATIVE_ERROR = 1e-6
"""Largest relative error of a converged solution: of the sum of the forces against the load, and of the
forces that follow from the recomputed penetrations. Chosen: far below the uncertainty of any measured load,
and far above the rounding errors of ordinary scenes, 1e-12."""


def refuse_beyond_floats(solve: Callable[Arguments, Solution]) -> Callable[Arguments, Solution]:
    """Turn an overflow, a division by zero or a singular matrix inside a solver into a `ModelRangeError`.

    Arrays of one number are taken as Python numbers: single precision would overflow and round.
    """

    @functools.wraps(solve)
    def guarded(*args: Arguments.args, **keywords: Arguments.kwargs) -> Solution:
        numbers = {key: one for key, one in keywords.items() if isinstance(one, np.generic | np.ndarray)}
        options: Any = keywords | {key: one.item() for key, one in numbers.items() if one.size == 1}
        try:
            with np.errstate(over="raise", divide="raise", invalid="raise"):
                return solve(*args, **options)
        except (ArithmeticError, np.linalg.LinAlgError) as error:
            raise ModelRangeError(
                f"the solution leaves the range of floating-point numbers ({error}): loads, lengths and "
                "moduli are too many orders of magnitude apart; check their units"
            ) from error

    return guarded


def check_range(name: str, value: float | None, limits: tuple[float, float], unit: str) -> None:
    """Refuse a finite value, other than zero, whose magnitude is outside the limits."""
    low, high = limits
    if value and not np.isinf(value) and not low <= abs(value) <= high:
        raise ModelRangeError(
            f"{name} must lie between {low:g} and {high:g} {unit}, the range of the contact models, "
            f"got {value!r} {unit}; check its unit"
        )


def check_finite(quantities: Mapping[str, ArrayLike]) -> None:
    """Raise `ModelRangeError` that names the first quantity with a value that is not finite."""
    for name, values in quantities.items():
        array = np.asarray(values)
        if not np.isfinite(array).all():
            wrong = float(array[~np.isfinite(array)].flat[0])
            raise ModelRangeError(
                f"{name} of the solution is {wrong}, not a finite number: loads, lengths and moduli are too "
                "many orders of magnitude apart; check their units"
            )


def relative_error(value: float, expected: float) -> float:
    """Absolute difference over the expected value; over 1 where that is zero."""
    return abs(value - expected) / (abs(expected) or 1.0)


def judge(errors: Mapping[str, float], tolerance: float) -> str:
    """Status of a solution from its relative errors, by what they are errors of.

    ``tolerance`` is the residual that was asked for: an error above `MAX_RELATIVE_ERROR` is stated within it,
    and raises `ConvergenceError` beyond it.
    """
    name, worst = max(errors.items(), key=lambda item: np.inf if np.isnan(item[1]) else item[1])
    if worst <= MAX_RELATIVE_ERROR:
        return CONVERGED
    if worst <= 4 * tolerance:
        return f"within the tolerance of {tolerance:.3g} only: the {name} has a relative error of {worst:.3g}"
    raise ConvergenceError(
        f"the {name} of the solution has a relative error of {worst:.3g}, above {MAX_RELATIVE_ERROR:g}: "
        "loads, lengths and moduli may be too many orders of magnitude apart; check their units"
    )
