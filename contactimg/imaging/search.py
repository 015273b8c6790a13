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

from contactimg.imaging.light import LEAST_RATIO, LightField, block_means, fit_light

__all__ = ["Search", "search_shift"]

COARSE = 4  # px
REACH = 4  # shifts up to the size of the image divided by this
WIDEST = 10  # coarse pixels: half width of the window whose mean is taken off the reference's detail
CLIP = 4.0  # robust standard deviations of the reference's detail beyond which a pixel counts no more
WIDE = 5  # coarse pixels: what differs over more is a contact and left out, less may be dirt
SIGNIFICANT = 7.0  # robust standard deviations of the correlation: of 10^4 normal ones none exceeds 5
UNIQUE = 0.75  # of the peak: a second one as high leaves the shift open
SMALLEST = 16  # coarse pixels
SHARED = 5.0  # standard deviations of the covariance of neighbours
GRAIN, GRAINS = 5.0, 4  # robust standard deviations of a grain of dirt, coarse pixels that are enough


@dataclass(frozen=True)
class Search:
    """What the search says.

    Parameters
    ----------
    x_px, y_px : float
        Shift, to about 1 px; zero if none was found.
    found : bool
        Whether one peak of the correlation stands out.
    textured : bool
        Whether the reference has anything to show that a shift would move.
    """

    x_px: float
    y_px: float
    found: bool
    textured: bool


NOTHING = Search(0.0, 0.0, found=False, textured=False)


def search_shift(
    frame: NDArray[np.float32],
    reference: NDArray[np.float32],
    light: LightField,
    valid: NDArray[np.uint8] | None,
) -> Search:
    """Shift of up to a quarter of the image.

    Parameters
    ----------
    frame, reference : ndarray, shape (rows, columns)
        Grey levels.
    light : LightField
        Slow ratio frame/reference of the background.
    valid : ndarray of uint8 or None
        0 at holes of either.
    """
    size = (frame.shape[1] // COARSE, frame.shape[0] // COARSE)
    if min(size) < SMALLEST:
        return NOTHING
    small, other = (cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in (frame, reference))
    good = np.ones(size[::-1], np.bool_)
    if valid is not None:
        holes = cv2.resize(1 - valid, size, interpolation=cv2.INTER_AREA)
        good = cv2.dilate(holes, np.ones((3, 3), np.uint8)) == 0
    slow = _slow(reference, valid, size)
    good &= slow > LEAST_RATIO * float(np.abs(slow).max())
    if np.count_nonzero(good) < SMALLEST**2:
        return NOTHING
    slow = np.where(good, slow, np.float32(1.0))
    detail = _without_mean(np.where(good, other / slow - 1.0, 0.0).astype(np.float32), good)
    spread = max(1.4826 * float(np.median(np.abs(detail[good]))), 1e-9)
    detail = np.clip(detail, -2 * CLIP * spread, 2 * CLIP * spread)
    if not _textured(detail, good, spread):
        return NOTHING
    rows = np.minimum(np.arange(size[1]) * COARSE + COARSE // 2, frame.shape[0] - 1)
    ratio = light.ratio_rows(rows, frame.shape)[:, COARSE // 2 :: COARSE][:, : size[0]]
    seen = np.where(good, small / (ratio * slow) - 1.0, 0.0)
    far = (np.abs(seen) > CLIP * spread).astype(np.uint8)
    contacts = cv2.morphologyEx(far, cv2.MORPH_OPEN, np.ones((WIDE, WIDE), np.uint8), borderValue=1)
    seen = np.where(good & (contacts == 0), np.clip(seen, -CLIP * spread, CLIP * spread), 0.0)
    return _peak(seen, detail)


def _slow(
    reference: NDArray[np.float32], valid: NDArray | None, size: tuple[int, int]
) -> NDArray[np.float32]:
    """Light of the reference at each coarse pixel: a polynomial."""
    blocks = block_means(reference, valid)
    level = float(np.nanmedian(blocks))
    spread = 1.4826 * float(np.nanmedian(np.abs(blocks - level)))
    light = fit_light(blocks, (reference.shape[0], reference.shape[1]), start=level, spread=2.0 * spread)
    rows = np.arange(size[1]) * COARSE + COARSE // 2
    return light.rows(rows, (reference.shape[0], reference.shape[1]))[:, COARSE // 2 :: COARSE][:, : size[0]]


def _without_mean(image: NDArray[np.float32], good: NDArray[np.bool_]) -> NDArray[np.float32]:
    """The image, 0 at holes, minus the mean of the window about each pixel."""
    window = (2 * WIDEST + 1, 2 * WIDEST + 1)
    weight = cv2.blur(good.astype(np.float32), window)
    mean = cv2.blur(image, window) / np.maximum(weight, np.float32(1e-3))
    return np.where(good, image - mean, np.float32(0.0))


def _peak(target: NDArray, detail: NDArray) -> Search:
    """The highest peak of the correlation of the two, to a fraction of a coarse pixel."""
    reach = [max(n // REACH, 2) for n in target.shape]
    padded = [fft.next_fast_len(n + r, real=True) for n, r in zip(target.shape, reach, strict=True)]
    spectra = [fft.rfft2(image.astype(np.float32), padded) for image in (target, detail)]
    whole = fft.irfft2(spectra[0] * np.conj(spectra[1]), padded)
    near = np.roll(whole, reach, axis=(0, 1))[: 2 * reach[0] + 1, : 2 * reach[1] + 1]
    row, column = np.unravel_index(int(np.argmax(near)), near.shape)
    height = float(near[row, column])
    scatter = 1.4826 * float(np.median(np.abs(near - np.median(near))))
    others = near.copy()
    others[max(row - 5, 0) : row + 6, max(column - 5, 0) : column + 6] = -np.inf
    alone = float(others.max()) < UNIQUE * height
    inside = 0 < row < near.shape[0] - 1 and 0 < column < near.shape[1] - 1
    if not (inside and alone and height > SIGNIFICANT * scatter > 0.0):
        return Search(0.0, 0.0, found=False, textured=True)
    y = row - reach[0] + _vertex(*near[row - 1 : row + 2, column])
    x = column - reach[1] + _vertex(*near[row, column - 1 : column + 2])
    return Search(float(COARSE * x), float(COARSE * y), found=True, textured=True)


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
    return bool(grains >= GRAINS) or float(product.mean()) > SHARED * float(product.std()) / np.sqrt(
        len(product)
    )
