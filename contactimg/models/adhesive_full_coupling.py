"""Full coupling of adhesive contacts: the terms of `contactimg.models.full_coupling` with JKR's pressure.

JKR's pressure is Hertz's at the same contact radius minus that of a flat punch with the force
``sqrt(8 pi w a^3)``. Outside the contact the punch displaces the surface by ``p asin(a/r)/(pi a)``.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contactimg.models.coupling import DenseCoupling, Kernel
from contactimg.models.full_coupling import MIN_CURVATURE_FACTOR
from contactimg.models.scaled_problem import ScaledProblem

Values = NDArray[np.float64]
Rows = NDArray[np.intp]


def correct_for_field(
    problem: ScaledProblem,
    at: ScaledProblem,
    kernel: Kernel,
    *,
    near: Rows,
    force: Values,
    pull: Values,
    contact_radius: Values,
) -> ScaledProblem:
    """Correct the problem for the neighbours' displacement field over the width of each contact.

    Parameters
    ----------
    problem : ScaledProblem
        With point forces at the summits.
    at : ScaledProblem
        The problem as corrected last, or the same: the fields are taken at its shifted summits.
    kernel : Kernel
    near : ndarray of int
        Asperities to correct: those in or near contact.
    force, pull, contact_radius : ndarray
        Net force, force of the punch and contact radius of these asperities; zero out of contact.

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
    corrected = replace(
        problem,
        x=problem.x.copy(),
        y=problem.y.copy(),
        gap=problem.gap.copy(),
        radius=problem.radius.copy(),
    )
    corrected.x[near] += shift_x
    corrected.y[near] += shift_y
    corrected.gap[near] += excess + (shift_x**2 + shift_y**2) / (2 * radius)
    corrected.radius[near] /= np.maximum(1 + radius * fields.curvature, MIN_CURVATURE_FACTOR)
    return corrected


def _punch_over_hertz(x: Values, y: Values, pull: Values, a: Values) -> Values:
    """Displacement of a half-space by flat punches minus that by Hertz's pressure of the same forces."""
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
    """Correction of that difference for a layer: 1/15 of ``sum p a^2`` times the Laplacian of the deficit."""
    half_space = DenseCoupling(x, y, Kernel.of_thickness(np.inf))
    weight = (moment > 0).astype(np.float64)
    return (half_space.fields(moment, weight).curvature - pairs.fields(moment, weight).curvature) * 2 / 15
