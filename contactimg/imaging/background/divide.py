"""Divide a frame by its reference without adding the reference's noise: a Wiener filter in bands of scale.

The reference shows texture and dirt of the surface, which are wanted, and noise, which is not. It is split
into bands of scale by Gaussians, and each band is weighted by the least-squares gain of the frame on it.
Where a band shows dirt, the reference is used unfiltered.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.imaging.background import alignment
from contactimg.imaging.background.illumination import DARKEST_FRACTION, Illumination, cubic
from contactimg.imaging.pixels.blocks import block_means, is_background, strips, to_pixels
from contactimg.imaging.pixels.masks import Mask, Values, mean_of_seen
from contactimg.imaging.pixels.robust import CLIP_SIGMA, SOME, median, robust_std

NARROW_PX, MIDDLE_PX, WIDE_PX = 0.7, 2.0, 6.0
"""Standard deviations of the Gaussians that separate the bands: less than, as, and more than a usual blur.
What the first takes away is lost in the blur of the contacts as well."""
STRIPS, STRIP_ROWS, SPACING_PX = 4, 16, 4
"""Strips in which the gains are measured, their rows, and the distance at which pixels are independent behind
`SMOOTHING_PX`, which is also what the borders of a strip spoil. Accuracy: some thousand samples."""
FULL_DIRT_SIGMA = 6.0
"""Robust standard deviations of a band from which its detail is wholly dirt, and partly from `CLIP_SIGMA`
on; pixels of the frame that differ by so much do not count for the gains. By hand: rendered frames."""


def divide_by_reference(
    frame: NDArray, reference: NDArray, valid: Mask, illumination: Illumination, *,
    residual: alignment.Alignment, level: float,
) -> Values:  # fmt: skip
    """``level (F/(g R) - 1)`` of the frame F, the ratio g of the illuminations, and the filtered reference R.

    Parameters
    ----------
    frame, reference : ndarray, shape (rows, columns)
        Grey levels, of 8 bits or in single precision.
    valid : Mask
        0 at holes of either.
    illumination : Illumination
        Ratio frame/reference of the background.
    residual : Alignment
        Shift of the frame against the reference, less than a pixel.
    level : float
        Grey level of the background of the reference.
    """
    frame, reference = np.ascontiguousarray(frame), np.ascontiguousarray(reference)
    shift = (residual.x_px, residual.y_px)
    half = block_means(reference, valid, side=2)
    finite = np.isfinite(half)
    quarter = block_means(half, None if finite.all() else finite.astype(np.uint8), side=2)
    wide = _move_and_blur(quarter, WIDE_PX, shift, 4)
    wide = to_pixels(wide, half.shape, side=2, interpolation=cv2.INTER_LINEAR)
    source = (reference, _move_and_blur(half, MIDDLE_PX, shift, 2), wide, *_gaussians(shift, NARROW_PX))
    gains, scatters = _measure_gains(frame, source, illumination)
    numbers = np.array([*gains, *scatters, level, DARKEST_FRACTION * level], np.float32)
    move = [alignment.shift_kernel(part).astype(np.float32) for part in shift]
    light = illumination.row_polynomials(np.arange(len(frame)), frame.shape)
    out = np.empty(frame.shape, np.float32)
    _divide(out, frame, source, *move, *light, numbers)
    return out


@njit(cache=True)
def _divide(out, frame, source, sinc_x, sinc_y, light, places, numbers):
    """Relative excess of the frame over the weighted bands of the reference, times the level."""
    rows, background = np.arange(len(out)), np.empty(out.shape[1], np.float32)
    for y in rows:
        bands = _bands_at_rows(rows[y : y + 1], source)
        if _weight_bands(background, bands[0, 0], bands[1, 0], bands[2, 0], numbers) > 0:
            _restore_dirt(background, y, source[0], sinc_x, sinc_y, bands, numbers)
        _divide_row(out[y], frame[y], background, light[y], places, numbers)


@njit(cache=True)
def _bands_at_rows(rows, source):
    """The reference as each of the three Gaussians leaves it, at some rows.

    A filter of five by five pixels, and interpolation.
    """
    reference, half, quarter, across, down = source
    last, columns = len(reference) - 1, reference.shape[1]
    out = np.empty((3, len(rows), columns), np.float32)
    column, low = np.empty(columns + 4, np.float32), np.empty(half.shape[1] + 2, np.float32)
    inner = column[2 : 2 + columns]
    for k in range(len(rows)):
        y = rows[k]
        _add_five(
            inner, reference[max(y - 2, 0)], reference[max(y - 1, 0)], reference[y],
            reference[min(y + 1, last)], reference[min(y + 2, last)], down,
        )  # fmt: skip
        column[:2], column[2 + columns :] = inner[0], inner[columns - 1]
        _add_five(
            out[0, k], column[:columns], column[1 : columns + 1],
            inner, column[3 : columns + 3], column[4:], across,
        )  # fmt: skip
        _interpolate_row(out[1, k], y, half, low)
        _interpolate_row(out[2, k], y, quarter, low)
    return out


@njit(cache=True, fastmath=True, forceinline=True)
def _add_five(out, first, second, third, fourth, fifth, weights):
    """Weighted sum of five rows; in single precision, so that it compiles to vector instructions."""
    a, b, d, e = weights[0], weights[1], weights[3], weights[4]
    for x in range(len(out)):
        middle = np.float32(third[x])  # the weights sum to 1: what is constant stays so exactly
        near = b * (np.float32(second[x]) - middle) + d * (np.float32(fourth[x]) - middle)
        far = a * (np.float32(first[x]) - middle) + e * (np.float32(fifth[x]) - middle)
        out[x] = middle + (near + far)


@njit(cache=True, fastmath=True, forceinline=True)
def _interpolate_row(out, y, half, low):
    """A row of an image of twice the size, by linear interpolation; the border repeats."""
    three, one = np.float32(0.75), np.float32(0.25)
    k, columns = y // 2, half.shape[1]
    near, far = half[k], half[min(max(k + 2 * (y % 2) - 1, 0), len(half) - 1)]
    for x in range(columns):  # a quarter of the way from one row to the next, then of the columns
        low[x + 1] = three * near[x] + one * far[x]
    low[0], low[columns + 1] = low[1], low[columns]
    for x in range(len(out) // 2):
        out[2 * x] = one * low[x] + three * low[x + 1]
        out[2 * x + 1] = three * low[x + 1] + one * low[x + 2]
    if len(out) % 2:
        x = len(out) // 2
        out[2 * x] = one * low[x] + three * low[x + 1]


@njit(cache=True, fastmath=True, forceinline=True)
def _weight_bands(out, narrow, middle, wide, numbers):
    """Sum the weighted bands of a row; return the number of pixels where a band shows dirt."""
    finer, coarser, finer_dirt, coarser_dirt = numbers[:4]
    less_fine, less_coarse = np.float32(1.0) - finer, np.float32(1.0) - coarser
    finer_dirt, coarser_dirt = np.float32(CLIP_SIGMA) * finer_dirt, np.float32(CLIP_SIGMA) * coarser_dirt
    one, zero = np.float32(1.0), np.float32(0.0)
    dirty = zero
    for x in range(len(out)):
        fine, coarse = narrow[x] - middle[x], middle[x] - wide[x]
        out[x] = narrow[x] - less_fine * fine - less_coarse * coarse
        dirty += one if (abs(fine) > finer_dirt) | (abs(coarse) > coarser_dirt) else zero
    return dirty


@njit(cache=True, fastmath=True, error_model="numpy", forceinline=True)
def _restore_dirt(out, y, reference, taps_x, taps_y, bands, numbers):
    """Replace the sum by the unfiltered reference, merely moved, in the pixels where a band shows dirt."""
    (rows, columns), reach = reference.shape, len(taps_x) // 2
    for x in range(columns):
        fine, coarse = bands[0, 0, x] - bands[1, 0, x], bands[1, 0, x] - bands[2, 0, x]
        worst = max(abs(fine) / numbers[2], abs(coarse) / numbers[3])
        if worst > CLIP_SIGMA:
            moved = 0.0
            for j in range(-reach, reach + 1):
                row = reference[min(max(y + j, 0), rows - 1)]
                for i in range(-reach, reach + 1):
                    moved += taps_y[j + reach] * taps_x[i + reach] * row[min(max(x + i, 0), columns - 1)]
            share = min((worst - CLIP_SIGMA) / (FULL_DIRT_SIGMA - CLIP_SIGMA), 1.0)
            out[x] += share * (moved - out[x])


@njit(cache=True, fastmath=True, error_model="numpy", forceinline=True)
def _divide_row(out, frame, reference, light, places, numbers):
    """Relative excess of a row over the background, times the level."""
    c0, c1, c2, c3 = light
    level, lowest = numbers[4:]
    for x in range(len(out)):
        background = cubic(c0, c1, c2, c3, places[x]) * reference[x]
        out[x] = level * (np.float32(frame[x]) - background) / max(background, lowest)


def _gaussians(shift: tuple[float, float], width: float) -> list[Values]:
    """Filters along rows and columns that blur by a standard deviation ``width`` and move, px."""
    half = int(np.ceil(2.7 * width))
    taps = [np.exp(-((np.arange(-half, half + 1) + part) ** 2) / (2 * width**2)) for part in shift]
    return [(part / part.sum()).astype(np.float32) for part in taps]


def _move_and_blur(binned: Values, blur_px: float, shift: tuple[float, float], side: int) -> Values:
    """Means of ``side`` pixels, moved and blurred to ``blur_px`` as they are interpolated; without NaN."""
    # Binning and linear interpolation add the variances of a box and of a triangle.
    width = float(np.sqrt((blur_px / side) ** 2 - (1.0 / 12.0 + 1.0 / 6.0)))
    kernels = _gaussians((shift[0] / side, shift[1] / side), width)
    finite = np.isfinite(binned)
    if finite.all():
        return alignment.filter_rows_and_columns(binned, *kernels)
    return mean_of_seen(lambda part: alignment.filter_rows_and_columns(part, *kernels), binned, finite)[0]


def _measure_gains(
    frame: NDArray, source: tuple[NDArray, ...], illumination: Illumination
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gains of the two finer bands by least squares, and their robust scatters; without dirt.

    Measured in strips of the image, behind a blur of `SMOOTHING_PX` as in the image of a contact. ``source``
    is what `_bands_at_rows` takes.
    """
    rows, _ = strips(len(frame), STRIP_ROWS, STRIPS, 0)
    for spacing in (SPACING_PX, SPACING_PX // 2):  # nearer pixels where little background is left
        inner = slice(SPACING_PX, -SPACING_PX, spacing)
        columns, picked = np.arange(frame.shape[1])[inner], rows.reshape(STRIPS, -1)[:, inner]
        mask = is_background(illumination.background, picked.ravel(), columns, frame.shape)
        if np.count_nonzero(mask) >= SOME:
            break
    else:
        return np.ones(2), np.full(2, np.inf)

    def sample(part: NDArray) -> Values:
        return np.asarray(part.reshape(STRIPS, -1, frame.shape[1])[:, inner, inner].reshape(mask.shape)[mask])

    narrow, middle, wide = _bands_at_rows(rows, source)
    target = frame[rows] / illumination.ratio_at_rows(rows, frame.shape) - wide
    still, parts = _gaussians((0.0, 0.0), alignment.SMOOTHING_PX), (narrow - middle, middle - wide)
    excess, *bands = (sample(alignment.filter_rows_and_columns(part, *still)) for part in (target, *parts))
    detail = np.stack([sample(part) for part in parts])
    excess = excess - np.float32(median(excess))
    scatters = np.array([robust_std(part, centre=0.0) for part in detail])
    usable = np.abs(excess) < FULL_DIRT_SIGMA * robust_std(excess, centre=0.0)
    usable &= np.all(np.abs(detail) < CLIP_SIGMA * scatters[:, None], axis=0)
    fine, excess = np.stack(bands)[:, usable], excess[usable]
    normal = (fine @ fine.T).astype(float)
    if not np.all(np.diag(normal) > 1e-12 * len(excess)):
        return np.ones(2), np.full(2, np.inf)
    return np.linalg.lstsq(normal, (fine @ excess).astype(float), rcond=1e-9)[0], scatters
