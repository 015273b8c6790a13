"""Least-squares fit of blurred disks to an image, all contacts of a frame together.

Each contact has a centre, a radius and a contrast; the model image is the sum of contrast x profile. Gauss-Newton: every
contact accumulates its own 4 x 4 normal matrix over its rim and its interior, contacts whose windows overlap the 4 x 4
matrix between them, and the linear system is solved block by block. The blur is one more unknown shared by all.
Contrasts carry a normal prior, whose mean and width come from the frame's own large contacts: a small disk, whose
radius and contrast cannot be told apart, borrows it, a large one ignores it. Everything compiled; cost is linear in contacts.
"""

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from contactimg.imaging.edge import INNER, STEPS_PER_WIDTH, EdgeTable, disk_table

__all__ = ["CONTRAST", "RADIUS", "X", "Y", "DiskFit", "Noise", "Prior", "fit_disks", "render_disks"]

X, Y, RADIUS, CONTRAST = range(4)
"""Columns of the parameters of a disk."""

REACH = 4.0  # blur widths about the rim that enter the fit; the profile beyond differs from 0 or 1 by 3e-5
OUTLIER = 5.0  # standard deviations from which a pixel loses weight
SETTLED = 0.05  # of its standard deviation: a smaller step of the radius ends the iteration
SMALLEST = 0.1  # blur widths: radius at which the iteration is stopped from collapsing


@dataclass(frozen=True)
class Noise:
    """Variance of a pixel, linear in the level of the contact: ``variance (1 + slope m/contrast) / brightness``.

    Parameters
    ----------
    variance : float
        Of a background pixel, squared grey levels.
    slope : float
        Relative increase at full contrast.
    """

    variance: float
    slope: float = 0.0


@dataclass(frozen=True, eq=False)
class Prior:
    """Normal prior of the contrast of each contact.

    Parameters
    ----------
    mean, std : ndarray, shape (n,)
        Grey levels.
    """

    mean: NDArray[np.float64]
    std: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DiskFit:
    """Disks fitted to an image.

    Parameters
    ----------
    disks : ndarray, shape (n, 4)
        x, y, radius (px), contrast (grey levels).
    std : ndarray, shape (n, 4)
        Their standard uncertainties from the Fisher information, neighbours included.
    chi_square : ndarray, shape (n,)
        Mean squared residual about the rim, in units of the expected variance.
    pixels : ndarray, shape (n,)
        Number of pixels that enters it.
    blur : float, px
        Standard deviation of the profile's Gaussian, pixel included.
    model : ndarray, shape (rows, columns)
        Sum of all disks.
    iterations : int
    settled : ndarray of bool, shape (n,)
        Whether the last step was below tolerance.
    """

    disks: NDArray[np.float64]
    std: NDArray[np.float64]
    chi_square: NDArray[np.float64]
    pixels: NDArray[np.int64]
    blur: float
    model: NDArray[np.float32]
    iterations: int
    settled: NDArray[np.bool_]

    def replace(self, **changes: object) -> "DiskFit":
        """A copy with other fields."""
        return replace(self, **changes)


def render_disks(
    disks: NDArray[np.float64], blur: float, shape: tuple[int, int], *, table: EdgeTable | None = None
) -> NDArray[np.float32]:
    """Sum of blurred disks.

    Parameters
    ----------
    disks : ndarray, shape (n, 4)
        x, y, radius (px), contrast (grey levels).
    blur : float, px
        Pixel included.
    shape : (int, int)
    table : EdgeTable or None
        Profile; None for the uniform disk.

    Examples
    --------
    >>> image = render_disks(np.array([[8.0, 8.0, 4.0, 100.0]]), 1.0, (17, 17))
    >>> float(image[8, 8].round(1)), float(image.sum().round(-1))  # pi 4^2 x 100
    (100.0, 5030.0)
    """
    table = table or disk_table()
    model = np.zeros(shape, np.float32)
    for i in range(len(disks)):
        _add(model, disks[i], blur, table.values, table.outer, 1.0)
    return model


