"""How many disks: add one where the fit leaves light unexplained, drop one that the pixels do not need.

The first disks are inscribed in the regions above half the contrast. A disk is added at each significant
peak of the matched-filtered residual. It stays if its radius is significant and if it lies in a neighbour by
no more than two contacts can: otherwise it describes the ragged rim of the neighbour.
"""

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from contactimg.imaging.fit.coarse_rims import allow_for_coarse_rims, noise_near_contacts, rim_noise
from contactimg.imaging.fit.covers import find_better_covers
from contactimg.imaging.fit.disks import FitControl, FittedDisks, ModelImage, erase_disks, fit_disks
from contactimg.imaging.fit.problem import RADIUS, FitProblem
from contactimg.imaging.fit.settings import (
    INSCRIBED_GROWTH_RATIO,
    LARGEST_USUAL_CHI_SQUARE,
    LEAST_PEAK_FRACTION,
    NEIGHBOUR_GAP_BLUR_WIDTHS,
    REPLACED_GROWTH_RATIO,
    RIM_REACH_BLUR_WIDTHS,
    RINGING_REACH_PX,
    SMOOTHED_CONTRAST_TO_NOISE,
)
from contactimg.imaging.fit.significance import find_insignificant
from contactimg.imaging.kernels.normal_equations import REACH_BLUR_WIDTHS
from contactimg.imaging.kernels.pairs import find_pairs
from contactimg.imaging.detect.inscribed_disks import find_inscribed
from contactimg.imaging.detect.peaks import FALSE_ALARM_SIGMA, find_peaks
from contactimg.timings import stage

ADDING_ITERATIONS = 5
"""Gauss-Newton steps at most when disks are added. Accuracy."""
PEAK_PIXELS_BLUR_WIDTHS = np.pi * (2.0 + REACH_BLUR_WIDTHS) ** 2
"""Pixels of the disk at a peak, about two blur widths in radius, squared blur widths (theory)."""


@dataclass(frozen=True, eq=False)
class DetectedDisks:
    """Disks that together explain an image.

    Parameters
    ----------
    problem : FitProblem
        With the noise that the disks show at their rims and beside them.
    fit : FittedDisks
    dropped : ndarray, shape (m, 3)
        x, y, radius (px) of disks that were tried and found insignificant.
    smallest : float, px
        Radius of the smallest isolated disk that stands out of the noise.
    """

    problem: FitProblem
    fit: FittedDisks
    dropped: NDArray[np.float64]
    smallest: float


@stage("detection")
def assemble_disks(
    problem: FitProblem, *, blur: float, free_blur: bool, try_covers: bool = True
) -> DetectedDisks:
    """Find and fit the disks of an image.

    Parameters
    ----------
    problem : FitProblem
        With a loose prior of the contrasts.
    blur : float, px
        To start from, pixel included.
    free_blur : bool
        Fit the blur as well.
    try_covers : bool
        Try other covers of the groups that fit badly.

    Returns
    -------
    DetectedDisks
    """
    image, contrast = problem.image, problem.contrast
    disks, largest = _inscribed_disks(problem, blur)
    assembly = _Assembly(problem, disks, largest, blur=blur, free_blur=free_blur)
    assembly.drop_insignificant()
    fit, problem = assembly.fit, assembly.problem
    peaks, lowest = find_peaks(image, fit.model, width=fit.blur, height=0.0, background=problem.background)
    smallest = float(_disks_from_peaks(np.array([[0.0, 0.0, lowest]]), fit.blur, contrast)[0, RADIUS])
    lowest_at_rim = max(LEAST_PEAK_FRACTION * contrast, FALSE_ALARM_SIGMA * _rim_noise(problem, fit.blur))
    at_rim = _near_a_rim(peaks, fit.disks, RIM_REACH_BLUR_WIDTHS * fit.blur)
    peaks = peaks[(peaks[:, 2] > max(lowest, lowest_at_rim)) | ~at_rim]
    if assembly.ringing > 1.0:
        beside = _near_a_rim(peaks, fit.disks, RINGING_REACH_PX)
        peaks = peaks[(peaks[:, 2] > assembly.ringing * lowest) | ~beside]
    peaks = peaks[: problem.work.most_disks(ADDING_ITERATIONS, pixels=PEAK_PIXELS_BLUR_WIDTHS * fit.blur**2)]
    if len(peaks):
        assembly.add(_disks_from_peaks(peaks, fit.blur, contrast))
    if free_blur and not len(disks):
        assembly.free_blur()
    if try_covers:
        assembly.improve_covers()
    assembly.drop_insignificant(final=True)
    return DetectedDisks(assembly.problem, assembly.fit, np.vstack(assembly.dropped), smallest)


