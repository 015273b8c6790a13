"""Sums over pixels: model image, and normal equations of one disk and of two overlapping ones (compiled).

Parameters of a disk are x, y, radius a, contrast c; the blur s is common. Pixels far inside the rim tell only about c and are summed
run by run; pixels about the rim go through the profile table.
"""

import numpy as np
from numba import njit

from contactimg.imaging.edge import INNER, STEPS_PER_WIDTH

__all__ = [
    "CROSS",
    "CHI",
    "COUNT",
    "RIGHT",
    "SUMS",
    "add_disk",
    "disk_sums",
    "whole_disk_sums",
    "pair_sums",
    "unpack",
]

REACH = 3.6  # blur widths about the rim that enter the fit: beyond, the profile is 0 or 1 to 2e-4
RENDER_REACH = 5.0  # blur widths about the rim that are drawn
THINNED = 4.0  # px: radius from which a disk has rows to spare
OUTLIER = 5.0  # standard deviations from which a pixel loses weight
LARGEST_Z2 = 4.0 * OUTLIER**2  # share of one pixel in chi-square

SUMS = 22
"""Length of the packed sums: upper triangle for (x, y, a, c), cross terms and square of s, right sides, chi-square."""
CROSS, RIGHT, CHI, COUNT = 10, 15, 20, 21

FAST = {"contract", "reassoc", "nsz", "arcp"}  # everything but assumptions on NaN and infinity


@njit(cache=True)
def table_row(table, a, s):
    """Profile and derivatives against distance from the rim for one radius, interpolated between table rows."""
    rows = table.shape[0]
    position = s / (s + a) * (rows - 1)
    k = min(int(position), rows - 2)
    f = np.float32(position - k)
    return table[k] * (np.float32(1.0) - f) + table[k + 1] * f


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


@njit(cache=True, fastmath=FAST)
def disk_sums(image, model, weight, disk, s, variance, slope, alone, robust, table, outer, out):
    """Normal matrix, right side and chi-square of one disk into ``out`` (see `SUMS`).

    ``variance (1 + slope m)`` is the variance of a pixel of model level m. A disk that stands ``alone`` is its own model, and
    the model image is not looked at.
    """
    x, y, a, c = disk
    row = table_row(table, a, s)
    last = row.shape[0] - 1.001
    half = a + (REACH if outer <= INNER else outer) * s
    inner = a - REACH * s
    scale, offset = STEPS_PER_WIDTH / s, INNER * STEPS_PER_WIDTH - a * STEPS_PER_WIDTH / s
    rows, columns = image.shape
    masked = weight.shape == image.shape
    cut = OUTLIER * OUTLIER
    xx = xy = xa = xc = yy = ya = yc = aa = ac = cc = 0.0
    xs = ys = as_ = cs = ss = 0.0
    rx = ry = ra = rc = rs = chi = count = 0.0
    for j in range(max(int(np.ceil(y - half)), 0), min(int(np.floor(y + half)), rows - 1) + 1):
        dy = j - y
        x0, x1 = _chord(half, dy, x, columns)
        i0, i1 = _chord(inner, dy, x, columns) if inner > 0 else (1, 0)
        if i1 < i0:
            i0 = i1 = x1 + 1
        else:
            for i in range(i0, i1 + 1):
                if masked and weight[j, i] == 0:
                    continue
                m = c if alone else np.float64(model[j, i])
                residual = image[j, i] - m
                w = 1.0 / (variance * (1.0 + slope * max(m, 0.0)))
                z2 = residual * residual * w
                if robust and z2 > cut:
                    w *= cut / z2
                cc += w
                rc += w * residual
            i1 += 1
        for part in range(2):
            first, end = (x0, min(i0, x1 + 1)) if part == 0 else (i1, x1 + 1)
            for i in range(first, end):
                if masked and weight[j, i] == 0:
                    continue
                dx = i - x
                r = np.sqrt(dx * dx + dy * dy)
                t = min(max(r * scale + offset, 0.0), last)
                k = int(t)
                f = t - k
                p = row[k, 0] + f * (row[k + 1, 0] - row[k, 0])
                pa = row[k, 1] + f * (row[k + 1, 1] - row[k, 1])
                pr = row[k, 2] + f * (row[k + 1, 2] - row[k, 2])
                m = c * p if alone else np.float64(model[j, i])
                residual = image[j, i] - m
                w = 1.0 / (variance * (1.0 + slope * max(m, 0.0)))
                z2 = residual * residual * w
                chi += min(z2, LARGEST_Z2)
                count += 1.0
                if robust and z2 > cut:
                    w *= cut / z2
                along = -pr / max(r, 1e-9)
                jx, jy = along * dx, along * dy
                js = -(a * pa + r * pr)
                wx, wy, wa, wp = w * jx, w * jy, w * pa, w * p
                xx += wx * jx
                xy += wx * jy
                xa += wx * pa
                xc += wx * p
                xs += wx * js
                yy += wy * jy
                ya += wy * pa
                yc += wy * p
                ys += wy * js
                aa += wa * pa
                ac += wa * p
                as_ += wa * js
                cc += wp * p
                cs += wp * js
                ss += w * js * js
                rx += wx * residual
                ry += wy * residual
                ra += wa * residual
                rc += wp * residual
                rs += w * js * residual
    g = c / s  # the table holds s times the derivatives, of a disk of unit contrast
    h = g / s
    out[0], out[1], out[2], out[3] = g * g * xx, g * g * xy, g * g * xa, g * xc
    out[4], out[5], out[6] = g * g * yy, g * g * ya, g * yc
    out[7], out[8], out[9] = g * g * aa, g * ac, cc
    out[10], out[11], out[12], out[13], out[14] = g * h * xs, g * h * ys, g * h * as_, h * cs, h * h * ss
    out[15], out[16], out[17], out[18], out[19] = g * rx, g * ry, g * ra, rc, h * rs
    out[20], out[21] = chi, count


