"""The exceptions of contactimg, each carrying one sentence a physicist can act on."""

import inspect
from functools import cache, wraps
from textwrap import shorten
from types import UnionType
from typing import Any, get_args


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


MADE_BY = {
    "Scene": "contactimg.read_scene reads one",
    "Generator": "numpy.random.default_rng(seed) makes one",
    "DataFrame": "pandas.DataFrame makes one of columns, pandas.read_csv of a file",
}
"""Class that an argument must have -> where it comes from."""


@cache
def checking_arguments(public: Any, module: str) -> Any:
    """A function of a module as its users call it: an argument of another class is an `InputError`.

    The classes are those of `MADE_BY` in the annotations; any other object stays as it is.

    Examples
    --------
    >>> class Scene: ...
    >>> def plan(scene: Scene) -> None: ...
    >>> checking_arguments(plan, "m")(scene="folder")
    Traceback (most recent call last):
    contactimg.errors.InputError: plan: scene must be a Scene (contactimg.read_scene reads one), got 'folder'
    """
    if not inspect.isfunction(public):
        return public
    asked = {name: one.annotation for name, one in inspect.signature(public).parameters.items()}

    @wraps(public)
    def checked(*args: Any, **options: Any) -> Any:
        for name, value in (dict(zip(asked, args, strict=False)) | options).items():
            kind: Any = asked.get(name)  # of a union the first class says what is meant
            what = getattr(get_args(kind)[0] if isinstance(kind, UnionType) else kind, "__name__", "")
            if what in MADE_BY and not isinstance(value, kind):
                got = shorten(repr(value), 60)
                raise InputError(f"{public.__name__}: {name} must be a {what} ({MADE_BY[what]}), got {got}")
        return public(*args, **options)

    checked.__module__ = module
    return checked


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
