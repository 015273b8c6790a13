"""Averages by which statistical models and models of single contacts are compared."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid, trapezoid

from contactimg.errors import InputError
from contactimg.models.greenwood_williamson import RingSolution
from contactimg.models.solution import InteractingSolution

Values = NDArray[np.float64]

RADIAL_NODES = 4001
"""Points of the trapezoidal rule over rings. Chosen: far more than any number of rings."""


@dataclass(frozen=True, eq=False)
class Average:
    """Averages over all contacts: area (m^2), loads on rings around the apex (N), mean contact radius (m)."""

    area: float
    loads: Values
    mean_radius: float

    def change(self, output: str, reference: "Average") -> float:
        """Relative error against a reference with the same rings.

        ``area``: error of the real contact area. ``force``, ``profile``: sum of ``|dP_k|`` over the rings
        divided by the load. ``radius``: error of the mean contact radius. ``all``: the largest of the three.
        """
        errors = {
            "area": abs(self.area / reference.area - 1),
            "force": float(np.abs(self.loads - reference.loads).sum() / reference.loads.sum()),
            "radius": abs(self.mean_radius / reference.mean_radius - 1),
        }
        return max(errors.values()) if output == "all" else errors.get(output, errors["force"])


def average_contacts(solution: InteractingSolution, *, centre: tuple[float, float], edges: Values) -> Average:
    """Averages of a solution with single contacts; those beyond the last edge (m) count in the last ring."""
    rows = solution.touching
    if not rows.size:
        raise InputError("there is no contact to average; increase the load")
    r = np.hypot(solution.x[rows] - centre[0], solution.y[rows] - centre[1])
    ring = np.clip(np.searchsorted(edges, r, side="right") - 1, 0, edges.size - 2)
    loads = np.bincount(ring, solution.force[rows], minlength=edges.size - 1)
    return Average(solution.area, loads, float(solution.radius[rows].mean()))


def average_rings(rings: RingSolution, *, edges: Values) -> Average:
    """Averages of a statistical solution on rings with these edges, m."""
    r = np.linspace(0.0, rings.r[-1], RADIAL_NODES)
    pressure, density, radius = (
        np.interp(r, rings.r, values) for values in (rings.pressure, rings.density, rings.mean_radius)
    )
    inside = cumulative_trapezoid(2 * np.pi * r * pressure, r, initial=0.0)
    at_edges = np.interp(edges, r, inside)
    at_edges[-1] = inside[-1]
    mean_radius = trapezoid(r * density * radius, r) / trapezoid(r * density, r)
    return Average(rings.area, np.diff(at_edges), float(mean_radius))