def fit_disks(
    image: NDArray[np.float32],
    weight: NDArray[np.uint8],
    disks: NDArray[np.float64],
    *,
    blur: float,
    noise: Noise,
    prior: Prior,
    brightness: NDArray[np.float64],
    free_blur: bool = True,
    robust: bool = True,
    active: NDArray[np.bool_] | None = None,
    table: EdgeTable | None = None,
    iterations: int = 12,
) -> DiskFit:
    """Fit all disks of an image.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Difference image, contacts positive.
    weight : ndarray of uint8, shape (rows, columns) or (1, 1)
        0 for pixels to leave out; shape (1, 1) leaves out none.
    disks : ndarray, shape (n, 4)
        Starting values.
    blur : float, px
        Starting value (or the value, if not free), pixel included.
    noise, prior
        Variance of a pixel and prior of the contrasts.
    brightness : ndarray, shape (n,)
        Relative illumination at each contact.
    free_blur : bool
        Fit the blur as well.
    robust : bool
        Pixels far off the model lose weight, once the fit is close.
    active : ndarray of bool or None
        Disks to move; the others stay as they are.
    table : EdgeTable or None
        Profile; None for the uniform disk.
    iterations : int
        At most.

    Returns
    -------
    DiskFit
    """
    table = table or disk_table()
    n = len(disks)
    moving = np.ones(n, np.bool_) if active is None else active.copy()
    result = _iterate(
        image,
        weight,
        np.array(disks, float),
        float(blur),
        np.array([noise.variance, noise.slope]),
        np.stack([prior.mean, prior.std]) if n else np.zeros((2, 0)),
        np.ascontiguousarray(brightness, float),
        free_blur,
        robust,
        moving,
        table.values,
        table.outer,
        iterations,
    )
    return DiskFit(*result)


@njit(cache=True)
def _row(table, a, s):
    """Profile and derivatives against distance from the rim for one radius, interpolated between table rows."""
    rows = table.shape[0]
    position = s / (s + a) * (rows - 1)
    k = min(int(position), rows - 2)
    f = np.float32(position - k)
    return table[k] * (np.float32(1.0) - f) + table[k + 1] * f


@njit(cache=True)
def _box(disk, half, shape):
    """Window of a disk inside the image: first and last row and column."""
    x0 = max(int(np.ceil(disk[0] - half)), 0)
    x1 = min(int(np.floor(disk[0] + half)), shape[1] - 1)
    y0 = max(int(np.ceil(disk[1] - half)), 0)
    y1 = min(int(np.floor(disk[1] + half)), shape[0] - 1)
    return x0, x1, y0, y1


@njit(cache=True)
def _add(model, disk, s, table, outer, sign):
    """Add ``sign`` times one disk to the model image."""
    x, y, a, c = disk
    row = _row(table, a, s)
    last = row.shape[0] - 1
    x0, x1, y0, y1 = _box(
        disk, a + min(REACH + 1.0, outer) * s if outer <= INNER else a + outer * s, model.shape
    )
    scale = STEPS_PER_WIDTH / s
    height = np.float32(sign * c)
    inner = max(a - REACH * s, 0.0)
    for j in range(y0, y1 + 1):
        dy2 = (j - y) ** 2
        for i in range(x0, x1 + 1):
            r2 = (i - x) ** 2 + dy2
            if r2 < inner * inner:
                model[j, i] += height
                continue
            t = (np.sqrt(r2) - a) * scale + INNER * STEPS_PER_WIDTH
            if t >= last:
                continue
            t = max(t, 0.0)
            k = int(t)
            f = np.float32(t - k)
            model[j, i] += height * (row[k, 0] + f * (row[k + 1, 0] - row[k, 0]))


