"""Relative difference of two solutions in the output that a scene asks for: area, force or radius."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactimg.errors import InputError

Values = NDArray[np.float64]
Contacts = tuple[ArrayLike, ArrayLike]

OUTPUTS = ("area", "force", "radius")

POWER = {"radius": 1, "area": 2, "force": 3}
"""Power of the radius that each output is."""


def relative_change(output: str, *, without: Contacts, complete: Contacts) -> float:
    """Relative change of an output if an effect is left out.

    ``area``: ``|A - A'|/A``. ``force``: ``sum |p - p'| / sum |p|`` over all asperities.
    ``radius``: ``sqrt(sum (a - a')^2 / sum a^2)``. An asperity out of contact has force and radius zero.

    Parameters
    ----------
    output : {"area", "force", "radius"}
    without, complete : (array_like, array_like), N and m
        Forces and contact radii of all asperities, in the same order, without the effect (primed above) and
        with it.

    Returns
    -------
    float
        0 if neither solution has a contact, 1 if only the one without the effect has.

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
    """The ratio of change and size; 0 for zero over zero, 1 for a change of nothing."""
    return change / size if size > 0 else float(change > 0)


def stated_change(output: str, *, radius: ArrayLike, std: ArrayLike) -> float:
    """Relative standard uncertainty of an output, from independent uncertainties of the radii.

    Parameters
    ----------
    output : {"area", "force", "radius"}
        Forces are proportional to ``a^3``.
    radius, std : array_like, shape (n,)
        Both in the same unit.

    Returns
    -------
    float
        Infinite without contacts.

    Examples
    --------
    >>> round(stated_change("area", radius=[3.0, 4.0], std=[0.03, 0.04]), 6)
    0.014686
    """
    a, s = np.asarray(radius, float), np.asarray(std, float)
    if not a.size:
        return float("inf")
    power = POWER[output]
    if output == "radius":
        return float(np.sqrt(np.sum(s**2) / np.sum(a**2)))
    return float(np.sqrt(np.sum((power * a ** (power - 1) * s) ** 2)) / np.sum(a**power))
