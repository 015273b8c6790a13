"""The sums of the views of a background, from which the mean of all but one follows."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.pooled.views import View

FILL_PX = 4.0
"""Standard deviation of the Gaussian that fills places that no frame shows, from around them."""


UNSEEN_VIEWS = 0.1
"""Views that a place is worth which none shows. Chosen: texture of 2 % behind a blur of 1.4 px, filled in
from around, then counts ten times the noise of a pixel."""


RIM_POINTS = 24
"""Points of a rim at which the number of views is looked up. Chosen: one each 2 px on the usual contacts."""


@dataclass(frozen=True, eq=False)
class PooledBackground:
    """Sums of the views of a background.

    Parameters
    ----------
    total : ndarray of float32, shape (rows, columns)
        Sum of the views that show a pixel, grey levels.
    count : ndarray of uint8, shape (rows, columns)
        How many do.
    """

    total: NDArray[np.float32]
    count: NDArray[np.uint8]

    @classmethod
    def empty(cls, shape: tuple[int, int]) -> "PooledBackground":
        """The sums without any view."""
        return cls(np.zeros(shape, np.float32), np.zeros(shape, np.uint8))

    def plus(self, view: View, weight: int = 1) -> "PooledBackground":
        """The sums with one view more, which counts like ``weight`` views."""
        seen = view.seen * np.uint8(weight)
        return PooledBackground(self.total + view.image * seen, self.count + seen)

    def minus(self, view: View) -> "PooledBackground":
        """The sums without a view that was added."""
        return PooledBackground(self.total - view.image * view.seen, self.count - view.seen)

    def changed_by(self, change: NDArray[np.float32]) -> "PooledBackground":
        """The sums after a change of the sum."""
        return replace(self, total=self.total + change)

    def mean(self) -> NDArray[np.float32]:
        """The background; where no view shows it, what surrounds the place."""
        known = self.count > 0
        image = np.asarray(self.total / np.maximum(self.count, 1), np.float32)
        return image if known.all() else _fill(image, known)

    def views_at(self, x: NDArray, y: NDArray, radius: NDArray) -> NDArray[np.float64]:
        """Number of views at each rim (px on the anchor): the harmonic mean over its points."""
        angles = 2.0 * np.pi * np.arange(RIM_POINTS) / RIM_POINTS
        rows, columns = (
            np.clip(np.rint(centre[:, None] + radius[:, None] * part), 0, size - 1).astype(int)
            for centre, part, size in (
                (y, np.sin(angles), self.count.shape[0]),
                (x, np.cos(angles), self.count.shape[1]),
            )
        )
        count = np.maximum(self.count[rows, columns], UNSEEN_VIEWS)
        return np.asarray(1.0 / np.mean(1.0 / count, axis=1))


def _fill(image: NDArray[np.float32], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """The image with unknown places filled from around them."""
    out, width = np.where(known, image, np.float32(0.0)), FILL_PX
    weight = known.astype(np.float32)
    done = known.copy()
    while not done.all() and width < 2 * max(image.shape):
        total, norm = (
            cv2.GaussianBlur(part, (0, 0), width)
            for part in (np.where(known, image, 0.0).astype(np.float32), weight)
        )
        new = ~done & (norm > 1e-2)
        out[new] = total[new] / norm[new]
        done |= new
        width *= 2.0
    return np.asarray(out, np.float32)
