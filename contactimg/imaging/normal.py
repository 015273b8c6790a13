"""Sums over pixels: model image, and normal equations of one disk and of two overlapping ones (compiled).

Parameters of a disk are x, y, radius a, contrast c; the blur s is common. Pixels far inside the rim tell only
about c and are summed run by run; pixels about the rim go through the profile table.
"""

import numpy as np
from numba import njit

from contactimg.imaging.edge import INNER, STEPS_PER_WIDTH

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
RENDER_REACH = 5.0  # blur widths about the rim that are drawn
THINNED = 4.0  # px: radius from which a disk has rows to spare
OUTLIER = 5.0  # standard deviations from which a pixel loses weight
LARGEST_Z2 = 4.0 * OUTLIER**2  # share of one pixel in chi-square

SUMS = 22
"""Length of the packed sums: upper triangle for (x, y, a, c), products with s, right sides, chi-square."""
CROSS, RIGHT, CHI, COUNT = 10, 15, 20, 21

FAST = {"contract", "reassoc", "nsz", "arcp"}  # everything but assumptions on NaN and infinity


@njit(cache=True)
def table_row(table, a, s):
    """Profile and derivatives against distance from the rim for one radius."""
    rows = table.shape[0]
    position = s / (s + a) * (rows - 1)
    k = min(int(position), rows - 2)
    f = np.float32(position - k)
    row = np.empty(table.shape[1:], np.float32)
    one, other, out = table[k].ravel(), table[k + 1].ravel(), row.ravel()
    for j in range(len(out)):
        out[j] = one[j] + f * (other[j] - one[j])
    return row


@njit(cache=True)
def _chord(radius, dy, centre, columns):
    """First and last column of the pixels of a row inside a circle; an empty range if there is none."""
    square = radius * radius - dy * dy
    if square < 0.0:
        return 1, 0
    half = np.sqrt(square)
    return max(int(np.ceil(centre - half)), 0), min(int(np.floor(centre + half)), columns - 1)


@njit(cache=True, fastmath=FAST)
def add_disk(model, disk, s, table, outer, sign):
    """Add ``sign`` times one disk to the model image."""
    x, y, a, c = disk
    row = table_row(table, a, s)
    last = row.shape[0] - 1.001
    reach = a + min(RENDER_REACH if outer <= INNER else outer, outer) * s
    inner = a - RENDER_REACH * s
    scale, offset = STEPS_PER_WIDTH / s, INNER * STEPS_PER_WIDTH - a * STEPS_PER_WIDTH / s
    height = np.float32(sign * c)
    rows, columns = model.shape
    for j in range(max(int(np.ceil(y - reach)), 0), min(int(np.floor(y + reach)), rows - 1) + 1):
        dy = j - y
        x0, x1 = _chord(reach, dy, x, columns)
        i0, i1 = _chord(inner, dy, x, columns) if inner > 0 else (1, 0)
        if i1 < i0:
            i0 = i1 = x1 + 1
        else:
            model[j, i0 : i1 + 1] += height
            i1 += 1
        for part in range(2):
            first, end = (x0, min(i0, x1 + 1)) if part == 0 else (i1, x1 + 1)
            for i in range(first, end):
                dx = i - x
                t = min(max(np.sqrt(dx * dx + dy * dy) * scale + offset, 0.0), last)
                k = int(t)
                f = np.float32(t - k)
                model[j, i] += height * (row[k, 0] + f * (row[k + 1, 0] - row[k, 0]))


@njit(cache=True)
def disk_sums(image, model, weight, disk, s, variance, slope, alone, robust, every, table, outer, out):
    """Normal matrix, right side and chi-square of one disk into ``out`` (see `SUMS`).

    ``variance (1 + slope m)`` is the variance of a pixel of model level m. A disk that stands ``alone``
    is its own model, and the model image is not looked at. Of a disk wider than a few pixels, one row in
    ``every`` tells enough while a fit is still far off.
    """
    half = disk[2] + (REACH if outer <= INNER else outer) * s
    whole = (
        disk[0] - half > 0 and disk[0] + half < image.shape[1] - 1
        and disk[1] - half > 0 and disk[1] + half < image.shape[0] - 1
    )  # fmt: skip
    if whole and weight.shape != image.shape:
        _whole_disk_sums(image, model, disk, s, variance, slope, alone, robust, every, table, outer, out)
    else:
        _cut_disk_sums(image, model, weight, disk, s, variance, slope, alone, robust, table, outer, out)


