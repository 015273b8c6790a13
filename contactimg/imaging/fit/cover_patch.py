"""A group of disks with its surroundings: fits of other covers for its pixels, and what they leave over."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.contrast.noise import Noise
from contactimg.imaging.fit.disks import RADIUS, DiskFit, Prior, fit_disks, render_disks
from contactimg.imaging.pixels.masks import Mask
from contactimg.imaging.profile.blurred_disk import EdgeTable
from contactimg.imaging.shapes.peaks import find_peaks_near

REACH = 4.0  # blur widths about a group that its fit sees
AROUND = 2.0  # blur widths about a disk that belong to it
ITERATIONS = 15
LOOSE = 0.1  # relative width of the contrast's prior


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What all groups of a frame have in common.

    Parameters
    ----------
    image, valid
        As for `contactimg.imaging.fit.disks.fit_disks`.
    blur : float, px
    plateau : float
        Contrast, grey levels.
    noise : Noise
    table : EdgeTable or None
    keep : callable
        Which disks of a fit are needed.
    """

    image: NDArray[np.float32]
    valid: Mask
    blur: float
    plateau: float
    noise: Noise
    table: EdgeTable | None
    keep: Callable[[DiskFit], NDArray[np.bool_]]


@dataclass(frozen=True, eq=False)
class Patch:
    """The pixels about a group, other disks taken away.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
    valid : Mask
    corner : ndarray, shape (4,)
        Parameters of a disk in the frame minus those in the patch.
    noise : Noise
        At the group's illumination.
    frame : Surroundings
    """

    image: NDArray[np.float32]
    valid: Mask
    corner: NDArray[np.float64]
    noise: Noise
    frame: Surroundings
    _misfits: dict[bytes, NDArray[np.float32]] = field(default_factory=dict, init=False)

    @classmethod
    def about(
        cls, disks: NDArray, model: NDArray[np.float32], frame: Surroundings, *, brightness: float
    ) -> "Patch | None":
        """The patch about disks that a model image holds; None where nothing of it lies in the image."""
        reach = disks[:, RADIUS] + REACH * frame.blur
        low = np.maximum(np.floor((disks[:, :2].T - reach).min(axis=1)), 0).astype(int)
        high = np.maximum(np.ceil((disks[:, :2].T + reach).max(axis=1)).astype(int) + 1, 0)
        box = (slice(low[1], high[1]), slice(low[0], high[0]))
        if not frame.image[box].size:
            return None
        corner = np.array([low[0], low[1], 0.0, 0.0])
        own = render_disks(disks - corner, frame.blur, frame.image[box].shape, table=frame.table)
        return cls(
            frame.image[box] - model[box] + own,
            None if frame.valid is None else frame.valid[box],
            corner,
            Noise(frame.noise.variance / brightness, frame.noise.slope),
            frame,
        )

    def fit(self, disks: NDArray, largest: NDArray) -> tuple[NDArray[np.float64], float]:
        """The disks fitted, without those that are not needed, and the squares left over.

        ``largest`` bounds the radii.
        """
        while True:
            n = len(disks)
            found = fit_disks(
                self.image, self.valid, disks, blur=self.frame.blur, noise=self.noise,
                prior=Prior(np.full(n, self.frame.plateau), np.full(n, LOOSE * self.frame.plateau)),
                brightness=np.ones(n), free_blur=False, robust=False, table=self.frame.table,
                iterations=ITERATIONS, largest=largest,
            )  # fmt: skip
            kept = self.frame.keep(found)
            if kept.all() or not kept.any():
                return found.disks, self.squares(found.disks)
            disks, largest = found.disks[kept], largest[kept]

    def model(self, disks: NDArray) -> NDArray[np.float32]:
        """Image of some disks."""
        return render_disks(disks, self.frame.blur, self.image.shape, table=self.frame.table)

    def squares(self, disks: NDArray) -> float:
        """Squares of what the disks leave over, in units of the variance."""
        return float(self.misfit(disks).sum())

    def misfit(self, disks: NDArray) -> NDArray[np.float32]:
        """The same pixel by pixel."""
        known = disks.tobytes()
        if known not in self._misfits:
            self._misfits[known] = self._misfit(disks)
        return self._misfits[known]

    def _misfit(self, disks: NDArray) -> NDArray[np.float32]:
        model = self.model(disks)
        variance = np.maximum(model, np.float32(0.0))
        variance *= np.float32(self.noise.variance * self.noise.slope / self.frame.plateau)
        variance += np.float32(self.noise.variance)
        squares = np.square(np.subtract(self.image, model, out=model), out=model)
        squares /= variance
        if self.valid is not None:
            squares[self.valid == 0] = 0.0
        return squares

    def peak(self, disks: NDArray) -> NDArray[np.float64] | None:
        """The highest (x, y, height) of the light that disks leave over, as the blur smooths it."""
        peaks = find_peaks_near(self.image, self.model(disks), disks, width=self.frame.blur, lowest=0.0)
        return peaks[np.argmax(peaks[:, 2])] if len(peaks) else None

    def window(self, disk: NDArray) -> NDArray[np.bool_]:
        """The pixels that belong to a disk."""
        x, y = self.from_centre(disk)
        return np.asarray(np.hypot(x, y) < disk[RADIUS] + AROUND * self.frame.blur)

    def from_centre(self, disk: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Columns and rows counted from the centre of a disk, to be broadcast."""
        rows, columns = self.image.shape
        return np.arange(columns) - disk[0], np.arange(rows)[:, None] - disk[1]