@njit(cache=True)
def _normal(image, model, weight, disk, s, noise, contrast, brightness, robust, table, outer, out):
    """Normal matrix, right side and chi-square of one disk.

    ``out`` collects the upper triangle of the 5 x 5 matrix for (x, y, a, c, s), the right side and residual sums.
    """
    x, y, a, c = disk
    out[:] = 0.0
    row = _row(table, a, s)
    last = row.shape[0] - 1
    half = a + (REACH if outer <= INNER else outer) * s
    x0, x1, y0, y1 = _box(disk, half, image.shape)
    masked = weight.shape == image.shape
    scale = STEPS_PER_WIDTH / s
    inner = max(a - REACH * s, 0.0)
    variance = noise[0] / brightness
    slope = noise[1] / contrast
    cut = OUTLIER * OUTLIER
    j5 = np.empty(5)
    for j in range(y0, y1 + 1):
        dy = j - y
        for i in range(x0, x1 + 1):
            dx = i - x
            r2 = dx * dx + dy * dy
            if r2 > half * half or (masked and weight[j, i] == 0):
                continue
            m = model[j, i]
            residual = image[j, i] - m
            w = 1.0 / (variance * (1.0 + slope * max(m, 0.0)))
            z2 = residual * residual * w
            if robust and z2 > cut:
                w *= cut / z2
            if r2 < inner * inner:
                out[12] += w
                out[18] += w * residual
                continue
            r = np.sqrt(r2)
            t = (r - a) * scale + INNER * STEPS_PER_WIDTH
            if t >= last:
                continue
            t = max(t, 0.0)
            k = int(t)
            f = t - k
            p = row[k, 0] + f * (row[k + 1, 0] - row[k, 0])
            pa = (row[k, 1] + f * (row[k + 1, 1] - row[k, 1])) / s
            pr = (row[k, 2] + f * (row[k + 1, 2] - row[k, 2])) / s
            along = -c * pr / max(r, 1e-9)
            j5[0] = along * dx
            j5[1] = along * dy
            j5[2] = c * pa
            j5[3] = p
            j5[4] = -c * (a * pa + r * pr) / s
            n = 0
            for u in range(5):
                wj = w * j5[u]
                for v in range(u, 5):
                    out[n] += wj * j5[v]
                    n += 1
                out[15 + u] += wj * residual
            out[20] += min(z2, 4 * cut)
            out[21] += 1.0


@njit(cache=True)
def _pair_normal(image, model, weight, one, two, s, noise, contrast, brightness, table, outer, out):
    """The 4 x 4 block of the normal matrix between two disks."""
    out[:] = 0.0
    rows = (_row(table, one[2], s), _row(table, two[2], s))
    last = rows[0].shape[0] - 1
    reach = (REACH if outer <= INNER else outer) * s
    a0, a1, b0, b1 = _box(one, one[2] + reach, image.shape)
    c0, c1, d0, d1 = _box(two, two[2] + reach, image.shape)
    masked = weight.shape == image.shape
    scale = STEPS_PER_WIDTH / s
    variance, slope = noise[0] / brightness, noise[1] / contrast
    j1, j2 = np.empty(4), np.empty(4)
    for j in range(max(b0, d0), min(b1, d1) + 1):
        for i in range(max(a0, c0), min(a1, c1) + 1):
            if masked and weight[j, i] == 0:
                continue
            inside = True
            for which in range(2):
                disk, row = (one, rows[0]) if which == 0 else (two, rows[1])
                jac = j1 if which == 0 else j2
                dx, dy = i - disk[0], j - disk[1]
                r = np.sqrt(dx * dx + dy * dy)
                t = (r - disk[2]) * scale + INNER * STEPS_PER_WIDTH
                if t >= last:
                    inside = False
                    break
                t = max(t, 0.0)
                k = int(t)
                f = t - k
                along = -disk[3] * (row[k, 2] + f * (row[k + 1, 2] - row[k, 2])) / s / max(r, 1e-9)
                jac[0] = along * dx
                jac[1] = along * dy
                jac[2] = disk[3] * (row[k, 1] + f * (row[k + 1, 1] - row[k, 1])) / s
                jac[3] = row[k, 0] + f * (row[k + 1, 0] - row[k, 0])
            if not inside:
                continue
            w = 1.0 / (variance * (1.0 + slope * max(model[j, i], 0.0)))
            for u in range(4):
                for v in range(4):
                    out[u, v] += w * j1[u] * j2[v]


@njit(cache=True)
def _find_pairs(disks, s, reach):
    """Pairs of disks whose windows overlap, by a sweep along x."""
    n = len(disks)
    left = disks[:, 0] - disks[:, 2] - reach * s
    order = np.argsort(left)
    capacity = 4 * n + 16
    pairs = np.empty((capacity, 2), np.int64)
    count = 0
    for u in range(n):
        i = order[u]
        right = disks[i, 0] + disks[i, 2] + reach * s
        for v in range(u + 1, n):
            j = order[v]
            if left[j] > right:
                break
            limit = disks[i, 2] + disks[j, 2] + 2 * reach * s
            dx, dy = disks[i, 0] - disks[j, 0], disks[i, 1] - disks[j, 1]
            if abs(dy) > limit or dx * dx + dy * dy > limit * limit:
                continue
            if count == capacity:
                grown = np.empty((2 * capacity, 2), np.int64)
                grown[:capacity] = pairs
                pairs, capacity = grown, 2 * capacity
            pairs[count, 0], pairs[count, 1] = min(i, j), max(i, j)
            count += 1
    return pairs[:count]


