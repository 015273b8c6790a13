"""Where a frame lies against its reference, and images moved there by a Kaiser-windowed sinc.

A rotation with a change of scale takes two one-dimensional passes, along the rows and then along the columns
(Catmull and Smith, doi:10.1145/800250.807505).
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import special

from contactimg.compiled import njit
from contactimg.imaging.pixels.masks import Mask


@dataclass(frozen=True)
class Alignment:
    """Position in the frame = centre + scale x rotation (position in the reference - centre) + shift.

    Parameters
    ----------
    x_px, y_px : float
        Shift at the centre of the image; zero if the images do not determine it.
    std_px : float
        Standard uncertainty of each; infinite if the images do not determine them.
    rotation : float, rad
        From x towards y (clockwise on the screen).
    scale : float
    consistent : bool
        Whether frame and reference agree all over the image, not only near the centre of a rotation.
    """

    x_px: float
    y_px: float
    std_px: float
    rotation: float = 0.0
    scale: float = 1.0
    consistent: bool = True

    @property
    def known(self) -> bool:
        """Whether the images determine the shift."""
        return bool(np.isfinite(self.std_px))

    @property
    def is_shift(self) -> bool:
        """Whether there is neither rotation nor change of scale."""
        return self.rotation == 0.0 and self.scale == 1.0

    @property
    def largest_px(self) -> float:
        """Larger component of the shift, px."""
        return max(abs(self.x_px), abs(self.y_px))

    def after(self, first: "Alignment") -> "Alignment":
        """The transform ``first`` followed by this one; the uncertainty is this one's.

        Examples
        --------
        >>> both = Alignment(1.0, 0.0, 0.1).after(Alignment(0.0, 2.0, 0.1, rotation=0.01))
        >>> both.x_px, both.y_px, both.rotation
        (1.0, 2.0, 0.01)
        """
        moved = self.scale * np.exp(1j * self.rotation) * complex(first.x_px, first.y_px)
        return replace(
            self,
            x_px=float(moved.real) + self.x_px,
            y_px=float(moved.imag) + self.y_px,
            rotation=self.rotation + first.rotation,
            scale=self.scale * first.scale,
        )

    def to_reference(self, shape: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Matrix and offset that turn (x, y) in the frame into (x, y) in the reference."""
        centre = np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])
        c, s = np.cos(self.rotation) / self.scale, np.sin(self.rotation) / self.scale
        matrix = np.array([[c, s], [-s, c]])
        return matrix, centre - matrix @ (centre + np.array([self.x_px, self.y_px]))


UNKNOWN = Alignment(0.0, 0.0, np.inf)
"""Neither image determines anything."""


KAISER_BETA = 8.0  # shape of the window: error at most 3e-3 of the amplitude at periods of 4 px and more
HALF_WIDTH_PX = 4  # of the filters, which have 2 x 4 + 1 coefficients
PHASES = 512  # tabulated positions between two pixels: a position is off by at most 1/1024 px


def shift_kernel(fraction: float) -> NDArray[np.float64]:
    """Filter that moves a row of pixels by ``fraction`` (px, between -1 and 1): a Kaiser-windowed sinc.

    Correlating with it gives ``image(x - fraction)``. Nine coefficients, which sum to 1.

    Examples
    --------
    >>> [float(abs(c)) for c in shift_kernel(0.0).round(12)]
    [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]
    """
    offset = np.arange(-HALF_WIDTH_PX, HALF_WIDTH_PX + 1) + fraction
    inside = np.clip(1 - (offset / (HALF_WIDTH_PX + 1)) ** 2, 0, None)
    kernel = np.sinc(offset) * special.i0(KAISER_BETA * np.sqrt(inside)) / special.i0(KAISER_BETA)
    return kernel / kernel.sum()


