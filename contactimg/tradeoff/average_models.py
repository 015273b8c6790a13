"""Averages that models of rings and models of contacts both know, and how far two of them are apart."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.errors import InputError
from contactimg.models.greenwood_williamson import RingSolution
from contactimg.models.solution import InteractingSolution

Values = NDArray[np.float64]

NODES = 4001
"""Points of the integrals over rings."""


@dataclass(frozen=True, eq=False)
class Average:
    """What a model of averages and one of single contacts both know.

    Parameters
    ----------
    area : float, m^2
    loads : ndarray, shape (k,), N
        Carried by annuli about the apex.
    mean_radius : float, m
        Of the contacts.
    """

    area: float
    loads: Values
    mean_radius: float


def average_change(output: str, *, answer: Average, reference: Average) -> float:
    """Relative error of an average.

    ``area``: of the real contact area. ``force``: sum of ``|dP_k|`` over the annuli, over the load.
    ``radius``: of the mean contact radius.

    Parameters
    ----------
    output : {"area", "force", "radius"}
    answer, reference : Average
        Over the same annuli.
    """
    if output == "force":
        return float(np.abs(answer.loads - reference.loads).sum() / reference.loads.sum())
    name = {"area": "area", "radius": "mean_radius"}[output]
    return abs(getattr(answer, name) / getattr(reference, name) - 1)


def average_contacts(solution: InteractingSolution, *, centre: tuple[float, float], edges: Values) -> Average:
    """Averages of a solution by contacts.

    Parameters
    ----------
    solution : InteractingSolution
    centre : (float, float), m
    edges : ndarray, shape (k + 1,), m
        Of the annuli; contacts beyond the last edge count in the last annulus.
    """
    rows = solution.touching
    if not rows.size:
        raise InputError("nothing is in contact: there is no average")
    r = np.hypot(solution.x[rows] - centre[0], solution.y[rows] - centre[1])
    place = np.clip(np.searchsorted(edges, r, side="right") - 1, 0, edges.size - 2)
    loads = np.zeros(edges.size - 1)
    np.add.at(loads, place, solution.force[rows])
    return Average(solution.area, loads, float(solution.radius[rows].mean()))


def average_rings(rings: RingSolution, *, edges: Values) -> Average:
    """The same of a solution by rings.

    Parameters
    ----------
    rings : RingSolution
    edges : ndarray, shape (k + 1,), m
    """
    r = np.linspace(0.0, rings.r[-1], NODES)
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
    """Means of neighbours: the trapezoidal rule."""
    return 0.5 * (values[1:] + values[:-1])
