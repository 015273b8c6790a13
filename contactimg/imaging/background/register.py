"""Register a reference with its frame to a fraction of a pixel, from the background alone.

Near: Gauss-Newton on the difference of the two images. Both are smoothed by the same Gaussian, which makes
them band-limited: interpolation is then accurate, and its noise does not depend on the shift. Contacts are
left out, and residuals are clipped. The sums are kept for each tile of the image: a rotation or change of
scale shows in the way the shift varies from tile to tile.

Far: cross-correlation at a quarter of the resolution, over the pixels that are as bright as the background.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.imaging.background.alignment import (
    SMOOTHING_PX,
    UNKNOWN,
    Alignment,
    filter_rows_and_columns,
    shift_kernel,
)
from contactimg.imaging.background.illumination import Illumination
from contactimg.imaging.pixels.blocks import side_of, strips
from contactimg.imaging.pixels.frame_pair import ROUNDING_STD
from contactimg.imaging.pixels.masks import Flags, Mask, Values, mean_of_seen
from contactimg.imaging.pixels.robust import (
    CLIP_SIGMA,
    FEWEST_VALUES,
    LIGHT_SIGMA,
    SIGNIFICANT_SIGMA,
    median,
    quantile,
    robust_std,
)
from contactimg.imaging.profile.limits import ITERATIONS

# Pixels for each independent value after the smoothing. Theory: the noise-equivalent area of a Gaussian.
CORRELATED_PX = 4.0 * np.pi * SMOOTHING_PX**2
# Rows of a strip, and at most from one strip to the next; an image with fewer rows is used whole. Accuracy:
# the uncertainty decides whether strips are enough.
STRIP_ROWS, STRIP_SPACING = 32, 400
MARGIN_PX = 6  # pixels not used at the edges of a strip, of the image and of holes: the filters reach so far
# Side of the tiles of the image whose shifts show a rotation, or width of those of a strip. By hand.
TILE_PX = 256
# Step after which the next one does not matter, being ten times smaller; and least shift of the corners that
# counts as a rotation. Accuracy.
NEGLIGIBLE_PX = 0.02
# Fraction of the best from which on another is as good: if a second peak is as high the shift is
# undetermined, if the median correlation of the tiles is they agree all over the image. By hand.
AS_GOOD_FRACTION = 0.7
# Side of a binned pixel, in which all lengths named ``_BINS`` are; the Gauss-Newton iteration is not followed
# beyond one.
BIN_PX = 4
# Half the side of the window whose mean the detail is relative to, wider than texture and dirt; and how far
# the shift of a tile may lie from that of the whole image. By hand.
WINDOW_BINS = 10
# What stands out and is wider is a contact and left out, what is narrower may be dirt; and about the half
# width of what belongs to a peak. By hand.
CONTACT_BINS = 5
# Tiles that show a rotation, and grains of dirt that will do instead of texture: a similarity has as many
# numbers.
FEWEST_PLACES = 4
AGREEMENT_BINS = 0.5  # largest misfit of the shift of a tile to a common rotation. Accuracy: a bin


def align(
    frame: NDArray, reference: NDArray, illumination: Illumination, valid: Mask = None, *,
    all_rows: bool = False,
) -> Alignment:  # fmt: skip
    """Alignment of two images that lie a few pixels apart at most.

    Parameters
    ----------
    frame, reference : ndarray, shape (rows, columns)
        Grey levels, holes filled.
    illumination : Illumination
        Ratio frame/reference of the background, with the blocks where no contact stands.
    valid : Mask
        0 at holes of either.
    all_rows : bool
        From all rows instead of strips.

    Returns
    -------
    Alignment
        `UNKNOWN` if the images have nothing in common. Uncertainty 0.004-0.03 px for a 1600 x 1200 frame with
        2 % texture.
    """
    size = len(frame)
    whole = all_rows or size <= STRIP_SPACING
    height, number = (size, 1) if whole else (STRIP_ROWS, -(-size // STRIP_SPACING))
    rows, inside = strips(size, height, number, MARGIN_PX)
    # pixels of the background, far from holes and from the edges of their strip and of the image
    side = side_of(illumination.background.shape, frame.shape)
    free = illumination.background[rows // side] & inside[:, None]
    mask = free.astype(np.uint8).repeat(side, axis=1)[:, : frame.shape[1]].copy()
    mask[:, :MARGIN_PX] = mask[:, -MARGIN_PX:] = 0
    if valid is not None:
        around = np.ones((2 * MARGIN_PX + 1, 2 * MARGIN_PX + 1), np.uint8)
        mask &= np.asarray(cv2.erode(valid[rows], around), np.uint8)
    seen = _smooth(frame[rows] / illumination.ratio_at_rows(rows, frame.shape))
    found = _gauss_newton(seen, _smooth(reference[rows]), mask, rows, frame.shape)
    return found if found.std_px < 0.25 else UNKNOWN  # else there is no texture. By hand


def _smooth(image: NDArray) -> Values:
    single = np.asarray(image, np.float32)
    smooth = cv2.GaussianBlur(single, (7, 7), SMOOTHING_PX, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(smooth, np.float32)


def _gauss_newton(
    frame: Values, reference: Values, mask: NDArray, rows: NDArray[np.int64], shape: tuple[int, int]
) -> Alignment:
    """Gauss-Newton for a shift of a few pixels at most.

    The gradients of the frame are used as instrumental variables for those of the reference: the noise of the
    two images is independent, so the mean of their product has no noise term, which would shorten every step.
    """
    if np.count_nonzero(mask) < FEWEST_VALUES:
        return UNKNOWN
    x = y = 0.0
    tops = np.arange(0, len(rows), STRIP_ROWS)
    edges = np.linspace(0, shape[1], max(round(shape[1] / TILE_PX), 1) + 1).astype(np.int64)
    sums = np.zeros((len(tops), len(edges) - 1, 10))  # of `_sum_row`
    for _ in range(ITERATIONS):
        moved = reference
        if x or y:
            moved = filter_rows_and_columns(reference, shift_kernel(x), shift_kernel(y))
        residuals = (frame[3::7, 3::5] - moved[3::7, 3::5])[mask[3::7, 3::5] > 0]
        middle = median(residuals) if len(residuals) else 0.0
        clip = CLIP_SIGMA * robust_std(residuals, middle) if len(residuals) else 1.0
        limits = np.float32(middle), np.float32(max(clip, 1e-6))
        _tile_sums(frame, moved, mask, *limits, np.r_[tops, len(rows)], edges, sums)
        total = sums.sum(axis=(0, 1))
        cross, own = (float(np.linalg.eigvalsh(matrix)[0]) for matrix in _matrices(total))
        # the gradients of the two images must be correlated beyond chance, in every direction
        chance = SIGNIFICANT_SIGMA / np.sqrt(max(total[9], 1.0) / CORRELATED_PX)
        if total[9] < FEWEST_VALUES / 2 or not cross > chance * own > 0.0:
            return UNKNOWN
        step, stds = _solve(sums, np.eye(2))
        x, y = x + float(step[0]), y + float(step[1])
        if max(abs(x), abs(y)) > BIN_PX:
            return UNKNOWN
        if np.hypot(step[0], step[1]) < NEGLIGIBLE_PX:
            break
    middles = (rows[tops] + rows[np.r_[tops[1:], len(rows)] - 1]) / 2
    rotation, scale = _rotation_and_scale(sums, (edges[1:] + edges[:-1] - 1) / 2, middles, shape)
    return Alignment(x, y, float(stds.max()), rotation, scale, _consistent(sums))


def _matrices(sums: NDArray) -> list[NDArray]:
    """Products of the gradients of the two images, and of their mean with itself: matrices of two by two."""
    return [sums[..., np.array(k)].reshape(*sums.shape[:-1], 2, 2) for k in ([0, 1, 1, 2], [3, 4, 4, 5])]


def _solve(sums: NDArray, jacobian: NDArray) -> tuple[NDArray, NDArray]:
    """Numbers that move the tiles by ``jacobian`` times them, and their standard uncertainties."""
    transposed = np.swapaxes(jacobian, -1, -2)
    normal, own = ((transposed @ part @ jacobian).sum(axis=(0, 1)) for part in _matrices(sums))
    right = (transposed @ sums[..., 6:8, None]).sum(axis=(0, 1))[:, 0]
    chi_square, count = sums[..., 8:].sum(axis=(0, 1))
    inverse = np.linalg.pinv(normal, rcond=1e-6)  # what is not determined is 0
    variance = np.diag(inverse @ own @ inverse.T) * (chi_square / count) * CORRELATED_PX
    return inverse @ right, np.sqrt(np.maximum(variance, 0.0))


def _consistent(sums: NDArray) -> bool:
    """Whether the gradients of the two images agree in most tiles as well as they do in the best."""
    tiles = sums[sums[..., 9] > FEWEST_VALUES]
    own = tiles[:, 3] + tiles[:, 5]
    correlation = (tiles[:, 0] + tiles[:, 2])[own > 0] / own[own > 0]
    few = len(correlation) < FEWEST_PLACES
    return few or median(correlation) > AS_GOOD_FRACTION * quantile(correlation, 0.9)


def _rotation_and_scale(sums: NDArray, x: NDArray, y: NDArray, shape: tuple[int, int]) -> tuple[float, float]:
    """Rotation (rad) and scale from the shifts of the tiles; 0 and 1 if they are not significant."""
    centre = np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])
    corner = float(np.hypot(*centre))
    u, v = np.meshgrid((x - centre[0]) / corner, (y - centre[1]) / corner)
    one, none = np.ones_like(u), np.zeros_like(u)
    jacobian = np.stack([np.stack([one, none, -v, u], -1), np.stack([none, one, u, v], -1)], -2)
    numbers, stds = _solve(sums, jacobian)
    if not np.any(np.abs(numbers[2:]) > np.maximum(SIGNIFICANT_SIGMA * stds[2:], NEGLIGIBLE_PX)):
        return 0.0, 1.0
    return float(numbers[2]) / corner, 1.0 + float(numbers[3]) / corner


@njit(cache=True)
def _tile_sums(frame, reference, mask, middle, clip, tops, edges, sums):
    """Sums of every tile; residuals beyond clip are left out."""
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
    """Add the inside of a row of a tile; single precision within it, for vector instructions.

    The sums are products of the gradients of the two images (xx, xy, yy), of their mean with itself (xx, xy,
    yy) and with the residual (x, y), chi-square, number of pixels.
    """
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


def search_alignment(
    frame: NDArray, reference: NDArray, illumination: Illumination, valid: Mask, *, near: Alignment
) -> tuple[Alignment | None, bool]:
    """Search shifts of up to a quarter of the image and rotations of up to a degree.

    The images are as for `align`; ``near`` is the shift at the centre of the image, if known.

    Returns
    -------
    alignment, textured
        To about 1 px, with a rotation and scale if the tiles show one, None if no peak stands out or the
        reference has nothing that a shift would move; and whether it has more than a few grains of dirt.
    """
    size = (frame.shape[1] // BIN_PX, frame.shape[0] // BIN_PX)
    if min(size) < 2 * WINDOW_BINS:
        return None, False
    every = np.ones(frame.shape, np.bool_) if valid is None else valid > 0
    (binned, share), (before, _) = (
        mean_of_seen(
            lambda part: cv2.resize(part, size, interpolation=cv2.INTER_AREA),
            np.asarray(image, np.float32),
            every,
        )
        for image in (frame, reference)
    )
    usable = share > 0.5
    window = (2 * WINDOW_BINS + 1, 2 * WINDOW_BINS + 1)
    around, _ = mean_of_seen(lambda part: cv2.blur(part, window), before, usable)
    # near the border and holes the mean lies to one side of a place, and a slope of the light is no texture
    seen = cv2.blur(usable.astype(np.float32), window, borderType=cv2.BORDER_CONSTANT)
    # By hand, of what is seen of the widest window.
    usable &= seen > 0.75 * (quantile(seen[usable], 0.9) if usable.any() else 1.0)
    if np.count_nonzero(usable) < FEWEST_VALUES:
        return None, False
    around = np.where(usable, around, np.float32(1.0))
    detail = np.where(usable, before / around - 1.0, np.float32(0.0))
    detail[usable] -= median(detail[usable])  # light that falls off quadratically is above its mean around
    scatter = max(robust_std(detail[usable], centre=0.0), 1e-9)
    detail = np.clip(detail, -2 * CLIP_SIGMA * scatter, 2 * CLIP_SIGMA * scatter)
    grains, textured = _texture(detail, usable, scatter)
    if not (grains or textured):
        return None, False
    middle = [np.arange(count) * BIN_PX + BIN_PX // 2 for count in size]
    ratio = illumination.ratio_at_rows(middle[1], frame.shape, middle[0])
    excess = np.where(usable, binned / (ratio * around) - 1.0, np.float32(0.0))
    bright = (np.abs(excess) > CLIP_SIGMA * scatter).astype(np.uint8)
    square = np.ones((CONTACT_BINS, CONTACT_BINS), np.uint8)
    contacts = cv2.morphologyEx(bright, cv2.MORPH_OPEN, square, borderValue=1)
    excess = np.where(contacts, np.float32(0.0), np.clip(excess, -CLIP_SIGMA * scatter, CLIP_SIGMA * scatter))
    peak: complex | None = complex(near.x_px, near.y_px) / BIN_PX
    if not near.known:
        # Larger shifts, of the size of the image, are not searched.
        reach = [max(int(count * 0.25), 2) for count in excess.shape]
        peak = _find_peak(np.pad(detail, [(bins, bins) for bins in reach]), excess)
    if peak is None:
        return None, textured
    shift = Alignment(BIN_PX * peak.real, BIN_PX * peak.imag, BIN_PX * ROUNDING_STD)
    return _align_tiles(excess, detail, peak) or shift, textured


def _texture(detail: NDArray, usable: Flags, scatter: float) -> tuple[bool, bool]:
    """Whether neighbours correlate beyond chance: in a few grains of dirt, and all over the image."""
    far = CONTACT_BINS
    known = usable[:, :-far] & usable[:, 1 : 1 - far] & usable[:, far:]
    one, near, beyond = (part[known] for part in (detail[:, :-far], detail[:, 1 : 1 - far], detail[:, far:]))
    if not len(one):
        return False, False
    least = SIGNIFICANT_SIGMA * scatter
    grains = (np.abs(one) > least) & (one * near > (SIGNIFICANT_SIGMA / 2 * scatter) ** 2)
    product = one * (near - beyond)  # what far ones share as well is a slope of the light
    covariance = float(product.mean()) * np.sqrt(len(product)) / max(float(product.std()), 1e-30)
    return int(np.count_nonzero(grains)) >= FEWEST_PLACES, covariance > SIGNIFICANT_SIGMA


def _find_peak(window: Values, part: Values) -> complex | None:
    """Shift (x + iy, bins) of a part against the middle of a wider window; None if no peak stands out."""
    correlation = cv2.matchTemplate(window, part, cv2.TM_CCORR)
    _, height, _, (column, row) = cv2.minMaxLoc(correlation)
    others = correlation.copy()
    cv2.circle(others, (column, row), CONTACT_BINS, -np.inf, cv2.FILLED)
    unique, (rows, columns) = float(others.max()) < AS_GOOD_FRACTION * height, correlation.shape
    inside = 0 < row < rows - 1 and 0 < column < columns - 1
    if not (inside and unique and height > LIGHT_SIGMA * robust_std(correlation) > 0.0):
        return None
    # the part moves over the detail of the reference, so the shift has the opposite sign
    x = columns // 2 - column - _parabola_vertex(*correlation[row, column - 1 : column + 2].tolist())
    y = rows // 2 - row - _parabola_vertex(*correlation[row - 1 : row + 2, column].tolist())
    return complex(x, y)


def _align_tiles(excess: Values, detail: Values, shift: complex) -> Alignment | None:
    """Similarity through the shifts of tiles about a common one; None if there is no rotation or scale."""
    rows, columns = excess.shape
    high, wide = (size // max(size // (TILE_PX // BIN_PX), 1) for size in excess.shape)
    x, y = round(shift.real), round(shift.imag)
    border = WINDOW_BINS + max(abs(x), abs(y))
    padded, found = np.pad(detail, border), []
    for top in range(0, rows - high + 1, high):
        for left in range(0, columns - wide + 1, wide):
            first, start = top - y + border - WINDOW_BINS, left - x + border - WINDOW_BINS
            window = padded[first : first + high + 2 * WINDOW_BINS, start : start + wide + 2 * WINDOW_BINS]
            peak = _find_peak(window, excess[top : top + high, left : left + wide])
            if peak is not None:
                place = complex(left + (wide - columns) / 2, top + (high - rows) / 2)
                found.append((place, complex(x, y) + peak))
    positions, shifts = np.array(found, complex).reshape(-1, 2).T
    matrix, keep = np.stack([np.ones(len(found)), positions], axis=1), np.ones(len(found), np.bool_)
    for _ in range(3):
        if np.count_nonzero(keep) < FEWEST_PLACES:
            return None
        solution = np.linalg.lstsq(matrix[keep], shifts[keep], rcond=None)[0]
        keep = np.abs(shifts - matrix @ solution) < AGREEMENT_BINS
    if abs(solution[1]) * np.abs(positions).max() < AGREEMENT_BINS / 2:
        return None
    # position in the frame = factor x position in the reference + ..., and the shifts are given at positions
    # in the frame: shift = position - position/factor
    factor = complex(1.0 / (1.0 - solution[1]))
    moved = BIN_PX * complex(solution[0]) * factor
    return Alignment(moved.real, moved.imag, BIN_PX * ROUNDING_STD, float(np.angle(factor)), abs(factor))


def _parabola_vertex(left: float, middle: float, right: float) -> float:
    """Position of the maximum of a parabola through three values, the middle one the largest."""
    curvature = left - 2.0 * middle + right
    return 0.5 * (left - right) / curvature if curvature < 0 else 0.0
