"""Divide a frame by its reference without adding the reference's noise: a Wiener filter in bands of scale.

The reference shows texture and dirt of the surface, which are wanted, and noise, which is not. It is split
into bands of scale by Gaussians, and each band is weighted by the least-squares gain of the frame on it.
Where a band shows dirt, the reference is used unfiltered.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.imaging.background.alignment import Alignment, filter_rows_and_columns, shift_kernel
from contactimg.imaging.background.illumination import Illumination, cubic
from contactimg.imaging.pixels.blocks import block_means, is_background, strips
from contactimg.imaging.pixels.robust import median, robust_std

Values = NDArray[np.float32]
Filters = list[NDArray[np.float64]]

DARKEST_FRACTION = 0.1
"""Of the median level of the reference: where it is darker, it is not divided by. Chosen by hand."""
NARROW_PX, MIDDLE_PX, WIDE_PX = 0.7, 2.0, 6.0
"""Standard deviations of the Gaussians that separate the bands: less than, as, and more than a usual blur."""
BINNING_VARIANCE = 1.0 / 12.0 + 1.0 / 6.0
"""Variance (binned pixels squared) that binning and linear interpolation add to a Gaussian.

Theory: the variances of a box and of a triangle."""
BLUR_PX = 1.0
"""The gains suit an image blurred by this: finer detail is lost in the blur of the contacts."""
STRIPS, STRIP_ROWS, STRIP_MARGIN = 4, 16, 4
"""Strips of the image that the gains are measured in, their rows, and those at their ends that the blur
spoils. Accuracy: some thousand samples."""
SAMPLE_SPACINGS_PX = (4, 2)
"""Distance at which pixels are independent behind `BLUR_PX`, and that in a small frame."""
FEWEST_SAMPLES = 60
"""Pixels of fewer than which no gains are measured and the reference is used as it is. Accuracy: 10 %."""
NEGLIGIBLE_GAIN = 0.1
"""Gain of the finest band for which it is left out. By hand: a full-frame filter is saved."""
GAIN_LIMITS = (-1.0, 3.0)
"""A gain may exceed 0..1 where it corrects for the overlap with other bands."""
OUTLIER_SIGMA = 6.0
"""Robust standard deviations from the reference beyond which a pixel does not count for the gains."""
DIRT_SIGMA, FULL_DIRT_SIGMA = 4.0, 6.0
"""Robust standard deviations of a band from which its detail is partly, and from which it is wholly taken as
dirt. Chosen by hand on rendered frames; sensitivity not measured."""
NO_DIRT = 1e30
"""Scatter of a band in which nothing counts as dirt."""


def divide_by_reference(
    frame: NDArray,
    reference: NDArray,
    half: Values,
    illumination: Illumination,
    *,
    residual: Alignment,
    level: float,
) -> Values:
    """``level (F/(g R) - 1)`` of the frame F, the ratio g of the illuminations, and the filtered reference R.

    Parameters
    ----------
    frame, reference : ndarray, shape (rows, columns)
        Grey levels of any type.
    half : ndarray, shape (rows / 2, columns / 2)
        Means of the reference over 2 x 2 pixels, see `contactimg.imaging.pixels.blocks.block_means`; NaN in
        holes.
    illumination : Illumination
        Ratio frame/reference of the background.
    residual : Alignment
        Shift of the frame against the reference, less than a pixel.
    level : float
        Grey level of the background of the reference.
    """
    full = np.ascontiguousarray(reference, np.float32)
    shift = (residual.x_px, residual.y_px)
    move = [shift_kernel(part) for part in shift]
    finite = np.isfinite(half)
    quarter = block_means(half, None if finite.all() else finite.astype(np.uint8), side=2)
    bands = [filter_rows_and_columns(reference, *_gaussians(shift, NARROW_PX))]
    for side, binned, blur in ((2, half, MIDDLE_PX), (4, quarter, WIDE_PX)):
        bands.append(_move_and_blur(binned, blur, shift, side, full.shape))
    gains, scatters = _measure_gains(frame, full, bands, illumination, shift)
    sharp = filter_rows_and_columns(full, *move) if gains[0] else bands[0]
    numbers = np.array([*gains, *(1.0 / scatters), level, DARKEST_FRACTION * level], np.float32)
    out = np.array(frame, np.float32, order="C")
    _divide(out, sharp, *bands, full, *move, *illumination.row_polynomials(out.shape), numbers)
    return out


@njit(cache=True)
def _divide(out, sharp, narrow, middle, wide, full, taps_x, taps_y, along, across, numbers):
    """Put the relative excess over the weighted bands, times the level, in the place of the frame ``out``."""
    for y in range(len(out)):
        background = np.empty_like(out[y])
        if _weight_bands(background, sharp[y], narrow[y], middle[y], wide[y], numbers):
            _restore_dirt(background, y, full, taps_x, taps_y, narrow[y], middle[y], wide[y], numbers)
        _divide_row(out[y], background, along[y], across, numbers)


@njit(cache=True, fastmath=True, forceinline=True)
def _weight_bands(out, sharp, narrow, middle, wide, numbers):
    """Sum the weighted bands of a row; return the number of pixels where a band shows dirt."""
    finest, finer, coarser, per_finer, per_coarser = numbers[:5]
    limit = np.float32(DIRT_SIGMA)
    dirty = np.int32(0)
    for x in range(len(out)):
        fine, coarse = narrow[x] - middle[x], middle[x] - wide[x]
        out[x] = wide[x] + coarser * coarse + finer * fine + finest * (sharp[x] - narrow[x])
        dirty += np.int32((abs(fine) * per_finer > limit) | (abs(coarse) * per_coarser > limit))
    return dirty


@njit(cache=True, fastmath=True, error_model="numpy", forceinline=True)
def _restore_dirt(out, y, full, taps_x, taps_y, narrow, middle, wide, numbers):
    """Replace the sum by the unfiltered reference, merely moved, in the pixels where a band shows dirt."""
    (rows, columns), reach = full.shape, len(taps_x) // 2
    for x in range(columns):
        worst = max(abs(narrow[x] - middle[x]) * numbers[3], abs(middle[x] - wide[x]) * numbers[4])
        if worst > DIRT_SIGMA:
            moved = 0.0
            for j in range(-reach, reach + 1):
                row = full[min(max(y + j, 0), rows - 1)]
                for i in range(-reach, reach + 1):
                    moved += taps_y[j + reach] * taps_x[i + reach] * row[min(max(x + i, 0), columns - 1)]
            share = min((worst - DIRT_SIGMA) / (FULL_DIRT_SIGMA - DIRT_SIGMA), 1.0)
            out[x] += share * (moved - out[x])


@njit(cache=True, fastmath=True, error_model="numpy", forceinline=True)
def _divide_row(out, reference, along, across, numbers):
    """Relative excess of a row over the background, times the level."""
    c0, c1, c2, c3 = along
    level, lowest = numbers[5:]
    for x in range(len(out)):
        background = cubic(c0, c1, c2, c3, across[x]) * reference[x]
        out[x] = level * (out[x] - background) / max(background, lowest)


def _gaussians(shift: tuple[float, float], width: float) -> Filters:
    """Filters along rows and columns that blur by a standard deviation ``width`` and move, px."""
    half = int(np.ceil(2.7 * width))
    taps = [np.exp(-((np.arange(-half, half + 1) + part) ** 2) / (2 * width**2)) for part in shift]
    return [part / part.sum() for part in taps]


def _move_and_blur(
    binned: Values, blur_px: float, shift: tuple[float, float], side: int, shape: tuple[int, int]
) -> Values:
    """Means of ``side`` pixels, moved, blurred to ``blur_px`` and interpolated to the pixels; without NaN."""
    kernels = _gaussians(
        (shift[0] / side, shift[1] / side), float(np.sqrt((blur_px / side) ** 2 - BINNING_VARIANCE))
    )
    finite = np.isfinite(binned)
    if finite.all():
        smooth = filter_rows_and_columns(binned, *kernels)
    else:
        smooth = filter_rows_and_columns(np.where(finite, binned, np.float32(0.0)), *kernels)
        smooth /= np.maximum(filter_rows_and_columns(finite, *kernels), np.float32(1e-3))
    size = (side * binned.shape[1], side * binned.shape[0])
    return np.asarray(cv2.resize(smooth, size)[: shape[0], : shape[1]], np.float32)


def _measure_gains(
    frame: NDArray, full: Values, bands: list[Values], illumination: Illumination, shift: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gains of the three finer bands, the finest 0 if negligible, and scatter of the coarser two of them.

    Measured in strips of the image, behind a blur of `BLUR_PX` as in the image of a contact.
    """
    rows, inside = strips(len(full), STRIP_ROWS, STRIPS, STRIP_MARGIN)
    for spacing in SAMPLE_SPACINGS_PX:
        picked = np.flatnonzero(inside & (rows % spacing == 0))
        columns = np.arange(STRIP_MARGIN, full.shape[1] - STRIP_MARGIN, spacing)
        mask = is_background(illumination.background, rows[picked], columns, full.shape)
        if np.count_nonzero(mask) >= FEWEST_SAMPLES:
            break
    else:
        return np.ones(3), np.full(2, NO_DIRT)

    def sample(strips: NDArray, filters: Filters | None = None) -> Values:
        smooth = strips if filters is None else filter_rows_and_columns(strips, *filters)
        return np.asarray(smooth[np.ix_(picked, columns)][mask], np.float32)

    narrow, middle, wide = (part[rows] for part in bands)
    still = _gaussians((0.0, 0.0), BLUR_PX)
    target = sample(frame[rows] / illumination.ratio_at_rows(rows, full.shape), still)
    blurred = [
        sample(full[rows], _gaussians(shift, BLUR_PX)),
        *(sample(part, still) for part in (narrow, middle)),
    ]
    plain = [sample(part) for part in (narrow, middle, wide)]
    differences = np.stack([*(-np.diff(blurred, axis=0)), blurred[2] - plain[2]])
    return _solve_gains(target - plain[2], differences, -np.diff(plain, axis=0))


def _solve_gains(
    target: Values, bands: Values, detail: Values
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gains of the bands by least squares on the target, and robust scatters of the detail; without dirt."""
    target = target - np.float32(median(target))
    scatters = np.array([robust_std(part, centre=0.0) for part in detail])
    usable = np.abs(target) < OUTLIER_SIGMA * robust_std(target, centre=0.0)
    usable &= np.all(np.abs(detail) < DIRT_SIGMA * scatters[:, None], axis=0)
    bands, target = bands[:, usable], target[usable]
    normal, right = (bands @ bands.T).astype(float), (bands @ target).astype(float)
    if not np.all(np.diag(normal) > 1e-12 * len(target)):
        return np.ones(3), np.full(2, NO_DIRT)
    gains = np.linalg.lstsq(normal, right, rcond=1e-9)[0]
    if gains[0] < NEGLIGIBLE_GAIN:
        gains = np.r_[0.0, np.linalg.lstsq(normal[1:, 1:], right[1:], rcond=1e-9)[0]]
    return np.clip(gains, *GAIN_LIMITS), scatters
