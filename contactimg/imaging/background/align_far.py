"""Search for the alignment of a frame that lies far from its reference, by cross-correlation.

At a quarter of the resolution, over the pixels of the frame that are as bright as the background: contacts
are left out, and that needs the slowly varying background alone, which is known before the texture is
registered.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from contactimg.imaging.background.alignment import UNKNOWN, Alignment
from contactimg.imaging.background.illumination import (
    SMALLEST_RATIO_FRACTION,
    Illumination,
    fit_illumination,
)
from contactimg.imaging.pixels.blocks import block_means
from contactimg.imaging.pixels.masks import Mask
from contactimg.imaging.pixels.robust import robust_std

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