def filter_rows_and_columns(image: NDArray, along: NDArray, across: NDArray) -> NDArray[np.float32]:
    """The image correlated with one filter along its rows and one along its columns; the border repeats."""
    source = image if image.dtype == np.uint8 else np.asarray(image, np.float32)
    filtered = cv2.sepFilter2D(source, cv2.CV_32F, along, across, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(filtered, np.float32)


def shift_whole_pixels(image: NDArray, columns: int, rows: int) -> NDArray:
    """The image moved right by ``columns`` and down by ``rows``; the border is repeated."""
    if not (rows or columns):
        return image
    y = np.clip(np.arange(image.shape[0]) - rows, 0, image.shape[0] - 1)
    x = np.clip(np.arange(image.shape[1]) - columns, 0, image.shape[1] - 1)
    return np.ascontiguousarray(image[y][:, x])


def move_reference(reference: NDArray, valid: Mask, alignment: Alignment) -> tuple[NDArray, Mask]:
    """The reference as it lies under the frame, and where it has pixels.

    Parameters
    ----------
    reference : ndarray, shape (rows, columns)
    valid : ndarray of uint8 or None
        0 at its holes.
    alignment : Alignment
        A pure shift must be by whole pixels.

    Returns
    -------
    image, valid
        Outside the reference the image repeats its border and is not valid.
    """
    shape = reference.shape
    if alignment.is_shift and not alignment.largest_px:
        return reference, valid
    valid = np.ones(shape, np.uint8) if valid is None else valid
    matrix, offset = alignment.to_reference(shape)
    x, y = np.arange(shape[1]), np.arange(shape[0])[:, None]
    inside = np.ones(shape, np.bool_)
    for (along_x, along_y), start, size in zip(matrix, offset, shape[::-1], strict=True):
        place = along_x * x + along_y * y + start
        inside &= (place > -0.5) & (place < size - 0.5)
    if alignment.is_shift:
        columns, rows = round(alignment.x_px), round(alignment.y_px)
        moved, there = (shift_whole_pixels(part, columns, rows) for part in (reference, valid))
    else:
        moved = move_rows(reference, alignment, 0, shape[0])
        there = move_rows(valid.astype(np.float32), alignment, 0, shape[0]) > 0.99
    return moved, np.asarray(there & inside, np.uint8)


def move_rows(image: NDArray, alignment: Alignment, first: int, end: int) -> NDArray[np.float32]:
    """Rows ``first`` to ``end`` of the image rotated, scaled and shifted; the border is repeated."""
    matrix, offset = alignment.to_reference((image.shape[0], image.shape[1]))
    return np.asarray(_move_rows(image, matrix, offset, first, end, _phases()))


@lru_cache(maxsize=1)
def _phases() -> NDArray[np.float32]:
    """Filters that interpolate at positions from -1/2 to 1/2 px from a pixel."""
    fractions = np.linspace(-0.5, 0.5, PHASES + 1)
    return np.stack([shift_kernel(-float(f)) for f in fractions]).astype(np.float32)


@njit(cache=True)
def _move_rows(image, matrix, offset, first, end, phases):
    """Resample each source row at the columns where the output columns cross it, then along the columns."""
    rows, columns = image.shape
    half = phases.shape[1] // 2
    corners = np.array([matrix[1, 0] * x + matrix[1, 1] * y + offset[1] for x in (0, columns - 1)
                        for y in (first, end - 1)])  # fmt: skip
    top = min(max(int(np.floor(corners.min())) - half, 0), rows - 1)
    bottom = max(min(int(np.ceil(corners.max())) + half + 1, rows), top + 1)
    between = np.empty((bottom - top, columns), np.float32)
    for r in range(top, bottom):
        for x in range(columns):
            y = (r - offset[1] - matrix[1, 0] * x) / matrix[1, 1]
            between[r - top, x] = _read(image[r], matrix[0, 0] * x + matrix[0, 1] * y + offset[0], phases)
    out = np.empty((end - first, columns), np.float32)
    for y in range(first, end):
        for x in range(columns):
            place = min(max(matrix[1, 0] * x + matrix[1, 1] * y + offset[1], 0.0), rows - 1.0)
            out[y - first, x] = _read(between[:, x], place - top, phases)
    return out


@njit(cache=True)
def _read(line, place, phases):
    """Value of a line of pixels at any position; its ends are repeated."""
    last = len(line) - 1
    place = min(max(place, 0.0), float(last))
    nearest = int(place + 0.5)
    half = phases.shape[1] // 2
    kernel = phases[int((place - nearest + 0.5) * (len(phases) - 1) + 0.5)]
    total = np.float32(0.0)
    if nearest >= half and nearest + half <= last:
        for k in range(len(kernel)):
            total += kernel[k] * line[nearest - half + k]
    else:
        for k in range(len(kernel)):
            total += kernel[k] * line[min(max(nearest - half + k, 0), last)]
    return total
