"""Connected components above a level, in one pass over the image, with what a measurement needs of each."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["COMPONENT", "add_pixel", "finish_component", "label_components"]

COMPONENT = np.dtype(
    [
        ("area", np.int64),  # pixels
        ("x", np.float64),  # centroid of the pixels
        ("y", np.float64),
        ("moment", np.float64),  # sum of the squared distances of the pixels from their centroid
        ("flux", np.float64),  # sum of the image over the pixels
        ("peak", np.float64),  # largest value
        ("peak_x", np.int64),
        ("peak_y", np.int64),
        ("left", np.int64),  # bounding box, inclusive
        ("right", np.int64),
        ("top", np.int64),
        ("bottom", np.int64),
        ("marked", np.int64),  # pixels set in the marks
    ]
)
"""One component; lengths in px."""


def label_components(
    image: NDArray[np.float32], level: float, *, marks: NDArray[np.uint8]
) -> NDArray[np.void]:
    """Components of the pixels above ``level``, joined by sides and corners.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Positive where the contacts are.
    level : float
        A pixel belongs to a component if it is strictly above.
    marks : ndarray of uint8, shape (rows, columns)
        Pixels to count in ``marked`` (saturated ones, say). An array of shape (1, 1) counts none.

    Returns
    -------
    ndarray of `COMPONENT`
        In order of their first pixel, row by row.

    Examples
    --------
    >>> image = np.array([[0, 2, 0], [0, 0, 3], [4, 0, 0]], np.float32)
    >>> found = label_components(image, 1.0, marks=np.zeros((1, 1), np.uint8))
    >>> [(int(c["area"]), float(c["flux"])) for c in found]
    [(2, 5.0), (1, 4.0)]
    """
    runs = _find_runs(image, level)
    parents = _join_runs(runs)
    numbers, components = _number(parents)
    out = np.zeros(components, COMPONENT)
    if components:
        _measure(image, runs, numbers, marks, out)
    return out


def _find_runs(image: NDArray[np.float32], level: float) -> NDArray[np.int64]:
    """Runs (row, first column, last column) of pixels above the level, row by row."""
    rows, columns = image.shape
    # one pixel below the level between rows, and the ends of the runs are where the mask changes
    mask = np.zeros((rows, columns + 1), np.bool_)
    np.greater(image, np.float32(level), out=mask[:, :columns])
    flat = mask.ravel()
    changes = np.flatnonzero(flat[1:] != flat[:-1]) + 1
    if flat[0]:
        changes = np.concatenate([[0], changes])
    row, first = np.divmod(changes[::2], columns + 1)
    return np.stack([row, first, changes[1::2] - row * (columns + 1) - 1], axis=1)


@njit(cache=True)
def _root(parents, i):
    """Representative of a run's component, with path halving."""
    while parents[i] != i:
        parents[i] = parents[parents[i]]
        i = parents[i]
    return i


@njit(cache=True)
def _join_runs(runs):
    """Union of runs that touch from row to row."""
    count = len(runs)
    parents = np.arange(count)
    above, above_end, start = 0, 0, 0
    while start < count:
        end = start
        while end < count and runs[end, 0] == runs[start, 0]:
            end += 1
        if above < above_end and runs[above, 0] == runs[start, 0] - 1:
            i = above
            for j in range(start, end):
                while i < above_end and runs[i, 2] < runs[j, 1] - 1:
                    i += 1
                k = i
                while k < above_end and runs[k, 1] <= runs[j, 2] + 1:
                    a, b = _root(parents, k), _root(parents, j)
                    parents[max(a, b)] = min(a, b)
                    k += 1
        above, above_end, start = start, end, end
    return parents


@njit(cache=True)
def _number(parents):
    """Consecutive number of each run's component."""
    numbers = np.empty(len(parents), np.int64)
    count = 0
    for i in range(len(parents)):
        root = _root(parents, i)
        if root == i:
            numbers[i] = count
            count += 1
        else:
            numbers[i] = numbers[root]
    return numbers, count


@njit(cache=True)
def _measure(image, runs, numbers, marks, out):
    """Sums over the pixels of each component."""
    out["left"][:] = image.shape[1]
    out["top"][:] = image.shape[0]
    marked = marks.shape == image.shape
    for i in range(len(runs)):
        y, first, last = runs[i]
        for x in range(first, last + 1):
            add_pixel(out[numbers[i]], x, y, image[y, x], marked and marks[y, x] > 0)
    for c in out:
        finish_component(c)


@njit(cache=True)
def add_pixel(c, x, y, value, marked):
    """Add one pixel to the sums of a component."""
    c["area"] += 1
    c["x"] += x
    c["y"] += y
    c["moment"] += float(x * x + y * y)
    c["left"] = min(c["left"], x)
    c["right"] = max(c["right"], x)
    c["top"] = min(c["top"], y)
    c["bottom"] = max(c["bottom"], y)
    c["flux"] += value
    if value > c["peak"]:
        c["peak"], c["peak_x"], c["peak_y"] = value, x, y
    c["marked"] += marked


@njit(cache=True)
def finish_component(c):
    """Make means of the sums of a component."""
    c["x"] /= c["area"]
    c["y"] /= c["area"]
    c["moment"] -= c["area"] * (c["x"] ** 2 + c["y"] ** 2)
