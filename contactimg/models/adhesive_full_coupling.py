"""Full coupling of adhesive contacts: the terms of `contactimg.models.full_coupling` with JKR's pressure.

JKR's pressure is Hertz's at the same contact radius minus that of a flat punch with the force
``sqrt(8 pi w a^3)``. Outside the contact the punch displaces the surface by ``p asin(a/r)/(pi a)``. What
makes a contact elliptic is taken as without adhesion at the same contact radius.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contactimg.models.coupling import QUARTIC, DenseCoupling, Kernel
from contactimg.models.full_coupling import CapCorrection, bounded_saddle, pressure_radius
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
    aspect: float,
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
    aspect : float
        Of the law of the asperities: 0 for paraboloids.

    Returns
    -------
    ScaledProblem
        With summits shifted, gaps raised and profiles bent.
    """
    radius = problem.radius[near]
    pairs = DenseCoupling(at.x[near], at.y[near], kernel)
    wide = pressure_radius(contact_radius, radius, aspect)
    fields = pairs.fields(force, wide, bounded_saddle(pairs.fields(force, wide), radius))
    moment = pull * contact_radius**2
    fields = replace(
        fields,
        excess=fields.excess - _punch_over_hertz(at.x[near], at.y[near], pull, contact_radius),
        curvature=fields.curvature - _punch_curvature(pairs, moment),
    )
    if kernel.thinness:
        fields.excess[:] += _layer_part(pairs, at.x[near], at.y[near], moment)
    return _moved(problem, near, CapCorrection.of(fields, radius, contact_radius, aspect))


def _moved(problem: ScaledProblem, near: Rows, terms: CapCorrection) -> ScaledProblem:
    """The problem with some of its asperities corrected."""
    x, y, gap, bends = problem.x.copy(), problem.y.copy(), problem.gap.copy(), np.zeros((problem.gap.size, 2))
    x[near] += terms.shift_x
    y[near] += terms.shift_y
    gap[near] += terms.shifted_rise
    bends[near] = terms.bends
    return replace(problem, x=x, y=y, gap=gap, bends=bends)


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


def _punch_curvature(pairs: DenseCoupling, moment: Values) -> Values:
    """Half the Laplacian of that difference, ``p a^2/(15 r^3)`` for each ``p a^2`` of ``moment``."""
    return pairs.fields(moment, (moment > 0).astype(np.float64)).quartic * 0.3 / QUARTIC


def _layer_part(pairs: DenseCoupling, x: Values, y: Values, moment: Values) -> Values:
    """Correction of that difference for a layer: 1/15 of ``sum p a^2`` times the Laplacian of the deficit."""
    half_space = DenseCoupling(x, y, Kernel.of_thickness(np.inf))
    weight = (moment > 0).astype(np.float64)
    return (half_space.fields(moment, weight).curvature - pairs.fields(moment, weight).curvature) * 2 / 15
