"""The pixels about the rim of a disk, block by block, and what a blurred disk shows there (compiled).

Blocks of pixels are gathered into the rows of one small array, on which everything is then computed pixel
after pixel without a branch: profile and derivatives are polynomials (or, with a bright rim, looked up). A
block is its first row, the number of its rows, the step between them, its first column and the number of its
columns.
"""

import numpy as np
from numba import njit

from contactimg.imaging.profile.blurred_disk import DEGREE, ENDS, INNER, SLOPE_DEGREE, STEPS_PER_WIDTH

FIELDS = 8
"""Rows of the array: the distance from the centre gives way to the derivatives with respect to x and y."""
BY_X, BY_Y, BY_A, BY_C, BY_S, DATA, WEIGHT, PLACE = range(FIELDS)

FAST = {"contract", "reassoc", "nsz", "arcp"}  # everything but assumptions on NaN and infinity
GATHERED = 512  # pixels at a time: they stay in the fastest cache
STRIP = 8  # rows of a block at most
SKIPPED = 12  # px: a narrower inside is not worth a second block
LANES = 32  # pixels that vector instructions take at once: what is left over would be taken one by one


@njit(cache=True, error_model="numpy")
def edge_row(table, a, s):
    """Polynomials of the profile and its derivatives for one radius, or their values where there are none."""
    rows = table.powers if len(table.powers) else table.values
    position = s / (s + a) * (rows.shape[0] - 1)
    k = min(int(position), rows.shape[0] - 2)
    f = np.float32(position - k)
    row = np.empty(rows.shape[1:], np.float32)
    one, other, out = rows[k].ravel(), rows[k + 1].ravel(), row.ravel()
    for j in range(len(out)):
        out[j] = one[j] + f * (other[j] - one[j])
    return row


@njit(cache=True)
def _chord(radius, dy, centre, columns):
    """First column of the pixels of a row inside a circle, and the one after the last."""
    square = radius * radius - dy * dy
    if radius <= 0.0 or square < 0.0:
        return 0, 0
    half = np.sqrt(square)
    first = max(int(np.ceil(centre - half)), 0)
    return first, max(min(int(np.floor(centre + half)) + 1, columns), first)


