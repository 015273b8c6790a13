"""Register a reference with its frame to a fraction of a pixel, from the background alone.

Near: Gauss-Newton on the difference of the two images. Both are smoothed by the same Gaussian, which makes
them band-limited: interpolation is then accurate, and its noise does not depend on the shift. Contacts are
left out, and residuals are clipped. The sums are kept for each tile of the image: a rotation or change of
scale shows in the way the shift varies from tile to tile.

Far: cross-correlation at a quarter of the resolution, over the pixels that are as bright as the background.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from contactimg.compiled import njit
from contactimg.imaging.background.alignment import UNKNOWN, Alignment, filter_rows_and_columns, shift_kernel
from contactimg.imaging.background.illumination import (
    SMALLEST_RATIO_FRACTION,
    Illumination,
    fit_illumination,
)
from contactimg.imaging.pixels.blocks import block_means, side_of
from contactimg.imaging.pixels.masks import Mask
from contactimg.imaging.pixels.robust import median, robust_std
from contactimg.timings import stage

# Constants without a stated origin were chosen by hand on rendered frames; their sensitivity is not measured.
SMOOTHING_PX = 1.0  # standard deviation of the Gaussian
CORRELATED_PX = 4.0 * np.pi * SMOOTHING_PX**2
"""Pixels for each independent value after the smoothing. Theory: the noise-equivalent area of a Gaussian."""

STRIP_ROWS, STRIP_SPACING = 32, 400  # rows of a strip, and from one strip to the next
MARGIN_PX = 6  # pixels not used at the edges of a strip, of the image and of holes: the filters reach so far
SMALL_ROWS = 560  # an image with fewer rows is used whole
TILE_PX = 256  # width of a tile
LARGEST_STD_PX = 0.25  # an alignment that is more uncertain is taken as unknown: there is no texture
GOOD_STD_PX = 0.05
"""Uncertainty up to which an alignment from strips is accepted: what it leaves of the texture is the noise
times `CORRELATED_PX` over the number of pixels, whatever the texture."""

LARGEST_SHIFT_PX = 4.0  # the Gauss-Newton iteration is not followed beyond
ROTATION_SIGMA = 5.0  # a rotation or scale must exceed so many standard deviations ...
SMALLEST_ROTATION_PX = 0.03  # ... and move the corners of the image by so much
CONSISTENT_FRACTION = 0.6  # the median correlation of the tiles must reach this fraction of that of the best
ITERATIONS = 8
CONVERGED_PX = 0.02  # the next step would be ten times smaller
CLIP_MAD = 4.0  # residuals beyond so many median absolute deviations are left out
CORRELATION_SIGMA = 5.0  # significance that the correlation of the two images must have
FEWEST_PIXELS = 200
DIRT_WINDOW_PX = 31  # dirt stands out of the mean over a square of this side ...
DIRT_SIGMA = 5.0  # ... by so many robust standard deviations


@stage("registration")
def align_strips(
    frame: NDArray, reference: NDArray, illumination: Illumination, valid: Mask = None
) -> Alignment:
    """Alignment of two images that lie a few pixels apart at most, from strips of the image.

    Parameters
    ----------
    frame, reference : ndarray, shape (rows, columns)
        Grey levels, holes filled.
    illumination : Illumination
        Ratio frame/reference of the background, with the blocks where no contact stands.
    valid : Mask
        0 at holes of either.

    Returns
    -------
    Alignment
        `UNKNOWN` if the images have nothing in common. Uncertainty 0.004-0.03 px for a 1600 x 1200 frame with
        2 % texture.
    """
    return _known_only(_align(frame, reference, illumination, valid, _strip_rows(frame.shape[0])))


def align_all_rows(
    frame: NDArray, reference: NDArray, illumination: Illumination, valid: Mask = None
) -> Alignment:
    """`align_strips` from all rows; if that is too uncertain, from dirt alone where that is better."""
    rows = np.arange(frame.shape[0])
    alignment = _align(frame, reference, illumination, valid, rows)
    if alignment.std_px >= GOOD_STD_PX:
        from_dirt = _align(frame, reference, illumination, valid, rows, dirt_only=True)
        alignment = min(alignment, from_dirt, key=lambda one: one.std_px)
    return _known_only(alignment)


def _known_only(alignment: Alignment) -> Alignment:
    """The alignment, or `UNKNOWN` if it is too uncertain."""
    return alignment if alignment.std_px < LARGEST_STD_PX else UNKNOWN


def _align(
    frame: NDArray,
    reference: NDArray,
    illumination: Illumination,
    valid: Mask,
    rows: NDArray[np.int64],
    *,
    dirt_only: bool = False,
) -> Alignment:
    """Alignment from some rows, or from the dirt in them alone."""
    mask = _background_mask(rows, illumination.background, frame.shape, valid)
    smooth_frame = _smooth(frame[rows] / illumination.ratio_at_rows(rows, frame.shape))
    smooth_reference = _smooth(reference[rows])
    if dirt_only:
        mask &= _find_dirt(smooth_reference, mask)
    if np.count_nonzero(mask) < FEWEST_PIXELS:
        return UNKNOWN
    return _gauss_newton(smooth_frame, smooth_reference, mask, rows, frame.shape)


def _find_dirt(smooth: NDArray[np.float32], mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """1 around pixels that stand out of the usual texture and noise of the reference."""
    detail = smooth - cv2.blur(smooth, (DIRT_WINDOW_PX, DIRT_WINDOW_PX))
    scatter = robust_std(detail[mask > 0], centre=0.0) if mask.any() else 0.0
    grains = (np.abs(detail) > DIRT_SIGMA * scatter).astype(np.uint8) & mask
    return np.asarray(cv2.dilate(grains, np.ones((5, 5), np.uint8)), np.uint8)


def _strip_rows(rows: int) -> NDArray[np.int64]:
    """Row numbers of the strips; all rows of a small image."""
    if rows <= SMALL_ROWS:
        return np.arange(rows)
    starts = np.arange((STRIP_SPACING - STRIP_ROWS) // 2, rows - STRIP_ROWS, STRIP_SPACING)
    return (starts[:, None] + np.arange(STRIP_ROWS)).ravel()


def _background_mask(
    rows: NDArray, background: NDArray, shape: tuple[int, int], valid: NDArray | None
) -> NDArray[np.uint8]:
    """1 where a pixel is background and far from holes and from the edges of its strip and of the image."""
    inside = np.ones(len(rows), bool)
    breaks = np.flatnonzero(np.diff(rows) != 1)
    for edge in np.r_[-1, breaks, len(rows) - 1]:
        inside[max(edge + 1 - MARGIN_PX, 0) : edge + 1 + MARGIN_PX] = False
    side = side_of(background.shape, shape)
    free = background[rows // side] & inside[:, None]
    mask = free.astype(np.uint8).repeat(side, axis=1)[:, : shape[1]].copy()
    mask[:, :MARGIN_PX] = mask[:, -MARGIN_PX:] = 0
    if valid is not None:
        mask &= cv2.erode(valid[rows], np.ones((2 * MARGIN_PX + 1, 2 * MARGIN_PX + 1), np.uint8))
    return mask


def _smooth(image: NDArray) -> NDArray[np.float32]:
    single = np.asarray(image, np.float32)
    smooth = cv2.GaussianBlur(single, (7, 7), SMOOTHING_PX, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(smooth, np.float32)


def _gauss_newton(
    frame: NDArray, reference: NDArray, mask: NDArray, rows: NDArray[np.int64], shape: tuple[int, int]
) -> Alignment:
    """Gauss-Newton for a shift of a few pixels at most.

    The gradients of the frame are used as instrumental variables for those of the reference: the noise of the
    two images is independent, so the mean of their product has no noise term, which would shorten every step.
    """
    x = y = 0.0
    tops = np.flatnonzero(np.r_[True, np.diff(rows) != 1])
    tops = np.unique(np.r_[tops, np.arange(0, len(rows), STRIP_ROWS)]) if len(tops) == 1 else tops
    edges = np.linspace(0, shape[1], max(round(shape[1] / TILE_PX), 1) + 1).astype(np.int64)
    sums = np.zeros((len(tops), len(edges) - 1, SUMS))
    for _ in range(ITERATIONS):
        moved = reference
        if x or y:
            moved = filter_rows_and_columns(reference, shift_kernel(x), shift_kernel(y))
        residuals = (frame[3::7, 3::5] - moved[3::7, 3::5])[mask[3::7, 3::5] > 0]
        middle = median(residuals) if len(residuals) else 0.0
        clip = CLIP_MAD * median(np.abs(residuals - np.float32(middle))) if len(residuals) else 1.0
        limits = np.float32(middle), np.float32(max(clip, 1e-6))
        _tile_sums(frame, moved, mask, *limits, np.r_[tops, len(rows)], edges, sums)
        cross, own, right, chi_square, count = _unpack(sums.sum(axis=(0, 1)))
        if not _correlated(cross, own, count):
            return UNKNOWN
        step = np.linalg.solve(cross, right)
        x, y = x + float(step[0]), y + float(step[1])
        if max(abs(x), abs(y)) > LARGEST_SHIFT_PX:
            return UNKNOWN
        if np.hypot(step[0], step[1]) < CONVERGED_PX:
            break
    inverse = np.linalg.inv(cross)
    covariance = inverse @ own @ inverse.T * (chi_square / count) * CORRELATED_PX
    std = float(np.sqrt(max(covariance[0, 0], covariance[1, 1])))
    middles = (rows[tops] + rows[np.r_[tops[1:], len(rows)] - 1]) / 2
    rotation, scale = _rotation_and_scale(sums, (edges[1:] + edges[:-1] - 1) / 2, middles, shape)
    return Alignment(x, y, std, rotation, scale, _consistent(sums))


def _correlated(cross: NDArray, own: NDArray, count: float) -> bool:
    """Whether the gradients of the two images are correlated beyond chance, in every direction."""
    if count < FEWEST_PIXELS / 2:
        return False
    smallest = float(np.linalg.eigvalsh((cross + cross.T) / 2)[0])
    noise = CORRELATION_SIGMA / np.sqrt(count / CORRELATED_PX) * float(np.linalg.eigvalsh(own)[0])
    return smallest > noise > 0.0


def _consistent(sums: NDArray) -> bool:
    """Whether the gradients of the two images agree in most tiles as well as they do in the best."""
    tiles = sums[sums[..., 9] > FEWEST_PIXELS]
    own = tiles[:, 3] + tiles[:, 5]
    correlation = (tiles[:, 0] + tiles[:, 2])[own > 0] / own[own > 0]
    best = np.percentile(correlation, 90) if len(correlation) else 0.0
    return len(correlation) < 4 or bool(np.median(correlation) > CONSISTENT_FRACTION * best)


def _rotation_and_scale(sums: NDArray, x: NDArray, y: NDArray, shape: tuple[int, int]) -> tuple[float, float]:
    """Rotation (rad) and scale from the shifts of the tiles; 0 and 1 if they are not significant."""
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
    chi_square, count = sums[..., 8:].sum(axis=(0, 1))
    if np.linalg.cond(normal) > 1e6:
        return 0.0, 1.0
    inverse = np.linalg.inv(normal)
    solution = inverse @ right
    std = np.sqrt(np.maximum(np.diag(inverse @ own @ inverse.T) * (chi_square / count) * CORRELATED_PX, 0.0))
    if not np.any(np.abs(solution[2:]) > np.maximum(ROTATION_SIGMA * std[2:], SMALLEST_ROTATION_PX)):
        return 0.0, 1.0
    return float(solution[2]) / corner, 1.0 + float(solution[3]) / corner


SUMS = 10
"""Length of the packed sums of a tile: products of the gradients of the two images (xx, xy, yy), of their
mean with itself (xx, xy, yy) and with the residual (x, y), chi-square, number of pixels."""


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


# Constants without a stated origin were chosen by hand on rendered frames; their sensitivity is not measured.
BIN_PX = 4
"""Side of a binned pixel, in which all lengths named ``_BINS`` are."""

LARGEST_SHIFT_FRACTION = 4  # shifts up to the size of the image divided by this are searched
DETAIL_WINDOW_BINS = 21  # side of the window whose mean is subtracted from the reference
CLIP_SIGMA = 4.0  # robust standard deviations of the reference's detail at which the detail is clipped
CONTACT_BINS = 5  # what stands out and is wider is a contact and left out; what is narrower may be dirt
PEAK_SIGMA = 7.0
"""Height of a peak in robust standard deviations of the correlation map.
Of 10^4 normal deviates none exceeds 5."""

SECOND_PEAK_FRACTION = 0.75  # of the peak: a second peak as high leaves the shift undetermined
PEAK_BINS = 4  # half width of what belongs to a peak
SMALLEST_BINS = 16  # side of the smallest image that is searched; so many squared usable pixels are needed
TILE_BINS = 64  # side of the tiles whose shifts show a rotation
TILE_SHIFT_BINS = 10  # how far the shift of a tile may lie from that of the whole image
FEWEST_TILES = 4
AGREEMENT_BINS = 0.5  # largest misfit of the shift of a tile to a common rotation
TEXTURE_SIGMA = 5.0  # significance of the covariance of neighbours: there is texture, not noise alone
GRAIN_SIGMA, FEWEST_GRAINS = 5.0, 4  # height of a grain of dirt; so many will do instead of texture


@dataclass(frozen=True)
class FarSearch:
    """Result of the search.

    Parameters
    ----------
    alignment : Alignment or None
        To about 1 px, with a rotation and scale if the tiles show one; None if no peak stands out.
    textured : bool
        Whether the reference has any texture or dirt that a shift would move.
    textured_everywhere : bool
        Whether it has more than a few grains of dirt.
    """

    alignment: Alignment | None
    textured: bool
    textured_everywhere: bool = False


def search_alignment(
    frame: NDArray,
    reference: NDArray,
    illumination: Illumination,
    valid: Mask,
    *,
    near: Alignment = UNKNOWN,
) -> FarSearch:
    """Search shifts of up to a quarter of the image and rotations of up to a degree.

    Parameters
    ----------
    frame, reference : ndarray, shape (rows, columns)
        Grey levels.
    illumination : Illumination
        Ratio frame/reference of the background.
    valid : Mask
        0 at holes of either.
    near : Alignment
        Shift at the centre of the image, if known.
    """
    details = _relative_details(frame, reference, illumination, valid)
    if details is None:
        return FarSearch(None, textured=False)
    everywhere = _neighbour_covariance(details[1], np.ones(details[1].shape, np.bool_)) > TEXTURE_SIGMA
    peak = (near.x_px / BIN_PX, near.y_px / BIN_PX) if near.known else _correlation_peak(*details)
    if peak is None:
        return FarSearch(None, textured=True, textured_everywhere=everywhere)
    alignment = _align_tiles(*details, round(peak[0]), round(peak[1]))
    alignment = alignment or Alignment(BIN_PX * peak[0], BIN_PX * peak[1], np.inf)
    return FarSearch(alignment, textured=True, textured_everywhere=everywhere)


def _relative_details(
    frame: NDArray, reference: NDArray, illumination: Illumination, valid: Mask
) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
    """Relative detail of the frame's background and of the reference, binned; None if the latter has none."""
    size = (frame.shape[1] // BIN_PX, frame.shape[0] // BIN_PX)
    if min(size) < SMALLEST_BINS:
        return None
    binned_frame, binned_reference = (
        cv2.resize(np.asarray(image, np.float32), size, interpolation=cv2.INTER_AREA)
        for image in (frame, reference)
    )
    usable = np.ones(size[::-1], np.bool_)
    if valid is not None:
        holes = cv2.resize(1 - valid, size, interpolation=cv2.INTER_AREA)
        usable = cv2.dilate(holes, np.ones((3, 3), np.uint8)) == 0
    smooth = _smooth_reference(reference, valid, size)
    usable &= smooth > SMALLEST_RATIO_FRACTION * float(np.abs(smooth).max())
    if np.count_nonzero(usable) < SMALLEST_BINS**2:
        return None
    smooth = np.where(usable, smooth, np.float32(1.0))
    relative = np.where(usable, binned_reference / smooth - 1.0, 0.0).astype(np.float32)
    detail = _subtract_local_mean(relative, usable)
    scatter = max(robust_std(detail[usable], centre=0.0), 1e-9)
    detail = np.clip(detail, -2 * CLIP_SIGMA * scatter, 2 * CLIP_SIGMA * scatter)
    if not _is_textured(detail, usable, scatter):
        return None
    ratio = illumination.ratio_at_rows(_bin_centres(size[1]), frame.shape, _bin_centres(size[0]))
    excess = np.where(usable, binned_frame / (ratio * smooth) - 1.0, 0.0)
    bright = (np.abs(excess) > CLIP_SIGMA * scatter).astype(np.uint8)
    square = np.ones((CONTACT_BINS, CONTACT_BINS), np.uint8)
    contacts = cv2.morphologyEx(bright, cv2.MORPH_OPEN, square, borderValue=1)
    excess = np.clip(excess, -CLIP_SIGMA * scatter, CLIP_SIGMA * scatter)
    excess = np.where(usable & (contacts == 0), excess, 0.0)
    return excess.astype(np.float32), detail.astype(np.float32)


def _bin_centres(count: int) -> NDArray[np.int64]:
    """Pixel in the middle of each bin."""
    return np.arange(count) * BIN_PX + BIN_PX // 2


def _smooth_reference(reference: NDArray, valid: Mask, size: tuple[int, int]) -> NDArray[np.float32]:
    """Polynomial through the reference, at each binned pixel."""
    blocks = block_means(reference, valid)
    finite = blocks[np.isfinite(blocks)]
    if not finite.size:
        return np.zeros(size[::-1], np.float32)
    level = float(np.median(finite))
    scatter = 2.0 * robust_std(finite, centre=level)
    illumination = fit_illumination(blocks, reference.shape, level=level, scatter=scatter)
    return illumination.at_rows(_bin_centres(size[1]), reference.shape, _bin_centres(size[0]))


def _subtract_local_mean(image: NDArray[np.float32], usable: NDArray[np.bool_]) -> NDArray[np.float32]:
    """The image, 0 at holes, minus the mean of the window around each pixel."""
    window = (DETAIL_WINDOW_BINS, DETAIL_WINDOW_BINS)
    weight = cv2.blur(usable.astype(np.float32), window)
    mean = cv2.blur(image, window) / np.maximum(weight, np.float32(1e-3))
    return np.where(usable, image - mean, np.float32(0.0))


def _correlation_peak(excess: NDArray, detail: NDArray) -> tuple[float, float] | None:
    """Shift (x, y in bins) at which the whole images correlate best, if one peak stands out."""
    reach = [max(n // LARGEST_SHIFT_FRACTION, 2) for n in excess.shape]
    padded = [fft.next_fast_len(n + r, real=True) for n, r in zip(excess.shape, reach, strict=True)]
    spectra = [fft.rfft2(image, padded) for image in (excess, detail)]
    correlation = fft.irfft2(spectra[0] * np.conj(spectra[1]), padded)
    return _find_peak(np.roll(correlation, reach, axis=(0, 1))[: 2 * reach[0] + 1, : 2 * reach[1] + 1])


def _find_peak(correlation: NDArray) -> tuple[float, float] | None:
    """Position (x, y) of the peak of a correlation map from its centre; None if none stands out."""
    row, column = np.unravel_index(int(np.argmax(correlation)), correlation.shape)
    height = float(correlation[row, column])
    scatter = robust_std(correlation)
    others = correlation.copy()
    others[
        max(row - PEAK_BINS, 0) : row + PEAK_BINS + 1, max(column - PEAK_BINS, 0) : column + PEAK_BINS + 1
    ] = -np.inf
    unique = float(others.max()) < SECOND_PEAK_FRACTION * height
    inside = 0 < row < correlation.shape[0] - 1 and 0 < column < correlation.shape[1] - 1
    if not (inside and unique and height > PEAK_SIGMA * scatter > 0.0):
        return None
    y = row - correlation.shape[0] // 2 + _parabola_vertex(*correlation[row - 1 : row + 2, column])
    x = column - correlation.shape[1] // 2 + _parabola_vertex(*correlation[row, column - 1 : column + 2])
    return float(x), float(y)


def _align_tiles(excess: NDArray, detail: NDArray, x: int, y: int) -> Alignment | None:
    """Similarity through the shifts of tiles about a common one; None if there is no rotation or scale."""
    rows, columns = excess.shape
    high, wide = (n // max(n // TILE_BINS, 1) for n in excess.shape)
    border = TILE_SHIFT_BINS + max(abs(x), abs(y))
    padded = cv2.copyMakeBorder(detail, border, border, border, border, cv2.BORDER_CONSTANT, value=0.0)
    positions, shifts = [], []
    for top in range(0, rows - high + 1, high):
        for left in range(0, columns - wide + 1, wide):
            start = (top - y + border - TILE_SHIFT_BINS, left - x + border - TILE_SHIFT_BINS)
            window = padded[
                start[0] : start[0] + high + 2 * TILE_SHIFT_BINS,
                start[1] : start[1] + wide + 2 * TILE_SHIFT_BINS,
            ]
            tile = excess[top : top + high, left : left + wide]
            peak = _find_peak(cv2.matchTemplate(window, tile, cv2.TM_CCORR))
            if peak is not None:  # the tile moves over the reference, so the shift has the opposite sign
                positions.append(complex(left + (wide - columns) / 2, top + (high - rows) / 2))
                shifts.append(complex(x - peak[0], y - peak[1]))
    return _fit_similarity(np.array(positions), np.array(shifts))


def _fit_similarity(positions: NDArray[np.complex128], shifts: NDArray[np.complex128]) -> Alignment | None:
    """Shift, rotation and scale (in bins) through the shifts of most tiles; None if there is no rotation."""
    keep = np.ones(len(positions), np.bool_)
    for _ in range(3):
        if np.count_nonzero(keep) < FEWEST_TILES:
            return None
        matrix = np.stack([np.ones(len(positions)), positions], axis=1)
        (shift, slope), *_ = np.linalg.lstsq(matrix[keep], shifts[keep], rcond=None)
        keep = np.abs(shifts - matrix @ np.array([shift, slope])) < AGREEMENT_BINS
    corner_shift = abs(slope) * np.abs(positions).max()
    if np.count_nonzero(keep) < 0.5 * len(positions) or corner_shift < AGREEMENT_BINS / 2:
        return None
    # position in the frame = factor x position in the reference + ..., and the shifts are given at positions
    # in the frame: shift = position - position/factor
    factor = 1.0 / (1.0 - slope)
    moved = BIN_PX * shift * factor
    return Alignment(
        float(moved.real), float(moved.imag), np.inf, float(np.angle(factor)), float(abs(factor))
    )


def _parabola_vertex(left: float, middle: float, right: float) -> float:
    """Position of the maximum of a parabola through three values, the middle one the largest."""
    curvature = left - 2.0 * middle + right
    return 0.5 * (left - right) / curvature if curvature < 0 else 0.0


def _is_textured(detail: NDArray, usable: NDArray[np.bool_], scatter: float) -> bool:
    """Whether neighbours correlate beyond chance: everywhere, or in a few grains of dirt."""
    both = usable[:, 1:] & usable[:, :-1]
    one, other = detail[:, 1:][both], detail[:, :-1][both]
    if len(one) < SMALLEST_BINS**2:
        return False
    grains = (np.abs(one) > GRAIN_SIGMA * scatter) & (one * other > (GRAIN_SIGMA / 2 * scatter) ** 2)
    enough = np.count_nonzero(grains) >= FEWEST_GRAINS
    return bool(enough or _neighbour_covariance(detail, usable) > TEXTURE_SIGMA)


def _neighbour_covariance(detail: NDArray, usable: NDArray[np.bool_]) -> float:
    """Covariance of neighbours in its standard deviations."""
    product = (detail[:, 1:] * detail[:, :-1])[usable[:, 1:] & usable[:, :-1]]
    return float(product.mean()) * np.sqrt(len(product)) / max(float(product.std()), 1e-30)
