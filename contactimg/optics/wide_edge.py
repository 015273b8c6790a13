"""The light across the edge of a wide contact with the air film around it.

Outside the edge of a contact of radius ``a`` under a sphere of radius ``R`` the gap opens as

    g = g_Hertz(r; a, R) + (2/pi) q sqrt(a) acos(a/r),    q = sqrt(8 pi w/(3 K)),

with ``w = 0`` Hertz's contact (`contactimg.mechanics.jkr.gap`). The ``opening`` q, in sqrt(m), is all that
the image depends on of adhesion and stiffness: 0 gives the wide soft edge of a Hertz contact, infinity a
sharp edge without film.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.errors import InputError
from contactimg.mechanics import hertz
from contactimg.optics.film import ExcessTable

Values = NDArray[np.float64]

FILM_NODES = 300
"""Points across the film, uniform in the square root of the distance, in which the gap is smooth at the edge.

Chosen: about ten points resolve the last fringe, ``lambda/(2 g')``.
"""


def film_opening(*, contact_modulus: float, work_of_adhesion: float) -> float:
    """Opening of the gap at the edge by adhesion: ``q = sqrt(8 pi w/(3 K))`` with ``K = 4 E*/3``.

    Parameters
    ----------
    contact_modulus : float, Pa
    work_of_adhesion : float, J/m^2

    Returns
    -------
    float, sqrt(m)

    Examples
    --------
    >>> film_opening(contact_modulus=4e6, work_of_adhesion=0.05) * 1e3
    0.2802
    """
    return float(np.sqrt(2 * np.pi * work_of_adhesion / contact_modulus))


@dataclass(frozen=True, eq=False)
class EdgeLight:
    """Light along a line across the edge: 1 in the contact, the film's excess outside; made by `edge_light`.

    Parameters
    ----------
    edges : ndarray, shape (n + 1,), m
        Distances from the edge, from 0 on, between which the film is sampled; one point for a sharp edge.
    excess : ndarray, shape (n,)
        Excess in the middle of each interval.
    """

    edges: Values
    excess: Values

    @property
    def reach(self) -> float:
        """Distance (m) outside the edge at which the film has faded."""
        return float(self.edges[-1])

    def film_means(self, start: float, step: float, count: int) -> Values:
        """Mean light of the film in equal cells along the line, contact apart.

        Parameters
        ----------
        start, step : float, m
            Where the first cell begins, from the edge, and the width of the cells.
        count : int

        Returns
        -------
        ndarray, shape (count,)

        Examples
        --------
        >>> film = EdgeLight(np.array([0.0, 2e-6, 4e-6]), np.array([1.0, -0.5]))
        >>> film.film_means(-1e-6, 2e-6, 4)
        array([ 0.5 ,  0.25, -0.25,  0.  ])
        """
        integral = np.append(0.0, np.cumsum(self.excess * np.diff(self.edges)))
        return np.diff(np.interp(start + step * np.arange(count + 1), self.edges, integral)) / step


def edge_light(radius: float, *, sphere_radius: float, opening: float, excess: ExcessTable) -> EdgeLight:
    """Light across the edge of a wide contact and of the film around it.

    Parameters
    ----------
    radius, sphere_radius : float, m
    opening : float, sqrt(m)
        ``q`` of `film_opening`; 0 for Hertz's contact, infinity for a sharp edge.
    excess : ExcessTable
        Of the light (`contactimg.optics.film.excess_table`).

    Returns
    -------
    EdgeLight

    Raises
    ------
    InputError
        If a length is not positive or the opening is negative.

    Notes
    -----
    The edge is treated as straight: valid for contacts many times wider than the blur.

    Examples
    --------
    The film stays bright for tens of micrometres without adhesion, for a fraction of a micrometre with it:

    >>> from contactimg.optics.film import Light, excess_table
    >>> table = excess_table(Light(1.52, 1.41, 560e-9, 70e-9, (450e-9, 680e-9)))
    >>> for opening in (0.0, 0.28e-3):
    ...     light = edge_light(1.5e-3, sphere_radius=0.1288, opening=opening, excess=table)
    ...     half = light.edges[:-1][light.excess < 0.5][0]
    ...     print(f"{half * 1e6:.2f} um")
    25.18 um
    0.02 um
    """
    if not (radius > 0 and sphere_radius > 0 and opening >= 0):
        raise InputError(
            "the edge needs a positive radius and sphere radius and an opening that is not negative, "
            f"got {radius!r} m, {sphere_radius!r} m, {opening!r} sqrt(m)"
        )
    reach = float(excess.reach(radius=radius, sphere_radius=sphere_radius)) - radius
    adhesive_opening = opening * radius**0.5
    angle = np.pi / 2 * excess.longest_gap / adhesive_opening if adhesive_opening > 0 else np.inf
    if angle < np.pi / 2:
        reach = min(reach, radius * (1 / np.cos(angle) - 1))
    if reach < 1e-6 * radius:  # below any pixel
        return EdgeLight(np.zeros(1), np.zeros(0))
    u = np.linspace(0, 1, FILM_NODES + 1)
    distance = reach * ((u[1:] + u[:-1]) / 2) ** 2
    r = radius + distance
    angle = np.arctan(np.sqrt(distance * (r + radius)) / radius)  # acos(a/r) without cancellation
    gap = hertz.gap(r, radius=radius, sphere_radius=sphere_radius)
    return EdgeLight(reach * u**2, excess(gap + 2 / np.pi * opening * radius**0.5 * angle))
