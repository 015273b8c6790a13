"""The light of contacts seen through the air film around them, averaged over a grid of square cells."""

import math

import numpy as np

from contactimg.compiled import njit
from contactimg.optics.coverage import sector_of


@njit(cache=True, error_model="numpy")
def _interpolate(place, values):  # type: ignore[no-untyped-def]
    """Linear interpolation at a fractional index; the first value below index 0."""
    if place <= 0.0:
        return values[0]
    k = min(int(place), values.size - 2)
    return values[k] + (place - k) * (values[k + 1] - values[k])


@njit(cache=True, error_model="numpy")
def _film_light(px, py, disks, outline, gaps, excess, excess_step):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Light at one point: the excess of the thinnest film above it, times that contact's brightness."""
    thinnest, brightness = math.inf, 0.0
    for k in range(disks.shape[0]):
        dx, dy = px - disks[k, 0], py - disks[k, 1]
        edge = disks[k, 2] + outline[k, sector_of(dx, dy, outline.shape[1])]
        place = (math.hypot(dx, dy) - edge) / disks[k, 4]
        if place < gaps.shape[1] - 1:
            gap = _interpolate(place, gaps[k])
            if gap < thinnest:
                thinnest, brightness = gap, disks[k, 3]
    place = thinnest / excess_step
    if place >= excess.size - 1:
        return 0.0
    return brightness * _interpolate(place, excess)


@njit(cache=True, error_model="numpy")
def _is_dark(px, py, cell, disks, reach):  # type: ignore[no-untyped-def]
    """Whether the cell centred at a point lies beyond the film of every contact."""
    corner = cell * math.sqrt(0.5)
    for k in range(disks.shape[0]):
        if math.hypot(px - disks[k, 0], py - disks[k, 1]) - corner < reach[k]:
            return False
    return True


@njit(cache=True, error_model="numpy")
def film_cells(shape, disks, outline, gaps, excess, excess_step, origin, cell, points):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Light of contacts and of the film around them, averaged over each cell.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of the grid.
    disks : ndarray, shape (n, 5)
        x, y, radius (px), brightness, and the spacing (px) of the distances at which ``gaps`` are given.
    outline : ndarray, shape (n, sectors), px
        Deviation of the radius in each sector of the azimuth; the gap moves with the edge.
    gaps : ndarray, shape (n, k), m
        Gap at ``k`` equally spaced distances from the edge of each contact; 0 at the edge.
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
    out = np.zeros(shape)
    reach = np.array([disks[k, 2] + outline[k].max() for k in range(disks.shape[0])])
    reach += disks[:, 4] * (gaps.shape[1] - 1)
    step = cell / points
    for row in range(shape[0]):
        y = origin[1] + row * cell
        for column in range(shape[1]):
            x = origin[0] + column * cell
            if _is_dark(x, y, cell, disks, reach):
                continue
            total = 0.0
            for i in range(points):
                for j in range(points):
                    px = x + (j + 0.5) * step - 0.5 * cell
                    py = y + (i + 0.5) * step - 0.5 * cell
                    total += _film_light(px, py, disks, outline, gaps, excess, excess_step)
            out[row, column] = total / (points * points)
    return out
