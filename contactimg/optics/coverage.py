"""Exact areas of disks on the square cells of a grid: the fraction of each pixel that a contact covers."""

import math

import numpy as np

from contactimg.compiled import njit


@njit(cache=True, error_model="numpy")
def _quadrant_area(x, y, radius):  # type: ignore[no-untyped-def]
    """Area between the axes and (x, y) that lies in the disk around the origin; odd in x and in y.

    ``int_0^x clip(y, -s, s) du`` with ``s = sqrt(a^2 - u^2)``: a rectangle up to where the circle falls below
    y, from there on the area under the circle, ``(u s + a^2 atan(u/s))/2`` (an arcsine loses digits near 1).
    """
    sign = math.copysign(1.0, x) * math.copysign(1.0, y)
    x, y = min(abs(x), radius), min(abs(y), radius)
    corner = math.sqrt((radius - y) * (radius + y))
    if x <= corner:
        return sign * x * y
    height = math.sqrt((radius - x) * (radius + x))
    angle = math.atan2(x, height) - math.atan2(corner, y)
    return sign * 0.5 * (corner * y + x * height + radius * radius * angle)


@njit(cache=True, error_model="numpy")
def disk_rectangle_area(left, right, top, bottom, radius):  # type: ignore[no-untyped-def]
    """Area of a rectangle that lies inside the disk of a radius around the origin.

    Parameters
    ----------
    left, right, top, bottom : float, px
        Edges of the rectangle, relative to the centre of the disk; ``left <= right``, ``top <= bottom``.
    radius : float, px
        Above 0.

    Returns
    -------
    float, px^2

    Notes
    -----
    Four quadrant areas are added, so that the rounding error is about ``1e-16 radius^2``.

    Examples
    --------
    >>> 4 * disk_rectangle_area(0.0, 2.0, 0.0, 2.0, 1.0)
    3.14159265
    """
    above_bottom = _quadrant_area(right, bottom, radius) - _quadrant_area(left, bottom, radius)
    return above_bottom - _quadrant_area(right, top, radius) + _quadrant_area(left, top, radius)


@njit(cache=True, error_model="numpy")
def _cell_fraction(x, y, radius, cell):  # type: ignore[no-untyped-def]
    """Fraction of the square cell centred at (x, y) that the disk around the origin covers."""
    half = 0.5 * cell
    distance = math.hypot(x, y)
    if radius <= 0.0 or distance - cell * math.sqrt(0.5) >= radius:
        return 0.0
    if distance + cell * math.sqrt(0.5) <= radius:
        return 1.0
    area = disk_rectangle_area(x - half, x + half, y - half, y + half, radius)
    return max(area, 0.0) / (cell * cell)  # rounding can make an empty cell negative


@njit(cache=True, error_model="numpy")
def sector_of(x, y, count):  # type: ignore[no-untyped-def]
    """Index of the sector, of ``count`` equal ones from -pi on, that contains the direction (x, y)."""
    if count == 1:
        return 0
    return min(int((math.atan2(y, x) / (2 * math.pi) + 0.5) * count), count - 1)


@njit(cache=True, error_model="numpy")
def cover_cells(shape, disks, outline, rim, rim_weight, origin, cell):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Brightness of disks on a grid of square cells: exact coverage, overlapping disks as a union.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of the grid.
    disks : ndarray, shape (n, 4 or more)
        x, y, radius (px) and brightness of each disk.
    outline : ndarray, shape (n, sectors), px
        Deviation of the radius in each sector of the azimuth, from -pi on; one sector of zeros for disks.
    rim, rim_weight : ndarray, shape (m,), px and fractions
        A disk is the sum of ``m`` concentric ones whose radii exceed its own by ``rim``; ``[0]`` and ``[1]``
        for a sharp edge. The weights add up to 1.
    origin : (float, float), px
        (x, y) of the centre of the first cell.
    cell : float, px

    Returns
    -------
    ndarray, shape ``shape``
        Coverage times brightness, averaged over each cell. Where the coverages of several disks add up to
        more than 1 the cell is full, and its brightness their mean: exact unless two edges cross in one cell.

    Examples
    --------
    >>> disk, sharp = np.array([[4.0, 4.0, 3.0, 1.0]]), (np.zeros(1), np.ones(1))
    >>> image = cover_cells((9, 9), disk, np.zeros((1, 1)), *sharp, (0.0, 0.0), 1.0)
    >>> float(image.sum())  # 9 pi
    28.27433388
    """
    covered, light = np.zeros(shape), np.zeros(shape)
    for k in range(disks.shape[0]):
        column0, row0 = (disks[k, 0] - origin[0]) / cell, (disks[k, 1] - origin[1]) / cell
        reach = (disks[k, 2] + outline[k].max() + rim.max()) / cell + 1.0
        for row in range(max(int(row0 - reach), 0), min(int(row0 + reach) + 2, shape[0])):
            for column in range(max(int(column0 - reach), 0), min(int(column0 + reach) + 2, shape[1])):
                dx, dy = (column - column0) * cell, (row - row0) * cell
                edge = disks[k, 2] + outline[k, sector_of(dx, dy, outline.shape[1])]
                for m in range(rim.size):
                    part = rim_weight[m] * _cell_fraction(dx, dy, edge + rim[m], cell)
                    covered[row, column] += part
                    light[row, column] += disks[k, 3] * part
    return light / np.maximum(covered, 1.0)
