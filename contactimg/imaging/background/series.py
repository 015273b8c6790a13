"""The background of a series: the mean of its reference and of what each of the other frames shows of it.

Each frame is brought to the place and to the light of the reference, without its contacts. Sums over all of
them are kept, and a frame's own part is subtracted for the background that this frame is measured on: no
frame is compared with itself. Where no other frame shows the background, the reference remains.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.alignment import Alignment, move_rows
from contactimg.imaging.background.find_illumination import BackgroundLevel
from contactimg.imaging.background.subtract import subtract_reference
from contactimg.imaging.pixels.masks import Mask
from contactimg.imaging.pixels.robust import robust_std

MARGIN_PX = 5.0  # around contacts: three and a half blur widths of 1.4 px
COMPARED_PX = (
    5  # side of the square over which a frame is compared with the reference; by hand: a small contact
)
DIFFERENT_SIGMA = 6.0  # scatters of such means beyond which a frame shows no background; false alarms 2e-9


@dataclass(frozen=True, eq=False)
class View:
    """What one frame shows of the background, in the place and in the light of the reference.

    Parameters
    ----------
    image : ndarray of float32, shape (rows, columns)
        Grey levels.
    seen : ndarray of uint8, shape (rows, columns)
        1 where it shows background.
    """

    image: NDArray[np.float32]
    seen: NDArray[np.uint8]


class PooledBackground:
    """Sums of a reference and of the views of a series.

    Parameters
    ----------
    reference : ndarray, shape (rows, columns)
        Grey levels of an image without contact.
    weight : int
        Number of images that the reference is the mean of.
    """

    def __init__(self, reference: NDArray, weight: int = 1) -> None:
        self.reference = np.asarray(reference, np.float32)
        self._total = self.reference * np.float32(weight)
        self._count = np.full(reference.shape, np.float32(weight))

    def view(
        self,
        frame: NDArray,
        disks: NDArray[np.float64],
        *,
        valid: Mask = None,
        background_is: BackgroundLevel = "nearest_one",
        registered: bool = False,
    ) -> View | None:
        """What a frame shows of the background; None where it does not show the surface of the reference.

        Parameters
        ----------
        frame : ndarray, shape (rows, columns)
            Grey levels.
        disks : ndarray, shape (n, 3)
            x, y, radius (px) of the contacts, and of what else hides the background.
        valid : Mask
            0 at holes of the frame or of the reference.
        background_is : BackgroundLevel
        registered : bool
            No shift is looked for.
        """
        difference = subtract_reference(
            frame, self.reference, valid=valid, background_is=background_is, registered=registered
        )
        alignment = difference.alignment
        if not difference.ratio or difference.registration_failed or alignment is None:
            return None
        shape = (frame.shape[0], frame.shape[1])
        flat = np.asarray(frame, np.float32) / difference.illumination.ratio_at_rows(
            np.arange(shape[0]), shape
        )
        seen = np.ones(shape, np.uint8) if valid is None else valid.copy()
        for x, y, radius in disks:
            cv2.circle(seen, (round(x), round(y)), int(np.ceil(radius + MARGIN_PX)), 0, cv2.FILLED)
        if alignment.known:
            back = _inverse(alignment)
            flat = move_rows(np.ascontiguousarray(flat, np.float32), back, 0, shape[0])
            transform = np.column_stack(back.to_reference(shape))
            flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
            seen = np.asarray(cv2.warpAffine(seen, transform, shape[::-1], flags=flags))
        return View(flat, seen & self._agrees(flat, seen))

    def _agrees(self, image: NDArray[np.float32], seen: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """1 where an image differs from the reference by no more than noise."""
        square = (COMPARED_PX, COMPARED_PX)
        difference = cv2.blur(image - self.reference, square)
        some = difference[::3, ::3][seen[::3, ::3] > 0]
        if not some.size:
            return seen
        differs = (np.abs(difference) > DIFFERENT_SIGMA * robust_std(some, centre=0.0)).astype(np.uint8)
        return np.asarray(1 - cv2.dilate(differs, np.ones(square, np.uint8)), np.uint8)

    def add(self, view: View) -> None:
        """Count a view."""
        self._total += view.image * view.seen
        self._count += view.seen

    def without(self, view: View | None = None) -> NDArray[np.float32]:
        """The mean of the reference and of all views but one that was added, grey levels."""
        if view is None:
            return self._total / self._count
        return (self._total - view.image * view.seen) / (self._count - view.seen)


def _inverse(alignment: Alignment) -> Alignment:
    """The alignment of the reference against the frame.

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