@njit(cache=True, fastmath=FAST)
def _cut_disk_sums(image, model, weight, disk, s, variance, slope, alone, robust, table, outer, out):
    """`disk_sums` of any disk, pixel by pixel."""
    out[:] = 0.0
    x, y, a, c = disk
    row = table_row(table, a, s)
    reach = REACH if outer <= INNER else outer
    half = a + reach * s
    columns = image.shape[1]
    masked = weight.shape == image.shape
    jac = np.empty(5)
    for j in range(max(int(np.ceil(y - half)), 0), min(int(np.floor(y + half)), image.shape[0] - 1) + 1):
        first, last = _chord(half, j - y, x, columns)
        for i in range(first, last + 1):
            if masked and weight[j, i] == 0:
                continue
            r = _derivatives(jac, i - x, j - y, a, c, s, row)
            m = c * jac[3] if alone else np.float64(model[j, i])
            residual = image[j, i] - m
            w = 1.0 / (variance * (1.0 + slope * max(m, 0.0)))
            z2 = residual * residual * w
            if r > a - reach * s:
                out[CHI] += min(z2, LARGEST_Z2)
                out[COUNT] += 1.0
            if robust and z2 > OUTLIER * OUTLIER:
                w *= OUTLIER * OUTLIER / z2
            _accumulate(out, jac, w, residual)


@njit(cache=True, fastmath=FAST)
def _derivatives(jac, dx, dy, a, c, s, row):
    """Derivatives of the model at one pixel with respect to x, y, a, c and s; returns the distance."""
    r = np.sqrt(dx * dx + dy * dy)
    t = min(max((r - a) / s * STEPS_PER_WIDTH + INNER * STEPS_PER_WIDTH, 0.0), row.shape[0] - 1.001)
    k = int(t)
    f = t - k
    pa = (row[k, 1] + f * (row[k + 1, 1] - row[k, 1])) / s
    pr = (row[k, 2] + f * (row[k + 1, 2] - row[k, 2])) / s
    along = -c * pr / max(r, 1e-9)
    jac[0], jac[1], jac[2] = along * dx, along * dy, c * pa
    jac[3] = row[k, 0] + f * (row[k + 1, 0] - row[k, 0])
    jac[4] = -c * (a * pa + r * pr) / s
    return r


@njit(cache=True, fastmath=FAST)
def _accumulate(out, jac, w, residual):
    """Add one pixel to the packed sums."""
    n = 0
    for u in range(4):
        for v in range(u, 4):
            out[n] += w * jac[u] * jac[v]
            n += 1
    for u in range(5):
        out[CROSS + u] += w * jac[u] * jac[4]
        out[RIGHT + u] += w * jac[u] * residual


@njit(cache=True, fastmath=FAST)
def _whole_disk_sums(image, model, disk, s, variance, slope, alone, robust, every, table, outer, out):
    """`disk_sums` of a disk whose window lies inside the image and has no masked pixel.

    Its normal matrix then follows from its profile (the expected information, by radial quadrature), and only
    the right side needs the pixels. The weights of a pixel come from the nearest node of the profile, which
    costs no accuracy: they decide how residuals are averaged, not what is subtracted.
    """
    x, y, a, c = disk
    row = table_row(table, a, s)
    terms = np.zeros((row.shape[0], 5), np.float32)
    reach = REACH if outer <= INNER else outer
    inner = max(a - reach * s, 0.0)
    _expected(row, terms, a, c, s, inner, reach, variance, slope, out)
    half = a + reach * s
    scale = np.float32(STEPS_PER_WIDTH / s)
    offset = np.float32(INNER * STEPS_PER_WIDTH - a * STEPS_PER_WIDTH / s)
    height = np.float32(c)
    plain = np.float32(1.0 / (variance * (1.0 + slope * c)))
    columns = image.shape[1]
    step = every if a > THINNED else 1
    for j in range(int(np.ceil(y - half)), int(np.floor(y + half)) + 1, step):
        dy = np.float32(j - y)
        x0, x1 = _chord(half, dy, x, columns)
        i0, i1 = _chord(inner, dy, x, columns) if inner > 0 else (1, 0)
        if i1 < i0:
            i0, i1 = x1 + 1, x1
        else:
            out[RIGHT + 3] += step * _plateau_row(image[j], model[j], i0, i1, height, plain, alone, robust)
        for part in range(2):
            first, end = (x0, i0) if part == 0 else (i1 + 1, x1 + 1)
            _rim_row(
                image[j],
                model[j],
                first,
                end,
                x,
                dy,
                scale,
                offset,
                height,
                row,
                terms,
                alone,
                robust,
                step,
                out,
            )


@njit(cache=True, fastmath=FAST)
def _plateau_row(image, model, first, last, height, weight, alone, robust):
    """Weighted sum of the residuals of a run of pixels inside a disk."""
    cut = np.float32(OUTLIER * OUTLIER)
    total = np.float32(0.0)
    for i in range(first, last + 1):
        residual = image[i] - (height if alone else model[i])
        z2 = residual * residual * weight
        if robust and z2 > cut:
            residual *= cut / z2
        total += residual
    return weight * total


