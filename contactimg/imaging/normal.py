"""Sums over pixels: model image, and normal equations of one disk and of two overlapping ones (compiled).

Parameters of a disk are x, y, radius a, contrast c; the blur s is common. Pixels far inside the rim tell only
about c and are summed run by run; those about the rim are gathered first.
"""

import numpy as np
from numba import njit

from contactimg.imaging.edge import ENDS, INNER
from contactimg.imaging.window import (
    BY_A,
    BY_C,
    BY_S,
    BY_X,
    BY_Y,
    DATA,
    FAST,
    FIELDS,
    WEIGHT,
    chord,
    derivatives,
    edge_row,
    locate,
    profile,
    subtract,
    take,
)

__all__ = [
    "CHI",
    "COUNT",
    "CROSS",
    "RIGHT",
    "SUMS",
    "add_disk",
    "disk_sums",
    "pair_sums",
    "unpack",
]

REACH = 3.6  # blur widths about the rim that enter the fit: beyond, the profile is 0 or 1 to 2e-4
THINNED = 4.0  # px: radius for each row in between that a disk can spare
OUTLIER = 5.0  # standard deviations from which a pixel loses weight
LARGEST_Z2 = 4.0 * OUTLIER**2  # share of one pixel in chi-square
GATHERED = 500  # pixels at a time: they stay in the fastest cache
RINGS = 4  # in a blur width, for the information that a rim carries

SUMS = 22
"""Length of the packed sums: upper triangle for (x, y, a, c), products with s, right sides, chi-square."""
CROSS, RIGHT, CHI, COUNT = 10, 15, 20, 21


@njit(cache=True)
def _reach(table, near):
    """Blur widths beyond the rim that matter, ``near`` of them for a plain disk."""
    return near if table.outer <= INNER else table.outer


@njit(cache=True)
def _space(half):
    """Room for the pixels of some rows of a window, one row at least."""
    return np.empty((FIELDS, max(GATHERED, 2 * int(half) + 3)), np.float32)


@njit(cache=True)
def _runs(half, inner, dy, x, columns):
    """Pixels of a row about the rim, left and right, and between them; each run up to its end."""
    first, end = chord(half, dy, x, columns)
    left, right = chord(inner, dy, x, columns)
    if left < right:
        return (first, left), (right, end), (left, right)
    return (first, end), (end, end), (end, end)


@njit(cache=True)
def add_disk(model, disk, s, table, sign):
    """Add ``sign`` times one disk to the model image."""
    x, y, a, c = disk
    row = edge_row(table, a, s)
    rows, columns = model.shape
    half, inner = a + _reach(table, ENDS) * s, a - ENDS * s
    height = np.float32(sign * c)
    pixels = _space(half)
    top, bottom = max(int(np.ceil(y - half)), 0), min(int(np.floor(y + half)), rows - 1)
    while top <= bottom:
        j, n = top, 0
        while j <= bottom:
            left, right, _ = _runs(half, inner, j - y, x, columns)
            if n + right[1] - left[0] > pixels.shape[1]:
                break
            n = locate(pixels, n, j, left, x, y)
            n = locate(pixels, n, j, right, x, y)
            j += 1
        profile(pixels, n, a, s, row)
        n = 0
        for i in range(top, j):
            left, right, middle = _runs(half, inner, i - y, x, columns)
            n = _add(model, i, left, height, pixels, n)
            n = _add(model, i, right, height, pixels, n)
            for k in range(middle[0], middle[1]):
                model[i, k] += height
        top = j


@njit(cache=True, fastmath=FAST, forceinline=True)
def _add(model, j, run, height, pixels, n):
    """Add a run of pixels gathered; how many have been added."""
    first, end = run
    for i in range(end - first):
        model[j, first + i] += height * pixels[BY_C, n + i]
    return n + max(end - first, 0)


@njit(cache=True, error_model="numpy")
def disk_sums(image, model, weight, disk, s, variance, slope, alone, robust, every, table, out):
    """Normal matrix, right side and chi-square of one disk into ``out`` (see `SUMS`).

    ``variance (1 + slope m)`` is the variance of a pixel of model level m. A disk that stands ``alone``
    is its own model, and the model image is not looked at. Of a disk wider than a few pixels, one row in
    up to ``every`` tells enough while a fit is still far off. The normal matrix of a disk whose window lies
    inside the image and has no masked pixel follows from its profile; only the right side needs the pixels.
    """
    out[:] = 0.0
    x, y, a, c = disk
    rows, columns = image.shape
    half, inner = a + _reach(table, REACH) * s, a - REACH * s
    top, bottom = max(int(np.ceil(y - half)), 0), min(int(np.floor(y + half)), rows - 1)
    row, pixels, n = edge_row(table, a, s), _space(half), 0
    masked = _masked(weight, image.shape, top, bottom + 1, x, half)
    whole = not masked and x > half and x + half < columns - 1 and y > half and y + half < rows - 1
    flat = np.float32(1.0 / (variance * (1.0 + slope * c)))
    step = min(every, 1 + int(a / THINNED))
    for j in range(top, bottom + 1, step):
        left, right, middle = _runs(half, inner, j - y, x, columns)
        if n + right[1] - left[0] > pixels.shape[1]:
            _add_rim(pixels, n, disk, s, row, variance, slope, alone, robust, whole, out)
            n = 0
        if masked:
            n = _gather_seen(pixels, n, image, model, weight, j, left, x, y, alone)
            n = _gather_seen(pixels, n, image, model, weight, j, right, x, y, alone)
            _add_seen(image, model, weight, j, middle, c, flat, alone, robust, whole, out)
        else:
            n = _gather(pixels, n, image, model, j, left, x, y, alone)
            n = _gather(pixels, n, image, model, j, right, x, y, alone)
            _add_plateau(image, model, j, middle, c, flat, alone, robust, whole, out)
    _add_rim(pixels, n, disk, s, row, variance, slope, alone, robust, whole, out)
    out[:CHI] *= step
    if whole:
        _add_expected(pixels, disk, s, row, max(inner, 0.0), half, variance, slope, out)


