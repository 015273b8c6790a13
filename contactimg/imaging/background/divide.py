"""Divide a frame by its reference without adding the reference's noise: a Wiener filter in bands of scale.

The reference shows texture and dirt of the surface, which are wanted, and noise, which is not. It is split
into bands of scale by Gaussians, and each band is weighted by the least-squares gain of the frame on it.
Where a band shows dirt, the reference is used unfiltered.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.imaging.background.alignment import Alignment, filter_rows_and_columns, shift_kernel
from contactimg.imaging.background.illumination import Illumination, cubic
from contactimg.imaging.pixels.blocks import BLOCK, block_means, is_background, side_of
from contactimg.imaging.pixels.robust import median, robust_std

TAPS = 9
"""Number of coefficients of each filter; odd."""

NO_DIRT = 1e30
"""Scatter of a band in which nothing counts as dirt."""

DIRT_SIGMA, FULL_DIRT_SIGMA = 4.0, 6.0
"""Robust standard deviations of a band from which its detail is partly, and from which it is wholly taken as
dirt. Chosen by hand on rendered frames; sensitivity not measured."""


@njit(cache=True)
def divide_rows(out, frame, reference, half, quarter, along, across, filters, sharp, numbers):
    """Divide a frame by the weighted bands of its reference.

    Parameters
    ----------
    out : ndarray of float32, shape (rows, columns)
        Receives the relative excess of the frame over the background, times the level.
    frame, reference : ndarray, shape (rows, columns)
    half, quarter : ndarray of float32
        The reference at half and quarter of the resolution, moved and blurred.
    along, across : ndarray of float32
        Illumination ratio, see `contactimg.imaging.background.illumination.Illumination.row_polynomials`.
    filters : ndarray of float32, shape (1 or 2, 2, TAPS)
        Filters along rows and columns that move the reference (left out if its finest band has no weight) and
        that move it and blur it by the narrowest Gaussian.
    sharp : ndarray of float32, shape (2, TAPS)
        Filter that moves the reference.
    numbers : ndarray of float32
        Gains of the three finer bands, finest first; the inverse scatters of the coarser two of them; the
        level; the smallest background that is divided by.
    """
    rows, columns = reference.shape
    reach, kinds = TAPS // 2, len(filters)
    ring = np.empty((kinds, TAPS, columns), np.float32)
    bands = np.empty((kinds + 2, columns), np.float32)
    line, turned = np.empty(columns + 2 * reach, np.float32), np.empty(TAPS, np.float32)
    halves = np.empty((2, 2 * half.shape[1]), np.float32)
    twice = np.empty(2 * quarter.shape[1], np.float32)
    quarters = np.empty((2, 2 * len(twice)), np.float32)
    halves_done = quarters_done = 0
    for ahead in range(-reach, rows + reach):
        _pad_row(line, reference[min(max(ahead, 0), rows - 1)])
        for i in range(kinds):
            _filter_row(ring[i, (ahead + reach) % TAPS], line, filters[i, 0])
        y = ahead - reach
        if y < 0:
            continue
        for i in range(kinds):
            _turn_taps(turned, filters[i, 1], y)
            _sum_rows(bands[i], ring[i], turned)
        above, below, fraction = _neighbours(y, 2, len(half))
        for row in range(halves_done, below + 1):
            _double_row(halves[row % 2], half[row])
        halves_done = below + 1
        _mix_rows(bands[-2], halves[above % 2], halves[below % 2], fraction)
        above, below, fraction = _neighbours(y, 4, len(quarter))
        for row in range(quarters_done, below + 1):
            _double_row(twice, quarter[row])
            _double_row(quarters[row % 2], twice)
        quarters_done = below + 1
        _mix_rows(bands[-1], quarters[above % 2], quarters[below % 2], fraction)
        dirty = _weight_bands(out[y], bands[0], bands[-3], bands[-2], bands[-1], numbers)
        if dirty:
            _restore_dirt(out[y], dirty, y, reference, sharp, bands[-3], bands[-2], bands[-1], numbers)
        _divide_row(out[y], frame[y], along[y], across, numbers)


@njit(cache=True)
def _neighbours(y, side, rows):
    """Binned rows above and below row y, and its position between them (0 to 1)."""
    place = min(max((y + 0.5) / side - 0.5, 0.0), rows - 1.0)
    above = int(place)
    return above, min(above + 1, rows - 1), np.float32(place - above)


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
def _restore_dirt(out, dirty, y, reference, sharp, narrow, middle, wide, numbers):
    """Replace the sum by the unfiltered reference, merely moved, in the pixels where a band shows dirt."""
    per_finer, per_coarser = numbers[3:5]
    rows, columns = reference.shape
    reach = TAPS // 2
    start, width = np.float32(DIRT_SIGMA), np.float32(FULL_DIRT_SIGMA - DIRT_SIGMA)
    for x in range(columns):
        worst = max(abs(narrow[x] - middle[x]) * per_finer, abs(middle[x] - wide[x]) * per_coarser)
        if not worst > start:
            continue
        moved = np.float32(0.0)
        for j in range(TAPS):
            row = reference[min(max(y + j - reach, 0), rows - 1)]
            for i in range(TAPS):
                moved += sharp[1, j] * sharp[0, i] * np.float32(row[min(max(x + i - reach, 0), columns - 1)])
        out[x] += min((worst - start) / width, np.float32(1.0)) * (moved - out[x])
        dirty -= 1
        if dirty == 0:
            break


@njit(cache=True, fastmath=True, error_model="numpy", forceinline=True)
def _divide_row(out, frame, along, across, numbers):
    """Relative excess of the frame over the background, times the level."""
    c0, c1, c2, c3 = along
    level, lowest = numbers[5:]
    for x in range(len(out)):
        background = cubic(c0, c1, c2, c3, across[x]) * out[x]
        out[x] = level * (np.float32(frame[x]) - background) / max(background, lowest)


@njit(cache=True)
def _turn_taps(turned, taps, y):
    """Coefficients in the order of a ring buffer whose first row is number y modulo `TAPS`."""
    for k in range(TAPS):
        turned[(y + k) % TAPS] = taps[k]


@njit(cache=True, fastmath=True, forceinline=True)
def _pad_row(line, row):
    """The row in single precision, padded by its end values."""
    half = TAPS // 2
    for x in range(len(row)):
        line[half + x] = np.float32(row[x])
    line[:half] = np.float32(row[0])
    line[half + len(row) :] = np.float32(row[-1])


@njit(cache=True, fastmath=True, forceinline=True)
def _filter_row(out, line, taps):
    """Filter a padded row."""
    for x in range(len(out)):
        total = np.float32(0.0)
        for k in range(TAPS):
            total += taps[k] * line[x + k]
        out[x] = total


@njit(cache=True, fastmath=True, forceinline=True)
def _sum_rows(out, rows, taps):
    """Weighted sum of `TAPS` rows."""
    for x in range(len(out)):
        total = np.float32(0.0)
        for k in range(TAPS):
            total += taps[k] * rows[k, x]
        out[x] = total


@njit(cache=True, fastmath=True, forceinline=True)
def _double_row(out, row):
    """The row interpolated to twice as many pixels."""
    near, far = np.float32(0.75), np.float32(0.25)
    out[0], out[2 * len(row) - 1] = row[0], row[-1]
    for i in range(len(row) - 1):
        out[2 * i + 1] = near * row[i] + far * row[i + 1]
        out[2 * i + 2] = far * row[i] + near * row[i + 1]


@njit(cache=True, fastmath=True, forceinline=True)
def _mix_rows(out, above, below, fraction):
    """The row interpolated linearly between two."""
    for x in range(len(out)):
        out[x] = above[x] + fraction * (below[x] - above[x])


# Constants without a stated origin were chosen by hand on rendered frames; their sensitivity is not measured.
DARKEST_FRACTION = 0.1
"""Of the median level of the reference: where it is darker, it is not divided by."""

NARROW_PX, MIDDLE_PX, WIDE_PX = 0.7, 2.0, 6.0
"""Standard deviations of the Gaussians that separate the bands."""

BINNING_VARIANCE = 1.0 / 12.0 + 1.0 / 6.0
"""Variance (binned pixels squared) that binning and linear interpolation add to a Gaussian.

