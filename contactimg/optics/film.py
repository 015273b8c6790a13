"""Transmission of the air film around a contact, averaged over the spectrum of the lamp.

At normal incidence on ``n1 | air | n3`` the film of thickness ``g`` reflects, at one wavelength,

    Rf = (r12^2 + r23^2 + 2 r12 r23 c) / (1 + r12^2 r23^2 + 2 r12 r23 c),    c = cos(4 pi g / lambda),

with ``r12 = (n1 - 1)/(n1 + 1)`` and ``r23 = (1 - n3)/(1 + n3)``. A thick film shows the average over the
phase, which without dispersion does not depend on the spectrum. The image shows the excess over a thick film,

    e(g) = (T(g) - T(inf)) / (T(0) - T(inf)),    T = <1 - Rf>,

1 in contact and 0 far away. Around a Hertz contact the gap, and so the excess, follows from ``a`` and ``R``.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactimg.compiled import njit
from contactimg.errors import InputError
from contactimg.mechanics import hertz
from contactimg.optics.coverage import sector_of

Values = NDArray[np.float64]

MAX_GAP_WAVELENGTHS = 512  # chosen: light that is still coherent there is a laser, with fringes everywhere


LIT_BANDWIDTHS = 6.3
"""Bandwidths about the centre of a spectrum beyond which it is dark. Theory: exp(-6.3^2) is 6e-18."""


@dataclass(frozen=True)
class Light:
    """Spectrum of the lamp, ``exp(-((lambda - wavelength)/bandwidth)^2)``, in a band, and the two bodies.

    Parameters
    ----------
    index_indenter, index_elastic : float
        Refractive indices of the two bodies, without dispersion; neither may be that of air.
    wavelength, bandwidth : float, m
        Centre and 1/e half-width of the spectrum.
    band : (float, float), m
        Shortest and longest wavelength that the detector sees.

    Raises
    ------
    InputError
        If an index is 1, the band is empty, or no light of the lamp lies in it.
    """

    index_indenter: float
    index_elastic: float
    wavelength: float
    bandwidth: float
    band: tuple[float, float]

    def __post_init__(self) -> None:
        if self.index_indenter == 1 or self.index_elastic == 1:
            raise InputError(
                "light: a body with the index of air (1) shows no film; give the bodies' own indices"
            )
        if not 0 < self.band[0] < self.band[1] < np.inf:
            raise InputError(f"light: band must be two increasing positive wavelengths, got {self.band!r} m")

        if not self.lit_band[0] < self.lit_band[1]:
            raise InputError(
                f"light: the lamp, {self.wavelength!r} +- {self.bandwidth!r} m, sends no light into the band "
                f"{self.band!r} m; check the wavelengths"
            )

    @property
    def lit_band(self) -> tuple[float, float]:
        """The part of the band (m) in which the spectrum lies to rounding."""
        reach = LIT_BANDWIDTHS * self.bandwidth
        return max(self.band[0], self.wavelength - reach), min(self.band[1], self.wavelength + reach)

    @property
    def reflections(self) -> tuple[float, float]:
        """Amplitude reflection coefficients ``r12`` and ``r23`` at the two surfaces of the film."""
        n1, n3 = self.index_indenter, self.index_elastic
        return (n1 - 1) / (n1 + 1), (1 - n3) / (1 + n3)


def transmission(gap: ArrayLike, *, light: Light) -> Values:
    """Transmittance of an air film, averaged over the spectrum.

    Parameters
    ----------
    gap : array_like, m
        Film thickness ``g``, finite and not negative; 0 is contact.
    light : Light

    Returns
    -------
    ndarray
        ``T(g)``, the shape of ``gap``.

    Notes
    -----
    Gauss-Legendre quadrature over the wavelength, with enough nodes for the fastest phase, ``4 pi g
    (1/lambda_min - 1/lambda_max)``. Valid for normal incidence; the cone of light of a microscope objective
    shortens the fringes.

    References
    ----------
    M. Born and E. Wolf, Principles of Optics, 7th ed. (1999), section 7.6.1, eqs (9)-(12).

    Examples
    --------
    >>> led = Light(1.52, 1.41, 560e-9, 70e-9, (450e-9, 680e-9))
    >>> transmission([0.0, 138e-9], light=led)
    array([0.9986, 0.8696])
    """
    gaps = np.asarray(gap, float)
    r12, r23 = light.reflections
    low, high = light.lit_band
    phases = 4 * np.pi * float(gaps.max(initial=0.0)) * (1 / low - 1 / high)
    nodes, weights = np.polynomial.legendre.leggauss(48 + int(phases))
    wavelengths = (low + high) / 2 + (high - low) / 2 * nodes
    weights = weights * np.exp(-(((wavelengths - light.wavelength) / light.bandwidth) ** 2))
    reflected = np.zeros(gaps.shape)
    for wavelength, weight in zip(wavelengths, weights / weights.sum(), strict=True):
        beat = 2 * r12 * r23 * np.cos(4 * np.pi / wavelength * gaps)
        reflected += weight * (r12**2 + r23**2 + beat) / (1 + r12**2 * r23**2 + beat)
    return 1 - reflected


def thick_transmission(light: Light) -> float:
    """Transmittance of a thick film, ``T(inf) = (1-r12^2)(1-r23^2)/(1-r12^2 r23^2)``.

    Examples
    --------
    The contact exceeds the far background by 6.8 % of the incident light:

    >>> led = Light(1.52, 1.41, 560e-9, 70e-9, (450e-9, 680e-9))
    >>> float(transmission(0.0, light=led)) - thick_transmission(led)
    0.0677
    """
    p12, p23 = (r**2 for r in light.reflections)
    return (1 - p12) * (1 - p23) / (1 - p12 * p23)


@dataclass(frozen=True, eq=False)
class ExcessTable:
    """The excess ``e(g)`` on a uniform grid of gaps, for interpolation; see `excess_table`.

    Parameters
    ----------
    light : Light
    step : float, m
        Spacing of the gaps; entry ``k`` is the gap ``k step``.
    values : ndarray
        ``e``; the last entry is 0.
    """

    light: Light
    step: float
    values: Values

    @property
    def longest_gap(self) -> float:
        """Gap (m) beyond which the excess counts as 0."""
        return self.step * (len(self.values) - 1)

    def fades_at(self, level: float) -> float:
        """Gap (m) beyond which the excess stays below ``level``."""
        above = np.flatnonzero(np.abs(self.values) > level)
        return self.step * (int(above[-1]) + 1 if above.size else 0)

    def __call__(self, gap: ArrayLike) -> Values:
        """Excess at gaps (m), the shape of ``gap``; 0 beyond the table."""
        place = np.asarray(gap, float) / self.step
        return np.interp(place, np.arange(len(self.values)), self.values)

    def around_contact(self, r: ArrayLike, *, radius: ArrayLike, sphere_radius: ArrayLike) -> Values:
        """Excess at the distances ``r`` (m) from the centre of a Hertz contact, 1 inside; all broadcast."""
        return self(hertz.gap(r, radius=radius, sphere_radius=sphere_radius))

    def reach(self, *, radius: ArrayLike, sphere_radius: ArrayLike) -> Values:
        """Distance from the centre (m) beyond which the film around a contact has no excess.

        From ``g >= (r^2 - 2 a^2)/(2 R)``, as the surface outside a contact lies below its undeformed level.
        """
        return np.sqrt(2 * np.asarray(sphere_radius, float) * self.longest_gap + 2 * np.square(radius))


@lru_cache(maxsize=8)
def excess_table(light: Light, *, tolerance: float = 5e-3, accuracy: float = 1e-4) -> ExcessTable:
    """Tabulate the excess of a lamp; tables are kept.

    Parameters
    ----------
    light : Light
    tolerance : float
        The table ends where the excess stays below this; half a grey level at a contrast of 100.
    accuracy : float
        Largest error of linear interpolation.

    Returns
    -------
    ExcessTable

    Raises
    ------
    InputError
        If the light is so coherent that its fringes do not fade within 512 wavelengths.

    Examples
    --------
    The half-contrast contour of a contact of radius 10 um under a cap of R = 100 um lies 1.12 um outside its
    edge:

    >>> led = Light(1.52, 1.41, 560e-9, 70e-9, (450e-9, 680e-9))
    >>> table = excess_table(led)
    >>> table.around_contact([9e-6, 11.12e-6], radius=10e-6, sphere_radius=100e-6).round(2)
    array([1. , 0.5])
    """
    # |e''| <= (4 pi / lambda)^2 |e|, and linear interpolation errs by step^2 |e''| / 8
    step = light.band[0] / (4 * np.pi) * np.sqrt(8 * accuracy)
    contact, thick = float(transmission(0.0, light=light)), thick_transmission(light)
    count, excess = int(8 * light.wavelength / step), np.empty(0)
    while count * step <= MAX_GAP_WAVELENGTHS * light.wavelength:
        more = transmission(np.arange(len(excess), count) * step, light=light)
        excess = np.append(excess, (more - thick) / (contact - thick))
        last = int(np.flatnonzero(np.abs(excess) > tolerance)[-1])
        if last < count // 2:
            values = np.append(excess[: last + 1], 0.0)
            values.flags.writeable = False
            return ExcessTable(light=light, step=step, values=values)
        count *= 2
    raise InputError(
        f"the light is too coherent: fringes of a film of {MAX_GAP_WAVELENGTHS} wavelengths still exceed "
        f"{tolerance:g} of the contrast; widen the bandwidth, got {light.bandwidth!r} m"
    )


@njit(cache=True, error_model="numpy")
def _film_gap(x, y, disk, outline):  # type: ignore[no-untyped-def]
    """Thickness (m) of the film of a contact at a place from its centre (px); infinite beyond its reach."""
    distance = math.hypot(x, y)
    if distance >= disk[5]:
        return math.inf
    # `jkr.gap` about the disk; what cancels at its edge is far below a step of the table
    q = 1.0 + max(distance - disk[2] - outline[sector_of(x, y, outline.size)], 0.0) / disk[2]
    root = math.sqrt((q - 1.0) * (q + 1.0))
    angle = math.atan(root)
    return max(disk[4] / math.pi * ((q * q - 2.0) * angle + root) + disk[6] * angle, 0.0)


@njit(cache=True, error_model="numpy")
def film_cells(shape, disks, outline, excess, excess_step, origin, cell, points):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Light of contacts and of the film around them, averaged over each cell.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of the grid.
    disks : ndarray, shape (n, 7)
        x, y, radius (px), brightness, ``a^2/R`` (m), the distance (px) from the centre beyond which the film
        has no excess in any direction, and what adhesion adds to the gap, over ``acos(a/r)`` (m).
    outline : ndarray, shape (n, sectors), px
        Deviation of the radius in each sector of the azimuth; the gap moves with the edge.
    excess : ndarray
        Excess at equally spaced gaps, 1 in contact.
    excess_step : float, m
    origin : (float, float), px
        (x, y) of the centre of the first cell.
    cell : float, px
    points : int
        Points per cell and axis over which the light is averaged. The excess is smooth at the edge (``1 - e``
        grows as the cube of the distance), so midpoints suffice if they resolve the fringes.

    Returns
    -------
    ndarray, shape ``shape``
        Where the films of several contacts meet, the thinnest one counts.
    """
    step, out = cell / points, np.zeros(shape)
    rows, columns = shape[0] * points, shape[1] * points
    thinnest, above = np.empty((rows, columns)), np.empty((rows, columns), np.int32)
    for turn in range(3):  # only where there is light: forget, find the thinnest film, add its light
        for k in range(disks.shape[0]):
            # place of the centre among the points, of which the first lies half a step inside the first cell
            column0 = (disks[k, 0] - origin[0] + 0.5 * (cell - step)) / step
            row0 = (disks[k, 1] - origin[1] + 0.5 * (cell - step)) / step
            reach = disks[k, 5] / step
            for i in range(max(int(row0 - reach), 0), min(int(row0 + reach) + 2, rows)):
                for j in range(max(int(column0 - reach), 0), min(int(column0 + reach) + 2, columns)):
                    if turn == 0:
                        thinnest[i, j], above[i, j] = math.inf, -1
                    elif turn == 1:
                        gap = _film_gap((j - column0) * step, (i - row0) * step, disks[k], outline[k])
                        if gap < thinnest[i, j]:
                            thinnest[i, j], above[i, j] = gap, k
                    elif above[i, j] == k:
                        place = min(thinnest[i, j] / excess_step, excess.size - 1.0)
                        below = int(min(place, excess.size - 2.0))
                        light = excess[below] + (place - below) * (excess[below + 1] - excess[below])
                        out[i // points, j // points] += disks[k, 3] * light
    return out / points**2
