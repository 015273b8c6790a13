"""What one frame shows of the background, in the coordinates and in the light of an anchor image."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.alignment import (
    Alignment,
    filter_rows_and_columns,
    move_image,
    move_mask,
    shift_kernel,
)
from contactimg.imaging.background.find_illumination import BackgroundLevel
from contactimg.imaging.background.illumination import Illumination
from contactimg.imaging.background.subtract import subtract_reference
from contactimg.imaging.pixels.blocks import block_means
from contactimg.imaging.pixels.frame_pair import FramePair
from contactimg.timings import stage

SQUARE_PX = 4
"""Side of the squares on which frames are compared. Chosen: as wide as the blurred rim of a contact."""


FEWEST_SEEN = 0.25
"""Fraction of a square that a frame must show to be compared there; a smaller part is taken as it is."""


BRIGHTNESS_PX = 33
"""Side of the square over which the brightness of the anchor is averaged. Chosen: as most contacts."""


@dataclass(frozen=True, eq=False)
class Placement:
    """The place of a frame on the anchor, and its light relative to it.

    Parameters
    ----------
    alignment : Alignment
        Of the frame against the anchor; no shift where the images do not determine it.
    illumination : Illumination
        Ratio frame/anchor of the background.
    found : bool
        Whether the frame shows the surface of the anchor, as far as that has any texture.
    """

    alignment: Alignment
    illumination: Illumination
    found: bool

    @classmethod
    def unknown(cls) -> "Placement":
        """The placement of a frame that was not found on the anchor."""
        nothing = Illumination(np.ones((1, 1)), np.zeros((1, 1), np.bool_), 0.0)
        return cls(Alignment(0.0, 0.0, np.inf), nothing, found=False)


@dataclass(frozen=True, eq=False)
class View:
    """What one frame shows of the background.

    Parameters
    ----------
    image : ndarray of float32, shape (rows, columns)
        The frame in the coordinates and in the light of the anchor, grey levels.
    seen : ndarray of uint8, shape (rows, columns)
        1 where it shows background.
    """

    image: NDArray[np.float32]
    seen: NDArray[np.uint8]

    @classmethod
    def plain(cls, image: NDArray) -> "View":
        """The view of an image without contacts; non-finite pixels are holes."""
        finite = np.isfinite(image)
        return cls(np.where(finite, image, 0.0).astype(np.float32), finite.astype(np.uint8))

    def restricted(self, used: NDArray[np.bool_], light: NDArray[np.float32]) -> "View":
        """Seen only in the squares that are used, and corrected for its slow light (`Agreement`)."""
        shape = self.image.shape
        return View(self.image - _enlarge(light, shape), self.seen & _enlarge_mask(used, shape))

    def squares(self) -> NDArray[np.float32]:
        """Means over squares of `SQUARE_PX`; NaN where the frame shows too little of a square."""
        enough = block_means(self.seen.astype(np.float32), side=SQUARE_PX) >= FEWEST_SEEN
        return np.where(enough, block_means(self.image, self.seen, side=SQUARE_PX), np.float32(np.nan))


@stage("light")
def place_frame(
    image: NDArray,
    anchor: NDArray,
    *,
    background_is: BackgroundLevel,
    registered: bool = False,
) -> Placement | None:
    """Find where a frame lies on the anchor and how its light differs.

    Parameters
    ----------
    image, anchor : ndarray, shape (rows, columns)
        Grey levels; non-finite pixels are holes.
    background_is : BackgroundLevel
        Which level is background.
    registered : bool
        No shift is looked for.

    Returns
    -------
    Placement or None
        None if the frame shows nothing, or the anchor is too dark to divide by.
    """
    pair = FramePair.of(image, anchor, None)
    if pair.trivial or pair.reference is None:
        return None
    difference = subtract_reference(
        pair.frame, pair.reference, valid=pair.valid, background_is=background_is, registered=registered
    )
    if not difference.ratio or difference.alignment is None:
        return None
    known = difference.alignment.known
    alignment = difference.alignment if known else Alignment(0.0, 0.0, np.inf)
    return Placement(alignment, difference.illumination, found=not difference.registration_failed)


@stage("light")
def view_background(image: NDArray, placement: Placement, disks: NDArray[np.float64]) -> View:
    """The background that a frame shows, in the coordinates and in the light of the anchor.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Grey levels; non-finite pixels are holes.
    placement : Placement
    disks : ndarray, shape (n, 3)
        x, y, radius (px, in the frame) of the places where no background shows.
    """
    shape = (image.shape[0], image.shape[1])
    finite = np.isfinite(image)
    seen = pixels_outside(disks, shape) & finite.astype(np.uint8)
    flat = np.asarray(image, np.float32) / placement.illumination.ratio_at_rows(np.arange(shape[0]), shape)
    if not finite.all():
        flat = np.where(finite, flat, np.float32(np.median(flat[finite])))
    back = _inverse(placement.alignment)
    return View(_move(np.asarray(flat, np.float32), back), move_mask(seen, back))


def pixels_outside(disks: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.uint8]:
    """1 outside all disks."""
    seen = np.ones(shape, np.uint8)
    bits = 4
    for x, y, radius in disks:
        centre = (round(x * 2**bits), round(y * 2**bits))
        cv2.circle(seen, centre, round(radius * 2**bits), 0, cv2.FILLED, cv2.LINE_8, bits)
    return seen


def to_anchor(
    x: NDArray, y: NDArray, alignment: Alignment, shape: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points of a frame (px) on the anchor, for the alignment of the frame against it."""
    matrix, offset = alignment.to_reference(shape)
    return matrix[0, 0] * x + matrix[0, 1] * y + offset[0], matrix[1, 0] * x + matrix[1, 1] * y + offset[1]


