"""Compute the light of contacts on the pixels; only their neighbourhoods are sampled finely, block by block.

Blurring and averaging are linear, so contacts that share no fine cell are rendered separately and added.
"""

import math
from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactimg.optics.coverage import cover_cells
from contactimg.optics.film import ExcessTable, film_cells
from contactimg.optics.psf import Halo, Psf

Values = NDArray[np.float64]

BLOCK_PX = 64  # largest side of a finely sampled block without margins; chosen for speed
POINTS_PER_FRINGE = 1.5  # at the end of the film's table; chosen: 3 where fringes have 5 % of the contrast

_gauss_nodes = cache(np.polynomial.legendre.leggauss)


@dataclass(frozen=True, eq=False)
class Spots:
    """Spots of light on the image: disks with a sharp or a soft edge.

    Parameters
    ----------
    x_px, y_px, radius_px : ndarray, shape (n,)
        Radii above 0.
    brightness : ndarray, shape (n,)
    outline_px : ndarray, shape (n, sectors)
        Deviation of the radius in each sector of the azimuth, from -pi on; one sector of zeros for disks.
    rim_px : float
        Width over which the brightness falls linearly to 0 outside the edge.
    """

    x_px: Values
    y_px: Values
    radius_px: Values
    brightness: Values
    outline_px: Values
    rim_px: float = 0.0

    @property
    def disks(self) -> Values:
        """x, y, radius (px) and brightness of each spot, one row a spot."""
        return np.column_stack([self.x_px, self.y_px, self.radius_px, self.brightness])

    @property
    def extent_px(self) -> Values:
        """Distance from the centre beyond which each spot is dark."""
        return self.radius_px + self.outline_px.max(axis=1, initial=0.0) + self.rim_px

    def sample(self, chosen: NDArray[np.intp], shape: tuple[int, int], origin: Values, cell: float) -> Values:
        """Mean light of the chosen spots in each cell of a grid whose first cell is centred at ``origin``."""
        # the linear rim as a sum of disks, two or more a pixel: Gauss nodes give its area exactly
        nodes, weights = _gauss_nodes(max(2, math.ceil(2 * self.rim_px)) if self.rim_px else 1)
        rim, disks, outline = self.rim_px * (nodes + 1) / 2, self.disks[chosen], self.outline_px[chosen]
        return cover_cells(shape, disks, outline, rim, weights / 2, (origin[0], origin[1]), cell)


@dataclass(frozen=True, eq=False, kw_only=True)
class FilmSpots(Spots):
    """Contacts and the light that the air film around them lets through; made by `surround_with_film`.

    Parameters
    ----------
    depth : ndarray, shape (n,), m
        ``a^2/R`` of each contact, whose edge is sharp.
    film_px : ndarray, shape (n,)
        Distance from the edge at which the film has no excess.
    excess : ExcessTable
    fringe_px : float
        Period of the finest fringe, at the end of the table.
    opening : float, m
        What adhesion adds to the gap of Hertz's contact, over ``acos(a/r)``.
    """

    depth: Values
    film_px: Values
    excess: ExcessTable
    fringe_px: float
    opening: float = 0.0

    @property
    def extent_px(self) -> Values:
        """Distance from its centre beyond which the halo of each contact has ended."""
        return super().extent_px + self.film_px

    def sample(self, chosen: NDArray[np.intp], shape: tuple[int, int], origin: Values, cell: float) -> Values:
        """Mean light in each cell; where halos meet, that of the thinnest film counts."""
        opening = np.full(len(self.depth), self.opening)
        disks = np.column_stack([self.disks, self.depth, self.extent_px, opening])[chosen]
        outline, excess = self.outline_px[chosen], (self.excess.values, self.excess.step)
        points = max(math.ceil(POINTS_PER_FRINGE * cell / self.fringe_px), 2 if self.opening else 1)
        return film_cells(shape, disks, outline, *excess, (origin[0], origin[1]), cell, points)


def surround_with_film(
    spots: Spots, *, sphere_radius: ArrayLike, pixel_size: float, excess: ExcessTable
) -> FilmSpots:
    """Contacts with the air film around them.

    Parameters
    ----------
    spots : Spots
        With a sharp edge.
    sphere_radius : array_like, m
        Radius of curvature R of each contact, or one for all.
    pixel_size : float, m
    excess : ExcessTable

    Returns
    -------
    FilmSpots
    """
    radius = spots.radius_px * pixel_size
    sphere = np.broadcast_to(np.asarray(sphere_radius, float), radius.shape)
    reach = excess.reach(radius=radius, sphere_radius=sphere)
    # the gap opens less than the sphere
    steepest = float(np.max(reach / sphere, initial=np.finfo(float).tiny))
    return FilmSpots(
        **vars(spots),
        depth=radius**2 / sphere,
        film_px=(reach - radius) / pixel_size,
        excess=excess,
        fringe_px=excess.light.wavelength / (2 * steepest * pixel_size),
    )