@njit(cache=True)
def _masked(weight, shape, top, end, x, half):
    """Whether a pixel of a window is to be left out."""
    if weight.shape != shape:
        return False
    first, last = max(int(x - half), 0), min(int(x + half) + 2, shape[1])
    for j in range(top, end):
        least = np.uint8(1)
        for i in range(first, last):
            least = min(least, weight[j, i])
        if least == 0:
            return True
    return False


@njit(cache=True)
def _gather(pixels, n, image, model, j, run, x, y, alone):
    """Add a run of pixels; the number there are now."""
    take(pixels, n, image, j, run)
    if not alone:
        subtract(pixels, n, model, j, run)
    return locate(pixels, n, j, run, x, y)


@njit(cache=True)
def _gather_seen(pixels, n, image, model, weight, j, run, x, y, alone):
    """`_gather` the pixels of a run that are not masked."""
    for i in range(run[0], run[1]):
        if weight[j, i] > 0:
            n = _gather(pixels, n, image, model, j, (i, i + 1), x, y, alone)
    return n


@njit(cache=True)
def _add_seen(image, model, weight, j, run, c, flat, alone, robust, whole, out):
    """`_add_plateau` with the pixels of a run that are not masked."""
    for i in range(run[0], run[1]):
        if weight[j, i] > 0:
            _add_plateau(image, model, j, (i, i + 1), c, flat, alone, robust, whole, out)


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def _add_plateau(image, model, j, run, c, flat, alone, robust, whole, out):
    """Add a run of pixels inside a disk to the right side, and what they tell about the contrast."""
    first, end = run
    cut = np.float32(OUTLIER**2 if robust else np.inf)
    height, total = np.float32(c), np.float32(0.0)
    for i in range(end - first):
        residual = image[j, first + i] - (height if alone else model[j, first + i])
        z2 = residual * residual * flat
        total += residual * (cut / z2 if z2 > cut else np.float32(1.0))
    out[RIGHT + 3] += flat * total
    if not whole:
        out[9] += flat * max(end - first, 0)


@njit(cache=True)
def _add_rim(pixels, n, disk, s, row, variance, slope, alone, robust, whole, out):
    """Add the pixels gathered to the right sides, to chi-square and to the count, and their information."""
    derivatives(pixels, n, disk[2], disk[3], s, row)
    _weigh(pixels[BY_C, :n], pixels[WEIGHT, :n], np.float32(1.0 / variance), np.float32(slope * disk[3]))
    if not whole:
        _add_information(pixels, n, out)
    height = np.float32(disk[3] if alone else 0.0)
    _add_right(pixels, n, height, np.float32(OUTLIER**2 if robust else np.inf), out)


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def _weigh(level, weight, plain, growth):
    """Weights of pixels at some levels of a disk."""
    one, zero = np.float32(1.0), np.float32(0.0)
    for i in range(len(level)):
        weight[i] = plain / (one + growth * max(level[i], zero))


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def _add_right(pixels, n, height, cut, out):
    """Right sides, chi-square and count; the model of ``height`` is still to be taken from the data."""
    data, weight, level = pixels[DATA, :n], pixels[WEIGHT, :n], pixels[BY_C, :n]
    by_x, by_y, by_a, by_s = pixels[BY_X, :n], pixels[BY_Y, :n], pixels[BY_A, :n], pixels[BY_S, :n]
    x = y = a = c = s = chi = np.float32(0.0)
    most = np.float32(LARGEST_Z2)
    for i in range(n):
        residual = data[i] - height * level[i]
        w = weight[i]
        z2 = residual * residual * w
        chi += min(z2, most)
        share = w * residual * (cut / z2 if z2 > cut else np.float32(1.0))
        x += by_x[i] * share
        y += by_y[i] * share
        a += by_a[i] * share
        c += level[i] * share
        s += by_s[i] * share
    out[RIGHT] += x
    out[RIGHT + 1] += y
    out[RIGHT + 2] += a
    out[RIGHT + 3] += c
    out[RIGHT + 4] += s
    out[CHI] += chi
    out[COUNT] += n


