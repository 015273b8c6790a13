"""How far apart two answers to one contact problem are, in the output that a scene asks for."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactimg.errors import InputError

__all__ = ["OUTPUTS", "relative_change"]

Values = NDArray[np.float64]
Contacts = tuple[ArrayLike, ArrayLike]

OUTPUTS = ("area", "force", "radius")


def relative_change(output: str, *, without: Contacts, complete: Contacts) -> float:
    """Relative change of an output when something is left out.

    ``area``: ``|A - A'|/A``. ``force``: ``sum |p - p'| / sum |p|`` over the contacts of either answer.
    ``radius``: ``sqrt(sum (a - a')^2 / sum a^2)`` over the same; a contact of one answer only has radius and
    force zero in the other.

    Parameters
    ----------
    output : {"area", "force", "radius"}
    without, complete : (array_like, array_like), N and m
        Forces and contact radii of all asperities, in the same order, without the effect (primed above) and
        with it; zero out of contact.

    Returns
    -------
    float
        0 if neither has a contact, 1 if only the one without the effect has.

    Examples
    --------
    >>> before, after = ([1.0, 1.0], [1.0, 2.0]), ([1.5, 0.5], [2.0, 1.0])
    >>> [round(relative_change(name, without=before, complete=after), 3) for name in OUTPUTS]
    [0.0, 0.5, 0.632]
    """
    if output not in OUTPUTS:
        raise InputError(f"output must be one of {', '.join(map(repr, OUTPUTS))}, got {output!r}")
    force, radius = (np.asarray(v, dtype=np.float64) for v in without)
    full_force, full_radius = (np.asarray(v, dtype=np.float64) for v in complete)
    if output == "area":
        area = float(np.sum(full_radius**2))
        return _ratio(abs(area - float(np.sum(radius**2))), area)
    if output == "force":
        return _ratio(float(np.abs(full_force - force).sum()), float(np.abs(full_force).sum()))
    square = _ratio(float(np.sum((full_radius - radius) ** 2)), float(np.sum(full_radius**2)))
    return float(np.sqrt(square))


def _ratio(change: float, size: float) -> float:
    """A change over a size; nothing over nothing is no change."""
    return change / size if size > 0 else float(change > 0)