def spots_image(spots: Spots, *, shape: tuple[int, int], psf: Psf, halo: Halo | None = None) -> Values:
    """Compute the light of spots on the pixels, blurred and averaged over each pixel.

    Parameters
    ----------
    spots : Spots
    shape : (int, int)
        Rows and columns of the image.
    psf : Psf
        Its sampling sets the size of the fine cells.
    halo : Halo, optional
        A fraction of the light that is spread widely.

    Returns
    -------
    ndarray, shape (rows, columns)

    Notes
    -----
    Without blur the sum over the image of a disk of brightness 1 is its area inside the frame.

    Examples
    --------
    >>> from contactimg.optics.psf import gaussian_psf
    >>> one = np.ones(1)
    >>> spots = Spots(20.3 * one, 14.8 * one, 3 * one, one, np.zeros((1, 1)))
    >>> image = spots_image(spots, shape=(30, 40), psf=gaussian_psf(1.4, sampling=4))
    >>> float(image.sum())  # 9 pi
    28.27433
    """
    margin = halo.margin_px if halo is not None else 0
    canvas = np.zeros((shape[0] + 2 * margin, shape[1] + 2 * margin))
    places, cell = np.column_stack([spots.y_px, spots.x_px]) + margin, 1 / psf.sampling
    reach, side = (spots.extent_px + psf.margin_px + 1)[:, np.newaxis], max(BLOCK_PX, 2 * psf.margin_px)
    for corner in product(range(0, canvas.shape[0], side), range(0, canvas.shape[1], side)):
        end = np.minimum(np.array(corner) + side, canvas.shape)
        outside = np.maximum(np.maximum(corner - places, places - (end - 1)), 0.0)
        near = np.flatnonzero(np.hypot(*outside.T) <= reach[:, 0])
        if not near.size:
            continue
        first = np.maximum(corner, np.floor((places - reach)[near].min(axis=0)).astype(int))
        last = np.minimum(end, np.ceil((places + reach)[near].max(axis=0)).astype(int) + 1)
        rows, columns = (last - first + 2 * psf.margin_px) * psf.sampling
        origin = first[::-1] - psf.margin_px - 0.5 + 0.5 * cell - margin
        patch = spots.sample(near, (int(rows), int(columns)), origin, cell)
        canvas[first[0] : last[0], first[1] : last[1]] = psf.bin_blurred(patch)
    if halo is None:
        return canvas
    return halo.spread(canvas)[margin : margin + shape[0], margin : margin + shape[1]]


# --- outlines that are not circles: ellipses, and waves around a disk of the same area

MAX_ROUGHNESS_FRACTION = 1 / 6
"""Largest rms roughness of an edge as a fraction of the radius. Chosen by hand; sensitivity not measured."""

SECTORS = 1024
"""Of the azimuth. Chosen: the radius of an ellipse of a ratio of 16 changes by less than 4 % from one to the
next."""

AZIMUTHS = -np.pi + 2 * np.pi * (np.arange(SECTORS) + 0.5) / SECTORS
"""Middle of each sector, rad."""

LOWEST_MODE, HIGHEST_MODE = 2, 8  # waves around an edge: mode 0 is the radius, mode 1 the position


def rough_outlines(radius_px: ArrayLike, *, rms_px: float, rng: np.random.Generator) -> Values:
    """Deviations of the radius in each sector of the azimuth, from -pi on.

    Parameters
    ----------
    radius_px : array_like, shape (n,), px
        Radii of disks of the same areas.
    rms_px : float, px
        Rms roughness of the edge; limited to a sixth of the radius.
    rng : numpy.random.Generator

    Returns
    -------
    ndarray, shape (n, `SECTORS`), px

    Examples
    --------
    >>> gain = rough_outlines([10.0], rms_px=0.5, rng=np.random.default_rng(1))
    >>> float(np.mean((10.0 + gain) ** 2))
    100.0
    """
    radius = np.asarray(radius_px, float)
    modes = np.arange(LOWEST_MODE, HIGHEST_MODE + 1)
    angles = modes[:, None] * AZIMUTHS
    waves = np.concatenate([np.cos(angles), np.sin(angles)])
    amplitudes = rng.standard_normal((radius.size, len(waves))) / np.sqrt(len(modes))
    rms = np.minimum(rms_px, MAX_ROUGHNESS_FRACTION * radius)
    edges = np.maximum(radius[:, None] + rms[:, None] * (amplitudes @ waves), 0.0)
    equal_area = radius / np.sqrt(np.mean(edges**2, axis=1))
    return edges * equal_area[:, None] - radius[:, None]


def elliptic_outlines(
    semi_major_px: ArrayLike, semi_minor_px: ArrayLike, angle: ArrayLike, *, outline_px: Values
) -> Values:
    """Deviations of ellipses from the circles of their areas in each sector of the azimuth, from -pi on.

    Parameters
    ----------
    semi_major_px, semi_minor_px : array_like, shape (n,), px
    angle : array_like, shape (n,), rad
        Of the major axis, from +x towards +y.
    outline_px : ndarray, shape (n, k), px
        Deviations of rough circles, which are stretched to the ellipses.

    Returns
    -------
    ndarray, shape (n, `SECTORS`), px

    Examples
    --------
    >>> elliptic_outlines([4.0], [1.0], [0.0], outline_px=np.zeros((1, 1)))[0, [0, 256]].round(2)
    array([ 2., -1.])
    """
    a, b, turn = (np.asarray(values, float)[:, None] for values in (semi_major_px, semi_minor_px, angle))
    azimuth = AZIMUTHS - turn
    edges, radius = a * b / np.hypot(b * np.cos(azimuth), a * np.sin(azimuth)), np.sqrt(a * b)
    on_circle = np.arctan2(a * np.sin(azimuth), b * np.cos(azimuth))  # where the point lay before stretching
    sector = ((on_circle + np.pi) / (2 * np.pi) * outline_px.shape[1]).astype(np.intp) % outline_px.shape[1]
    edges = edges * (1 + np.take_along_axis(outline_px, sector, axis=1) / radius)
    return edges * radius / np.sqrt(np.mean(edges**2, axis=1, keepdims=True)) - radius
