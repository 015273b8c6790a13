"""Profile of a contact with the bright rim of a thin air film.

Outside the contact the excess brightness e falls from 1 as the gap opens. Blurred like the contact itself, it
adds to the profile of the uniform disk::

    P(r; a, s) + int_a^inf e(t; a) (t/s^2) exp(-(r-t)^2/(2 s^2)) I0e(r t/s^2) dt

For a Hertz contact e follows from a, the radius of the sphere and the light, without a free parameter.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from contactimg.errors import InputError
from contactimg.imaging.profile.blurred_disk import (
    INNER_BLUR_WIDTHS,
    STEPS_PER_BLUR_WIDTH,
    EdgeTable,
    blurred_disks,
)
from contactimg.optics.film import Light, excess_table, thick_transmission, transmission

BLUR_RATIO = 1.15
"""Of the blurs of neighbouring tables. Accuracy: the parabola errs by 6e-4 of the contrast beside spheres of
100 um at 2 and 3 um a pixel, by 7e-3 at 1 um, where the rim is as wide as twenty blurs."""
RADII = 80  # rows of the table; accuracy, see the note of `rim_table`
FEWEST_RINGS, RINGS_PER_BLUR_WIDTH, PLACES_IN_RING = 48, 16, 10
"""Rings of which a rim is a sum, and distances over which the excess of each is averaged. Accuracy: with 150
and 20 the profile differs by 6e-4, by 2e-3 where laser light makes fringes narrower than a pixel."""
SPLINE_NODES = 220  # distances at which the integral is computed, a cubic spline between; accuracy
NEGLIGIBLE_EXCESS = 0.01  # a rim has ended below; by hand: later fringes are below the noise and average out
WIDEST_RIM_BLUR_WIDTHS = 14.0  # a wider rim is cut off; by hand


@dataclass(frozen=True)
class FilmRim:
    """Air film around Hertz contacts of spheres.

    Parameters
    ----------
    light : Light
    sphere_radius : float, m
        Radius R of the spheres.
    pixel_size : float, m

    Raises
    ------
    InputError
        If a length is not positive.
    """

    light: Light
    sphere_radius: float
    pixel_size: float

    def __post_init__(self) -> None:
        if not (self.sphere_radius > 0 and self.pixel_size > 0):
            raise InputError(
                "the film needs a positive sphere radius and pixel size, got "
                f"{self.sphere_radius!r} m and {self.pixel_size!r} m"
            )

    def excess(self, distance_px: NDArray, radius_px: float) -> NDArray[np.float64]:
        """Excess at distances (px) beyond the edge of a contact of a radius (px)."""
        a = radius_px * self.pixel_size
        r = a + np.asarray(distance_px, float) * self.pixel_size
        return excess_table(self.light).around_contact(r, radius=a, sphere_radius=self.sphere_radius)

    @property
    def contrast(self) -> float:
        """Brightness of a contact against a thick film, ``T(0)/T(inf) - 1``."""
        return float(transmission(0.0, light=self.light)) / thick_transmission(self.light) - 1.0

    def extent_px(self, radius_px: float) -> float:
        """Distance beyond the edge at which fringes have faded."""
        fades, a = excess_table(self.light).fades_at(NEGLIGIBLE_EXCESS), radius_px * self.pixel_size
        far = np.sqrt(2 * self.sphere_radius * fades + 2 * a**2)
        distance = np.linspace(0.0, (far - a) / self.pixel_size, 400)
        above = np.flatnonzero(np.abs(self.excess(distance, radius_px)) > NEGLIGIBLE_EXCESS)
        return float(distance[above[-1]]) if above.size else 0.0


@dataclass(frozen=True)
class FilmSetting:
    """A rim that contacts may have, and whether it is drawn.

    Parameters
    ----------
    rim : FilmRim
    asked : {"on", "off", "auto"}
        "auto": as the pixels say.
    doubt : float
        Probability that "on" or "off" is a mistake, before the pixels are looked at. A fifth by default: what
        the pixels cannot check and is wrong is then off by at most 1/sqrt(0.2) = 2.2 of its uncertainties.
    """

    rim: FilmRim
    asked: Literal["on", "off", "auto"] = "on"
    doubt: float = 0.2


@lru_cache(maxsize=16)
def rim_table(rim: FilmRim, blur: float) -> EdgeTable:
    """Profile of contacts with a rim, for the fit.

    Parameters
    ----------
    rim : FilmRim
    blur : float, px
        Standard deviation of the Gaussian, pixel included; the table holds for it alone (unlike that of the
        plain disk, whose only length it is).

    Returns
    -------
    EdgeTable

    Notes
    -----
    The integral over the rim is a sum over thin rings, the radius a linear interpolation between 80 rows;
    together they err by about 1e-3.
    """
    extents = [rim.extent_px(blur * x) / blur for x in (0.5, 1.0, 2.0, 5.0, 20.0)]
    outer = float(np.ceil(min(max(extents), WIDEST_RIM_BLUR_WIDTHS) + INNER_BLUR_WIDTHS))
    u = np.arange(-INNER_BLUR_WIDTHS, outer + 0.5 / STEPS_PER_BLUR_WIDTH, 1.0 / STEPS_PER_BLUR_WIDTH)
    values = np.zeros((RADII, len(u), 3), np.float32)
    q = np.arange(1, RADII) / (RADII - 1)
    radius = np.maximum(blur * (1 - q) / q, 1e-2 * blur)
    profiles = _profiles(rim, radius, blur, u)
    along = np.gradient(profiles, 1.0 / STEPS_PER_BLUR_WIDTH, axis=1)
    # at equal distance from the rim, not from the centre, profiles hardly change with the radius
    across = np.gradient(profiles, q, axis=0) / (np.gradient(radius, q) / blur)[:, None]
    values[1:] = np.stack([profiles, across - along, along], axis=-1)
    values[0] = values[1]  # the straight edge: radii beyond 80 blur widths
    return EdgeTable(values, outer)


def _profiles(rim: FilmRim, radius: NDArray, blur: float, u: NDArray) -> NDArray[np.float64]:
    """Blurred disks with their rims at distances u from the edge, in blur widths.

    A rim is a sum of thin rings, differences of disks.
    """
    coarse_u = np.linspace(u[0], u[-1], SPLINE_NODES)
    profiles = np.empty((len(radius), len(u)))
    for k, a in enumerate(radius):
        extent = min(rim.extent_px(a), WIDEST_RIM_BLUR_WIDTHS * blur)
        # the excess has infinite curvature at the edge: rings are thinner there
        count = max(FEWEST_RINGS, int(RINGS_PER_BLUR_WIDTH * extent / blur))
        edges = a + extent * np.linspace(0.0, 1.0, count + 1)[:, None] ** 2
        r = np.broadcast_to(np.abs(a + coarse_u * blur), (count + 1, SPLINE_NODES))
        places = (np.arange(count * PLACES_IN_RING).reshape(count, PLACES_IN_RING) + 0.5) / PLACES_IN_RING
        excess = rim.excess(extent * (places / count) ** 2, a).mean(axis=1)
        light = excess @ np.diff(blurred_disks(r, edges, blur), axis=0)
        # the light is an even function of the distance from the centre: smooth where it is folded
        plain = blurred_disks(np.abs(a + u * blur)[None], np.array([[a]]), blur)[0]
        profiles[k] = plain + CubicSpline(coarse_u, light)(u)
    return profiles


def film_table(rim: FilmRim, blur: float) -> EdgeTable:
    """Profile of contacts with a rim at a blur; see `rim_table`, which is exact and takes long.

    Parameters
    ----------
    rim : FilmRim
    blur : float, px
        Standard deviation of the Gaussian, pixel included.

    Examples
    --------
    >>> light = Light(1.52, 1.41, 560e-9, 70e-9, (450e-9, 680e-9))
    >>> quick, exact = (table(FilmRim(light, 1e-4, 3e-6), 1.3) for table in (film_table, rim_table))
    >>> columns = min(quick.values.shape[1], exact.values.shape[1])
    >>> bool(np.abs(quick.values[:, :columns, 0] - exact.values[:, :columns, 0]).max() < 1e-3)
    True
    """
    return _between(rim, round(float(np.log(blur)), 5))  # tables are kept for the same blur


@lru_cache(maxsize=24)
def _between(rim: FilmRim, log_blur: float) -> EdgeTable:
    """The parabola through the three next tables."""
    place = log_blur / np.log(BLUR_RATIO)
    middle = round(place)
    x = place - middle
    weights = (0.5 * x * (x - 1.0), 1.0 - x * x, 0.5 * x * (x + 1.0))
    tables = [rim_table(rim, BLUR_RATIO ** (middle + k)) for k in (-1, 0, 1)]
    values = np.zeros((RADII, max(table.values.shape[1] for table in tables), 3), np.float32)
    for weight, table in zip(weights, tables, strict=True):
        part: NDArray[np.float32] = np.float32(weight) * table.values
        values[:, : part.shape[1]] += part
    return EdgeTable(values, max(table.outer for table in tables))
