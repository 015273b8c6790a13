"""The exceptions of contactimg, each carrying one sentence a physicist can act on."""

from typing import Any


class ContactimgError(Exception):
    """Base of every exception that contactimg raises on purpose."""


class InputError(ContactimgError, ValueError):
    """An input breaks a rule: the message names what, the rule, the value and the remedy."""


class FrameError(InputError):
    """One frame cannot be read or measured; the other frames of its series are not concerned."""


class FrameWarning(UserWarning):
    """A frame was measured, but its status is not "ok": the message says why and what to do."""


class ModelRangeError(InputError):
    """The problem lies outside the range in which the model has one meaningful solution."""


class ConvergenceError(ContactimgError, RuntimeError):
    """An iterative solver stopped above its tolerance; the message names residual, tolerance and remedy."""


def finite_number(value: Any, name: str, unit: str) -> float:
    """The value as a finite float.

    Raises
    ------
    InputError
        If it is none.

    Examples
    --------
    >>> finite_number("0.5", "load", "N")
    0.5
    """
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be a number of {unit}, got {value!r}") from None
    if not -float("inf") < number < float("inf"):
        raise InputError(f"{name} must be finite, got {value!r} {unit}")
    return number