@njit(cache=True, fastmath=FAST)
def whole_disk_sums(image, model, disk, s, variance, slope, alone, robust, every, table, outer, out):
    """`disk_sums` of a disk whose window lies inside the image and has no masked pixel.

    Its normal matrix then follows from its profile (the expected information, by radial quadrature), and only the right side
    needs the pixels. The weights of a pixel come from the nearest node of the profile, which costs no accuracy: they
    decide how residuals are averaged, not what is subtracted. Of a disk wider than a few pixels, one row in ``every``
    tells enough while the fit is still far off.
    """
    x, y, a, c = disk
    row = table_row(table, a, s)
    nodes = row.shape[0]
    terms = np.zeros((nodes, 5), np.float32)
    reach = REACH if outer <= INNER else outer
    inner = max(a - reach * s, 0.0)
    _expected(row, terms, a, c, s, inner, reach, variance, slope, out)
    half = a + reach * s
    scale = np.float32(STEPS_PER_WIDTH / s)
    offset = np.float32(INNER * STEPS_PER_WIDTH - a * STEPS_PER_WIDTH / s)
    last = np.float32(nodes - 1.001)
    columns = image.shape[1]
    cut, most = np.float32(OUTLIER * OUTLIER), np.float32(LARGEST_Z2)
    height = np.float32(c)
    plain = np.float32(1.0 / (variance * (1.0 + slope * c)))
    rx = ry = ra = rc = rs = chi = 0.0
    count = 0
    step = every if a > THINNED else 1
    for j in range(int(np.ceil(y - half)), int(np.floor(y + half)) + 1, step):
        dy = np.float32(j - y)
        x0, x1 = _chord(half, dy, x, columns)
        i0, i1 = _chord(inner, dy, x, columns) if inner > 0 else (1, 0)
        if i1 < i0:
            i0 = i1 = x1 + 1
        else:
            total = np.float32(0.0)
            for i in range(i0, i1 + 1):
                residual = image[j, i] - (height if alone else model[j, i])
                z2 = residual * residual * plain
                if robust and z2 > cut:
                    residual *= cut / z2
                total += residual
            rc += plain * total
            i1 += 1
        for part in range(2):
            first, end = (x0, min(i0, x1 + 1)) if part == 0 else (i1, x1 + 1)
            count += max(end - first, 0)
            for i in range(first, end):
                dx = np.float32(i - x)
                t = min(max(np.sqrt(dx * dx + dy * dy) * scale + offset, np.float32(0.0)), last)
                k = int(t)
                if alone:
                    f = t - np.float32(k)
                    level = height * (row[k, 0] + f * (row[k + 1, 0] - row[k, 0]))
                else:
                    level = model[j, i]
                residual = image[j, i] - level
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
    out[15], out[16], out[17], out[18], out[19] = step * rx, step * ry, step * ra, step * rc, step * rs
    out[20], out[21] = chi, count