@njit(cache=True)
def _add_information(pixels, n, out):
    """Add weighted products of the derivatives of the pixels gathered."""
    k = 0
    for u in range(4):
        for v in range(u, 4):
            out[k] += _product(pixels[WEIGHT, :n], pixels[u, :n], pixels[v, :n])
            k += 1
    for u in range(5):
        out[CROSS + u] += _product(pixels[WEIGHT, :n], pixels[u, :n], pixels[BY_S, :n])


@njit(cache=True, fastmath=FAST, forceinline=True)
def _product(weight, one, other):
    total = np.float32(0.0)
    for i in range(len(weight)):
        total += weight[i] * one[i] * other[i]
    return total


@njit(cache=True, fastmath=FAST, forceinline=True)
def _add_expected(pixels, disk, s, row, inner, half, variance, slope, out):
    """Add the information that a whole disk carries, ring by ring."""
    n = int(RINGS * (half - inner) / s) + 1
    width = (half - inner) / n
    for k in range(n):
        pixels[BY_X, k], pixels[BY_Y, k] = inner + width * (k + 0.5), 0.0
        pixels[DATA, k] = 2.0 * np.pi * width * pixels[BY_X, k]
    derivatives(pixels, n, disk[2], disk[3], s, row)
    weight, by_x, by_a = pixels[WEIGHT, :n], pixels[BY_X, :n], pixels[BY_A, :n]
    by_c, by_s = pixels[BY_C, :n], pixels[BY_S, :n]
    _weigh(by_c, weight, np.float32(1.0 / variance), np.float32(slope * disk[3]))
    for k in range(n):
        weight[k] *= pixels[DATA, k]
    inside = np.pi * inner * inner / (variance * (1.0 + slope * disk[3]))
    out[0] = out[4] = 0.5 * _product(weight, by_x, by_x)
    out[7] = _product(weight, by_a, by_a)
    out[8] = _product(weight, by_a, by_c)
    out[9] = _product(weight, by_c, by_c) + inside
    out[CROSS + 2] = _product(weight, by_a, by_s)
    out[CROSS + 3] = _product(weight, by_c, by_s)
    out[CROSS + 4] = _product(weight, by_s, by_s)


@njit(cache=True)
def unpack(out, normal, right):
    """Full 4 x 4 matrix and right side from the packed sums."""
    n = 0
    for u in range(4):
        for v in range(u, 4):
            normal[u, v] = normal[v, u] = out[n]
            n += 1
    for u in range(4):
        right[u] = out[RIGHT + u]


@njit(cache=True, error_model="numpy")
def pair_sums(model, weight, one, two, s, variance, slope, table, out):
    """The 4 x 4 block of the normal matrix between two disks, over the pixels in the windows of both."""
    out[:] = 0.0
    row1, row2 = edge_row(table, one[2], s), edge_row(table, two[2], s)
    reach = _reach(table, REACH) * s
    half1, half2 = one[2] + reach, two[2] + reach
    rows, columns = model.shape
    masked = weight.shape == model.shape
    first, second = _space(half1), _space(half1)
    top = max(int(np.ceil(max(one[1] - half1, two[1] - half2))), 0)
    bottom = min(int(np.floor(min(one[1] + half1, two[1] + half2))), rows - 1)
    n = 0
    for j in range(top, bottom + 1):
        a0, a1 = chord(half1, j - one[1], one[0], columns)
        b0, b1 = chord(half2, j - two[1], two[0], columns)
        start, end = max(a0, b0), min(a1, b1)
        if end <= start:
            continue
        if n + end - start > first.shape[1]:
            _add_pair(first, second, n, one, two, s, row1, row2, variance, slope, out)
            n = 0
        run = (start, end)
        take(first, n, model, j, run)
        locate(first, n, j, run, one[0], one[1])
        for i in range(start, end):
            first[WEIGHT, n + i - start] = 0.0 if masked and weight[j, i] == 0 else 1.0
        n = locate(second, n, j, run, two[0], two[1])
    _add_pair(first, second, n, one, two, s, row1, row2, variance, slope, out)


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def _add_pair(first, second, n, one, two, s, row1, row2, variance, slope, out):
    """Add weighted products of the derivatives with respect to one disk and to the other."""
    derivatives(first, n, one[2], one[3], s, row1)
    derivatives(second, n, two[2], two[3], s, row2)
    plain, growth, zero = np.float32(1.0 / variance), np.float32(slope), np.float32(0.0)
    level, weight = first[DATA, :n], first[WEIGHT, :n]
    for i in range(n):
        weight[i] *= plain / (np.float32(1.0) + growth * max(level[i], zero))
    for u in range(4):
        for v in range(4):
            out[u, v] += _product(weight, first[u, :n], second[v, :n])
