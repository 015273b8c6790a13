"""Where a frame lies against its reference, and images moved there."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import special

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
    def good(self) -> bool:
        """Whether the shift is known so well, all over the image, that no other one is looked for."""
        # It leaves of the texture the noise times `register.CORRELATED_PX` over the number of pixels.
        return self.std_px < 0.05 and self.consistent

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
"""No alignment was found: a shift of 0 with an infinite uncertainty."""

SMOOTHING_PX = 1.0
"""Gaussian behind which a frame and its reference are compared: about the blur of the contacts."""

KAISER_BETA = 8.0  # shape of the window: error at most 3e-3 of the amplitude at periods of 4 px and more
HALF_WIDTH_PX = 4  # of the filters, which have 2 x 4 + 1 coefficients


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


def move_image(
    image: NDArray, alignment: Alignment, *, interpolation: int = cv2.INTER_LANCZOS4,
    outside: int | None = None,
) -> NDArray:  # fmt: skip
    """The image rotated, scaled and shifted; beyond it the value ``outside``, or its border repeated.

    Places are rounded to 1/32 px: texture with a period of 7 px errs by 0.6 % of its amplitude.
    """
    matrix, offset = alignment.to_reference((image.shape[0], image.shape[1]))
    border = cv2.BORDER_REPLICATE if outside is None else cv2.BORDER_CONSTANT
    return np.asarray(
        cv2.warpAffine(
            image, np.column_stack([matrix, offset]), image.shape[::-1],
            flags=interpolation | cv2.WARP_INVERSE_MAP, borderMode=border, borderValue=outside or 0,
        )
    )  # fmt: skip


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
    if alignment.is_shift and not alignment.largest_px:
        return reference, valid
    valid = np.ones(reference.shape, np.uint8) if valid is None else valid
    if alignment.is_shift:
        return move_image(reference, alignment, interpolation=cv2.INTER_NEAREST), move_mask(valid, alignment)
    valid = np.asarray(cv2.erode(valid, np.ones((5, 5), np.uint8)), np.uint8)
    return move_image(reference, alignment), move_mask(valid, alignment)


def move_mask(mask: NDArray[np.uint8], alignment: Alignment) -> NDArray[np.uint8]:
    """The mask moved to the nearest pixel; 0 outside it."""
    return np.asarray(move_image(mask, alignment, interpolation=cv2.INTER_NEAREST, outside=0), np.uint8)