@njit(cache=True, fastmath=FAST)
def _expected(row, terms, a, c, s, inner, reach, variance, slope, out):
    """Weighted derivatives at each node of the profile, and the information they carry together."""
    out[:] = 0.0
    g = c / s
    step = s / STEPS_PER_WIDTH
    margin = max(int((INNER - reach) * STEPS_PER_WIDTH) - 2, 0)  # nodes that no pixel of the window falls on
    for k in range(margin, row.shape[0] - margin):
        u = k / STEPS_PER_WIDTH - INNER
        r = a + u * s
        p, pa, pr = row[k, 0], row[k, 1], row[k, 2]
        w = 1.0 / (variance * (1.0 + slope * c * max(p, 0.0)))
        js = -g / s * (a * pa + r * pr)
        terms[k, 0] = w
        terms[k, 1] = -w * g * pr / max(abs(r), 0.25 * step)
        terms[k, 2] = w * g * pa
        terms[k, 3] = w * p
        terms[k, 4] = w * js
        if r > inner and abs(u) <= reach:
            ring = 2.0 * np.pi * r * step * w
            out[0] += 0.5 * ring * g * g * pr * pr
            out[7] += ring * g * g * pa * pa
            out[8] += ring * g * pa * p
            out[9] += ring * p * p
            out[12] += ring * g * pa * js
            out[13] += ring * p * js
            out[14] += ring * js * js
    out[4] = out[0]
    out[9] += np.pi * inner * inner / (variance * (1.0 + slope * c))


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
    last = row1.shape[0] - 1.001
    reach = (REACH if outer <= INNER else outer) * s
    half1, half2 = one[2] + reach, two[2] + reach
    scale = STEPS_PER_WIDTH / s
    offset1, offset2 = INNER * STEPS_PER_WIDTH - one[2] * scale, INNER * STEPS_PER_WIDTH - two[2] * scale
    rows, columns = model.shape
    masked = weight.shape == model.shape
    j1, j2 = np.empty(4), np.empty(4)
    top = max(int(np.ceil(max(one[1] - half1, two[1] - half2))), 0)
    bottom = min(int(np.floor(min(one[1] + half1, two[1] + half2))), rows - 1)
    for j in range(top, bottom + 1):
        dy1, dy2 = j - one[1], j - two[1]
        a0, a1 = _chord(half1, dy1, one[0], columns)
        b0, b1 = _chord(half2, dy2, two[0], columns)
        for i in range(max(a0, b0), min(a1, b1) + 1):
            if masked and weight[j, i] == 0:
                continue
            _jacobian(j1, i - one[0], dy1, row1, scale, offset1, last)
            _jacobian(j2, i - two[0], dy2, row2, scale, offset2, last)
            w = 1.0 / (variance * (1.0 + slope * max(np.float64(model[j, i]), 0.0)))
            for u in range(4):
                for v in range(4):
                    out[u, v] += w * j1[u] * j2[v]
    g1, g2 = one[3] / s, two[3] / s
    for u in range(4):
        for v in range(4):
            out[u, v] *= (g1 if u < 3 else 1.0) * (g2 if v < 3 else 1.0)


@njit(cache=True, fastmath=FAST)
def _jacobian(jac, dx, dy, row, scale, offset, last):
    """Derivatives of a unit disk with respect to x/s, y/s, a/s and c at one pixel."""
    r = np.sqrt(dx * dx + dy * dy)
    t = min(max(r * scale + offset, 0.0), last)
    k = int(t)
    f = t - k
    along = -(row[k, 2] + f * (row[k + 1, 2] - row[k, 2])) / max(r, 1e-9)
    jac[0] = along * dx
    jac[1] = along * dy
    jac[2] = row[k, 1] + f * (row[k + 1, 1] - row[k, 1])
    jac[3] = row[k, 0] + f * (row[k + 1, 0] - row[k, 0])