def _inscribed_disks(problem: FitProblem, blur: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Disks inscribed in what is above half the contrast, and the upper bounds of their radii."""
    contrast, shape = problem.contrast, problem.image.shape
    noisy = contrast < SMOOTHED_CONTRAST_TO_NOISE * np.sqrt(problem.noise.variance)
    places = find_inscribed(
        problem.image, 0.5 * contrast, smoothing=blur if noisy else 0.0, valid=problem.valid
    )
    x, y, a = places.T
    # a disk cut by the border may be much larger than what is inscribed
    cut = np.minimum.reduce([x, y, shape[1] - 1 - x, shape[0] - 1 - y]) < a + blur
    largest = np.where(cut, np.inf, INSCRIBED_GROWTH_RATIO * a + blur)
    return np.column_stack([places, np.full(len(places), contrast)]), largest


class _Assembly:
    """The disks of an image while some are added, dropped and replaced.

    Attributes
    ----------
    fit : FittedDisks
    largest : ndarray, shape (n,), px
        Upper bounds of the radii.
    dropped : list of ndarray, shape (m, 3)
        x, y, radius of the disks dropped so far.
    problem : FitProblem
        With the noise that the first disks show at their rims and beside them.
    ringing : float
        Noise beside the disks over that elsewhere.
    """

    def __init__(
        self, problem: FitProblem, disks: NDArray, largest: NDArray, *, blur: float, free_blur: bool
    ):
        control = FitControl(free_blur and len(disks) > 0, robust=False, iterations=3)
        fit = fit_disks(problem, disks, blur=blur, control=control, largest=largest)
        self.ringing = noise_near_contacts(problem, fit)
        problem = problem.with_noise(self.ringing**2 * problem.noise.variance)
        self.problem = allow_for_coarse_rims(problem, fit)
        if self.problem.noise.rim > 0.0:
            fit = fit_disks(self.problem, disks, blur=fit.blur, control=control, largest=largest)
            self.problem = allow_for_coarse_rims(problem, fit)
        self.fit = fit
        self.largest = largest
        self.dropped = [np.empty((0, 3))]

    def add(self, disks: NDArray[np.float64]) -> None:
        """Add disks, which are free to grow, and drop those near them that are not significant."""
        present = np.arange(len(self.fit.disks))
        self.largest = np.concatenate([self.largest, np.full(len(disks), np.inf)])
        active = self._refit(
            np.vstack([self.fit.disks, disks]), _append(present, -1, len(disks)), ADDING_ITERATIONS
        )
        self.drop_insignificant(active)

    def drop_insignificant(self, among: NDArray[np.bool_] | None = None, *, final: bool = False) -> None:
        """Drop the disks (all, or among some) that the pixels do not need."""
        dropped = find_insignificant(self.fit, self.problem.contrast, final=final)
        dropped = dropped if among is None else among & dropped
        if not dropped.any():
            return
        self.dropped.append(self.fit.disks[dropped, :3])
        erase_disks(self.problem, self.fit, dropped)
        active = _near(self.fit.disks, dropped, self.fit.blur)[~dropped]
        self.largest = self.largest[~dropped]
        self._refit(self.fit.disks[~dropped], np.flatnonzero(~dropped), 4, active)

    def free_blur(self) -> None:
        """Fit the blur too, after a start without wide disks, if that explains far more."""
        control, fit, problem = FitControl(robust=False, iterations=4), self.fit, self.problem
        misfit = float(np.median(fit.chi_square)) if len(fit.disks) else 0.0
        if misfit < LARGEST_USUAL_CHI_SQUARE:
            return
        for _ in range(2):
            fit = fit_disks(problem, fit.disks, blur=fit.blur, control=control, largest=self.largest)
            misfit_now = float(np.median(fit.chi_square))
            problem = allow_for_coarse_rims(problem, fit)
        if misfit_now < 0.5 * misfit:
            self.fit, self.problem = fit, problem

    def improve_covers(self) -> None:
        """Replace the disks of groups that fit badly by better covers of the same pixels."""
        covers = find_better_covers(self.problem, self.fit)
        if not covers.replaced.any():
            return
        erase_disks(self.problem, self.fit, covers.replaced)
        kept, new = np.flatnonzero(~covers.replaced), covers.new
        self.largest = np.concatenate([self.largest[kept], REPLACED_GROWTH_RATIO * new[:, RADIUS]])
        self._refit(np.vstack([self.fit.disks[kept], new]), _append(kept, -1, len(new)), 5)

    def _refit(
        self,
        disks: NDArray[np.float64],
        rows: NDArray[np.int64],
        iterations: int,
        active: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.bool_]:
        """Fit the active disks, by default the new ones and their neighbours; which are active.

        ``rows`` are the rows of the disks in the present fit, -1 for new ones.
        """
        old = self.fit
        active = _near(disks, rows < 0, old.blur) if active is None else active
        control = FitControl(free_blur=False, robust=False, iterations=iterations)
        fit = fit_disks(
            self.problem, disks, blur=old.blur, control=control, largest=self.largest, active=active,
            start=ModelImage(old.model, rows >= 0),
        )  # fmt: skip
        # the disks held fixed keep their uncertainty and misfit
        std, chi_square, pixels = fit.std.copy(), fit.chi_square.copy(), fit.pixels.copy()
        fixed, source = ~active, rows[~active]
        std[fixed], pixels[fixed] = old.std[source], old.pixels[source]
        chi_square[fixed] = old.chi_square[source]
        self.fit = replace(fit, std=std, chi_square=chi_square, pixels=pixels)
        return active


def _rim_noise(problem: FitProblem, blur: float) -> float:
    """Noise of a rim behind a filter of the blur's shape, where it exceeds that of the background."""
    if not problem.noise.rim > 0.0:
        return 0.0
    return rim_noise(problem.noise) * min(1.0 / (2.0 * np.sqrt(np.pi) * blur), 1.0)


def _append(rows: NDArray[np.int64], value: int, count: int) -> NDArray[np.int64]:
    """Rows followed by so many times a value."""
    return np.concatenate([rows, np.full(count, value)])


def _near_a_rim(peaks: NDArray, disks: NDArray, reach: float) -> NDArray[np.bool_]:
    """Peaks in a disk or closer than ``reach`` to its rim."""
    points = np.column_stack([peaks[:, :2], np.zeros(len(peaks))])
    is_disk = np.arange(len(disks) + len(peaks)) < len(disks)
    return _neighbours(np.vstack([disks[:, :3], points]), is_disk, reach)[len(disks) :]


def _disks_from_peaks(peaks: NDArray, blur: float, contrast: float) -> NDArray[np.float64]:
    """Disk whose filtered image has the height of each peak."""
    height = np.clip(peaks[:, 2] / contrast, 1e-3, 0.9)
    radius = np.sqrt(-4.0 * blur**2 * np.log1p(-height))
    return np.column_stack([peaks[:, :2], radius, np.full(len(peaks), contrast)])


def _near(disks: NDArray, changed: NDArray[np.bool_], blur: float) -> NDArray[np.bool_]:
    """The changed disks, and those whose rim they influence."""
    return _neighbours(disks, changed, NEIGHBOUR_GAP_BLUR_WIDTHS * blur)


@njit(cache=True)
def _neighbours(disks, changed, gap):
    """The changed disks, and those whose rim is closer than ``gap`` to the rim of one."""
    out = changed.copy()
    pairs = find_pairs(disks, 0.5 * gap)
    for p in range(len(pairs)):
        i, j = pairs[p]
        out[i] |= changed[j]
        out[j] |= changed[i]
    return out
