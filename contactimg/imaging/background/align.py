"""Sub-pixel shift, rotation and scale between a frame and its reference, from the background alone.

Gauss-Newton on the difference of the two images, both smoothed by the same Gaussian (which makes them
band-limited, so that interpolation is exact enough and its noise does not depend on the shift), over strips
of the image where no contact stands, with clipped residuals. The sums are kept for tiles of the strips: where
the tiles lie apart as a rotation or a change of scale would move them, that is found as well.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from contactimg.imaging.background.illumination import Illumination
from contactimg.imaging.background.resample import Shift, filter_rows_and_columns, shift_kernel
from contactimg.imaging.pixels.blocks import side_of
from contactimg.imaging.pixels.masks import Mask
from contactimg.imaging.pixels.robust import median
from contactimg.timings import stage

SMOOTHING = 1.0  # px
INDEPENDENT = 4.0 * np.pi * SMOOTHING**2  # pixels that share one independent value after the smoothing
STRIP, STRIP_EVERY, MARGIN = 32, 400, 6  # rows of a strip, distance of strips, rows lost at its rims
SMALL = 560  # rows of an image all of which take part
TILE = 256  # px: widest part of a strip that is looked at alone
LARGEST_STD = 0.25  # px: a background without texture determines no shift
GOOD_STD = 0.05
"""Uncertainty (px) up to which a shift found in strips holds: what it leaves of the texture is noise times
`INDEPENDENT` over the number of pixels, whatever the texture."""

LARGEST_REFINED = 4.0  # px
SIGNIFICANCE = 5.0  # standard deviations of a rotation or scale ...
LEAST_TURN = 0.03  # ... and px in the corners, below which there is none
UNEVEN = 0.6  # of the likeness of the best tiles
STEPS = 8
SETTLED = 0.02  # px: the next step is ten times smaller
FEWEST = 200  # pixels
WINDOW, STANDS_OUT = (
    31,
    5.0,
)  # px, robust standard deviations: what is dirt, against the mean of its surroundings


@dataclass(frozen=True)
class Found:
    """A shift and whether it holds for all of the image.

    Parameters
    ----------
    shift : Shift
        Unknown (infinite ``std_px``) if they have nothing in common.
    even : bool
        Whether the images are alike all over, not in the middle of a rotation alone.
    """

    shift: Shift
    even: bool


NOTHING = Found(Shift(0.0, 0.0, np.inf), even=True)


@stage("registration")
def estimate_shift(
    frame: NDArray,
    reference: NDArray,
    light: Illumination,
    valid: Mask = None,
) -> Found:
    """Shift of a few pixels at most between frame and reference, and their rotation and scale.

    Parameters
    ----------
    frame, reference : ndarray, shape (rows, columns)
        Grey levels, holes filled.
    light : Illumination
        Slow ratio frame/reference of the background, with the blocks where no contact stands.
    valid : ndarray of uint8 or None
        0 at holes of either.

    Returns
    -------
    Found
        Uncertainty 0.004-0.03 px for a 1600 x 1200 frame with 2 % texture.
    """
    found = _estimate(frame, reference, light, valid, _strip_rows(frame.shape[0]))
    return found if found.shift.std_px < LARGEST_STD else NOTHING


def estimate_shift_closely(
    frame: NDArray,
    reference: NDArray,
    light: Illumination,
    valid: Mask = None,
) -> Found:
    """`estimate_shift` from all rows; if that is not enough, from nothing but dirt where that tells more."""
    rows = np.arange(frame.shape[0])
    found = _estimate(frame, reference, light, valid, rows)
    if found.shift.std_px >= GOOD_STD:
        dirty = _estimate(frame, reference, light, valid, rows, dirt=True)
        found = min(found, dirty, key=lambda one: one.shift.std_px)
    return found if found.shift.std_px < LARGEST_STD else NOTHING


def _estimate(
    frame: NDArray,
    reference: NDArray,
    light: Illumination,
    valid: NDArray | None,
    rows: NDArray[np.int64],
    *,
    dirt: bool = False,
) -> Found:
    """`estimate_shift` from some rows, or from the dirt in them alone."""
    mask = _strip_mask(rows, light.background, frame.shape, valid)
    smooth, other = _smooth(frame[rows] / light.ratio_rows(rows, frame.shape)), _smooth(reference[rows])
    if dirt:
        mask &= _dirt(other, mask)
    if np.count_nonzero(mask) < FEWEST:
        return NOTHING
    return _refine(smooth, other, mask, rows, frame.shape)


def _dirt(smooth: NDArray[np.float32], mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """1 about pixels that stand out of the usual texture and noise of the reference."""
    detail = smooth - cv2.blur(smooth, (WINDOW, WINDOW))
    spread = 1.4826 * median(np.abs(detail[mask > 0])) if mask.any() else 0.0
    grains = (np.abs(detail) > STANDS_OUT * spread).astype(np.uint8) & mask
    return cv2.dilate(grains, np.ones((5, 5), np.uint8))


def _strip_rows(rows: int) -> NDArray[np.int64]:
    """Row numbers of the strips that take part; all rows of a small image."""
    if rows <= SMALL:
        return np.arange(rows)
    starts = np.arange((STRIP_EVERY - STRIP) // 2, rows - STRIP, STRIP_EVERY)
    return (starts[:, None] + np.arange(STRIP)).ravel()


def _strip_mask(
    rows: NDArray, background: NDArray, shape: tuple[int, int], valid: NDArray | None
) -> NDArray[np.uint8]:
    """1 where a strip pixel is background and far from holes and from the rims of its strip and the image."""
    row_ok = np.ones(len(rows), bool)
    breaks = np.flatnonzero(np.diff(rows) != 1)
    for edge in np.r_[-1, breaks, len(rows) - 1]:
        row_ok[max(edge + 1 - MARGIN, 0) : edge + 1 + MARGIN] = False
    side = side_of(background.shape, shape)
    usual = background[rows // side] & row_ok[:, None]
    mask = usual.astype(np.uint8).repeat(side, axis=1)[:, : shape[1]].copy()
    mask[:, :MARGIN] = mask[:, -MARGIN:] = 0
    if valid is not None:
        mask &= cv2.erode(valid[rows], np.ones((2 * MARGIN + 1, 2 * MARGIN + 1), np.uint8))
    return mask


def _smooth(image: NDArray) -> NDArray[np.float32]:
    single = np.asarray(image, np.float32)
    return cv2.GaussianBlur(single, (7, 7), SMOOTHING, borderType=cv2.BORDER_REPLICATE)


def _refine(
    frame: NDArray, reference: NDArray, mask: NDArray, rows: NDArray[np.int64], shape: tuple[int, int]
) -> Found:
    """Gauss-Newton for a shift of a few pixels at most.

    The gradients of the frame serve as instruments for those of the reference: the noise of the two images is
    independent, so their product is free of the noise power that would make every step too short.
    """
    x = y = 0.0
    tops = np.flatnonzero(np.r_[True, np.diff(rows) != 1])
    tops = np.unique(np.r_[tops, np.arange(0, len(rows), STRIP)]) if len(tops) == 1 else tops
    edges = np.linspace(0, shape[1], max(round(shape[1] / TILE), 1) + 1).astype(np.int64)
    sums = np.zeros((len(tops), len(edges) - 1, SUMS))
    for _ in range(STEPS):
        moved = filter_rows_and_columns(reference, shift_kernel(x), shift_kernel(y))
        residuals = (frame[3::7, 3::5] - moved[3::7, 3::5])[mask[3::7, 3::5] > 0]
        middle = median(residuals) if len(residuals) else 0.0
        clip = 4.0 * median(np.abs(residuals - np.float32(middle))) if len(residuals) else 1.0
        limits = np.float32(middle), np.float32(max(clip, 1e-6))
        _tile_sums(frame, moved, mask, *limits, np.r_[tops, len(rows)], edges, sums)
        cross, own, right, squares, count = _unpack(sums.sum(axis=(0, 1)))
        if not _in_common(cross, own, count):
            return NOTHING
        step = np.linalg.solve(cross, right)
        x, y = x + float(step[0]), y + float(step[1])
        if max(abs(x), abs(y)) > LARGEST_REFINED:
            return NOTHING
        if np.hypot(step[0], step[1]) < SETTLED:
            break
    inverse = np.linalg.inv(cross)
    covariance = inverse @ own @ inverse.T * (squares / count) * INDEPENDENT
    std = float(np.sqrt(max(covariance[0, 0], covariance[1, 1])))
    middles = (rows[tops] + rows[np.r_[tops[1:], len(rows)] - 1]) / 2
    turn = _turn(sums, (edges[1:] + edges[:-1] - 1) / 2, middles, shape)
    return Found(Shift(x, y, std, *turn), _even(sums))


def _in_common(cross: NDArray, own: NDArray, count: float) -> bool:
    """Whether the gradients of the two images are correlated beyond chance, in every direction."""
    if count < FEWEST / 2:
        return False
    smallest = float(np.linalg.eigvalsh((cross + cross.T) / 2)[0])
    return smallest > 5.0 / np.sqrt(count / INDEPENDENT) * float(np.linalg.eigvalsh(own)[0]) > 0.0


def _even(sums: NDArray) -> bool:
    """Whether the gradients of the two images agree in most tiles as well as they do in the best."""
    tiles = sums[sums[..., 9] > FEWEST]
    own = tiles[:, 3] + tiles[:, 5]
    likeness = (tiles[:, 0] + tiles[:, 2])[own > 0] / own[own > 0]
    return len(likeness) < 4 or bool(np.median(likeness) > UNEVEN * np.percentile(likeness, 90))


def _turn(sums: NDArray, x: NDArray, y: NDArray, shape: tuple[int, int]) -> tuple[float, float]:
    """Rotation (rad) and scale by which the tiles lie apart; 0 and 1 where they are not significant."""
    centre = np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])
    corner = float(np.hypot(*centre))
    u, v = np.meshgrid((x - centre[0]) / corner, (y - centre[1]) / corner)
    one, none = np.ones_like(u), np.zeros_like(u)
    jacobian = np.stack([np.stack([one, none, -v, u], -1), np.stack([none, one, u, v], -1)], -2)
    transposed = np.swapaxes(jacobian, -1, -2)
    tile_cross, tile_own = (
        sums[..., np.array(k)].reshape(*u.shape, 2, 2) for k in ([0, 1, 1, 2], [3, 4, 4, 5])
    )
    normal = (transposed @ tile_cross @ jacobian).sum(axis=(0, 1))
    own = (transposed @ tile_own @ jacobian).sum(axis=(0, 1))
    right = (transposed @ sums[..., 6:8, None]).sum(axis=(0, 1))[:, 0]
    squares, count = sums[..., 8:].sum(axis=(0, 1))
    if np.linalg.cond(normal) > 1e6:
        return 0.0, 1.0
    inverse = np.linalg.inv(normal)
    moves = inverse @ right
    std = np.sqrt(np.maximum(np.diag(inverse @ own @ inverse.T) * (squares / count) * INDEPENDENT, 0.0))
    if not np.any(np.abs(moves[2:]) > np.maximum(SIGNIFICANCE * std[2:], LEAST_TURN)):
        return 0.0, 1.0
    return float(moves[2]) / corner, 1.0 + float(moves[3]) / corner


SUMS = 10
"""Length of the packed sums of a tile: products of the gradients of the two images (xx, xy, yy), of their
mean with itself and with the residual, squares, count."""


def _unpack(sums: NDArray) -> tuple[NDArray, NDArray, NDArray, float, float]:
    """Matrices and right side from packed sums."""
    xx, xy, yy, ox, oxy, oy = sums[:6]
    cross, own = np.array([[xx, xy], [xy, yy]]), np.array([[ox, oxy], [oxy, oy]])
    return cross, own, sums[6:8], float(sums[8]), float(sums[9])


@njit(cache=True)
def _tile_sums(frame, reference, mask, middle, clip, tops, edges, sums):
    """Packed sums of every tile; residuals beyond clip are left out."""
    rows, columns = frame.shape
    sums[:] = 0.0
    for i in range(len(tops) - 1):
        for r in range(max(tops[i], 1), min(tops[i + 1], rows - 1)):
            for j in range(len(edges) - 1):
                # row first, then its part: that leaves vectors that are known to be contiguous
                part = slice(max(edges[j] - 1, 0), min(edges[j + 1] + 1, columns))
                _sum_row(
                    frame[r][part], frame[r - 1][part], frame[r + 1][part],
                    reference[r][part], reference[r - 1][part], reference[r + 1][part],
                    mask[r][part], middle, clip, sums[i, j],
                )  # fmt: skip


@njit(cache=True, fastmath=True, forceinline=True)
def _sum_row(frame, above, below, reference, over, under, mask, middle, clip, out):
    """Add the inside of a row of a tile; single precision within it, for vector instructions."""
    half, zero, one = np.float32(0.5), np.float32(0.0), np.float32(1.0)
    squares = count = xx = xy = yy = ox = oxy = oy = rx = ry = zero
    for c in range(1, len(frame) - 1):
        residual = frame[c] - reference[c] - middle
        used = one if (mask[c] != 0) & (abs(residual) <= clip) else zero
        gx = half * (reference[c - 1] - reference[c + 1])
        gy = half * (over[c] - under[c])
        hx = half * (frame[c - 1] - frame[c + 1])
        hy = half * (above[c] - below[c])
        # the mean of both gradients weighs the residual: no more noise than either, symmetric in the images
        wx, wy = half * used * (gx + hx), half * used * (gy + hy)
        xx += used * hx * gx
        xy += half * used * (hx * gy + gx * hy)
        yy += used * hy * gy
        ox += wx * wx
        oxy += wx * wy
        oy += wy * wy
        rx += wx * residual
        ry += wy * residual
        squares += used * residual * residual
        count += used
    out[0] += xx
    out[1] += xy
    out[2] += yy
    out[3] += ox
    out[4] += oxy
    out[5] += oy
    out[6] += rx
    out[7] += ry
    out[8] += squares
    out[9] += count
