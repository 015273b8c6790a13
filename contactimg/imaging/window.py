"""The pixels about the rim of a disk, run by run, and what a blurred disk shows there (compiled).

Runs of pixels are gathered into the rows of one small array, on which everything is then computed pixel after
pixel without a branch: profile and derivatives are polynomials (or, with a bright rim, looked up).
"""

import numpy as np
from numba import njit

from contactimg.imaging.edge import DEGREE, ENDS, INNER, STEPS_PER_WIDTH

__all__ = [
    "BY_A",
    "BY_C",
    "BY_S",
    "BY_X",
    "BY_Y",
    "DATA",
    "FAST",
    "FIELDS",
    "WEIGHT",
    "chord",
    "derivatives",
    "edge_row",
    "locate",
    "profile",
    "subtract",
    "take",
]

FIELDS = 8
"""Rows of the array: the distance from the centre gives way to the derivatives with respect to x and y."""
BY_X, BY_Y, BY_A, BY_C, BY_S, DATA, WEIGHT, PLACE = range(FIELDS)

FAST = {"contract", "reassoc", "nsz", "arcp"}  # everything but assumptions on NaN and infinity


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
def chord(radius, dy, centre, columns):
    """First column of the pixels of a row inside a circle, and the one after the last."""
    square = radius * radius - dy * dy
    if radius <= 0.0 or square < 0.0:
        return 0, 0
    half = np.sqrt(square)
    first = max(int(np.ceil(centre - half)), 0)
    return first, max(min(int(np.floor(centre + half)) + 1, columns), first)


@njit(cache=True, fastmath=FAST, forceinline=True)
def locate(pixels, n, j, run, x, y):
    """Add a run of pixels of row ``j`` by their distances from a centre; the number there are now."""
    first, end = run
    along, across = np.float32(first - x), np.float32(j - y)
    for i in range(end - first):
        pixels[BY_X, n + i] = along + np.float32(np.int32(i))
        pixels[BY_Y, n + i] = across
    return n + max(end - first, 0)


@njit(cache=True)
def take(pixels, n, image, j, run):
    """The levels of a run of pixels that is about to be added."""
    first, end = run
    for i in range(end - first):
        pixels[DATA, n + i] = image[j, first + i]


@njit(cache=True)
def subtract(pixels, n, model, j, run):
    """Less those of the model."""
    first, end = run
    for i in range(end - first):
        pixels[DATA, n + i] -= model[j, first + i]


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def profile(pixels, n, a, s, row):
    """The profile at the first ``n`` pixels, into the row of the derivative with respect to the contrast."""
    if len(row) > DEGREE + 1:
        _look_up(pixels, n, a, s, row)
        return
    u, level = pixels[PLACE, :n], pixels[BY_C, :n]
    _from_rim(pixels[BY_X, :n], pixels[BY_Y, :n], a, s, u)
    _polynomial(u, row, 0, level)


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
    _polynomial(u, row, 0, pixels[BY_C, :n])
    _polynomial(u, row, 1, pixels[BY_A, :n])
    _polynomial(u, row, 2, pixels[BY_S, :n])


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def _from_rim(along, across, a, s, u):
    """Distance from the rim in units of ``ENDS`` blur widths, within -1 and 1."""
    one = np.float32(1.0)
    scale, start = np.float32(1.0 / (ENDS * s)), np.float32(a / (ENDS * s))
    for i in range(len(u)):
        place = np.sqrt(along[i] * along[i] + across[i] * across[i]) * scale - start
        u[i] = min(max(place, -one), one)


@njit(cache=True, fastmath=FAST, forceinline=True)
def _polynomial(u, powers, column, out):
    """One of the polynomials of a row at each place ``u``."""
    for i in range(len(u)):
        value, place = powers[0, column], u[i]
        for k in range(1, DEGREE + 1):
            value = value * place + powers[k, column]
        out[i] = value


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def _look_up(pixels, n, a, s, row):
    """Profile and derivatives by linear interpolation between their values."""
    scale = np.float32(STEPS_PER_WIDTH / s)
    offset, last = np.float32((INNER - a / s) * STEPS_PER_WIDTH), np.float32(len(row) - 1.001)
    for i in range(n):
        r = np.sqrt(pixels[BY_X, i] ** 2 + pixels[BY_Y, i] ** 2)
        t = min(max(r * scale + offset, np.float32(0.0)), last)
        k = np.int32(t)
        f = t - np.float32(k)
        pixels[BY_C, i] = row[k, 0] + f * (row[k + 1, 0] - row[k, 0])
        pixels[BY_A, i] = row[k, 1] + f * (row[k + 1, 1] - row[k, 1])
        pixels[BY_S, i] = row[k, 2] + f * (row[k + 1, 2] - row[k, 2])
