"""By how much an effect changes the outputs: the norm of each, and the record of one effect."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactimg.errors import InputError

Values = NDArray[np.float64]
Contacts = tuple[ArrayLike, ArrayLike]

OUTPUTS = ("area", "force", "radius")
"""Outputs that forces and radii alone determine."""

WRITTEN: dict[str, str] = {
    "area": "area",
    "force": "forces",
    "radius": "radii",
    "hertz": "Hertz forces",
    "contacts": "contacts",
    "profile": "profile",
    "indentation": "indentation",
}
"""Every output that `predict` writes -> what to call it in a sentence. The sum of the forces is the load."""

POWER = {"radius": 1, "area": 2, "force": 3}
"""Power of the radius that each output is."""

ANNULUS = 2.5e-4
"""Width of the annuli of the profile, m: that of the paper, and the default of the commands."""


def requested_outputs(output: str) -> tuple[str, ...]:
    """The outputs that ``[tolerance] output`` requests: every written one for ``"all"``.

    Examples
    --------
    >>> requested_outputs("force"), len(requested_outputs("all"))
    (('force',), 7)
    """
    return tuple(WRITTEN) if output == "all" else (output,)


@dataclass(frozen=True, eq=False)
class Answer:
    """The outputs of a solution for the same asperities, in any consistent unit.

    Parameters
    ----------
    force, radius : ndarray, shape (n,)
        Of each asperity; zero out of contact.
    indentation : float
    """

    force: Values
    radius: Values
    indentation: float


def output_changes(
    distance: Values, curvature_radius: Values, *, without: Answer, complete: Answer
) -> dict[str, float]:
    """Relative change of every written output if an effect is left out.

    ``area``, ``force``, ``radius`` as in `relative_change`. ``hertz``: ``sum |d(a^3/R)| / sum a^3/R``.
    ``contacts``: contacts that form or vanish, over their number. ``profile``: the larger of the largest
    change of the pressure of an annulus over the largest pressure, and of ``sum |dn|/n`` over the numbers of
    contacts of the annuli. ``indentation``: its change over the indentation, or over the largest ``a^2/R``
    where adhesion makes that the larger.

    Parameters
    ----------
    distance : ndarray, shape (n,), m
        Of each asperity from the apex, for the annuli of the profile.
    curvature_radius : ndarray, shape (n,)
        Composite radius R, for Hertz's law.
    without, complete : Answer
        Of all asperities, in the same order, without the effect and with it.

    Returns
    -------
    dict
        The keys of `WRITTEN`.

    Examples
    --------
    >>> before = Answer(np.array([1.0, 1.0]), np.array([1.0, 2.0]), 4.0)
    >>> after = Answer(np.array([2.0, 0.0]), np.array([2.0, 0.0]), 5.0)
    >>> changes = output_changes(np.zeros(2), np.ones(2), without=after, complete=before)
    >>> {name: round(value, 3) for name, value in changes.items()}  # doctest: +NORMALIZE_WHITESPACE
    {'area': 0.2, 'force': 1.0, 'radius': 1.0, 'hertz': 1.667, 'contacts': 0.5, 'profile': 0.5,
     'indentation': 0.25}
    """
    found = _basic_changes((without.force, without.radius), (complete.force, complete.radius))
    R, annulus = curvature_radius, np.floor_divide(distance, ANNULUS).astype(np.intp)
    hertz, full_hertz = without.radius**3 / R, complete.radius**3 / R
    touching, complete_touching = without.radius > 0, complete.radius > 0
    flips = float(np.count_nonzero(touching != complete_touching))
    deepest = max(abs(complete.indentation), float(np.max(complete.radius**2 / R, initial=0.0)))
    found["hertz"] = _ratio(float(np.abs(full_hertz - hertz).sum()), float(full_hertz.sum()))
    found["contacts"] = _ratio(flips, float(np.count_nonzero(complete_touching)))
    found["profile"] = _profile_change(annulus, without, complete) if annulus.size else 0.0
    found["indentation"] = _ratio(abs(complete.indentation - without.indentation), deepest)
    return found


def _profile_change(annulus: NDArray[np.intp], without: Answer, complete: Answer) -> float:
    """The larger change of the pressure's and of the density's profile."""
    area = 2.0 * np.arange(int(annulus.max()) + 1) + 1  # in units of that of the innermost
    (p, n), (other_p, other_n) = (
        (np.bincount(annulus, answer.force) / area, np.bincount(annulus, answer.radius > 0))
        for answer in (complete, without)
    )
    pressure = _ratio(float(np.abs(p - other_p).max()), float(np.abs(p).max()))
    return max(pressure, _ratio(float(np.abs(n - other_n).sum()), float(n.sum())))


def relative_change(output: str, *, without: Contacts, complete: Contacts) -> float:
    """Relative change of an output if an effect is left out.

    ``area``: ``|A - A'|/A``. ``force``: ``sum |p - p'| / sum |p|`` over all asperities.
    ``radius``: ``sqrt(sum (a - a')^2 / sum a^2)``. An asperity out of contact has force and radius zero.

    Parameters
    ----------
    output : {"area", "force", "radius", "profile", "all"}
        ``"all"``: the largest of the first three; ``"profile"``: the force, of which a profile is a sum.
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
    >>> [round(relative_change(name, without=before, complete=after), 3) for name in (*OUTPUTS, "all")]
    [0.0, 0.5, 0.632, 0.632]
    """
    return chosen_change(_basic_changes(without, complete), output)


def _basic_changes(without: Contacts, complete: Contacts) -> dict[str, float]:
    """Relative change of each of `OUTPUTS`."""
    force, radius = (np.asarray(values, float) for values in without)
    full_force, full_radius = (np.asarray(values, float) for values in complete)
    area = float(np.sum(full_radius**2))
    return {
        "area": _ratio(abs(area - float(np.sum(radius**2))), area),
        "force": _ratio(float(np.abs(full_force - force).sum()), float(np.abs(full_force).sum())),
        "radius": math.sqrt(_ratio(float(np.sum((full_radius - radius) ** 2)), area)),
    }


def measured_outputs(output: str) -> tuple[str, ...]:
    """Return those of `OUTPUTS` that tell a requested output: all for ``"all"``, the force for a profile."""
    return {"all": OUTPUTS, "profile": ("force",)}.get(output, (output,))


def chosen_change(changes: Mapping[str, float], output: str) -> float:
    """The change of a requested output, by those of `OUTPUTS`."""
    return float(np.max([changes[name] for name in measured_outputs(output)]))  # NaN if one of them is


def _ratio(change: float, size: float) -> float:
    """The ratio of change and size; 0 for zero over zero, 1 for a change of nothing."""
    return change / size if size > 0 else float(change > 0)


def change_sentence(changes: Mapping[str, float]) -> str:
    """The expected errors of the outputs in per cent, for a person.

    Examples
    --------
    >>> change_sentence({"area": 0.0081, "force": 0.0, "contacts": 2e-5})
    'area 0.81 %, forces 0 %, contacts 0.002 %'
    """
    return ", ".join(f"{WRITTEN[name]} {100 * value:.2g} %" for name, value in changes.items())


@dataclass(frozen=True)
class EffectEstimate:
    """Estimated change of the outputs if an effect is left out.

    Parameters
    ----------
    effect : str
        Its name.
    change : float
        Largest relative change of the requested outputs if the effect is left out; never negative, 0 where
        the effect cannot act.
    reason : str
        The numbers that decide, in words.
    changes : mapping
        Output -> its relative change; empty where ``change`` holds for every one.

    Examples
    --------
    >>> EffectEstimate("layer", 0.004, "loaded region over thickness 0.15").change
    0.004
    """

    effect: str
    change: float
    reason: str
    changes: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        changes = {"change": self.change} | {f"change of {key}": v for key, v in self.changes.items()}
        for name, value in changes.items():
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(
                    f"{name} of the effect {self.effect} must be finite and not negative, got {value!r}"
                )

    @classmethod
    def of(cls, effect: str, reason: str, changes: Mapping[str, float], output: str) -> "EffectEstimate":
        """The estimate of an effect by its changes, of which that of the requested outputs counts."""
        change = max(changes.get(name, 0.0) for name in requested_outputs(output))
        return cls(effect, change, reason, changes)

    def change_of(self, output: str) -> float:
        """Relative change of one output; that of the requested ones where they are not told apart."""
        return self.changes.get(output, 0.0) if self.changes else self.change
