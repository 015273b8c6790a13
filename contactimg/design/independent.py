r"""Density of heights of independent Hertz contacts that follow a law, and whether there is one.

Equal caps of radius R touch a flat one after the other, at depths u below the highest one. At the depth d

    A(d) = pi R sum (d - u_i)+,    P(d) = 4/3 E* sqrt(R) sum (d - u_i)+^(3/2),

and because ``int_0^d (u - v)+ (d - u)^(-1/2) du = 4/3 (d - v)+^(3/2)``, for every set of heights

    P(d) = E*/(pi sqrt R) int_0^d A(u) (d - u)^(-1/2) du,    n(u) = A''(u)/(pi R).

With A = g(P) this is a weakly singular Volterra equation of Abel's kind. It is marched in d: A is linear on
each step, so that the integral is exact, and its kinks are the numbers of caps that touch at each depth. A
law is possible only where no kink is negative: A convex in d.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.design.laws import WantedLaw
from contactimg.errors import InputError
from contactimg.mechanics import hertz

Values = NDArray[np.float64]

LOAD_STEP = 0.01
"""Relative increase of the load in a step without new caps. Chosen: the law is met to 1e-3 of the area."""

MOST_STEPS, MOST_ITERATIONS = 5000, 200
"""Steps of the march, and iterations in one, after which it ends. Chosen: a hundred times the usual."""


@dataclass(frozen=True, eq=False)
class HeightDensity:
    """The number of caps that touch from each depth on, and the law that they follow.

    Parameters
    ----------
    depth : ndarray, shape (k,), m
        Below the highest cap; begins with 0.
    caps : ndarray, shape (k,)
        Number of caps that touch first there, not whole.
    load, area : ndarray, shape (k,), N and m^2
        Of the caps so far, at the next depth.
    wanted : ndarray, shape (k,), m^2
        Area of the wanted law at these loads.
    """

    depth: Values
    caps: Values
    load: Values
    area: Values
    wanted: Values

    @property
    def excess(self) -> Values:
        """The relative distance by which the nearest possible law lies above the wanted one."""
        return self.area / self.wanted - 1

    def heights(self, count: int) -> Values:
        """Depths of ``count`` caps below the highest one (m): quantiles, and what is left over below all."""
        sums = np.concatenate([[0.0], np.cumsum(self.caps)])
        # what touches first at a depth is spread over the step before it; the first caps touch together
        places = np.concatenate([[0.0], self.depth])
        depths = np.interp(np.arange(count) + 0.5, sums, places)
        spare = np.arange(count) + 0.5 > sums[-1]
        depths[spare] = SPARE_DEPTH * self.depth[-1]
        return depths - depths.min()


SPARE_DEPTH = 1.1
"""Depth of caps that the law does not need, over that of the last one it needs. Chosen: they do not touch."""


def find_density(law: WantedLaw, *, count: int, cap_radius: float, contact_modulus: float) -> HeightDensity:
    """March the Volterra equation from the first to the last load of a law.

    Parameters
    ----------
    law : WantedLaw
    count : int
        Number of caps there are.
    cap_radius : float, m
    contact_modulus : float, Pa

    Returns
    -------
    HeightDensity
        Of the wanted law where it is possible; of the nearest possible one elsewhere: no caps are added
        while those that touch have more area than wanted, nor when there are none left.

    Notes
    -----
    The caps that touch first are equally high, as many as have the wanted area at the first load:
    ``n = A^3/P^2 16 E*^2/(9 pi^3 R^2)`` of Hertz's law; less than one cap is not possible.

    References
    ----------
    Aymard et al., Science 383 (2024) 200, doi:10.1126/science.adk4234 (heights of independent caps for a law
    of friction). Abel's relation follows from Hertz's law, as derived above.
    """
    R, K = cap_radius, 4 / 3 * contact_modulus * np.sqrt(cap_radius)
    first = float(law.load[0])
    alone = float(np.pi * hertz.radius(first, sphere_radius=R, contact_modulus=contact_modulus) ** 2)
    least = float(np.clip((law.at(first) / alone) ** 3, 1.0, count))
    d = float(hertz.indentation(first / least, sphere_radius=R, contact_modulus=contact_modulus))
    depths, caps = np.zeros((2, MOST_STEPS + 1))
    caps[0], loads, areas = least, [first], [np.pi * R * least * d]
    for k in range(1, MOST_STEPS + 1):
        below, n = d - depths[:k], caps[:k]
        step = LOAD_STEP * loads[-1] / (1.5 * K * float(n @ np.sqrt(below)))
        below += step
        area = np.pi * R * float(n @ below)
        load = K * float(n @ (below * np.sqrt(below)))
        own_area, own_load, left = np.pi * R * step, K * step**1.5, count - float(n.sum())
        added = 0.0  # caps with which the area is that of the law at the load with them
        for _ in range(MOST_ITERATIONS):
            before, short = added, float(law.at(load + added * own_load)) - area
            added = min(max(short / own_area, 0.0), left)
            if abs(added - before) <= 1e-12 * added:
                break
        depths[k], caps[k] = d, added
        loads.append(load + added * own_load)
        areas.append(area + added * own_area)
        d += step
        if loads[-1] >= law.load[-1]:
            values = np.array(loads), np.array(areas), law.at(loads)
            return HeightDensity(depths[: k + 1], caps[: k + 1], *values)
    raise InputError(
        f"{MOST_STEPS} steps did not lead from {law.load[0]:g} to {law.load[-1]:g} N; take a narrower range"
    )
