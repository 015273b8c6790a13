"""Full coupling of adhesive contacts: the terms of `contactimg.models.full_coupling` with JKR's pressure.

JKR's pressure is Hertz's of the force that the contact radius calls for, less that of a flat punch with the
excess ``sqrt(8 pi w a^3)``; outside the contact the punch lowers the surface by ``p asin(a/r)/(pi a)``.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contactimg.models.coupling import DenseCoupling, Kernel
from contactimg.models.scaled_problem import ScaledProblem

Values = NDArray[np.float64]
Rows = NDArray[np.intp]


def refine(
    problem: ScaledProblem,
    at: ScaledProblem,
    kernel: Kernel,
    *,
    near: Rows,
    force: Values,
    pull: Values,
    contact_radius: Values,
) -> ScaledProblem:
    """The problem that asperities see in the field which their neighbours spread over a contact's width.

    Parameters
    ----------
    problem : ScaledProblem
        With point forces at the summits.
    at : ScaledProblem
        The one refined before, or the same: its shifted summits are where the fields are taken.
    kernel : Kernel
    near : ndarray of int
        Asperities to refine: those in or close to contact.
    force, pull, contact_radius : ndarray
        Theirs: net force, what the punch takes off Hertz's, radius; zero out of contact.

    Returns
    -------
    ScaledProblem
        Summits shifted by ``s = -R G``, gaps raised by the excess over point forces and by ``s^2/(2 R)``,
        radii of curvature divided by ``1 + R T``.
    """
    x, y, radius = at.x[near], at.y[near], problem.radius[near]
    pairs = DenseCoupling(x, y, kernel)
    fields = pairs.fields(force, contact_radius)
    excess = fields.excess - _punch_over_hertz(x, y, pull, contact_radius)
    if kernel.thinness:
        excess += _layer_part(pairs, x, y, pull * contact_radius**2)
    shift_x, shift_y = -radius * fields.slope_x, -radius * fields.slope_y
    place = {name: getattr(problem, name).copy() for name in ("x", "y", "gap", "radius")}
    place["x"][near] += shift_x
    place["y"][near] += shift_y
    place["gap"][near] += excess + (shift_x**2 + shift_y**2) / (2 * radius)
    place["radius"][near] /= np.maximum(1 + radius * fields.curvature, 0.1)
    return replace(problem, **place)


def _punch_over_hertz(x: Values, y: Values, pull: Values, a: Values) -> Values:
    """Displacement by punches less that by Hertz's pressure of the same forces, on a half-space."""
    loaded = np.flatnonzero(a)
    r = np.hypot(x[:, None] - x[loaded], y[:, None] - y[loaded])
    apart = r > 0
    ratio = a[loaded] / np.where(apart, r, np.inf)
    inner = np.clip(ratio, 1e-3, 1.0)
    punch = np.arcsin(inner) / inner
    hertz = 0.75 * ((2 * inner**2 - 1) * punch + np.sqrt(1 - inner**2)) / inner**2
    close = np.where(ratio > 1e-3, punch - hertz, ratio**2 / 15)
    inside = np.pi / 2 / np.maximum(ratio, 1.0) - 0.75 * np.pi * (1 - 0.5 / np.maximum(ratio, 1.0) ** 2) / (
        np.maximum(ratio, 1.0)
    )
    difference = np.where(ratio > 1, inside, close)
    return np.where(apart, difference / np.where(apart, r, 1.0), 0.0) @ pull[loaded] / np.pi


def _layer_part(pairs: DenseCoupling, x: Values, y: Values, moment: Values) -> Values:
    """What a layer takes from it: a fifteenth of ``sum p a^2`` times the deficit's Laplacian."""
    half_space = DenseCoupling(x, y, Kernel.of_thickness(np.inf))
    weight = (moment > 0).astype(np.float64)
    return (half_space.fields(moment, weight).curvature - pairs.fields(moment, weight).curvature) * 2 / 15