@njit(cache=True)
def space(half):
    """Room for some blocks of a window, one at least."""
    width = 2 * int(half) + 3
    return np.empty((FIELDS, -(-max(GATHERED, STRIP * width) // LANES) * LANES), np.float32)


@njit(cache=True)
def strip(j, bottom, step, half, inner, x, y, columns):
    """Blocks of the next rows of a window, left and right of its inside; the right one may be empty."""
    rows = min(STRIP, (bottom - j) // step + 1)
    last = j + (rows - 1) * step
    nearest = 0.0 if j <= y <= last else min(abs(j - y), abs(last - y))
    first, end = _chord(half, nearest, x, columns)
    left, right = _chord(inner, max(abs(j - y), abs(last - y)), x, columns)
    if right - left < SKIPPED:
        left = right = end
    return (j, rows, step, first, left - first), (j, rows, step, right, end - right)


@njit(cache=True)
def between(left, right):
    """The block between two others."""
    start = left[3] + left[4]
    return left[0], left[1], left[2], start, right[3] - start


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def locate(pixels, n, block, x, y):
    """Add the pixels of a block by their distances from a centre; the number there are now."""
    top, rows, step, first, width = block
    along, across = np.float32(first - x), np.float32(top - y)
    size, down = np.float32(width), np.float32(step)
    per, half = np.float32(1.0 / max(width, 1)), np.float32(0.5)
    end = n + rows * width
    by_x, by_y = pixels[BY_X, n:end], pixels[BY_Y, n:end]
    for i in range(len(by_x)):
        place = np.float32(np.int32(i))
        row = np.floor((place + half) * per)
        by_x[i] = along + (place - row * size)
        by_y[i] = across + row * down
    return end


@njit(cache=True)
def row_of(block, k, image, levels, n):
    """Row ``k`` of a block in an image, and its place in levels that start at ``n``."""
    top, _, step, first, width = block
    start = n + k * width
    return image[top + k * step, first : first + width], levels[start : start + width]


@njit(cache=True)
def take(pixels, n, block, image):
    """The levels of a block of pixels that is about to be added."""
    for k in range(block[1]):
        source, levels = row_of(block, k, image, pixels[DATA], n)
        for i in range(len(source)):
            levels[i] = source[i]


@njit(cache=True)
def pad(pixels, n):
    """Add pixels of no weight until vector instructions can take all of them; the number there are now."""
    end = -(-n // LANES) * LANES
    for i in range(n, end):
        pixels[BY_X, i] = pixels[BY_Y, i] = pixels[DATA, i] = pixels[WEIGHT, i] = 0.0
    return end


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def profile(pixels, n, a, s, row):
    """The profile at the first ``n`` pixels, into the row of the derivative with respect to the contrast."""
    if len(row) > DEGREE + 1:
        _look_up(pixels, n, a, s, row)
        return
    u = pixels[PLACE, :n]
    _from_rim(pixels[BY_X, :n], pixels[BY_Y, :n], a, s, u)
    _polynomial(u, row, 0, DEGREE, 1.0, pixels[BY_C, :n])


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def derivatives(pixels, n, a, c, s, row):
    """Derivatives of the model at the first ``n`` pixels with respect to x, y, a, c and s."""
    if len(row) > DEGREE + 1:
        _look_up(pixels, n, a, s, row)
    else:
        _polynomials(pixels, n, a, s, row)
    along, across, by_a, by_s = pixels[BY_X, :n], pixels[BY_Y, :n], pixels[BY_A, :n], pixels[BY_S, :n]
    g, per_width, least = np.float32(c / s), np.float32(1.0 / s), np.float32(1e-9)
    radius = np.float32(a)
    for i in range(n):
        r = np.sqrt(along[i] * along[i] + across[i] * across[i])
        pa, pr = g * by_a[i], g * by_s[i]
        outwards = -pr / max(r, least)
        along[i] *= outwards
        across[i] *= outwards
        by_a[i] = pa
        by_s[i] = -per_width * (radius * pa + r * pr)


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def _polynomials(pixels, n, a, s, row):
    """Profile and derivatives by their polynomials."""
    u = pixels[PLACE, :n]
    _from_rim(pixels[BY_X, :n], pixels[BY_Y, :n], a, s, u)
    _polynomial(u, row, 0, DEGREE, 1.0, pixels[BY_C, :n])
    _polynomial(u, row, 1, SLOPE_DEGREE, 0.0, pixels[BY_A, :n])
    _polynomial(u, row, 2, SLOPE_DEGREE, 0.0, pixels[BY_S, :n])


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def _from_rim(along, across, a, s, u):
    """Distance from the rim in units of ``ENDS`` blur widths."""
    scale, start = np.float32(1.0 / (ENDS * s)), np.float32(a / (ENDS * s))
    for i in range(len(u)):
        u[i] = np.sqrt(along[i] * along[i] + across[i] * across[i]) * scale - start


@njit(cache=True, fastmath=FAST, forceinline=True)
def _polynomial(u, powers, column, degree, inside, out):
    """One of the polynomials of a row at each place ``u``; farther in its limit ``inside``, farther out 0."""
    one, within, beyond = np.float32(1.0), np.float32(inside), np.float32(0.0)
    for i in range(len(u)):
        place = u[i]
        value = powers[DEGREE - degree, column]
        for k in range(DEGREE - degree + 1, DEGREE + 1):
            value = value * place + powers[k, column]
        limit = within if place < -one else beyond
        out[i] = value if abs(place) <= one else limit


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def _look_up(pixels, n, a, s, row):
    """Profile and derivatives by linear interpolation between their values."""
    scale = np.float32(STEPS_PER_WIDTH / s)
    offset, last = np.float32((INNER - a / s) * STEPS_PER_WIDTH), np.float32(len(row) - 1.001)
    _from_rim(pixels[BY_X, :n], pixels[BY_Y, :n], a, s, pixels[PLACE, :n])
    for i in range(n):
        r = np.sqrt(pixels[BY_X, i] ** 2 + pixels[BY_Y, i] ** 2)
        t = min(max(r * scale + offset, np.float32(0.0)), last)
        k = np.int32(t)
        f = t - np.float32(k)
        pixels[BY_C, i] = row[k, 0] + f * (row[k + 1, 0] - row[k, 0])
        pixels[BY_A, i] = row[k, 1] + f * (row[k + 1, 1] - row[k, 1])
        pixels[BY_S, i] = row[k, 2] + f * (row[k + 1, 2] - row[k, 2])
