"""The bright rim that a thin air film draws around a contact, in the edge model.

Outside the contact the excess brightness falls from 1 with the gap; blurred by the optics like the contact
itself it adds to the profile of the uniform disk::

    P(r; a, s) + int_a^inf e(t; a) (t/s^2) exp(-(r-t)^2/(2 s^2)) I0e(r t/s^2) dt

For a Hertz contact e follows from a, the sphere's radius and the light, without a free parameter; for others
a rim of given width.
"""

from collections.abc import Hashable
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import special

from contactimg.errors import InputError
from contactimg.imaging.profile.blurred_disk import INNER, STEPS_PER_WIDTH, EdgeTable, disk_table
from contactimg.optics.film import Light, excess_table

ROWS = 80
FEWEST_STEPS = 24  # nodes of the integral over the rim in a blur width
NEGLIGIBLE = (
    0.01  # excess at which a rim has ended: fringes beyond are smaller than the noise and average out
)
WIDEST = 14.0  # blur widths that are followed at most


class Rim(Hashable, Protocol):
    """Brightness around a contact of unit brightness."""

    def excess(self, distance_px: NDArray, radius_px: float) -> NDArray[np.float64]:
        """Excess at distances (px) beyond the edge of a contact of a radius (px)."""
        ...

    def extent_px(self, radius_px: float) -> float:
        """Distance beyond the edge at which it has ended."""
        ...


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
        return np.asarray(
            excess_table(self.light).around_contact(r, radius=a, sphere_radius=self.sphere_radius)
        )

    def extent_px(self, radius_px: float) -> float:
        """Distance beyond the edge at which fringes have faded."""
        fades = excess_table(self.light).fades_at(NEGLIGIBLE)
        a = radius_px * self.pixel_size
        far = np.sqrt(2 * self.sphere_radius * fades + 2 * a**2)
        distance = np.linspace(0.0, (far - a) / self.pixel_size, 400)
        above = np.flatnonzero(np.abs(self.excess(distance, radius_px)) > NEGLIGIBLE)
        return float(distance[above[-1]]) if above.size else 0.0


@dataclass(frozen=True)
class PlainRim:
    """Brightness that falls linearly to the background over a given width beyond the edge.

    Parameters
    ----------
    width_px : float

    Raises
    ------
    InputError
        If the width is not positive.
    """

    width_px: float

    def __post_init__(self) -> None:
        if not self.width_px > 0:
            raise InputError(f"a rim needs a positive width, got {self.width_px!r} px")

    def excess(self, distance_px: NDArray, radius_px: float) -> NDArray[np.float64]:  # noqa: ARG002
        """Excess at distances (px) beyond the edge, whatever the radius."""
        return np.clip(1.0 - np.asarray(distance_px, float) / self.width_px, 0.0, 1.0)

    def extent_px(self, radius_px: float) -> float:  # noqa: ARG002
        """The width."""
        return self.width_px


def rim_table(rim: Rim, blur: float) -> EdgeTable:
    """Profile of contacts with a rim, for the fit.

    Parameters
    ----------
    rim : Rim
        Hashable.
    blur : float, px
        Standard deviation of the Gaussian, pixel included; the table holds for it alone (unlike that of the
        plain disk, whose only length it is).

    Returns
    -------
    EdgeTable

    Notes
    -----
    The integral over the rim is a sum over 64 or 320 nodes, at least 20 a blur width, the radius a linear
    interpolation between 80 rows; together they err by about 1e-3.
    """
    return _build(rim, round(float(blur), 4))


@lru_cache(maxsize=16)
def _build(rim: Rim, blur: float) -> EdgeTable:
    """Rows of the table; the derivatives are differences between its nodes."""
    extents = [rim.extent_px(blur * x) / blur for x in (0.5, 1.0, 2.0, 5.0, 20.0)]
    outer = float(np.ceil(min(max(extents), WIDEST) + INNER))
    u = np.arange(-INNER, outer + 0.5 / STEPS_PER_WIDTH, 1.0 / STEPS_PER_WIDTH)
    values = np.zeros((ROWS, len(u), 3), np.float32)
    q = np.arange(1, ROWS) / (ROWS - 1)
    radius = np.maximum(blur * (1 - q) / q, 1e-2 * blur)
    profiles = np.stack([_profile(rim, np.abs(a + u * blur), a, blur) for a in radius])
    along = np.gradient(profiles, 1.0 / STEPS_PER_WIDTH, axis=1)
    # at equal distance from the rim, not from the centre, profiles hardly change with the radius
    across = np.gradient(profiles, q, axis=0) / (np.gradient(radius, q) / blur)[:, None]
    values[1:, :, 0], values[1:, :, 1], values[1:, :, 2] = profiles, across - along, along
    values[0] = values[1]  # the straight edge: radii beyond 80 blur widths
    return EdgeTable(values, outer)


def _profile(rim: Rim, r: NDArray, a: float, blur: float) -> NDArray[np.float64]:
    """Blurred disk with its rim at distances r; coarse nodes in r, interpolated."""
    extent = min(rim.extent_px(a), WIDEST * blur)
    if extent <= 0:
        return _plain(r, a, blur)
    # the excess starts with infinite curvature at the edge: nodes that lie closer there, x = extent z^2
    z, weight = _gauss_nodes(64 if FEWEST_STEPS * extent < 64 * blur else 320)
    distance, weight = extent * z**2, 2 * extent * z * weight
    t = a + distance
    light = rim.excess(distance, a) * t * weight / blur**2
    coarse = np.linspace(float(r.min()), float(r.max()), 220)
    kernel = np.exp(-((coarse[:, None] - t) ** 2) / (2 * blur**2)) * special.i0e(
        np.outer(coarse, t) / blur**2
    )
    return _plain(r, a, blur) + _smooth_interpolation(r, coarse, kernel @ light)


def _plain(r: NDArray, a: float, blur: float) -> NDArray[np.float64]:
    """The disk without its rim, from its table: to 3e-5, and a hundred times faster than the series."""
    table = disk_table().values
    place = blur / (blur + a) * (len(table) - 1)
    k = min(int(place), len(table) - 2)
    row = table[k, :, 0] + (place - k) * (table[k + 1, :, 0] - table[k, :, 0])
    nodes = np.arange(table.shape[1]) / STEPS_PER_WIDTH - INNER
    return np.interp((r - a) / blur, nodes, row, left=1.0, right=0.0)


@lru_cache(maxsize=2)
def _gauss_nodes(count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gauss-Legendre nodes and weights on (0, 1)."""
    z, weight = np.polynomial.legendre.leggauss(count)
    return (z + 1) / 2, weight / 2


def _smooth_interpolation(r: NDArray, nodes: NDArray, values: NDArray) -> NDArray[np.float64]:
    """Cubic interpolation on equidistant nodes (Catmull-Rom)."""
    step = nodes[1] - nodes[0]
    place = np.clip((r - nodes[0]) / step, 0, len(nodes) - 1 - 1e-9)
    k = place.astype(int)
    f = place - k
    around = [values[np.clip(k + j, 0, len(nodes) - 1)] for j in (-1, 0, 1, 2)]
    return np.asarray(
        around[1]
        + 0.5 * f * (around[2] - around[0])
        + f**2 * (around[0] - 2.5 * around[1] + 2 * around[2] - 0.5 * around[3])
        + 0.5 * f**3 * (3 * (around[1] - around[2]) + around[3] - around[0])
    )
