"""Outlines of contacts that are not circles: ellipses, and waves around a disk of the same area."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Values = NDArray[np.float64]

MAX_ROUGHNESS_FRACTION = 1 / 6
"""Largest rms roughness of an edge as a fraction of the radius. Chosen by hand; sensitivity not measured."""

SECTORS = 256  # of the azimuth; chosen to resolve the highest mode
SECTORS_FOR_RATIO = 4.0
"""Ratio of half-axes up to which 256 sectors follow an ellipse. Chosen: its radius then changes by less than
4 % from one sector to the next."""

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
    ndarray, shape (n, 256), px

    Examples
    --------
    >>> gain = rough_outlines([10.0], rms_px=0.5, rng=np.random.default_rng(1))
    >>> float(np.mean((10.0 + gain) ** 2))
    100.0
    """
    radius = np.asarray(radius_px, float)
    modes = np.arange(LOWEST_MODE, HIGHEST_MODE + 1)
    angles = -np.pi + 2 * np.pi * (np.arange(SECTORS) + 0.5) / SECTORS
    waves = np.concatenate([np.cos(modes[:, None] * angles), np.sin(modes[:, None] * angles)])
    amplitudes = rng.standard_normal((radius.size, len(waves))) / np.sqrt(len(modes))
    edges = radius[:, None] + np.minimum(rms_px, MAX_ROUGHNESS_FRACTION * radius)[:, None] * (
        amplitudes @ waves
    )
    edges = np.maximum(edges, 0.0)
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
    ndarray, shape (n, sectors), px
        256 sectors, or a multiple of that for long ellipses.

    Examples
    --------
    >>> elliptic_outlines([4.0], [1.0], [0.0], outline_px=np.zeros((1, 1)))[0, [0, 64]].round(2)
    array([ 2., -1.])
    """
    a, b, turn = (np.asarray(values, float)[:, None] for values in (semi_major_px, semi_minor_px, angle))
    sectors = SECTORS * int(np.ceil(np.max(a / b, initial=1.0) / SECTORS_FOR_RATIO))
    azimuth = -np.pi + 2 * np.pi * (np.arange(sectors) + 0.5) / sectors - turn
    edges, radius = a * b / np.hypot(b * np.cos(azimuth), a * np.sin(azimuth)), np.sqrt(a * b)
    on_circle = np.arctan2(a * np.sin(azimuth), b * np.cos(azimuth))  # where the point lay before stretching
    sector = ((on_circle + np.pi) / (2 * np.pi) * outline_px.shape[1]).astype(np.intp) % outline_px.shape[1]
    edges = edges * (1 + np.take_along_axis(outline_px, sector, axis=1) / radius)
    return edges * radius / np.sqrt(np.mean(edges**2, axis=1, keepdims=True)) - radius
