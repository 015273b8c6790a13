"""Sums over pixels: model image, and normal equations of one disk and of two overlapping disks (compiled).

The parameters of a disk are x, y, radius a, contrast c; the blur s is common. Pixels far inside the rim have
information on c only and are summed row by row; those about the rim are gathered in blocks first.

Where two disks overlap, a pixel is as bright as in one of them. The image of their union is the sum of the
two minus the image of the lens that they share,

    L(p, q) = int dt g(q - t) [Phi((hi(t) - p)/s) - Phi((lo(t) - p)/s)]

with p along the line of centres, q across, ``lo`` and ``hi`` the ends of the lens at height t, g and Phi the
Gaussian of width s and its integral. Sampled every 0.8 s the integral over t is exact to 1e-8 but for the
ends of the lens. The common part of three disks is subtracted once too often; contacts overlap too little for
that to matter.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import special

from contactimg.compiled import njit
from contactimg.imaging.kernels.pairs import select_close
from contactimg.imaging.kernels.rim_pixels import (
    BY_A,
    BY_C,
    BY_S,
    BY_X,
    BY_Y,
    DATA,
    EACH,
    FAST,
    MODEL,
    NONE,
    PLACE,
    WEIGHT,
    add_block,
    allocate_pixels,
    block_between,
    copy_levels,
    evaluate_derivatives,
    evaluate_profile,
    interpolate_row,
    next_blocks,
    pad_pixels,
    row_of_block,
)
from contactimg.imaging.kernels.solve import invert_4x4
from contactimg.imaging.pixels.robust import SIGNIFICANT_SIGMA
from contactimg.imaging.profile.blurred_disk import END_BLUR_WIDTHS, INNER_BLUR_WIDTHS, EdgeTable
from contactimg.imaging.profile.limits import FIT_BLUR_WIDTHS, REACH_BLUR_WIDTHS

EDGE_STEPS_PER_BLUR_WIDTH = 64  # theory: linear interpolation errs by (1/64)^2/8 x 0.24 = 7e-6
EDGE_HALF = REACH_BLUR_WIDTHS * EDGE_STEPS_PER_BLUR_WIDTH
EDGE = special.ndtr(np.arange(-EDGE_HALF, EDGE_HALF + 2) / EDGE_STEPS_PER_BLUR_WIDTH)  # a straight edge
NODE_SPACING_BLUR_WIDTHS = 0.8  # of the integral; theory: exact to 1e-8, see above
LEAST_NODES = 8  # theory: midpoint rule on the parabola of a thin lens, area right to 1/(2 x 8^2) = 0.8 %
THINNEST_OVERLAP_PX = 0.02  # depth of overlaps that are ignored; theory: area 4/3 sqrt(a) 0.02^1.5
THINNING_RADIUS_PX = 4.0  # radius for each row that a rough fit may skip; by hand
LARGEST_TERM = 4.0 * SIGNIFICANT_SIGMA**2  # largest term of chi-square, that of 10 sigma; by hand
SATURATED = 2  # in the mask: the light is at least what the pixel shows
CLEARED_PIXELS = 6000  # of the model image for each disk to erase, up to which all is cleared; speed only
RINGS_PER_BLUR_WIDTH = 4  # rings over which the expected information of a rim is summed; accuracy

SUMS = 22
"""Number of packed sums: upper triangle for (x, y, a, c), products with s, gradient, chi-square, count."""
CROSS, GRADIENT, CHI_SQUARE, PIXEL_COUNT = 10, 15, 20, 21


@njit(cache=True)
def _reach(table, near):
    """Blur widths beyond the rim at which the profile ends; ``near`` for a plain disk."""
    return near if table.outer <= INNER_BLUR_WIDTHS else table.outer


@njit(cache=True, error_model="numpy", inline="always")
def add_disk(model, disk, s, table, sign):
    """Add ``sign`` times one disk to the model image."""
    x, y, a, c = disk
    rows, columns = model.shape
    reach = _reach(table, END_BLUR_WIDTHS)
    half, inner = a + reach * s, a - END_BLUR_WIDTHS * s
    row, pixels, height = interpolate_row(table, a, s), allocate_pixels(half), np.float32(sign * c)
    j, bottom = max(int(np.ceil(y - half)), 0), min(int(np.floor(y + half)), rows - 1)
    while j <= bottom:
        left, right = next_blocks(j, bottom, EACH, half, inner, x, y, columns)
        n = pad_pixels(pixels, add_block(pixels, add_block(pixels, NONE, left, x, y), right, x, y))
        evaluate_profile(pixels, n, a, s, row)
        _scale_profile(pixels[BY_C, :n], pixels[PLACE, :n], np.float32(reach / END_BLUR_WIDTHS), height)
        _add_levels(model, left, pixels[BY_C], NONE)
        _add_levels(model, right, pixels[BY_C], left[1] * left[4])
        _add_flat(model, block_between(left, right), height)
        j += left[1]


@njit(cache=True, fastmath=FAST, forceinline=True)
def _scale_profile(level, place, reach, height):
    """Multiply a profile by its height, and set it to 0 beyond its end."""
    for i in range(len(level)):
        level[i] = height * level[i] if place[i] <= reach else np.float32(0.0)


@njit(cache=True)
def _add_levels(model, block, levels, n):
    """Add the levels from ``n`` on to a block of the model image."""
    for k in range(block[1]):
        line, more = row_of_block(block, k, model, levels, n)
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


@njit(cache=True, error_model="numpy", inline="always")
def sum_disk(image, model, weight, disk, s, noise, isolated, robust, row_step, table, out):
    """Normal matrix, gradient and chi-square of one disk into ``out`` (see `SUMS`).

    ``noise`` holds variance, slope and rim: ``variance (1 + slope m + rim q)`` is the variance of a pixel of
    model level m, that of the neighbours included, with ``q = 4 P (1 - P)`` at the height P of the disk's
    profile. An ``isolated`` disk is its own model, and the model image is not used; no pixel of it is
    saturated. Of a wide disk only every ``row_step``-th row is used, which is enough far from the solution.
    The normal matrix of a disk whose window lies inside the image and has no masked pixel follows from its
    profile alone; only the gradient and chi-square need the pixels.
    """
    out[:] = 0.0
    x, y, a, c = disk
    rows, columns = image.shape
    reach = _reach(table, FIT_BLUR_WIDTHS)
    half, inner = a + reach * s, a - FIT_BLUR_WIDTHS * s
    j, bottom = max(int(np.ceil(y - half)), 0), min(int(np.floor(y + half)), rows - 1)
    row, pixels, n = interpolate_row(table, a, s), allocate_pixels(half), NONE
    masked = _has_masked_pixel(weight, image.shape, j, bottom + 1, x, half)
    whole = not masked and x > half and x + half < columns - 1 and y > half and y + half < rows - 1
    flat = np.float32(1.0 / (noise[0] * (1.0 + noise[1] * c)))
    step = min(row_step, 1 + int(a / THINNING_RADIUS_PX))
    while j <= bottom:
        left, right = next_blocks(j, bottom, step, half, 0.0 if masked else inner, x, y, columns)
        if n + left[1] * (left[4] + right[4]) > pixels.shape[1]:
            _add_rim(pixels, n, disk, s, row, noise, reach, isolated, robust, whole, out)
            n = NONE
        n = _gather(pixels, n, left, image, model, weight, x, y, isolated, masked)
        n = _gather(pixels, n, right, image, model, weight, x, y, isolated, masked)
        _add_plateau(image, model, block_between(left, right), c, flat, isolated, robust, whole, out)
        j += left[1] * step
    _add_rim(pixels, n, disk, s, row, noise, reach, isolated, robust, whole, out)
    for k in range(CHI_SQUARE):
        out[k] *= step
    if whole:
        _add_expected(pixels, disk, s, row, max(inner, 0.0), half, noise, reach, out)


@njit(cache=True)
def _has_masked_pixel(weight, shape, top, end, x, half):
    """Whether a window contains a pixel that is masked or saturated."""
    if weight.shape != shape:
        return False
    first, last = max(int(x - half), 0), min(int(x + half) + 2, shape[1])
    for j in range(top, end):
        usual = True
        for i in range(first, last):
            usual &= weight[j, i] == 1
        if not usual:
            return True
    return False


@njit(cache=True)
def _gather(pixels, n, block, image, model, weight, x, y, isolated, masked):
    """Append a block of pixels, minus the model unless the disk is isolated; the number of pixels then."""
    if isolated:
        copy_levels(pixels, n, block, image)
    else:
        _take_difference(pixels, n, block, image, model)
    end = add_block(pixels, n, block, x, y)
    pixels[WEIGHT, n:end] = np.float32(1.0)
    if masked:
        _mask_pixels(pixels, n, block, weight)
    return end


@njit(cache=True)
def _take_difference(pixels, n, block, image, model):
    """The levels of a block of pixels minus those of the model, and the latter."""
    for k in range(block[1]):
        line, levels = row_of_block(block, k, image, pixels[DATA], n)
        source, modelled = row_of_block(block, k, model, pixels[MODEL], n)
        for i in range(len(line)):
            levels[i] = line[i] - source[i]
            modelled[i] = source[i]


@njit(cache=True)
def _mask_pixels(pixels, n, block, weight):
    """Set level and weight of masked pixels to 0, and of saturated ones that the model exceeds."""
    for k in range(block[1]):
        line, levels = row_of_block(block, k, weight, pixels[DATA], n)
        _, weights = row_of_block(block, k, weight, pixels[WEIGHT], n)
        for i in range(len(line)):
            if line[i] == 0 or (line[i] == SATURATED and levels[i] < 0.0):
                levels[i] = weights[i] = 0.0


@njit(cache=True)
def _add_plateau(image, model, block, c, flat, isolated, robust, whole, out):
    """Add a block of pixels inside a disk to gradient and information of the contrast."""
    top, rows, step, first, width = block
    cut = np.float32(SIGNIFICANT_SIGMA**2 if robust else np.inf)
    for j in range(top, top + rows * step if width else top, step):
        line, modelled = image[j, first : first + width], model[j, first : first + width]
        out[GRADIENT + 3] += flat * _sum_residuals(line, modelled, np.float32(c), flat, cut, isolated)
    if not whole:
        out[9] += flat * rows * width


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def _sum_residuals(line, modelled, height, flat, cut, isolated):
    """Sum of the residuals of a row, outliers with less weight."""
    total = np.float32(0.0)
    for i in range(len(line)):
        residual = line[i] - (height if isolated else modelled[i])
        z2 = residual * residual * flat
        total += residual * (cut / z2 if z2 > cut else np.float32(1.0))
    return total


@njit(cache=True)
def _add_rim(pixels, n, disk, s, row, noise, reach, isolated, robust, whole, out):
    """Add the gathered pixels to gradient, chi-square, count and information."""
    n = pad_pixels(pixels, n)
    evaluate_derivatives(pixels, n, disk[2], disk[3], s, row)
    # where a neighbour is bright, so is its noise
    light, gain = (BY_C, noise[1] * disk[3]) if isolated else (MODEL, noise[1])
    _weight_pixels(pixels, n, pixels[light, :n], gain, noise, reach)
    if not whole:
        _add_information(pixels, n, out)
    height = np.float32(disk[3] if isolated else 0.0)
    _add_right(pixels, n, height, np.float32(SIGNIFICANT_SIGMA**2 if robust else np.inf), out)


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def _weight_pixels(pixels, n, light, gain, noise, reach):
    """Inverse variances of pixels, which grow by ``gain`` with the light; 0 beyond the reach of a disk."""
    level, weight, place = pixels[BY_C, :n], pixels[WEIGHT, :n], pixels[PLACE, :n]
    plain, growth = np.float32(1.0 / noise[0]), np.float32(gain)
    rim, end = np.float32(4.0 * noise[2]), np.float32(reach / END_BLUR_WIDTHS)
    one, zero = np.float32(1.0), np.float32(0.0)
    for i in range(n):
        near = one if place[i] <= end else zero
        p = max(level[i], zero)
        weight[i] *= near * plain / (one + growth * max(light[i], zero) + rim * p * max(one - p, zero))


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def _add_right(pixels, n, height, cut, out):
    """Add to the gradient, and of the pixels about the rim to chi-square and count.

    The profile times ``height`` is subtracted from the data.
    """
    data, weight, level, place = pixels[DATA, :n], pixels[WEIGHT, :n], pixels[BY_C, :n], pixels[PLACE, :n]
    by_x, by_y, by_a, by_s = pixels[BY_X, :n], pixels[BY_Y, :n], pixels[BY_A, :n], pixels[BY_S, :n]
    x = y = a = c = s = chi_square = count = zero = np.float32(0.0)
    one, most = np.float32(1.0), np.float32(LARGEST_TERM)
    inside = np.float32(-FIT_BLUR_WIDTHS / END_BLUR_WIDTHS)
    for i in range(n):
        residual = data[i] - height * level[i]
        w = weight[i]
        z2 = residual * residual * w
        about = one if (place[i] >= inside) & (w > zero) else zero
        chi_square += about * min(z2, most)
        count += about
        share = w * residual * (cut / z2 if z2 > cut else one)
        x += by_x[i] * share
        y += by_y[i] * share
        a += by_a[i] * share
        c += level[i] * share
        s += by_s[i] * share
    sums = (x, y, a, c, s, chi_square, count)
    for k in range(len(sums)):
        out[GRADIENT + k] += sums[k]


@njit(cache=True)
def _add_information(pixels, n, out):
    """Add weighted products of the derivatives at the gathered pixels."""
    k = 0
    for u in range(4):
        for v in range(u, 4):
            out[k] += _product(pixels[WEIGHT, :n], pixels[u, :n], pixels[v, :n])
            k += 1
    for u in range(5):
        out[CROSS + u] += _product(pixels[WEIGHT, :n], pixels[u, :n], pixels[BY_S, :n])


@njit(cache=True, fastmath=FAST, forceinline=True)
def _product(weight, one, other):
    """Weighted sum of products."""
    total = np.float32(0.0)
    for i in range(len(weight)):
        total += weight[i] * one[i] * other[i]
    return total


@njit(cache=True)
def _add_expected(pixels, disk, s, row, inner, half, noise, reach, out):
    """Expected information of a whole disk, ring by ring."""
    n = int(RINGS_PER_BLUR_WIDTH * (half - inner) / s) + 1
    width = (half - inner) / n
    for k in range(n):
        r = inner + width * (k + 0.5)
        pixels[BY_X, k], pixels[BY_Y, k], pixels[WEIGHT, k] = r, 0.0, 2.0 * np.pi * width * r
    n = pad_pixels(pixels, n)
    evaluate_derivatives(pixels, n, disk[2], disk[3], s, row)
    _weight_pixels(pixels, n, pixels[BY_C, :n], noise[1] * disk[3], noise, reach)
    _add_information(pixels, n, out)
    # over all directions, the pixels along x stand for half of those along y, and odd products vanish
    out[0] = out[4] = 0.5 * out[0]
    out[2] = out[3] = out[CROSS] = 0.0
    out[9] += np.pi * inner * inner / (noise[0] * (1.0 + noise[1] * disk[3]))


@njit(cache=True)
def unpack_sums(out, normal, gradient):
    """Full 4 x 4 matrix and gradient from the packed sums."""
    n = 0
    for u in range(4):
        for v in range(u, 4):
            normal[u, v] = normal[v, u] = out[n]
            n += 1
        gradient[u] = out[GRADIENT + u]


@njit(cache=True, error_model="numpy", inline="always")
def sum_pair(model, weight, one, two, s, noise, table, out):
    """The 4 x 4 block of the normal matrix between two disks, from the pixels in the windows of both."""
    out[:] = 0.0
    row1, row2 = interpolate_row(table, one[2], s), interpolate_row(table, two[2], s)
    reach = _reach(table, FIT_BLUR_WIDTHS)
    half1, half2 = one[2] + reach * s, two[2] + reach * s
    rows, columns = model.shape
    left = max(int(np.ceil(max(one[0] - half1, two[0] - half2))), 0)
    width = min(int(np.floor(min(one[0] + half1, two[0] + half2))), columns - 1) + 1 - left
    j = max(int(np.ceil(max(one[1] - half1, two[1] - half2))), 0)
    bottom = min(int(np.floor(min(one[1] + half1, two[1] + half2))), rows - 1)
    if width <= 0:
        return
    first, second = allocate_pixels(half1), allocate_pixels(half1)
    tall = first.shape[1] // width
    while j <= bottom:
        block = (j, min(tall, bottom + 1 - j), EACH, left, width)
        copy_levels(first, NONE, block, model)
        n = add_block(first, NONE, block, one[0], one[1])
        first[WEIGHT, :n] = np.float32(1.0)
        if weight.shape == model.shape:
            _mask_pixels(first, NONE, block, weight)
        add_block(second, NONE, block, two[0], two[1])
        pad_pixels(second, n)
        n = pad_pixels(first, n)
        _add_pair(first, second, n, one, two, s, row1, row2, noise, reach, out)
        j += block[1]


@njit(cache=True, error_model="numpy", fastmath=FAST, forceinline=True)
def _add_pair(first, second, n, one, two, s, row1, row2, noise, reach, out):
    """Add weighted products of the derivatives with respect to the parameters of the two disks."""
    evaluate_derivatives(first, n, one[2], one[3], s, row1)
    evaluate_derivatives(second, n, two[2], two[3], s, row2)
    plain, growth, rim = np.float32(1.0 / noise[0]), np.float32(noise[1]), np.float32(4.0 * noise[2])
    level, weight, limit = first[DATA, :n], first[WEIGHT, :n], np.float32(reach / END_BLUR_WIDTHS)
    place, other = first[PLACE, :n], second[PLACE, :n]
    p, q = first[BY_C, :n], second[BY_C, :n]
    full, zero = np.float32(1.0), np.float32(0.0)
    for i in range(n):
        near = full if (place[i] <= limit) & (other[i] <= limit) else zero
        slants = max(p[i] * (full - p[i]) + q[i] * (full - q[i]), zero)
        weight[i] *= near * plain / (full + growth * max(level[i], zero) + rim * slants)
    for u in range(4):
        for v in range(4):
            out[u, v] += _product(weight, first[u, :n], second[v, :n])


@njit(cache=True, error_model="numpy")
def build_normal_equations(
    image, model, weight, disks, s, levels, prior, moving, isolated, robust, row_step, table,
    normals, inverse, gradient, cross, blurs, chi_square, pixels,
):  # fmt: skip
    """Normal equations of each moving disk with its prior, and the inverse of the normal matrix.

    ``prior`` holds mean, width and upper bound of the contrasts.
    Every ``row_step``-th row of a wide disk is used.
    """
    out, damped = np.empty(SUMS), np.empty((4, 4))
    for i in range(len(disks)):
        if not moving[i]:
            continue
        expected, spread = prior[0, i], prior[1, i]
        sum_disk(image, model, weight, disks[i], s, levels[i], isolated[i], robust, row_step, table, out)
        unpack_sums(out, normals[i], gradient[i])
        normals[i, 3, 3] += 1.0 / spread**2
        gradient[i, 3] += (expected - disks[i, 3]) / spread**2
        for u in range(4):
            cross[i, u] = out[CROSS + u]
        blurs[i, 0], blurs[i, 1] = out[CROSS + 4], out[GRADIENT + 4]
        pixels[i] = int(out[PIXEL_COUNT])
        chi_square[i] = out[CHI_SQUARE] / max(out[PIXEL_COUNT] - 3.0, 1.0)
        # a disk much smaller than the blur, or outside the image, has little information: keep steps finite
        floor = 1e-3 * expected**2 / levels[i, 0]
        for u in range(4):
            for v in range(4):
                damped[u, v] = normals[i, u, v]
            if u < 3:
                damped[u, u] = damped[u, u] * (1.0 + 1e-6) + floor
        invert_4x4(damped, inverse[i])


@njit(cache=True, error_model="numpy")
def build_pair_blocks(model, weight, disks, s, levels, started, pairs, table, blocks):
    """Blocks of the normal matrix between disks; settled disks still count for the uncertainties."""
    for p in range(len(pairs)):
        i, j = pairs[p]
        if started[i] and started[j]:
            sum_pair(model, weight, disks[i], disks[j], s, levels[i], table, blocks[p])


def draw_disks(
    model: NDArray[np.float32], disks: NDArray[np.float64], s: float, drawn: NDArray[np.bool_],
    wanted: NDArray[np.bool_],
    near_pairs: NDArray[np.int64], table: EdgeTable,
) -> None:  # fmt: skip
    """Add disks to the model image, or subtract them, until it contains those wanted, each with its overlaps.

    ``near_pairs`` contains all pairs that overlap.
    """
    change = np.flatnonzero(drawn != wanted)
    if not len(change):
        return
    if len(change) * CLEARED_PIXELS > model.size and not wanted.any():
        model.fill(0.0)
        drawn[:] = False
        return
    disks, touching = np.ascontiguousarray(disks), select_close(near_pairs, disks, 0.0)
    _draw(model, disks, s, drawn, wanted, table, change, touching)
    drawn[change] = wanted[change]


@njit(cache=True, error_model="numpy")
def _draw(model, disks, s, drawn, wanted, table, change, pairs):
    """Add or subtract the disks that ``change``, and what the pairs drawn after, or before, share."""
    for i in change:
        add_disk(model, disks[i], s, table, 1.0 if wanted[i] else -1.0)
    for p in range(len(pairs)):
        i, j = pairs[p]
        before, after = drawn[i] and drawn[j], wanted[i] and wanted[j]
        dx, dy = disks[j, 0] - disks[i, 0], disks[j, 1] - disks[i, 1]
        limit = disks[i, 2] + disks[j, 2] - THINNEST_OVERLAP_PX
        if before != after and limit > 0.0 and dx * dx + dy * dy < limit * limit:
            add_lens(model, disks[i], disks[j], s, -1.0 if after else 1.0)


@njit(cache=True)
def add_lens(model, one, two, s, sign):
    """Add ``sign`` times the lens that two overlapping disks share, at the mean of their contrasts."""
    dx, dy = two[0] - one[0], two[1] - one[1]
    d = math.sqrt(dx * dx + dy * dy)
    ex, ey = (dx / d, dy / d) if d > 0.0 else (1.0, 0.0)
    a, b = one[2], two[2]
    # half the height of the lens, and the nodes of the integral over it
    foot = 0.5 * (d + (a * a - b * b) / d) if d > 0.0 else -1.0
    tall = math.sqrt(max(a * a - foot * foot, 0.0)) if 0.0 <= foot <= d else min(a, b)
    count = max(math.ceil(2.0 * tall / (NODE_SPACING_BLUR_WIDTHS * s)), LEAST_NODES)
    step = 2.0 * tall / count
    low, high = np.empty(count), np.empty(count)
    for k in range(count):
        t = -tall + (k + 0.5) * step
        u, v = math.sqrt(max(a * a - t * t, 0.0)), math.sqrt(max(b * b - t * t, 0.0))
        low[k], high[k] = max(-u, d - v), max(min(u, d + v), -u, d - v)
    _draw_lens(model, (one[0], one[1], ex, ey), (a, b, d), low, high, tall, s, sign * 0.5 * (one[3] + two[3]))


@njit(cache=True)
def _draw_lens(model, frame, circles, low, high, tall, s, level):
    """Add the lens, given in the coordinates of its pair (origin and axis in ``frame``), to the image.

    Only pixels near one of the two ``circles`` (radii, distance of the centres) need the integral.
    """
    x, y, ex, ey = frame
    a, b, d = circles
    reach = REACH_BLUR_WIDTHS * s
    widest = len(low) // 2
    p0, p1, q1 = low[widest] - reach, high[widest] + reach, tall + reach
    half_x, half_y = 0.5 * (p1 - p0) * abs(ex) + q1 * abs(ey), 0.5 * (p1 - p0) * abs(ey) + q1 * abs(ex)
    cx, cy = x + 0.5 * (p0 + p1) * ex, y + 0.5 * (p0 + p1) * ey
    step = 2.0 * tall / len(low)
    height = level * step / (s * math.sqrt(2.0 * math.pi))
    spacing = step / s
    narrower = math.exp(-spacing * spacing)
    for j in range(max(math.ceil(cy - half_y), 0), min(math.floor(cy + half_y), model.shape[0] - 1) + 1):
        for i in range(max(math.ceil(cx - half_x), 0), min(math.floor(cx + half_x), model.shape[1] - 1) + 1):
            p, q = (i - x) * ex + (j - y) * ey, (j - y) * ex - (i - x) * ey
            if p < p0 or p > p1 or abs(q) > q1:
                continue
            depth = min(a - math.sqrt(p * p + q * q), b - math.sqrt((p - d) ** 2 + q * q))
            if abs(depth) > reach:
                model[j, i] += level if depth > 0.0 else 0.0
                continue
            first = max(int((q - reach + tall) / step), 0)
            last = min(int((q + reach + tall) / step) + 1, len(low))
            # Gaussians at equal steps: the ratio of two of them changes by a constant factor
            z, total = (q + tall - (first + 0.5) * step) / s, 0.0
            gaussian, ratio = math.exp(-0.5 * z * z), math.exp((z - 0.5 * spacing) * spacing)
            for k in range(first, last):
                total += gaussian * (_edge((high[k] - p) / s) - _edge((low[k] - p) / s))
                gaussian *= ratio
                ratio *= narrower
            model[j, i] += height * total


@njit(cache=True)
def _edge(z):
    """Integral of the normal distribution."""
    t = min(max((z + REACH_BLUR_WIDTHS) * EDGE_STEPS_PER_BLUR_WIDTH, 0.0), 2.0 * EDGE_HALF)
    k = int(t)
    return EDGE[k] + (t - k) * (EDGE[k + 1] - EDGE[k])
