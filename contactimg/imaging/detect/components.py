"""Connected components above a level, with their sums, in one pass over the image.

Rows are turned into runs of pixels, runs that touch are joined (union-find), and the sums are taken run by
run; no label image is written. For 500 contacts on 1600 x 1200 pixels it takes 2.0 ms on one thread, where
`cv2.connectedComponentsWithStats` takes 15 ms and gives neither the sums of the image nor second moments.
"""

import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import lengthened, njit
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE

NONE, EIGHT = np.uint64(0), np.uint64(0x0101010101010101)
"""Eight bytes of a mask at once: no pixel set, and all set."""

COMPONENT = np.dtype(
    [
        ("area", np.int64),  # pixels
        ("x", np.float64),  # centroid of the pixels
        ("y", np.float64),
        ("moment", np.float64),  # sum of the squared distances of the pixels from their centroid
        ("xx", np.float64),  # sums of the squares and products of those distances along x and y
        ("xy", np.float64),
        ("flux", np.float64),  # sum of the image over the pixels
        ("peak", np.float64),  # largest value
        ("peak_x", np.int64),
        ("peak_y", np.int64),
        ("left", np.int64),  # bounding box, inclusive
        ("right", np.int64),
        ("top", np.int64),
        ("bottom", np.int64),
    ]
)
"""One component; lengths in px."""


def label_components(image: NDArray[np.float32], level: float) -> NDArray[np.void]:
    """Label the components of the pixels above ``level``, joined by sides and corners.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Positive where the contacts are.
    level : float
        A pixel belongs to a component if it is strictly above.

    Returns
    -------
    ndarray of `COMPONENT`
        In order of their first pixel, row by row.

    Examples
    --------
    >>> image = np.array([[0, 2, 0], [0, 0, 3], [4, 0, 0]], np.float32)
    >>> found = label_components(image, 1.0)
    >>> [(int(c["area"]), float(c["flux"])) for c in found]
    [(2, 5.0), (1, 4.0)]
    """
    return label_runs(image, level)[0]


def label_runs(image: NDArray[np.float32], level: float) -> tuple[NDArray[np.void], NDArray[np.int64]]:
    """Label the components and return the runs of pixels of which they consist.

    Returns
    -------
    components : ndarray of `COMPONENT`
    runs : ndarray, shape (n, 4)
        Row, first and last column, and number of the component, row by row.
    """
    image = np.ascontiguousarray(image)
    runs = _find_runs(image, np.float32(level))
    _join_runs(runs)
    return _measured(image, runs, _number(runs)), runs


def measure_parts(image: NDArray[np.float32], owner: NDArray[np.intp], count: int) -> NDArray[np.void]:
    """The pixels above 0 of each owner, from 0, as one component, whether they are connected or not."""
    parts = [_find_runs(np.where(owner == k, image, np.float32(0.0)), np.float32(0.0)) for k in range(count)]
    runs = np.concatenate(parts)
    runs[:, 3] = np.repeat(np.arange(count), [len(part) for part in parts])
    return _measured(image, runs, count)


def _measured(image: NDArray[np.float32], runs: NDArray[np.int64], count: int) -> NDArray[np.void]:
    """So many components, with the sums over their runs."""
    components = np.zeros(count, COMPONENT)
    components["top"], components["left"] = image.shape
    _measure(image, runs, components)
    return components


def window_of(component: np.void, margin: int = 0) -> tuple[tuple[slice, slice], NDArray[np.float64]]:
    """Rows and columns of a component with a margin around it, and x, y and 0 of their first pixel.

    Examples
    --------
    >>> (only,) = label_components(np.array([[0, 0, 0], [0, 0, 3]], np.float32), 1.0)
    >>> window_of(only, 1)
    ((slice(0, 3, None), slice(1, 4, None)), array([1., 0., 0.]))
    """
    rows, columns = (
        slice(max(int(component[first]) - margin, 0), int(component[last]) + margin + 1)
        for first, last in (("top", "bottom"), ("left", "right"))
    )
    return (rows, columns), np.array([columns.start, rows.start, 0.0])


def sides_cut(components: NDArray[np.void] | np.void, shape: tuple[int, ...]) -> tuple[NDArray, ...]:
    """Whether components touch the top, bottom, left and right of an image of this shape."""
    last = {"top": 0, "bottom": shape[0] - 1, "left": 0, "right": shape[1] - 1}
    return tuple(components[side] == place for side, place in last.items())


def half_axes(components: NDArray[np.void] | np.void) -> tuple[NDArray[np.float64], ...]:
    """Major and minor half-axis and angle of the ellipses with the second moments of the pixels (squares)."""
    area = np.maximum(components["area"], 1)
    xx, xy = components["xx"] / area + PIXEL_VARIANCE, components["xy"] / area
    yy = (components["moment"] - components["xx"]) / area + PIXEL_VARIANCE
    middle, root = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    # the second moment of an ellipse along an axis is a quarter of the square of its half
    minor = 2.0 * np.sqrt(np.maximum(middle - root, PIXEL_VARIANCE))
    return 2.0 * np.sqrt(middle + root), minor, 0.5 * np.arctan2(2.0 * xy, xx - yy)


def mask_of_component(
    runs: NDArray[np.int64], number: int | np.integer, corner: tuple[int, int], shape: tuple[int, ...]
) -> NDArray[np.uint8]:
    """Return a window of the image in which the pixels of one component are 1.

    ``runs`` are those of `label_runs`; ``corner`` is the row and column of the first pixel of the window.

    Examples
    --------
    >>> runs = label_runs(np.array([[0, 2, 0, 0], [0, 0, 3, 0], [4, 0, 0, 0]], np.float32), 1.0)[1]
    >>> mask_of_component(runs, 0, (0, 1), (2, 3)).tolist()
    [[1, 0, 0], [0, 1, 0]]
    """
    mask = np.zeros(shape, np.uint8)
    rows = slice(*np.searchsorted(runs[:, 0], [corner[0], corner[0] + shape[0]]))
    _draw(mask, runs[rows], number, *corner)
    return mask