Theory: the variances of a box and of a triangle."""

BLUR_PX = 1.0  # the gains suit an image blurred by this: finer detail is lost in the blur of the contacts
TILES, TILE_ROWS, TILE_COLUMNS = 4, 32, 256  # number and size of the tiles that the gains are measured in
BORDER_PX = 8  # rows and columns around a tile that the filters need: one block
SAMPLE_SPACING_PX = 4  # pixels that far apart are independent behind `BLUR_PX`
FEWEST_SAMPLES = 60  # pixels: of fewer, no gains are measured and the reference is used as it is
NEGLIGIBLE_GAIN = 0.1  # gain of the finest band for which its filter is not computed
GAIN_LIMITS = (-1.0, 3.0)  # a gain may exceed 0..1 where it corrects for the overlap with other bands
OUTLIER_SIGMA = 6.0  # pixels of the frame that differ by more from the reference are not used for the gains
GOLDEN_RATIO = 0.618  # fractional parts of its multiples fill the unit interval evenly


def divide_by_reference(
    frame: NDArray,
    reference: NDArray,
    half: NDArray[np.float32],
    illumination: Illumination,
    *,
    residual: Alignment,
    level: float,
) -> NDArray[np.float32]:
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
    bands = _ReferenceBands.of(reference, half, residual)
    gains, scatters = _measure_gains(frame, bands, illumination)
    sharp, narrow = bands.filters(0.0), bands.filters(NARROW_PX)
    numbers = np.array([*gains, *(1.0 / scatters), level, DARKEST_FRACTION * level], np.float32)
    out = np.empty(frame.shape, np.float32)
    divide_rows(
        out, np.ascontiguousarray(frame, np.float32), bands.full, bands.half, bands.quarter,
        *illumination.row_polynomials(frame.shape),
        np.stack([narrow] if gains[0] == 0.0 else [sharp, narrow]), sharp, numbers,
    )  # fmt: skip
    return out


@dataclass(frozen=True, eq=False)
class _ReferenceBands:
    """The reference as it is, and at half and a quarter of the resolution, there moved and blurred."""

    full: NDArray
    half: NDArray[np.float32]
    quarter: NDArray[np.float32]
    residual: Alignment

    @classmethod
    def of(cls, reference: NDArray, half: NDArray[np.float32], residual: Alignment) -> "_ReferenceBands":
        finite = np.isfinite(half)
        quarter = block_means(half, None if finite.all() else finite.astype(np.uint8), side=2)
        return cls(
            np.ascontiguousarray(reference, np.float32),
            _move_and_blur(half, MIDDLE_PX, residual, 2),
            _move_and_blur(quarter, WIDE_PX, residual, 4),
            residual,
        )

    def filters(self, blur_px: float) -> NDArray[np.float32]:
        """Filters along rows and columns that move the reference, and blur it unless ``blur_px`` is 0."""
        shifts = (self.residual.x_px, self.residual.y_px)
        return np.stack(
            [_fit_taps(_moved_gaussian(part, blur_px) if blur_px else shift_kernel(part)) for part in shifts]
        )


def _moved_gaussian(fraction: float, width: float) -> NDArray[np.float64]:
    """Filter that blurs by a standard deviation ``width`` and moves by ``fraction`` px."""
    half = int(np.ceil(2.7 * width)) + 1
    kernel = np.exp(-((np.arange(-half, half + 1) + fraction) ** 2) / (2 * width**2))
    return np.asarray(kernel / kernel.sum())


def _fit_taps(taps: NDArray[np.float64]) -> NDArray[np.float32]:
    """An odd number of coefficients padded with zeros to `TAPS`, or cut to `TAPS` and normalised to sum 1.

    Examples
    --------
    >>> _fit_taps(np.ones(3) / 3).round(2).tolist()
    [0.0, 0.0, 0.0, 0.33000001311302185, 0.33000001311302185, 0.33000001311302185, 0.0, 0.0, 0.0]
    """
    kernel, spare = np.zeros(TAPS), (TAPS - len(taps)) // 2
    if spare < 0:
        kernel = taps[-spare:spare] / taps[-spare:spare].sum()
    else:
        kernel[spare : spare + len(taps)] = taps
    return kernel.astype(np.float32)


def _move_and_blur(
    binned: NDArray[np.float32], blur_px: float, residual: Alignment, side: int
) -> NDArray[np.float32]:
    """Means of ``side`` pixels, moved, and blurred so that interpolation gives ``blur_px``; without NaN."""
    width = float(np.sqrt((blur_px / side) ** 2 - BINNING_VARIANCE))
    kernels = [_fit_taps(_moved_gaussian(part / side, width)) for part in (residual.x_px, residual.y_px)]
    finite = np.isfinite(binned)
    if finite.all():
        return filter_rows_and_columns(binned, *kernels)
    smooth = filter_rows_and_columns(np.where(finite, binned, np.float32(0.0)), *kernels)
    weight = filter_rows_and_columns(finite, *kernels)
    return np.asarray(smooth / np.maximum(weight, np.float32(1e-3)), np.float32)


def _measure_gains(
    frame: NDArray, bands: _ReferenceBands, illumination: Illumination
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gains of the three finer bands, the finest 0 if negligible, and scatter of the coarser two of them.

    Measured in the tiles with the most background, behind a blur of `BLUR_PX` as in the image of a contact.
    """
    shape, background = frame.shape, illumination.background
    tiles = _emptiest_tiles(background, shape)
    spacing = SAMPLE_SPACING_PX if len(tiles) == TILES else SAMPLE_SPACING_PX // 2
    mask = np.array([_sample_is_background(background, *tile, spacing, shape) for tile in tiles], np.bool_)
    if np.count_nonzero(mask) < FEWEST_SAMPLES:
        return np.ones(3), np.full(2, NO_DIRT)

    def sample(stack: NDArray[np.float32]) -> NDArray[np.float32]:
        inside = slice(BORDER_PX, -BORDER_PX, spacing)
        return np.asarray(stack.reshape(len(tiles), -1, stack.shape[1])[:, inside, inside][mask])

    full = np.concatenate([bands.full[tile] for tile in tiles])
    half = np.concatenate([_enlarge(bands.half, *tile, 2) for tile in tiles])
    quarter = np.concatenate([_enlarge(bands.quarter, *tile, 4) for tile in tiles])
    ratio = [
        illumination.ratio_at_rows(np.arange(rows.start, rows.stop), shape, columns)
        for rows, columns in tiles
    ]
    target = np.concatenate([frame[tile] for tile in tiles]) / np.concatenate(ratio)

    blur = [_fit_taps(_moved_gaussian(0.0, BLUR_PX))] * 2
    sharp, narrow, unblurred = (
        sample(filter_rows_and_columns(full, *bands.filters(width)))
        for width in (BLUR_PX, float(np.hypot(NARROW_PX, BLUR_PX)), NARROW_PX)
    )
    middle, wide = sample(filter_rows_and_columns(half, *blur)), sample(quarter)
    differences = np.stack([sharp - narrow, narrow - middle, middle - wide])
    detail = np.stack([unblurred - sample(half), sample(half) - wide])
    return _solve_gains(sample(filter_rows_and_columns(target, *blur)) - wide, differences, detail)


