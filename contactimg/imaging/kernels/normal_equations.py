"""Sums over pixels: model image, and normal equations of one disk and of two overlapping ones (compiled).

Parameters of a disk are x, y, radius a, contrast c; the blur s is common. Pixels far inside the rim tell only
about c and are summed row by row; those about the rim are gathered first, in blocks.
"""

import numpy as np
from numba import njit

from contactimg.imaging.kernels.rim_pixels import (
    BY_A,
    BY_C,
    BY_S,
    BY_X,
    BY_Y,
    DATA,
    FAST,
    PLACE,
    WEIGHT,
    between,
    derivatives,
    edge_row,
    locate,
    pad,
    profile,
    row_of,
    space,
    strip,
    take,
)
from contactimg.imaging.profile.blurred_disk import ENDS, INNER

REACH = 3.6  # blur widths about the rim that enter the fit: beyond, the profile is 0 or 1 to 2e-4
THINNED = 4.0  # px: radius for each row in between that a disk can spare
OUTLIER = 5.0  # standard deviations from which a pixel loses weight
LARGEST_Z2 = 4.0 * OUTLIER**2  # share of one pixel in chi-square
RINGS = 4  # in a blur width, for the information that a rim carries

SUMS = 22
"""Length of the packed sums: upper triangle for (x, y, a, c), products with s, right sides, chi-square."""
CROSS, RIGHT, CHI, COUNT = 10, 15, 20, 21


@njit(cache=True)
def _reach(table, near):
    """Blur widths beyond the rim that matter, ``near`` of them for a plain disk."""
    return near if table.outer <= INNER else table.outer


@njit(cache=True)
def add_disk(model, disk, s, table, sign):
    """Add ``sign`` times one disk to the model image."""
    x, y, a, c = disk
    rows, columns = model.shape
    reach = _reach(table, ENDS)
    half, inner = a + reach * s, a - ENDS * s
    row, pixels, height = edge_row(table, a, s), space(half), np.float32(sign * c)
    j, bottom = max(int(np.ceil(y - half)), 0), min(int(np.floor(y + half)), rows - 1)
    while j <= bottom:
        left, right = strip(j, bottom, 1, half, inner, x, y, columns)
        n = pad(pixels, locate(pixels, locate(pixels, 0, left, x, y), right, x, y))
        profile(pixels, n, a, s, row)
        _raise(pixels[BY_C, :n], pixels[PLACE, :n], np.float32(reach / ENDS), height)
        _add(model, left, pixels[BY_C], 0)
        _add(model, right, pixels[BY_C], left[1] * left[4])
        _add_flat(model, between(left, right), height)
        j += left[1]


@njit(cache=True, fastmath=FAST, forceinline=True)
def _raise(level, place, reach, height):
    """Multiply a profile with its height, and cut it off at its end."""
    for i in range(len(level)):
        level[i] = height * level[i] if place[i] <= reach else np.float32(0.0)


@njit(cache=True)
def _add(model, block, levels, n):
    """Add the levels from ``n`` on to a block of the model image."""
    for k in range(block[1]):
        line, more = row_of(block, k, model, levels, n)
        for i in range(len(line)):
            line[i] += more[i]


