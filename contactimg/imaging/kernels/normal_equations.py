"""Sums over pixels: normal equations of one disk and of two overlapping disks (compiled).

The parameters of a disk are x, y, radius a, contrast c; the blur s is common. Pixels far inside the rim have
information on c only and are summed row by row; those about the rim are gathered in blocks first.
"""

import numpy as np

from contactimg.compiled import njit
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
    interpolate_row,
    next_blocks,
    pad_pixels,
    reach_of_profile,
    row_of_block,
)
from contactimg.imaging.kernels.solve import invert_4x4
from contactimg.imaging.pixels.robust import SIGNIFICANT_SIGMA
from contactimg.imaging.profile.blurred_disk import END_BLUR_WIDTHS
from contactimg.imaging.profile.limits import FIT_BLUR_WIDTHS

LARGEST_TERM = 4.0 * SIGNIFICANT_SIGMA**2  # largest term of chi-square, that of 10 sigma; by hand
SATURATED = 2  # in the mask: the light is at least what the pixel shows
RINGS_PER_BLUR_WIDTH = 4  # rings over which the expected information of a rim is summed; accuracy

SUMS = 22
"""Number of packed sums: upper triangle for (x, y, a, c), products with s, gradient, chi-square, count."""
CROSS, GRADIENT, CHI_SQUARE, PIXEL_COUNT = 10, 15, 20, 21


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
    reach = reach_of_profile(table, FIT_BLUR_WIDTHS)
    half, inner = a + reach * s, a - FIT_BLUR_WIDTHS * s
    j, bottom = max(int(np.ceil(y - half)), 0), min(int(np.floor(y + half)), rows - 1)
    row, pixels, n = interpolate_row(table, a, s), allocate_pixels(half), NONE
    masked = _has_masked_pixel(weight, image.shape, j, bottom + 1, x, half)
    whole = not masked and x > half and x + half < columns - 1 and y > half and y + half < rows - 1
    flat = np.float32(1.0 / (noise[0] * (1.0 + noise[1] * c)))
    step = min(row_step, 1 + int(a / 4.0))  # a row for each 4 px, by hand
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
    reach = reach_of_profile(table, FIT_BLUR_WIDTHS)
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