def _solve_gains(
    target: NDArray[np.float32], bands: NDArray[np.float32], detail: NDArray[np.float32]
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


def _emptiest_tiles(background: NDArray[np.bool_], shape: tuple[int, ...]) -> list[tuple[slice, slice]]:
    """Tiles with the most background, spread evenly, each with the border that the filters need."""
    blocks = tuple(max((size - 2 * BORDER_PX) // BLOCK, 0) for size in shape)
    high, wide = min(TILE_ROWS // BLOCK, blocks[0]), min(TILE_COLUMNS // BLOCK, blocks[1])
    if not high * wide:
        return []
    down, across = blocks[0] // high, blocks[1] // wide
    border, per_block = BORDER_PX // BLOCK, BLOCK // side_of(background.shape, shape)
    inner = background[
        border * per_block : (border + down * high) * per_block,
        border * per_block : (border + across * wide) * per_block,
    ]
    fraction = inner.reshape(down, high * per_block, across, wide * per_block).mean(axis=(1, 3)).ravel()
    spread = np.argsort(np.arange(len(fraction)) * GOLDEN_RATIO % 1.0)
    chosen = spread[np.argsort(-fraction[spread], kind="stable")[:TILES]]
    corners = zip(*np.divmod(chosen, across) * np.array([[high], [wide]]) * BLOCK, strict=True)
    return [
        (slice(top, top + high * BLOCK + 2 * BORDER_PX), slice(left, left + wide * BLOCK + 2 * BORDER_PX))
        for top, left in corners
    ]


def _sample_is_background(
    background: NDArray[np.bool_], rows: slice, columns: slice, spacing: int, shape: tuple[int, ...]
) -> NDArray[np.bool_]:
    """Whether the sampled pixels of a tile are background."""
    y, x = (np.arange(part.start + BORDER_PX, part.stop - BORDER_PX, spacing) for part in (rows, columns))
    return is_background(background, y, x, shape)


def _enlarge(binned: NDArray[np.float32], rows: slice, columns: slice, side: int) -> NDArray[np.float32]:
    """Part of a binned image, interpolated to the full resolution."""
    part = binned[rows.start // side : rows.stop // side, columns.start // side : columns.stop // side]
    return np.asarray(cv2.resize(part, (columns.stop - columns.start, rows.stop - rows.start)), np.float32)
