"""Divide a frame by its reference without the reference's noise: a Wiener filter measured on the images.

What the reference shows of the surface (texture, dirt) is wanted, its noise is not. So it is split into bands
of scale, and each band is weighted by what least squares finds common to frame and reference. Where it shows
dirt it counts in full.
"""

from dataclasses import dataclass

import numpy as np
from cv2 import resize
from numpy.typing import NDArray

from contactimg.imaging.background.divide_rows import CLEAN, DUST_FROM, TAPS, divide_rows
from contactimg.imaging.background.illumination import Illumination
from contactimg.imaging.background.resample import Shift, filter_rows_and_columns, shift_kernel
from contactimg.imaging.pixels.blocks import BLOCK, block_means, is_background, side_of
from contactimg.imaging.pixels.robust import median

FLOOR = 0.1
"""Of the median level: where the reference is darker there is no light to measure by."""

NARROW, MIDDLE, WIDE = 0.7, 2.0, 6.0  # px, Gaussian widths that separate the bands
# variance (coarse px^2) that the mean over a coarse pixel and the interpolation between two add to a Gaussian
RESAMPLED = 1.0 / 12.0 + 1.0 / 6.0
SEEN = 1.0  # px: what is finer is lost in the blur of the contacts, and the weights need not suit it
TILES, HIGH, LONG = 4, 32, 256  # tiles that tell the weights, their rows and columns
REACH = 8  # rows and columns that the filters need around them: a block
EVERY = 4  # px: pixels as far apart behind a blur of `SEEN` are independent, those between tell little more
ENOUGH = 60  # pixels that tell the weights
NEGLIGIBLE = 0.1  # weight of the finest band not worth filtering for
GAINS = (-1.0, 3.0)  # a band makes up for what the overlap with its neighbours takes away
GOLDEN = 0.618  # whole numbers times this are spread evenly over the unit interval


def divide_by_reference(
    frame: NDArray,
    reference: NDArray,
    half: NDArray[np.float32],
    light: Illumination,
    *,
    shift: Shift,
    level: float,
) -> NDArray[np.float32]:
    """``level (F/(g R) - 1)`` of the frame F, the slow ratio g, and the reference R, moved and filtered.

    Parameters
    ----------
    frame, reference : ndarray, shape (rows, columns)
        Grey levels of any type.
    half : ndarray, shape (rows / 2, columns / 2)
        Means of the reference over 2 x 2 pixels, see `contactimg.imaging.pixels.blocks.block_means`; NaN in
        holes.
    light : Illumination
        Slow ratio frame/reference.
    shift : Shift
        Of the frame against the reference, less than a pixel.
    level : float
        Grey level of the background of the reference.
    """
    surface = _Surface.of(reference, half, shift)
    gains, scatters = _measure_gains(frame, surface, light)
    sharp, narrow = surface.filters(0.0), surface.filters(NARROW)
    numbers = np.array([*gains, *(1.0 / scatters), level, FLOOR * level], np.float32)
    out = np.empty(frame.shape, np.float32)
    divide_rows(
        out, np.ascontiguousarray(frame), surface.full, surface.half, surface.quarter,
        *light.row_polynomials((frame.shape[0], frame.shape[1])),
        np.stack([narrow] if gains[0] == 0.0 else [sharp, narrow]), sharp, numbers,
    )  # fmt: skip
    return out


@dataclass(frozen=True, eq=False)
class _Surface:
    """The reference: in full, and at half and quarter of the resolution, there moved and blurred."""

    full: NDArray
    half: NDArray[np.float32]
    quarter: NDArray[np.float32]
    shift: Shift

    @classmethod
    def of(cls, reference: NDArray, half: NDArray[np.float32], shift: Shift) -> "_Surface":
        seen = np.isfinite(half)
        quarter = block_means(half, None if seen.all() else seen.astype(np.uint8), side=2)
        return cls(
            np.ascontiguousarray(reference),
            _blur_coarse(half, MIDDLE, shift, 2),
            _blur_coarse(quarter, WIDE, shift, 4),
            shift,
        )

    def filters(self, scale: float) -> NDArray[np.float32]:
        """Filters along rows and columns that move the full one, and blur it by ``scale`` px if not 0."""
        parts = (self.shift.x_px, self.shift.y_px)
        return np.stack(
            [_fit_taps(_moved_gaussian(part, scale) if scale else shift_kernel(part)) for part in parts]
        )


def _moved_gaussian(fraction: float, scale: float) -> NDArray[np.float64]:
    """Filter that blurs by ``scale`` and moves by ``fraction`` px."""
    half = int(np.ceil(2.7 * scale)) + 1
    kernel = np.exp(-((np.arange(-half, half + 1) + fraction) ** 2) / (2 * scale**2))
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


def _blur_coarse(coarse: NDArray[np.float32], scale: float, shift: Shift, side: int) -> NDArray[np.float32]:
    """Means of ``side`` pixels, moved, and blurred to ``scale`` px between them; holes do not count."""
    width = float(np.sqrt((scale / side) ** 2 - RESAMPLED))
    kernels = [_fit_taps(_moved_gaussian(part / side, width)) for part in (shift.x_px, shift.y_px)]
    seen = np.isfinite(coarse)
    if seen.all():
        return filter_rows_and_columns(coarse, *kernels)
    smooth = filter_rows_and_columns(np.where(seen, coarse, np.float32(0.0)), *kernels)
    return np.asarray(
        smooth / np.maximum(filter_rows_and_columns(seen, *kernels), np.float32(1e-3)), np.float32
    )


