"""The window about a group of disks: fits of other covers of its pixels, and their misfit."""

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.detect.peaks import find_peaks_near
from contactimg.imaging.fit.disks import FitControl, FittedDisks, find_insignificant, fit_disks, render_disks
from contactimg.imaging.fit.problem import RADIUS, FitProblem

DISK_REACH_BLUR_WIDTHS = 2.0
"""Margin about a disk within which pixels count as its own. By hand."""
GROUP_ITERATIONS = 15
"""Gauss-Newton steps at most. Accuracy."""
GROUP_REACH_BLUR_WIDTHS = 4.0
"""Margin of the window about a group. Theory: a blurred edge is 3e-5 there."""

CONTROL = FitControl(free_blur=False, robust=False, iterations=GROUP_ITERATIONS)


class GroupWindow:
    """The pixels about a group of disks, with all other disks subtracted.

    Attributes
    ----------
    problem : FitProblem
        Of the window.
    blur : float, px
    offset : ndarray, shape (4,)
        Parameters of a disk in the image minus those in the window.
    """

    def __init__(self, problem: FitProblem, blur: float):
        self.problem = problem
        self.blur = blur
        self.offset = np.array([*problem.corner, 0.0, 0.0])
        self._misfits: dict[bytes, NDArray[np.float32]] = {}

    @classmethod
    def about(
        cls, problem: FitProblem, fit: FittedDisks, members: NDArray[np.int64], *, margin: float = 0.0
    ) -> "GroupWindow | None":
        """The window about some disks of a fit, and so far around; None if nothing lies in the image."""
        disks = fit.disks[members]
        reach = disks[:, RADIUS] + GROUP_REACH_BLUR_WIDTHS * fit.blur + margin
        low = np.maximum(np.floor((disks[:, :2].T - reach).min(axis=1)), 0).astype(int)
        high = np.maximum(np.ceil((disks[:, :2].T + reach).max(axis=1)).astype(int) + 1, 0)
        box = (slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0])))
        if not problem.image[box].size:
            return None
        offset = np.array([low[0], low[1], 0.0, 0.0])
        group = render_disks(disks - offset, fit.blur, problem.image[box].shape, profile=problem.profile)
        image = problem.image[box] - fit.model[box] + group
        brightness = float(np.median(problem.brightness_at(disks)))
        return cls(problem.window(box, image, brightness), fit.blur)

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        return self.problem.image.size

    def fit(self, disks: NDArray, largest: NDArray) -> tuple[NDArray[np.float64], float]:
        """The disks fitted, without the insignificant ones, and their chi-square.

        ``largest`` are upper bounds of the radii, px.
        """
        while True:
            fit = fit_disks(self.problem, disks, blur=self.blur, control=CONTROL, largest=largest)
            kept = ~find_insignificant(fit, self.problem, final=True)
            if kept.all() or not kept.any():
                return fit.disks, self.chi_square(fit.disks)
            disks, largest = fit.disks[kept], largest[kept]

    def model(self, disks: NDArray) -> NDArray[np.float32]:
        """Image of some disks."""
        return render_disks(disks, self.blur, self.problem.image.shape, profile=self.problem.profile)

    def chi_square(self, disks: NDArray) -> float:
        """Sum of the squared residuals of some disks in units of their variance."""
        return float(self.misfit(disks).sum())

    def misfit(self, disks: NDArray) -> NDArray[np.float32]:
        """The terms of `chi_square`, pixel by pixel; each set of disks is computed once."""
        key = disks.tobytes()
        if key not in self._misfits:
            self._misfits[key] = self.misfit_of(self.model(disks))
        return self._misfits[key]

    def misfit_of(self, model: NDArray[np.float32]) -> NDArray[np.float32]:
        """The same of any image."""
        problem = self.problem
        height = np.clip(model / np.float32(problem.contrast), np.float32(0.0), np.float32(1.0))
        residual = problem.image - model
        squares = np.square(residual) / (np.float32(problem.noise.variance) * problem.noise.at(height))
        if problem.valid is not None:
            squares[problem.valid == 0] = 0.0
        if problem.saturated is not None:
            squares[(problem.saturated == 1) & (residual < 0.0)] = 0.0
        return np.asarray(squares, np.float32)

    def highest_residual(self, disks: NDArray) -> NDArray[np.float64] | None:
        """x, y and height of the highest peak of the blurred residual."""
        image = self.problem.image
        peaks = find_peaks_near(image, self.model(disks), disks, width=self.blur, lowest=0.0)
        return peaks[np.argmax(peaks[:, 2])] if len(peaks) else None

    def small_disk(self, x: float, y: float) -> NDArray[np.float64]:
        """A disk as small as the blur, with the expected contrast."""
        return np.array([x, y, self.blur, self.problem.contrast])

    def pixels_of(self, disk: NDArray) -> NDArray[np.bool_]:
        """The pixels on and about a disk."""
        x, y = self.from_centre(disk)
        return np.asarray(np.hypot(x, y) < disk[RADIUS] + DISK_REACH_BLUR_WIDTHS * self.blur)

    def from_centre(self, disk: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Columns and rows counted from the centre of a disk, to be broadcast."""
        rows, columns = self.problem.image.shape
        return np.arange(columns) - disk[0], np.arange(rows)[:, None] - disk[1]