@njit(cache=True)
def _add_flat(model, block, height):
    """Add one level to a block of the model image."""
    top, rows, _, first, width = block
    for j in range(top, top + rows):
        line = model[j, first : first + width]
        for i in range(len(line)):
            line[i] += height


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
    reach = _reach(table, REACH)
    half, inner = a + reach * s, a - REACH * s
    j, bottom = max(int(np.ceil(y - half)), 0), min(int(np.floor(y + half)), rows - 1)
    row, pixels, n = edge_row(table, a, s), space(half), 0
    masked = _masked(weight, image.shape, j, bottom + 1, x, half)
    whole = not masked and x > half and x + half < columns - 1 and y > half and y + half < rows - 1
    flat = np.float32(1.0 / (variance * (1.0 + slope * c)))
    step = min(every, 1 + int(a / THINNED))
    while j <= bottom:
        left, right = strip(j, bottom, step, half, 0.0 if masked else inner, x, y, columns)
        if n + left[1] * (left[4] + right[4]) > pixels.shape[1]:
            _add_rim(pixels, n, disk, s, row, variance, slope, reach, alone, robust, whole, out)
            n = 0
        n = _gather(pixels, n, left, image, model, weight, x, y, alone, masked)
        n = _gather(pixels, n, right, image, model, weight, x, y, alone, masked)
        _add_plateau(image, model, between(left, right), c, flat, alone, robust, whole, out)
        j += left[1] * step
    _add_rim(pixels, n, disk, s, row, variance, slope, reach, alone, robust, whole, out)
    out[:CHI] *= step
    if whole:
        _add_expected(pixels, disk, s, row, max(inner, 0.0), half, variance, slope, reach, out)


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
def _gather(pixels, n, block, image, model, weight, x, y, alone, masked):
    """Add a block of pixels, less the model if need be; the number there are now."""
    if alone:
        take(pixels, n, block, image)
    else:
        _take_difference(pixels, n, block, image, model)
    end = locate(pixels, n, block, x, y)
    pixels[WEIGHT, n:end] = np.float32(1.0)
    if masked:
        _mask(pixels, n, block, weight)
    return end


@njit(cache=True)
def _take_difference(pixels, n, block, image, model):
    """The levels of a block of pixels less those of the model."""
    for k in range(block[1]):
        line, levels = row_of(block, k, image, pixels[DATA], n)
        known, _ = row_of(block, k, model, pixels[DATA], n)
        for i in range(len(line)):
            levels[i] = line[i] - known[i]


@njit(cache=True)
def _mask(pixels, n, block, weight):
    """Give masked pixels, whatever their level, none, and no weight."""
    for k in range(block[1]):
        line, levels = row_of(block, k, weight, pixels[DATA], n)
        _, weights = row_of(block, k, weight, pixels[WEIGHT], n)
        for i in range(len(line)):
            if line[i] == 0:
                levels[i] = weights[i] = 0.0


@njit(cache=True)
def _add_plateau(image, model, block, c, flat, alone, robust, whole, out):
    """Add a block of pixels inside a disk to the right side, and what they tell about the contrast."""
    top, rows, step, first, width = block
    cut = np.float32(OUTLIER**2 if robust else np.inf)
    for j in range(top, top + rows * step if width else top, step):
        line, known = image[j, first : first + width], model[j, first : first + width]
        out[RIGHT + 3] += flat * _sum_residuals(line, known, np.float32(c), flat, cut, alone)
    if not whole:
        out[9] += flat * rows * width


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def _sum_residuals(line, known, height, flat, cut, alone):
    """Residuals of a row, outliers weighted down."""
    total = np.float32(0.0)
    for i in range(len(line)):
        residual = line[i] - (height if alone else known[i])
        z2 = residual * residual * flat
        total += residual * (cut / z2 if z2 > cut else np.float32(1.0))
    return total


@njit(cache=True)
def _add_rim(pixels, n, disk, s, row, variance, slope, reach, alone, robust, whole, out):
    """Add the pixels gathered to the right sides, to chi-square and to the count, and their information."""
    n = pad(pixels, n)
    derivatives(pixels, n, disk[2], disk[3], s, row)
    _weigh(pixels, n, np.float32(1.0 / variance), np.float32(slope * disk[3]), np.float32(reach / ENDS))
    if not whole:
        _add_information(pixels, n, out)
    height = np.float32(disk[3] if alone else 0.0)
    _add_right(pixels, n, height, np.float32(OUTLIER**2 if robust else np.inf), out)


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def _weigh(pixels, n, plain, growth, reach):
    """Weights of pixels, none beyond the reach of a disk."""
    level, weight, place = pixels[BY_C, :n], pixels[WEIGHT, :n], pixels[PLACE, :n]
    one, zero = np.float32(1.0), np.float32(0.0)
    for i in range(n):
        near = one if place[i] <= reach else zero
        weight[i] *= near * plain / (one + growth * max(level[i], zero))


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def _add_right(pixels, n, height, cut, out):
    """Right sides; chi-square and count of what lies about the rim.

    The model of ``height`` is still to be taken from the data.
    """
    data, weight, level, place = pixels[DATA, :n], pixels[WEIGHT, :n], pixels[BY_C, :n], pixels[PLACE, :n]
    by_x, by_y, by_a, by_s = pixels[BY_X, :n], pixels[BY_Y, :n], pixels[BY_A, :n], pixels[BY_S, :n]
    x = y = a = c = s = chi = count = zero = np.float32(0.0)
    one, most, inside = np.float32(1.0), np.float32(LARGEST_Z2), np.float32(-REACH / ENDS)
    for i in range(n):
        residual = data[i] - height * level[i]
        w = weight[i]
        z2 = residual * residual * w
        about = one if (place[i] >= inside) & (w > zero) else zero
        chi += about * min(z2, most)
        count += about
        share = w * residual * (cut / z2 if z2 > cut else one)
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
    out[COUNT] += count


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


