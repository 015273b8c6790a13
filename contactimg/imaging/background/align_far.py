"""Coarse search for the shift of a frame: correlation of its background with that of the reference.

At a quarter of the resolution, over the pixels of the frame that are as bright as the background: contacts do
not take part, and where the slow background alone is known it does not matter that the texture is not
registered yet.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from contactimg.imaging.background.illumination import LEAST_RATIO, Illumination, fit_illumination
from contactimg.imaging.background.resample import Shift
from contactimg.imaging.pixels.blocks import block_means
from contactimg.imaging.pixels.masks import Mask

COARSE = 4  # px
REACH = 4  # shifts up to the size of the image divided by this
WIDEST = 10  # coarse pixels: half width of the window whose mean is taken off the reference's detail
CLIP = 4.0  # robust standard deviations of the reference's detail beyond which a pixel counts no more
WIDE = 5  # coarse pixels: what differs over more is a contact and left out, less may be dirt
SIGNIFICANT = 7.0  # robust standard deviations of the correlation: of 10^4 normal ones none exceeds 5
UNIQUE = 0.75  # of the peak: a second one as high leaves the shift open
SMALLEST = 16  # coarse pixels
ALONE = 4  # coarse pixels about a peak that belong to it
TILE, TILE_REACH = (
    64,
    10,
)  # coarse pixels: parts of the image that are looked at alone, how far they may lie apart
FEWEST_TILES = 4
AGREE = 0.5  # coarse pixels by which the tiles may miss a common rotation
SHARED = 5.0  # standard deviations of the covariance of neighbours
GRAIN, GRAINS = 5.0, 4  # robust standard deviations of a grain of dirt, coarse pixels that are enough


@dataclass(frozen=True)
class Search:
    """What the search says.

    Parameters
    ----------
    shift : Shift
        To about 1 px; with a rotation and scale if the parts of the image lie apart by more than that.
    found : bool
        Whether one peak of the correlation stands out.
    textured : bool
        Whether the reference has anything to show that a shift would move.
    rich : bool
        Whether it has so all over, not only in a few grains of dirt.
    """

    shift: Shift
    found: bool
    textured: bool
    rich: bool = False


NOWHERE = Shift(0.0, 0.0, np.inf)


def search_shift(
    frame: NDArray,
    reference: NDArray,
    light: Illumination,
    valid: Mask,
    *,
    near: Shift = NOWHERE,
) -> Search:
    """Shift of up to a quarter of the image, and rotation of up to a degree.

    Parameters
    ----------
    frame, reference : ndarray, shape (rows, columns)
        Grey levels.
    light : Illumination
        Slow ratio frame/reference of the background.
    valid : ndarray of uint8 or None
        0 at holes of either.
    near : Shift
        Where the middle of the image lies, if known.
    """
    details = _details(frame, reference, light, valid)
    if details is None:
        return Search(NOWHERE, found=False, textured=False)
    rich = _shared(details[1], np.ones(details[1].shape, np.bool_)) > SHARED
    peak = (near.x_px / COARSE, near.y_px / COARSE) if near.known else _highest(*details)
    if peak is None:
        return Search(NOWHERE, found=False, textured=True, rich=rich)
    turned = _turned(*details, round(peak[0]), round(peak[1]))
    shift = turned or Shift(COARSE * peak[0], COARSE * peak[1], np.inf)
    return Search(shift, found=True, textured=True, rich=rich)


def _details(
    frame: NDArray, reference: NDArray, light: Illumination, valid: NDArray | None
) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
    """Relative detail of the frame's background and of the reference, coarse; None if the latter has none."""
    size = (frame.shape[1] // COARSE, frame.shape[0] // COARSE)
    if min(size) < SMALLEST:
        return None
    small, other = (
        cv2.resize(np.asarray(image, np.float32), size, interpolation=cv2.INTER_AREA)
        for image in (frame, reference)
    )
    good = np.ones(size[::-1], np.bool_)
    if valid is not None:
        holes = cv2.resize(1 - valid, size, interpolation=cv2.INTER_AREA)
        good = cv2.dilate(holes, np.ones((3, 3), np.uint8)) == 0
    slow = _slow(reference, valid, size)
    good &= slow > LEAST_RATIO * float(np.abs(slow).max())
    if np.count_nonzero(good) < SMALLEST**2:
        return None
    slow = np.where(good, slow, np.float32(1.0))
    detail = _without_mean(np.where(good, other / slow - 1.0, 0.0).astype(np.float32), good)
    spread = max(1.4826 * float(np.median(np.abs(detail[good]))), 1e-9)
    detail = np.clip(detail, -2 * CLIP * spread, 2 * CLIP * spread)
    if not _textured(detail, good, spread):
        return None
    rows = np.minimum(np.arange(size[1]) * COARSE + COARSE // 2, frame.shape[0] - 1)
    ratio = light.ratio_rows(rows, (frame.shape[0], frame.shape[1]))[:, COARSE // 2 :: COARSE][:, : size[0]]
    seen = np.where(good, small / (ratio * slow) - 1.0, 0.0)
    far = (np.abs(seen) > CLIP * spread).astype(np.uint8)
    contacts = cv2.morphologyEx(far, cv2.MORPH_OPEN, np.ones((WIDE, WIDE), np.uint8), borderValue=1)
    seen = np.where(good & (contacts == 0), np.clip(seen, -CLIP * spread, CLIP * spread), 0.0)
    return seen.astype(np.float32), detail.astype(np.float32)


def _slow(reference: NDArray, valid: NDArray | None, size: tuple[int, int]) -> NDArray[np.float32]:
    """Light of the reference at each coarse pixel: a polynomial."""
    blocks = block_means(reference, valid)
    if not np.isfinite(blocks).any():
        return np.zeros(size[::-1], np.float32)
    level = float(np.nanmedian(blocks))
    spread = 1.4826 * float(np.nanmedian(np.abs(blocks - level)))
    light = fit_illumination(
        blocks, (reference.shape[0], reference.shape[1]), start=level, spread=2.0 * spread
    )
    rows = np.arange(size[1]) * COARSE + COARSE // 2
    return light.rows(rows, (reference.shape[0], reference.shape[1]))[:, COARSE // 2 :: COARSE][:, : size[0]]


def _without_mean(image: NDArray[np.float32], good: NDArray[np.bool_]) -> NDArray[np.float32]:
    """The image, 0 at holes, minus the mean of the window about each pixel."""
    window = (2 * WIDEST + 1, 2 * WIDEST + 1)
    weight = cv2.blur(good.astype(np.float32), window)
    mean = cv2.blur(image, window) / np.maximum(weight, np.float32(1e-3))
    return np.where(good, image - mean, np.float32(0.0))


def _highest(seen: NDArray, detail: NDArray) -> tuple[float, float] | None:
    """Where the correlation of the whole images is highest (coarse x, y), if one peak stands out."""
    reach = [max(n // REACH, 2) for n in seen.shape]
    padded = [fft.next_fast_len(n + r, real=True) for n, r in zip(seen.shape, reach, strict=True)]
    spectra = [fft.rfft2(image, padded) for image in (seen, detail)]
    whole = fft.irfft2(spectra[0] * np.conj(spectra[1]), padded)
    return _peak(np.roll(whole, reach, axis=(0, 1))[: 2 * reach[0] + 1, : 2 * reach[1] + 1])


def _peak(near: NDArray) -> tuple[float, float] | None:
    """Place (x, y) of the peak of a correlation map from its middle; None if none stands out."""
    row, column = np.unravel_index(int(np.argmax(near)), near.shape)
    height = float(near[row, column])
    scatter = 1.4826 * float(np.median(np.abs(near - np.median(near))))
    others = near.copy()
    others[max(row - ALONE, 0) : row + ALONE + 1, max(column - ALONE, 0) : column + ALONE + 1] = -np.inf
    alone = float(others.max()) < UNIQUE * height
    inside = 0 < row < near.shape[0] - 1 and 0 < column < near.shape[1] - 1
    if not (inside and alone and height > SIGNIFICANT * scatter > 0.0):
        return None
    y = row - near.shape[0] // 2 + _vertex(*near[row - 1 : row + 2, column])
    x = column - near.shape[1] // 2 + _vertex(*near[row, column - 1 : column + 2])
    return float(x), float(y)


def _turned(seen: NDArray, detail: NDArray, x: int, y: int) -> Shift | None:
    """Similarity through the shifts of tiles of the image about a common one; None if they are equal."""
    rows, columns = seen.shape
    high, wide = (n // max(n // TILE, 1) for n in seen.shape)
    edge = TILE_REACH + max(abs(x), abs(y))
    around = cv2.copyMakeBorder(detail, edge, edge, edge, edge, cv2.BORDER_CONSTANT, value=0.0)
    places, moves = [], []
    for top in range(0, rows - high + 1, high):
        for left in range(0, columns - wide + 1, wide):
            start = (top - y + edge - TILE_REACH, left - x + edge - TILE_REACH)
            window = around[start[0] : start[0] + high + 2 * TILE_REACH, start[1] :][
                :, : wide + 2 * TILE_REACH
            ]
            # the template moves over the reference, so the shift has the opposite sign
            peak = _peak(cv2.matchTemplate(window, seen[top : top + high, left : left + wide], cv2.TM_CCORR))
            if peak is not None:
                places.append(complex(left + (wide - columns) / 2, top + (high - rows) / 2))
                moves.append(complex(x - peak[0], y - peak[1]))
    return _similarity(np.array(places), np.array(moves))


def _similarity(places: NDArray[np.complex128], moves: NDArray[np.complex128]) -> Shift | None:
    """Rotation, scale and shift (coarse) through the moves of some places, most of which agree; or None."""
    keep = np.ones(len(places), np.bool_)
    for _ in range(3):
        if np.count_nonzero(keep) < FEWEST_TILES:
            return None
        matrix = np.stack([np.ones(len(places)), places], axis=1)
        (shift, turn), *_ = np.linalg.lstsq(matrix[keep], moves[keep], rcond=None)
        keep = np.abs(moves - matrix @ np.array([shift, turn])) < AGREE
    if np.count_nonzero(keep) < 0.5 * len(places) or abs(turn) * np.abs(places).max() < AGREE / 2:
        return None
    # in the frame a place lies at (1 + turn) times what it was: moves are given at places of the frame
    factor = 1.0 / (1.0 - turn)
    moved = shift * factor
    return Shift(
        COARSE * float(moved.real),
        COARSE * float(moved.imag),
        np.inf,
        float(np.angle(factor)),
        float(abs(factor)),
    )


def _vertex(left: float, middle: float, right: float) -> float:
    """Place of the top of a parabola through three values, the middle one the largest."""
    bend = left - 2.0 * middle + right
    return 0.5 * (left - right) / bend if bend < 0 else 0.0


def _textured(detail: NDArray, good: NDArray[np.bool_], spread: float) -> bool:
    """Whether neighbours share more than chance: everywhere, or in a few grains of dirt. Noise does not."""
    both = good[:, 1:] & good[:, :-1]
    one, other = detail[:, 1:][both], detail[:, :-1][both]
    product = one * other
    if len(product) < SMALLEST**2:
        return False
    grains = np.count_nonzero((np.abs(one) > GRAIN * spread) & (one * other > (GRAIN / 2 * spread) ** 2))
    return bool(grains >= GRAINS) or _shared(detail, good) > SHARED


def _shared(detail: NDArray, good: NDArray[np.bool_]) -> float:
    """Covariance of neighbours in its standard deviations."""
    product = (detail[:, 1:] * detail[:, :-1])[good[:, 1:] & good[:, :-1]]
    return float(product.mean()) * np.sqrt(len(product)) / max(float(product.std()), 1e-30)
