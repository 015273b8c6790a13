"""Means of an image over blocks of pixels, and which pixels lie in background blocks."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.imaging.pixels.masks import Flags, Mask, Values
from contactimg.imaging.pixels.robust import MANY, SAMPLE, SOME, median, quantile, reach_std

BLOCK = 8
"""Side of the blocks, px; a power of 2."""

ALL_FOUR = np.ones(BLOCK // 2, np.bool_).view(np.uint32)[0]  # flags of the pixels of a square in one number
SOME_CLIPPED = 0.1  # share of clipped blocks or pixels of an image that matters. By hand


def block_means(image: NDArray, valid: Mask = None, *, side: int = BLOCK) -> Values:
    """Mean of each block of ``side`` (a power of 2) squared pixels; the border repeats to fill the last ones.

    Invalid pixels do not count; a block without a valid pixel is NaN.
    """
    means = np.full([-(-size // side) for size in image.shape], np.nan, np.float32)
    if valid is None:
        _mean_blocks(means, np.ascontiguousarray(image), side)
        return means
    lit = cv2.bitwise_and(image, image, mask=valid)
    total, weight = (block_means(part, side=side) for part in (lit, valid))
    return np.divide(total, weight, out=means, where=weight > 0)


def to_pixels(
    blocks: NDArray, shape: tuple[int, ...], *, side: int = BLOCK, interpolation: int = cv2.INTER_NEAREST
) -> NDArray:
    """The values of blocks at all pixels of an image of ``shape``.

    Examples
    --------
    >>> to_pixels(np.array([[1, 2]], np.uint8), (2, 3), side=2).tolist()
    [[1, 1, 2], [1, 1, 2]]
    """
    size = (side * blocks.shape[1], side * blocks.shape[0])
    pixels = np.asarray(cv2.resize(blocks, size, interpolation=interpolation))
    return np.ascontiguousarray(pixels[: shape[0], : shape[1]])


def rounding_of_blocks(*images: NDArray) -> float:
    """Standard uncertainty that compression leaves in the mean of a block of the difference of two images.

    A JPEG file rounds the means of its blocks of 8 px, and leaves most of a flat background without any other
    detail. Neighbouring blocks then differ by nothing or by the step, although their means are known to no
    better than ``step/sqrt(12)``, the standard deviation of a rounding error.

    Parameters
    ----------
    images : ndarray, shape (rows, columns)
        Frame, and reference where there is one, as they were read: a moved one has no such blocks.

    Returns
    -------
    float
        Grey levels; 0 where no image has such blocks.

    Examples
    --------
    >>> blocks = np.array([[70.0, 70.0, 73.0, 73.0], [70.0, 73.0, 73.0, 98.0]])
    >>> image = blocks.repeat(8, axis=0).repeat(8, axis=1)
    >>> round(rounding_of_blocks(image), 3), round(rounding_of_blocks(image, image), 3)
    (0.866, 1.225)
    """
    return float(np.sqrt(sum(_rounding_step(image) ** 2 for image in images) / 12.0))


def _rounding_step(image: NDArray) -> float:
    """Usual difference of neighbouring blocks, where they differ; 0 if their means are not rounded.

    Wherever a block of the file begins, a square of half its side lies in it, and so does another one a whole
    side further in its neighbour. Some rows of squares are looked at. Where noise leaves few blocks without
    detail, the means of blocks either hardly differ or differ by the step.
    """
    side = BLOCK // 2
    last, across = image.shape[0] // side - 2, image.shape[1] // side
    first = np.arange(0, last, max(8 * last * across // SAMPLE, 1))  # a quarter of it tells a step
    squares = image[np.stack([first, first + 2])[..., None] * side + np.arange(side), : across * side]
    top = squares[:, :, 0].reshape(*squares.shape[:2], across, side)
    same = (squares == squares[:, :, :1]).all(axis=2).reshape(top.shape) & (top == top[..., :1])
    even = same.view(np.uint32)[..., 0] == ALL_FOUR
    levels = np.where(even, top[..., 0], np.nan)
    # By hand: noise of half a grey level leaves no square whose pixels are all equal, compression does.
    if np.count_nonzero(even) > 0.1 * even.size:
        steps = np.abs(np.append(levels[:, :, 2:] - levels[:, :, :-2], levels[1] - levels[0]))
        steps = steps[steps > 0.0]  # not NaN either
        step = float(np.median(steps)) if steps.size else 0.0
    else:
        rows = (first[::2, None] // 2 * BLOCK + np.arange(BLOCK)).ravel()
        steps = np.abs(np.diff(block_means(image[rows]), axis=1).ravel())
        far = steps[steps > 4.0 * quantile(steps, 0.25)] if steps.size else steps
        step = median(far) if far.size else 0.0
        beyond, over_quarter = (int(np.count_nonzero(steps > share * step)) for share in (0.75, 0.25))
        # By hand: 0.03 in JPEG files, 0.2 and more elsewhere.
        if over_quarter - beyond > 0.1 * beyond:
            return 0.0
    # What differs by more than a quarter of the range is a contrast. By hand.
    return step if step < 0.25 * float(np.ptp(image[::side, ::side])) else 0.0


def find_clipped(image: NDArray) -> Mask:
    """Pixels (1) of blocks most of whose pixels are at the lowest or highest level of an image, or None.

    They show no noise, and nothing of the light. Where there are few of them, or where they leave next to
    nothing of the image, no block is taken out.
    """
    lowest, highest = image.min(), image.max()
    if not any(np.mean(image[::7, ::11] == level) > SOME_CLIPPED for level in (lowest, highest)):
        return None
    # By hand: half of the pixels are clipped where a background was subtracted.
    clipped = block_means(((image == lowest) | (image == highest)).astype(np.float32)) > 0.8
    if not SOME_CLIPPED < np.mean(clipped) < 1.0 - SOME_CLIPPED:
        return None
    return to_pixels(clipped.astype(np.uint8), image.shape)


class SignedImage:
    """A difference image with contacts positive, its noise, and means over its squares, each computed once.

    Parameters
    ----------
    image : ndarray of float32, shape (rows, columns)
        0 in holes.
    noise : float
        Standard deviation of a background pixel.
    valid : Mask
        0 for pixels without a value.
    rounding : float
        Part of the noise that the pixels of a block share (`rounding_of_blocks`).

    Examples
    --------
    >>> squares, noise = SignedImage(np.arange(16.0, dtype=np.float32).reshape(4, 4), 1.0).squares(2)
    >>> squares.tolist(), noise
    ([[2.5, 4.5], [10.5, 12.5]], 0.5)
    """

    def __init__(self, image: Values, noise: float, valid: Mask = None, *, rounding: float = 0.0) -> None:
        self.image, self.noise, self.valid, self.rounding = image, noise, valid, rounding
        self._squares: dict[int, tuple[Values, float]] = {}
        self.outlined: dict[int, Any] = {}  # what was outlined in the squares of each side

    def squares(self, side: int) -> tuple[Values, float]:
        """Means over squares of that side, 0 where no pixel is seen, and their noise.

        The noise is their scatter about a background of 0, from the negative ones: no contact is.
        """
        if side not in self._squares:
            means = block_means(self.image, self.valid, side=side)
            if self.valid is not None:
                means = np.where(np.isfinite(means), means, np.float32(0.0))
            every = max(int(np.sqrt(means.size / 6 / MANY)), 1)
            below, noise = means[:: 3 * every, :: 2 * every], max(self.noise / side, self.rounding)
            below = below[below < 0.0]
            if below.size > SOME:
                noise = max(reach_std(below, 0.0), noise)
            self._squares[side] = means, noise
        return self._squares[side]


def sample_background(image: Values, background: Flags, every: tuple[int, int]) -> Values:
    """Pixels of the background blocks, sampled every so many rows and columns."""
    rows, columns = (np.arange(0, size, step) for size, step in zip(image.shape, every, strict=True))
    return image[:: every[0], :: every[1]][is_background(background, rows, columns, image.shape)]


def is_background(background: Flags, rows: NDArray, columns: NDArray, shape: tuple[int, ...]) -> Flags:
    """Whether the pixels at the given rows and columns of an image of ``shape`` are background."""
    side = side_of(background.shape, shape)
    return background[rows // side][:, columns // side]


def strips(size: int, height: int, number: int, margin: int) -> tuple[NDArray[np.int64], Flags]:
    """Rows of strips spread evenly over an image of ``size`` rows, and which lie ``margin`` rows inside one.

    Examples
    --------
    >>> rows, inside = strips(20, 4, 2, 1)
    >>> rows.tolist(), inside.astype(int).tolist()
    ([3, 4, 5, 6, 13, 14, 15, 16], [0, 1, 1, 0, 0, 1, 1, 0])
    """
    height = min(height, size)
    tops = np.clip((np.arange(number) + 0.5) * size / number - height / 2, 0, size - height).astype(np.int64)
    offset = np.arange(height)
    inside = (offset >= margin) & (offset < height - margin)
    return (tops[:, None] + offset).ravel(), np.tile(inside, number)


def side_of(blocks: tuple[int, ...], shape: tuple[int, ...]) -> int:
    """Side (px) of the blocks, given how many rows and columns of them cover an image of ``shape``.

    Examples
    --------
    >>> side_of((150, 200), (1200, 1600)), side_of((2, 3), (9, 17)), side_of((600, 800), (1200, 1600))
    (8, 8, 2)
    """
    side = 1
    while any(-(-size // side) > count for size, count in zip(shape, blocks, strict=True)):
        side *= 2
    return side


@njit(cache=True)
def _mean_blocks(out, image, side):
    """Mean of each block of a power of 2: rows added, then neighbours; the border repeats."""
    rows, columns = image.shape
    total, share = np.empty((2, out.shape[1] * side), np.float32), np.float32(1.0 / side**2)
    for i in range(len(out)):
        total[0] = 0.0
        for y in range(i * side, (i + 1) * side):
            _add_row_to(total[0], image[min(y, rows - 1)])
        total[0, columns:] = total[0, columns - 1]
        width, now = total.shape[1], 0
        while width > out.shape[1]:
            width //= 2
            _add_neighbours(total[1 - now, :width], total[now])
            now = 1 - now
        for x in range(width):
            out[i, x] = total[now, x] * share


@njit(cache=True, fastmath=True, forceinline=True)
def _add_row_to(total, row):
    """Add a row; contiguous and in single precision, so that it compiles to vector instructions."""
    for x in range(len(row)):
        total[x] += np.float32(row[x])


@njit(cache=True, fastmath=True, forceinline=True)
def _add_neighbours(out, row):
    """Sums of pairs of pixels."""
    for x in range(len(out)):
        out[x] = row[2 * x] + row[2 * x + 1]