@njit(cache=True)
def _add_expected(pixels, disk, s, row, inner, half, variance, slope, reach, out):
    """Add the information that a whole disk carries, ring by ring."""
    n = int(RINGS * (half - inner) / s) + 1
    width = (half - inner) / n
    for k in range(n):
        r = inner + width * (k + 0.5)
        pixels[BY_X, k], pixels[BY_Y, k], pixels[WEIGHT, k] = r, 0.0, 2.0 * np.pi * width * r
    n = pad(pixels, n)
    derivatives(pixels, n, disk[2], disk[3], s, row)
    _weigh(pixels, n, np.float32(1.0 / variance), np.float32(slope * disk[3]), np.float32(reach / ENDS))
    weight, by_x, by_a = pixels[WEIGHT, :n], pixels[BY_X, :n], pixels[BY_A, :n]
    by_c, by_s = pixels[BY_C, :n], pixels[BY_S, :n]
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
    reach = _reach(table, REACH)
    half1, half2 = one[2] + reach * s, two[2] + reach * s
    rows, columns = model.shape
    left = max(int(np.ceil(max(one[0] - half1, two[0] - half2))), 0)
    width = min(int(np.floor(min(one[0] + half1, two[0] + half2))), columns - 1) + 1 - left
    j = max(int(np.ceil(max(one[1] - half1, two[1] - half2))), 0)
    bottom = min(int(np.floor(min(one[1] + half1, two[1] + half2))), rows - 1)
    if width <= 0:
        return
    first, second = space(half1), space(half1)
    tall = first.shape[1] // width
    while j <= bottom:
        block = (j, min(tall, bottom + 1 - j), 1, left, width)
        take(first, 0, block, model)
        n = locate(first, 0, block, one[0], one[1])
        first[WEIGHT, :n] = np.float32(1.0)
        if weight.shape == model.shape:
            _mask(first, 0, block, weight)
        locate(second, 0, block, two[0], two[1])
        pad(second, n)
        n = pad(first, n)
        _add_pair(first, second, n, one, two, s, row1, row2, variance, slope, reach, out)
        j += block[1]


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def _add_pair(first, second, n, one, two, s, row1, row2, variance, slope, reach, out):
    """Add weighted products of the derivatives with respect to one disk and to the other."""
    derivatives(first, n, one[2], one[3], s, row1)
    derivatives(second, n, two[2], two[3], s, row2)
    plain, growth, limit = np.float32(1.0 / variance), np.float32(slope), np.float32(reach / ENDS)
    level, weight = first[DATA, :n], first[WEIGHT, :n]
    place, other = first[PLACE, :n], second[PLACE, :n]
    full, zero = np.float32(1.0), np.float32(0.0)
    for i in range(n):
        near = full if (place[i] <= limit) & (other[i] <= limit) else zero
        weight[i] *= near * plain / (full + growth * max(level[i], zero))
    for u in range(4):
        for v in range(4):
            out[u, v] += _product(weight, first[u, :n], second[v, :n])