@njit(cache=True, fastmath=FAST)
def _rim_row(
    image, model, first, end, x, dy, scale, offset, height, row, terms, alone, robust, step, out
):  # fmt: skip
    """Add a run of pixels about the rim to the right sides, to chi-square and to the count."""
    cut, most = np.float32(OUTLIER * OUTLIER), np.float32(LARGEST_Z2)
    last = np.float32(row.shape[0] - 1.001)
    rx = ry = ra = rc = rs = chi = 0.0
    for i in range(first, end):
        dx = np.float32(i - x)
        t = min(max(np.sqrt(dx * dx + dy * dy) * scale + offset, np.float32(0.0)), last)
        k = int(t)
        level = model[i]
        if alone:
            level = height * (row[k, 0] + (t - np.float32(k)) * (row[k + 1, 0] - row[k, 0]))
        residual = image[i] - level
        z2 = residual * residual * terms[k, 0]
        chi += min(z2, most)
        if robust and z2 > cut:
            residual *= cut / z2
        along = terms[k, 1] * residual
        rx += along * dx
        ry += along * dy
        ra += terms[k, 2] * residual
        rc += terms[k, 3] * residual
        rs += terms[k, 4] * residual
    out[15] += step * rx
    out[16] += step * ry
    out[17] += step * ra
    out[18] += step * rc
    out[19] += step * rs
    out[CHI] += chi
    out[COUNT] += max(end - first, 0)


@njit(cache=True, fastmath=FAST)
def _expected(row, terms, a, c, s, inner, reach, variance, slope, out):
    """Weighted derivatives at each node of the profile, and the information they carry together."""
    out[:] = 0.0
    g, near = np.float32(c / s), np.float32(0.25 * s / STEPS_PER_WIDTH)
    plain, growth = np.float32(1.0 / variance), np.float32(slope * c)
    radius, step, zero = np.float32(a), np.float32(s / STEPS_PER_WIDTH), np.float32(0.0)
    first = np.float32(a - INNER * s)
    margin = max(int((INNER - reach) * STEPS_PER_WIDTH) - 2, 0)  # nodes that no pixel of the window falls on
    for k in range(margin, row.shape[0] - margin):
        r = first + np.float32(k) * step
        p, pa, pr = row[k, 0], row[k, 1], row[k, 2]
        w = plain / (np.float32(1.0) + growth * max(p, zero))
        terms[k, 0] = w
        terms[k, 1] = -w * g * pr / max(abs(r), near)
        terms[k, 2] = w * g * pa
        terms[k, 3] = w * p
        terms[k, 4] = -w * g * (radius * pa + r * pr) / np.float32(s)
    low = max(-reach, (inner - a) / s)
    start = int(np.ceil((low + INNER) * STEPS_PER_WIDTH))
    _add_information(row, terms, g, first, step, start, row.shape[0] - margin - 2, out)
    out[4] = out[0]
    out[9] += np.pi * inner * inner / (variance * (1.0 + slope * c))


@njit(cache=True, fastmath=FAST)
def _add_information(row, terms, g, first, step, start, end, out):
    """Add the information of the rings from node ``start`` to ``end`` by their weighted derivatives."""
    xx = aa = ac = cc = at = ct = tt = 0.0
    for k in range(start, end):
        r = first + np.float32(k) * step
        ring = np.float32(2.0 * np.pi) * r * step
        w, by_a, by_c, by_s = terms[k, 0], terms[k, 2], terms[k, 3], terms[k, 4]
        slope, a, c = g * row[k, 2], g * row[k, 1], row[k, 0]
        xx += ring * w * slope * slope
        aa += ring * by_a * a
        ac += ring * by_a * c
        cc += ring * by_c * c
        at += ring * by_s * a
        ct += ring * by_s * c
        tt += ring * by_s * by_s / w
    out[0] += 0.5 * xx
    out[7] += aa
    out[8] += ac
    out[9] += cc
    out[12] += at
    out[13] += ct
    out[14] += tt


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


@njit(cache=True, fastmath=FAST)
def pair_sums(model, weight, one, two, s, variance, slope, table, outer, out):
    """The 4 x 4 block of the normal matrix between two disks, over the pixels in the windows of both."""
    out[:] = 0.0
    row1, row2 = table_row(table, one[2], s), table_row(table, two[2], s)
    reach = (REACH if outer <= INNER else outer) * s
    half1, half2 = one[2] + reach, two[2] + reach
    rows, columns = model.shape
    masked = weight.shape == model.shape
    j1, j2 = np.empty(5), np.empty(5)
    top = max(int(np.ceil(max(one[1] - half1, two[1] - half2))), 0)
    bottom = min(int(np.floor(min(one[1] + half1, two[1] + half2))), rows - 1)
    for j in range(top, bottom + 1):
        a0, a1 = _chord(half1, j - one[1], one[0], columns)
        b0, b1 = _chord(half2, j - two[1], two[0], columns)
        for i in range(max(a0, b0), min(a1, b1) + 1):
            if masked and weight[j, i] == 0:
                continue
            _derivatives(j1, i - one[0], j - one[1], one[2], one[3], s, row1)
            _derivatives(j2, i - two[0], j - two[1], two[2], two[3], s, row2)
            w = 1.0 / (variance * (1.0 + slope * max(np.float64(model[j, i]), 0.0)))
            for u in range(4):
                for v in range(4):
                    out[u, v] += w * j1[u] * j2[v]
