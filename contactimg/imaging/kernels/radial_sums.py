"""Residuals of disks against the distance from their centres; radial profiles added to an image (compiled).

Profiles and templates are given at nodes (`contactimg.imaging.profile.edge_shape.Nodes`), linear between
them.
"""

import numpy as np

from contactimg.compiled import njit
from contactimg.imaging.profile.edge_shape import INNER_NODES


@njit(cache=True)
def _window(centre, half, size):
    """First pixel within ``half`` of a centre, and the one after the last."""
    return max(int(np.ceil(centre - half)), 0), min(int(np.floor(centre + half)) + 1, size)


@njit(cache=True, error_model="numpy", inline="always")
def _place(r, inner, step):
    """Place among the nodes."""
    if r < inner:
        return r / inner * INNER_NODES
    return INNER_NODES + (r - inner) / step


@njit(cache=True, error_model="numpy")
def sum_residuals(image, valid, disks, inner, profiles, steps, count, clip):
    """Residuals of each disk, shared between the two nodes about each pixel: shape (n, INNER_NODES + count).

    Their product with a template at the nodes is the sum over pixels of residual times template. Residuals
    are clipped at ``clip``. ``steps`` are those of the profiles and of the sums. Masked pixels are passed
    over; the sums of a disk with more than 2 % of them are NaN, whose steps would be shorter by as much.
    """
    rows, columns = image.shape
    sums = np.zeros((len(disks), INNER_NODES + count))
    masked = valid.shape == image.shape
    for i in range(len(disks)):
        x, y, c = disks[i, 0], disks[i, 1], disks[i, 3]
        reach = inner[i] + steps[1] * (count - 1) - 1e-9
        top, bottom = _window(y, reach, rows)
        first, last = _window(x, reach, columns)
        within = hidden = 0
        for row in range(top, bottom):
            dy2 = (row - y) ** 2
            for column in range(first, last):
                r2 = (column - x) ** 2 + dy2
                if r2 >= reach**2:
                    continue
                within += 1
                if masked and valid[row, column] == 0:
                    hidden += 1
                    continue
                r = np.sqrt(r2)
                place = _place(r, inner[i], steps[0])
                k = int(place)
                level = c * (profiles[i, k] + (place - k) * (profiles[i, k + 1] - profiles[i, k]))
                rest = min(max(image[row, column] - level, -clip), clip)
                place = _place(r, inner[i], steps[1])
                k = int(place)
                sums[i, k] += (1.0 - place + k) * rest
                sums[i, k + 1] += (place - k) * rest
        if hidden > 0.02 * within:
            sums[i, 0] = np.nan
    return sums


@njit(cache=True, error_model="numpy")
def add_profiles(image, disks, inner, profiles, step):
    """Add contrast times profile of each disk to an image, in place."""
    rows, columns = image.shape
    for i in range(len(disks)):
        x, y = disks[i, 0], disks[i, 1]
        reach = inner[i] + step * (profiles.shape[1] - INNER_NODES - 1) - 1e-9
        top, bottom = _window(y, reach, rows)
        levels = disks[i, 3] * profiles[i]
        for row in range(top, bottom):
            square = reach**2 - (row - y) ** 2
            first, last = _window(x, np.sqrt(max(square, 0.0)), columns)
            for column in range(first, last):
                r = np.sqrt((column - x) ** 2 + (row - y) ** 2)
                if r >= reach:
                    continue
                place = _place(r, inner[i], step)
                k = int(place)
                image[row, column] += levels[k] + (place - k) * (levels[k + 1] - levels[k])