@njit(cache=True)
def _unpack(out, normal, right):
    """Full 4 x 4 matrix and right side from the packed sums."""
    n = 0
    for u in range(5):
        for v in range(u, 5):
            if v < 4:
                normal[u, v] = normal[v, u] = out[n]
            n += 1
    right[:] = out[15:19]


@njit(cache=True)
def _relax(inverse, right, moving, pairs, blocks, steps, sweeps):
    """Solve the coupled normal equations by block Gauss-Seidel; ``steps`` starts at the uncoupled solution."""
    n = len(right)
    degree = np.zeros(n + 1, np.int64)
    for p in range(len(pairs)):
        degree[pairs[p, 0] + 1] += 1
        degree[pairs[p, 1] + 1] += 1
    start = np.cumsum(degree)
    fill = start[:-1].copy()
    link = np.empty((2 * len(pairs), 2), np.int64)
    for p in range(len(pairs)):
        for side in range(2):
            i = pairs[p, side]
            link[fill[i], 0], link[fill[i], 1] = p, side
            fill[i] += 1
    rest = np.empty(4)
    for _ in range(sweeps):
        largest = 0.0
        for i in range(n):
            if not moving[i] or start[i] == start[i + 1]:
                continue
            rest[:] = right[i]
            for q in range(start[i], start[i + 1]):
                p, side = link[q]
                other = pairs[p, 1 - side]
                for u in range(4):
                    for v in range(4):
                        b = blocks[p, u, v] if side == 0 else blocks[p, v, u]
                        rest[u] -= b * steps[other, v]
            for u in range(4):
                value = 0.0
                for v in range(4):
                    value += inverse[i, u, v] * rest[v]
                if u < 3:
                    largest = max(largest, abs(value - steps[i, u]))
                steps[i, u] = value
        if largest < 1e-4:
            break


@njit(cache=True)
def _covariances(normals, pairs, blocks, inverse, moved):
    """Variances of each disk's parameters with its direct neighbours free as well; zero for disks held fixed."""
    n = len(normals)
    variances = np.empty((n, 4))
    degree = np.zeros(n, np.int64)
    for p in range(len(pairs)):
        degree[pairs[p, 0]] += 1
        degree[pairs[p, 1]] += 1
    for i in range(n):
        for u in range(4):
            variances[i, u] = inverse[i, u, u]
    # the Schur complement over direct neighbours, each taken as independent of the others
    reduced = normals.copy()
    for p in range(len(pairs)):
        i, j = pairs[p]
        if not (moved[i] and moved[j]):
            continue
        b = blocks[p]
        reduced[i] -= b @ inverse[j] @ b.T
        reduced[j] -= b.T @ inverse[i] @ b
    for i in range(n):
        if degree[i] and moved[i]:
            inv = np.linalg.inv(reduced[i] + 1e-12 * np.diag(np.diag(normals[i])))
            for u in range(4):
                if inv[u, u] > variances[i, u]:
                    variances[i, u] = min(inv[u, u], 25.0 * variances[i, u])
                elif inv[u, u] <= 0:
                    variances[i, u] *= 25.0
    return variances