def _measure_gains(
    frame: NDArray, surface: _Surface, light: Illumination
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Weights of the three finer bands, the finest 0 if negligible, and scatter of the coarser two of them.

    Measured in the emptiest tiles of the frame, as the contacts see them: behind a blur of `SEEN`.
    """
    shape = (frame.shape[0], frame.shape[1])
    tiles = _emptiest_tiles(light.background, shape)
    every = EVERY if len(tiles) == TILES else EVERY // 2
    mask = np.array([_background_inside(light.background, *tile, every, shape) for tile in tiles], np.bool_)
    if np.count_nonzero(mask) < ENOUGH:
        return np.ones(3), np.full(2, CLEAN)

    def inside(stack: NDArray[np.float32]) -> NDArray[np.float32]:
        parts = stack.reshape(len(tiles), -1, stack.shape[1])
        return np.asarray(parts[:, REACH:-REACH:every, REACH:-REACH:every][mask])

    full = np.concatenate([surface.full[tile] for tile in tiles])
    half = np.concatenate([_between(surface.half, *tile, 2) for tile in tiles])
    quarter = np.concatenate([_between(surface.quarter, *tile, 4) for tile in tiles])
    ratio = [light.ratio_rows(np.arange(rows.start, rows.stop), shape, columns) for rows, columns in tiles]
    target = np.concatenate([frame[tile] for tile in tiles]) / np.concatenate(ratio)

    still = [_fit_taps(_moved_gaussian(0.0, SEEN))] * 2
    sharp, narrow, visible = (
        inside(filter_rows_and_columns(full, *surface.filters(scale)))
        for scale in (SEEN, float(np.hypot(NARROW, SEEN)), NARROW)
    )
    middle, wide = inside(filter_rows_and_columns(half, *still)), inside(quarter)
    bands = np.stack([sharp - narrow, narrow - middle, middle - wide])
    detail = np.stack([visible - inside(half), inside(half) - wide])
    return _share_common(inside(filter_rows_and_columns(target, *still)) - wide, bands, detail)


def _share_common(
    rest: NDArray[np.float32], bands: NDArray[np.float32], detail: NDArray[np.float32]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Weights of the bands that come closest to the rest, and robust scatters of the detail; without dirt."""
    rest = rest - np.float32(median(rest))
    scatters = 1.4826 * np.array([median(np.abs(part)) for part in detail])
    usual = np.abs(rest) < 6 * 1.4826 * median(np.abs(rest))
    usual &= np.all(np.abs(detail) < DUST_FROM * scatters[:, None], axis=0)
    bands, rest = bands[:, usual], rest[usual]
    power, common = (bands @ bands.T).astype(float), (bands @ rest).astype(float)
    if not np.all(np.diag(power) > 1e-12 * len(rest)):
        return np.ones(3), np.full(2, CLEAN)
    gains = np.linalg.lstsq(power, common, rcond=1e-9)[0]
    if gains[0] < NEGLIGIBLE:
        gains = np.r_[0.0, np.linalg.lstsq(power[1:, 1:], common[1:], rcond=1e-9)[0]]
    return np.clip(gains, *GAINS), scatters.astype(float)


def _emptiest_tiles(background: NDArray[np.bool_], shape: tuple[int, int]) -> list[tuple[slice, slice]]:
    """Tiles with the most background, spread evenly, with the pixels around them that the filters need."""
    inside = tuple(max((size - 2 * REACH) // BLOCK, 0) for size in shape)
    high, long = min(HIGH // BLOCK, inside[0]), min(LONG // BLOCK, inside[1])
    if not high * long:
        return []
    down, across = inside[0] // high, inside[1] // long
    around, per = REACH // BLOCK, BLOCK // side_of(background.shape, shape)
    inner = background[
        around * per : (around + down * high) * per, around * per : (around + across * long) * per
    ]
    share = inner.reshape(down, high * per, across, long * per).mean(axis=(1, 3)).ravel()
    spread = np.argsort(np.arange(len(share)) * GOLDEN % 1.0)
    chosen = spread[np.argsort(-share[spread], kind="stable")[:TILES]]
    corners = zip(*np.divmod(chosen, across) * np.array([[high], [long]]) * BLOCK, strict=True)
    return [
        (slice(top, top + high * BLOCK + 2 * REACH), slice(left, left + long * BLOCK + 2 * REACH))
        for top, left in corners
    ]


def _background_inside(
    background: NDArray[np.bool_], rows: slice, columns: slice, every: int, shape: tuple[int, int]
) -> NDArray[np.bool_]:
    """Whether the pixels that are looked at inside a tile are background."""
    y, x = (np.arange(part.start + REACH, part.stop - REACH, every) for part in (rows, columns))
    return is_background(background, y, x, shape)


def _between(coarse: NDArray[np.float32], rows: slice, columns: slice, side: int) -> NDArray[np.float32]:
    """Part of the full resolution, from the coarse one."""
    part = coarse[rows.start // side : rows.stop // side, columns.start // side : columns.stop // side]
    return resize(part, (columns.stop - columns.start, rows.stop - rows.start))