def component_of_pixels(runs: NDArray[np.int64], x: NDArray, y: NDArray) -> NDArray[np.int64]:
    """Number of the component that contains each of some pixels; -1 for pixels in none.

    ``runs`` are those of `label_runs`.

    Examples
    --------
    >>> runs = label_runs(np.array([[0, 2, 0], [0, 0, 3], [4, 0, 0]], np.float32), 1.0)[1]
    >>> component_of_pixels(runs, np.array([2, 0, 0]), np.array([1, 2, 0])).tolist()
    [0, 1, -1]
    """
    if not len(runs):
        return np.full(len(x), -1)
    width = int(runs[:, 2].max(initial=0)) + 2
    start, end = runs[:, 0] * width + runs[:, 1], runs[:, 0] * width + runs[:, 2]
    place = y * width + np.minimum(x, width - 1)
    k = np.searchsorted(start, place, side="right") - 1
    inside = (k >= 0) & (place <= end[np.maximum(k, 0)])
    return np.where(inside, runs[np.maximum(k, 0), 3], -1)


@njit(cache=True)
def _draw(mask, runs, number, top, left):
    """Set the pixels of one component in a window whose first pixel is at (top, left)."""
    for i in range(len(runs)):
        if runs[i, 3] == number:
            mask[runs[i, 0] - top, runs[i, 1] - left : runs[i, 2] - left + 1] = 1


@njit(cache=True)
def _find_runs(image, level):
    """Runs (row, first column, last column, own number) of pixels above the level, row by row."""
    rows, columns = image.shape
    runs = np.empty((1024 + columns, 4), np.int64)
    count = 0
    # a vectorised pass writes bytes, which are then read eight at a time; the last byte is never set
    mask = np.zeros((columns // 8 + 1) * 8, np.uint8)
    words = mask.view(np.uint64)
    for y in range(rows):
        _compare(image[y], level, mask)
        if count + columns // 2 + 1 > len(runs):
            runs = lengthened(runs)
        inside, unchanged = False, NONE
        for k in range(len(words)):
            if words[k] == unchanged:
                continue
            for x in range(8 * k, 8 * k + 8):
                if (mask[x] > 0) == inside:
                    continue
                if inside:
                    runs[count, 2] = x - 1
                    count += 1
                else:
                    runs[count, 0], runs[count, 1], runs[count, 3] = y, x, count
                inside = not inside
            unchanged = EIGHT if inside else NONE
    return runs[:count]


@njit(cache=True)
def _compare(row, level, mask):
    """1 where a row is above the level; a function of its own, so that it compiles to vector instructions."""
    for x in range(len(row)):
        mask[x] = row[x] > level


@njit(cache=True)
def _root(runs, i):
    """Root of a run in its union-find tree, with path halving."""
    while runs[i, 3] != i:
        runs[i, 3] = runs[runs[i, 3], 3]
        i = runs[i, 3]
    return i


@njit(cache=True)
def _join_runs(runs):
    """Join runs that touch those of the row above."""
    count = len(runs)
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
                    a, b = _root(runs, k), _root(runs, j)
                    runs[max(a, b), 3] = min(a, b)
                    k += 1
        above, above_end, start = start, end, end


@njit(cache=True)
def _number(runs):
    """Number the components of runs from 0, and count them."""
    count = 0
    for i in range(len(runs)):
        parent = runs[i, 3]  # an earlier run, already numbered, or the run itself
        if parent == i:
            runs[i, 3] = count
            count += 1
        else:
            runs[i, 3] = runs[parent, 3]
    return count


@njit(cache=True)
def _measure(image, runs, out):
    """Sums over the pixels of each component."""
    for i in range(len(runs)):
        y, first, last, c = runs[i, 0], runs[i, 1], runs[i, 2], out[runs[i, 3]]
        _add_run(c, y, first, last)
        flux, peak = _light(image[y, first : last + 1])
        c["flux"] += flux
        if peak > c["peak"]:
            c["peak"], c["peak_y"], x = peak, y, first
            while image[y, x] < peak:
                x += 1
            c["peak_x"] = x
    for c in out:
        if c["area"] > 0:
            c["x"] /= c["area"]
            c["y"] /= c["area"]
            c["moment"] -= c["area"] * (c["x"] ** 2 + c["y"] ** 2)
            c["xx"] -= c["area"] * c["x"] ** 2
            c["xy"] -= c["area"] * c["x"] * c["y"]


@njit(cache=True, fastmath=True, forceinline=True)
def _light(pixels):
    """Sum and maximum of some pixels."""
    flux, peak = 0.0, pixels[0]
    for value in pixels:
        flux += value
        peak = max(peak, value)
    return flux, peak


@njit(cache=True)
def _add_run(c, y, first, last):
    """Add the places of a run of pixels to the sums of a component."""
    n = last - first + 1
    c["area"] += n
    c["x"] += 0.5 * n * (first + last)
    c["y"] += float(n * y)
    # squared distances: of the middle of the run, and of its pixels from the middle
    c["moment"] += n * (0.25 * (first + last) ** 2 + y * y) + n * (n * n - 1.0) / 12.0
    middle = 0.5 * (first + last)
    c["xx"] += n * middle * middle + n * (n * n - 1.0) / 12.0
    c["xy"] += n * middle * y
    c["left"] = min(c["left"], first)
    c["right"] = max(c["right"], last)
    c["top"] = min(c["top"], y)
    c["bottom"] = max(c["bottom"], y)