@njit(cache=True)
def _iterate(
    image, weight, disks, s, noise, prior, brightness, free_blur, robust, moving, table, outer, iterations
):
    """Gauss-Newton on all disks that move, until none of them moves any more."""
    n = len(disks)
    shape = image.shape
    model = np.zeros(shape, np.float32)
    for i in range(n):
        _add(model, disks[i], s, table, outer, 1.0)
    reach = REACH if outer <= INNER else outer
    normals = np.zeros((n, 4, 4))
    inverse = np.zeros((n, 4, 4))
    right = np.zeros((n, 4))
    cross = np.zeros((n, 4))
    blurs = np.zeros((n, 2))
    steps = np.zeros((n, 4))
    chi = np.ones(n)
    pixels = np.zeros(n, np.int64)
    out = np.empty(22)
    started = moving.copy()
    pairs = _find_pairs(disks, s, reach)
    blocks = np.zeros((len(pairs), 4, 4))
    done = 0
    for iteration in range(iterations + 1):
        final = iteration == iterations or not moving.any()
        if final:
            moving[:] = started
        clip = robust and (iteration >= 2 or final)
        for i in range(n):
            if not moving[i]:
                continue
            _normal(
                image, model, weight, disks[i], s, noise, prior[0, i], brightness[i], clip, table, outer, out
            )
            _unpack(out, normals[i], right[i])
            normals[i, 3, 3] += 1.0 / prior[1, i] ** 2
            right[i, 3] += (prior[0, i] - disks[i, 3]) / prior[1, i] ** 2
            cross[i, 0], cross[i, 1], cross[i, 2], cross[i, 3] = out[4], out[8], out[11], out[13]
            blurs[i, 0], blurs[i, 1] = out[14], out[19]
            pixels[i] = int(out[21])
            chi[i] = out[20] / max(out[21] - 3.0, 1.0)
            damped = normals[i].copy()
            for u in range(4):
                damped[u, u] = damped[u, u] * (1.0 + 1e-6) + 1e-9
            # a disk much smaller than the blur has hardly any information on its radius: keep its steps finite
            damped[2, 2] += 1e-3 * prior[0, i] ** 2 / noise[0]
            inverse[i] = np.linalg.inv(damped)
        for p in range(len(pairs)):
            i, j = pairs[p]
            if moving[i] or moving[j]:
                _pair_normal(
                    image,
                    model,
                    weight,
                    disks[i],
                    disks[j],
                    s,
                    noise,
                    prior[0, i],
                    brightness[i],
                    table,
                    outer,
                    blocks[p],
                )
        if final:
            break
        done += 1
        change = 0.0
        if free_blur:
            top, bottom = 0.0, 0.0
            for i in range(n):
                if moving[i] and disks[i, 2] > s:
                    t = inverse[i] @ cross[i]
                    gain = blurs[i, 0] - cross[i] @ t
                    if chi[i] < 4.0 or iteration < 2:
                        bottom += gain
                        top += blurs[i, 1] - right[i] @ t
            if bottom > 0:
                change = min(max(top / bottom, -0.2 * s), 0.2 * s)
        for i in range(n):
            if moving[i]:
                right[i] -= cross[i] * change
                steps[i] = inverse[i] @ right[i]
            else:
                steps[i] = 0.0
        _relax(inverse, right, moving, pairs, blocks, steps, 40)
        if abs(change) > 0.0:
            model[:] = 0.0
        for i in range(n):
            if not moving[i]:
                if abs(change) > 0.0:
                    _add(model, disks[i], s + change, table, outer, 1.0)
                continue
            if change == 0.0:
                _add(model, disks[i], s, table, outer, -1.0)
            a = disks[i, 2]
            limit = 0.5 * max(a, s)
            small = abs(steps[i, 2]) < SETTLED * np.sqrt(inverse[i, 2, 2])
            disks[i, 0] += min(max(steps[i, 0], -limit), limit)
            disks[i, 1] += min(max(steps[i, 1], -limit), limit)
            disks[i, 2] = max(a + min(max(steps[i, 2], -0.4 * a), max(0.4 * a, 0.5 * s)), SMALLEST * s)
            disks[i, 3] = min(max(disks[i, 3] + steps[i, 3], 0.05 * prior[0, i]), 5.0 * prior[0, i])
            _add(model, disks[i], s + change, table, outer, 1.0)
            if small and iteration >= 2 and abs(change) < 1e-3 * s:
                moving[i] = False
        s += change
        if abs(change) < 1e-3 * s and iteration >= 2:
            free_blur = False
        pairs_now = _find_pairs(disks, s, reach)
        if len(pairs_now) != len(pairs) or not np.all(pairs_now == pairs):
            pairs = pairs_now
            blocks = np.zeros((len(pairs), 4, 4))
    settled = np.ones(n, np.bool_)
    for i in range(n):
        settled[i] = abs(steps[i, 2]) < 1.0
    variances = _covariances(normals, pairs, blocks, inverse, started)
    return disks, np.sqrt(variances), chi, pixels, s, model, done, settled