def smooth_brightness(anchor: NDArray) -> NDArray[np.float32]:
    """The anchor without its detail, grey levels."""
    view = View.plain(anchor)
    window = (BRIGHTNESS_PX, BRIGHTNESS_PX)
    total, weight = (cv2.blur(part, window) for part in (view.image, view.seen.astype(np.float32)))
    return np.asarray(total / np.maximum(weight, np.float32(1e-3)), np.float32)


def _inverse(alignment: Alignment) -> Alignment:
    """The alignment of the anchor against the frame.

    Examples
    --------
    >>> both = _inverse(Alignment(1.0, 2.0, 0.1, 0.3, 1.1)).after(Alignment(1.0, 2.0, 0.1, 0.3, 1.1))
    >>> [abs(round(value, 9)) for value in (both.x_px, both.y_px, both.rotation, both.scale)]
    [0.0, 0.0, 0.0, 1.0]
    """
    shift = -complex(alignment.x_px, alignment.y_px) * np.exp(-1j * alignment.rotation) / alignment.scale
    return replace(
        alignment,
        x_px=float(shift.real),
        y_px=float(shift.imag),
        rotation=-alignment.rotation,
        scale=1.0 / alignment.scale,
    )


def _move(image: NDArray[np.float32], alignment: Alignment) -> NDArray[np.float32]:
    """The image moved, with its noise nearly white."""
    if not alignment.is_shift:
        return move_image(image, alignment)
    columns, rows = round(alignment.x_px), round(alignment.y_px)
    whole = replace(alignment, x_px=float(columns), y_px=float(rows))
    moved = move_image(image, whole, interpolation=cv2.INTER_NEAREST)
    left = alignment.x_px - columns, alignment.y_px - rows
    return moved if left == (0.0, 0.0) else filter_rows_and_columns(moved, *map(shift_kernel, left))


def _enlarge(squares: NDArray[np.float32], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """A slowly varying field on squares, interpolated to the pixels."""
    size = (squares.shape[1] * SQUARE_PX, squares.shape[0] * SQUARE_PX)
    wide = cv2.resize(squares, size, interpolation=cv2.INTER_LINEAR)
    return np.asarray(wide[: shape[0], : shape[1]], np.float32)


def _enlarge_mask(squares: NDArray[np.bool_], shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """A mask of squares at each pixel; the neighbours of what is left out are left out too."""
    bad = cv2.dilate((~squares).astype(np.uint8), np.ones((3, 3), np.uint8))
    wide = bad.repeat(SQUARE_PX, axis=0).repeat(SQUARE_PX, axis=1)
    return np.asarray(1 - wide[: shape[0], : shape[1]], np.uint8)
