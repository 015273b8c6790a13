"""Averages by which statistical models and models of single contacts are compared."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.errors import InputError
from contactimg.models.greenwood_williamson import RingSolution
from contactimg.models.solution import InteractingSolution

Values = NDArray[np.float64]

RADIAL_NODES = 4001
"""Points of the trapezoidal rule over rings. Chosen: far more than any number of rings."""


@dataclass(frozen=True, eq=False)
class Average:
    """Averages over all contacts.

    Parameters
    ----------
    area : float, m^2
    loads : ndarray, shape (k,), N
        Loads on rings around the apex.
    mean_radius : float, m
        Mean contact radius.
    """

    area: float
    loads: Values
    mean_radius: float


def average_change(output: str, *, answer: Average, reference: Average) -> float:
    """Relative error of averages.

    ``area``: error of the real contact area. ``force``: sum of ``|dP_k|`` over the rings divided by the load.
    ``radius``: error of the mean contact radius.

    Parameters
    ----------
    output : {"area", "force", "radius", "profile", "all"}
        ``"profile"``: as the force; ``"all"``: the largest of the three.
    answer, reference : Average
        With the same rings.
    """
    if output == "all":
        outputs = ("area", "force", "radius")
        return max(average_change(name, answer=answer, reference=reference) for name in outputs)
    if output in ("force", "profile"):
        return float(np.abs(answer.loads - reference.loads).sum() / reference.loads.sum())
    name = {"area": "area", "radius": "mean_radius"}[output]
    return abs(getattr(answer, name) / getattr(reference, name) - 1)


def average_contacts(solution: InteractingSolution, *, centre: tuple[float, float], edges: Values) -> Average:
    """Averages of a solution with single contacts.

    Parameters
    ----------
    solution : InteractingSolution
    centre : (float, float), m
    edges : ndarray, shape (k + 1,), m
        Edges of the rings; contacts beyond the last edge count in the last ring.
    """
    rows = solution.touching
    if not rows.size:
        raise InputError("there is no contact to average; increase the load")
    r = np.hypot(solution.x[rows] - centre[0], solution.y[rows] - centre[1])
    place = np.clip(np.searchsorted(edges, r, side="right") - 1, 0, edges.size - 2)
    loads = np.zeros(edges.size - 1)
    np.add.at(loads, place, solution.force[rows])
    return Average(solution.area, loads, float(solution.radius[rows].mean()))


def average_rings(rings: RingSolution, *, edges: Values) -> Average:
    """Averages of a statistical solution.

    Parameters
    ----------
    rings : RingSolution
    edges : ndarray, shape (k + 1,), m
    """
    r = np.linspace(0.0, rings.r[-1], RADIAL_NODES)
    pressure, density, radius = (
        np.interp(r, rings.r, values) for values in (rings.pressure, rings.density, rings.mean_radius)
    )
    inside = np.concatenate([[0.0], 2 * np.pi * np.cumsum(np.diff(r) * _middle(r * pressure))])
    at_edges = np.interp(edges, r, inside)
    at_edges[-1] = inside[-1]
    count = float(np.sum(np.diff(r) * _middle(r * density)))
    mean_radius = float(np.sum(np.diff(r) * _middle(r * density * radius))) / count
    return Average(rings.area, np.diff(at_edges), mean_radius)


def _middle(values: Values) -> Values:
    """Means of adjacent values, for the trapezoidal rule."""
    return 0.5 * (values[1:] + values[:-1])
