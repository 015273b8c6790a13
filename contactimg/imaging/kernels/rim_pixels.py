"""The pixels about the rim of a disk, block by block, and profile and derivatives there (compiled).

Blocks of pixels are gathered in one small array, on which everything is computed in vector instructions:
profile and derivatives are polynomials (with a film, table entries). A block is a tuple of its first row, its
number of rows, the step between them, its first column and its number of columns.
"""

import numpy as np

from contactimg.compiled import njit
from contactimg.imaging.profile.blurred_disk import (
    END_BLUR_WIDTHS,
    INNER_BLUR_WIDTHS,
    PROFILE_DEGREE,
    SLOPE_DEGREE,
    STEPS_PER_BLUR_WIDTH,
)

FIELDS = 9
"""Rows of the array. The first two hold the distance from the centre, then the derivatives by x and y."""
BY_X, BY_Y, BY_A, BY_C, BY_S, DATA, WEIGHT, PLACE, MODEL = range(FIELDS)

FAST = {"contract", "reassoc", "nsz", "arcp"}  # all optimisations except assumptions on NaN and infinity
BLOCK_ROWS = 8  # rows of a block at most; speed only
VECTOR_PIXELS = 32  # pixels in one pass of vector instructions; a remainder would be slow; speed only

NONE, EACH = np.int64(0), np.int64(1)
"""No pixel so far, and each row: variables, because a function is compiled anew for each literal number."""


@njit(cache=True, error_model="numpy")
def interpolate_row(table, a, s):
    """Coefficients of the profile and its derivatives for one radius; with a film, table entries."""
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
def reach_of_profile(table, near):
    """Blur widths beyond the rim at which the profile ends; ``near`` for a plain disk."""
    return near if table.outer <= INNER_BLUR_WIDTHS else table.outer


@njit(cache=True)
def _chord_columns(radius, dy, centre, columns):
    """Columns of a row inside a circle: the first, and the one after the last."""
    square = radius * radius - dy * dy
    if radius <= 0.0 or square < 0.0:
        return 0, 0
    half = np.sqrt(square)
    first = max(int(np.ceil(centre - half)), 0)
    return first, max(min(int(np.floor(centre + half)) + 1, columns), first)


@njit(cache=True)
def allocate_pixels(half):
    """An array for at least one block of a window."""
    width = 2 * int(half) + 3
    # 512 pixels at a time fit into the fastest cache.
    passes = -(-max(512, BLOCK_ROWS * width) // VECTOR_PIXELS)
    return np.empty((FIELDS, passes * VECTOR_PIXELS), np.float32)


@njit(cache=True)
def next_blocks(j, bottom, step, half, inner, x, y, columns):
    """The next rows of a window as blocks left and right of the disk's inside; the right one may be empty."""
    rows = min(BLOCK_ROWS, (bottom - j) // step + 1)
    last = j + (rows - 1) * step
    nearest = 0.0 if j <= y <= last else min(abs(j - y), abs(last - y))
    first, end = _chord_columns(half, nearest, x, columns)
    left, right = _chord_columns(inner, max(abs(j - y), abs(last - y)), x, columns)
    if right - left < 12:  # speed only
        left = right = end
    return (j, rows, step, first, left - first), (j, rows, step, right, end - right)


@njit(cache=True)
def block_between(left, right):
    """The block between two others."""
    start = left[3] + left[4]
    return left[0], left[1], left[2], start, right[3] - start


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def add_block(pixels, n, block, x, y):
    """Append the pixels of a block by their distances from a centre; the number of pixels then."""
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
def row_of_block(block, k, image, levels, n):
    """Row ``k`` of a block in an image, and its part of an array in which the block starts at ``n``."""
    top, _, step, first, width = block
    start = n + k * width
    return image[top + k * step, first : first + width], levels[start : start + width]


@njit(cache=True)
def copy_levels(pixels, n, block, image):
    """Copy the levels of a block of pixels."""
    for k in range(block[1]):
        source, levels = row_of_block(block, k, image, pixels[DATA], n)
        for i in range(len(source)):
            levels[i] = source[i]


@njit(cache=True)
def pad_pixels(pixels, n):
    """Append pixels without weight up to a whole number of vector passes; the number of pixels then."""
    end = -(-n // VECTOR_PIXELS) * VECTOR_PIXELS
    for i in range(n, end):
        pixels[BY_X, i] = pixels[BY_Y, i] = pixels[DATA, i] = pixels[WEIGHT, i] = pixels[MODEL, i] = 0.0
    return end


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def evaluate_profile(pixels, n, a, s, row):
    """The profile at the first ``n`` pixels, which is the derivative with respect to the contrast."""
    u = pixels[PLACE, :n]
    _distance_from_rim(pixels[BY_X, :n], pixels[BY_Y, :n], a, s, u)
    if len(row) <= PROFILE_DEGREE + 1:
        _evaluate_polynomial(u, row, 0, PROFILE_DEGREE, 1.0, pixels[BY_C, :n])
        return
    # with a film, linear interpolation in the table, the derivatives as well
    scale = np.float32(STEPS_PER_BLUR_WIDTH / s)
    offset = np.float32((INNER_BLUR_WIDTHS - a / s) * STEPS_PER_BLUR_WIDTH)
    last = np.float32(len(row) - 1.001)
    for i in range(n):
        r = np.sqrt(pixels[BY_X, i] ** 2 + pixels[BY_Y, i] ** 2)
        t = min(max(r * scale + offset, np.float32(0.0)), last)
        k = np.int32(t)
        f = t - np.float32(k)
        pixels[BY_C, i] = row[k, 0] + f * (row[k + 1, 0] - row[k, 0])
        pixels[BY_A, i] = row[k, 1] + f * (row[k + 1, 1] - row[k, 1])
        pixels[BY_S, i] = row[k, 2] + f * (row[k + 1, 2] - row[k, 2])


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def evaluate_derivatives(pixels, n, a, c, s, row):
    """Derivatives of the model at the first ``n`` pixels with respect to x, y, a, c and s."""
    evaluate_profile(pixels, n, a, s, row)
    if len(row) <= PROFILE_DEGREE + 1:
        _evaluate_polynomial(pixels[PLACE, :n], row, 1, SLOPE_DEGREE, 0.0, pixels[BY_A, :n])
        _evaluate_polynomial(pixels[PLACE, :n], row, 2, SLOPE_DEGREE, 0.0, pixels[BY_S, :n])
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
def _distance_from_rim(along, across, a, s, u):
    """Distance from the rim in units of ``END_BLUR_WIDTHS`` blur widths."""
    scale, start = np.float32(1.0 / (END_BLUR_WIDTHS * s)), np.float32(a / (END_BLUR_WIDTHS * s))
    for i in range(len(u)):
        u[i] = np.sqrt(along[i] * along[i] + across[i] * across[i]) * scale - start


@njit(cache=True, fastmath=FAST, forceinline=True)
def _evaluate_polynomial(u, powers, column, degree, inside, out):
    """One polynomial at each distance ``u``; its limit ``inside`` further inwards, 0 further outwards."""
    one, within, beyond = np.float32(1.0), np.float32(inside), np.float32(0.0)
    for i in range(len(u)):
        place = u[i]
        value = powers[PROFILE_DEGREE - degree, column]
        for k in range(PROFILE_DEGREE - degree + 1, PROFILE_DEGREE + 1):
            value = value * place + powers[k, column]
        limit = within if place < -one else beyond
        out[i] = value if abs(place) <= one else limit
