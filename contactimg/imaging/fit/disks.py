"""Least-squares fit of blurred disks to an image, all contacts of a frame together.

Each contact has a centre, a radius and a contrast. The model image is the sum of contrast x profile, minus
the light counted twice where contacts overlap. The blur is common to all contacts
(`contactimg.imaging.kernels.gauss_newton`). Contrasts have a normal prior, whose mean and width come from
the wide contacts of the frame. The radius and contrast of a small disk are degenerate, so the prior
determines its contrast; a wide disk determines its own.
"""

from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.detect.overlap import visible_share
from contactimg.imaging.fit.problem import CONTRAST, RADIUS, WIDE_RADIUS_BLUR_WIDTHS, FitProblem
from contactimg.imaging.kernels.gauss_newton import (
    WELL_FITTED_CHI_SQUARE,
    draw_disks,
    iterate,
)
from contactimg.imaging.kernels.pairs import find_pairs
from contactimg.imaging.pixels.masks import for_kernel
from contactimg.imaging.profile.blurred_disk import EdgeTable, disk_table
from contactimg.timings import stage

GROWTH_RATIO, GROWTH_BLUR_WIDTHS = 1.5, 2.0
"""Bound of the growth of a disk in one fit, of its radius and in blur widths. By hand: no start is further
off."""
BRIGHTEST_RATIO = 5.0
"""Largest contrast of a contact over the expected one. By hand."""
RADIUS_TOLERANCE_SIGMA = 0.1
"""Error of a radius at which a disk has settled. Accuracy."""


@dataclass(frozen=True)
class FitControl:
    """How to iterate.

    Parameters
    ----------
    free_blur : bool
        Fit the blur as well.
    robust : bool
        For a start close to the solution: pixels far off the model lose weight, and every row is used.
        Otherwise every second row of wide disks.
    iterations : int
        At most.
    tolerance : float
        Error of a radius, in its standard uncertainties, at which a disk has settled.
    """

    free_blur: bool = True
    robust: bool = True
    iterations: int = 12
    tolerance: float = RADIUS_TOLERANCE_SIGMA


@dataclass(frozen=True, eq=False)
class ModelImage:
    """A model image to continue with; the fit overwrites it.

    Parameters
    ----------
    model : ndarray of float32, shape (rows, columns)
    drawn : ndarray of bool, shape (n,)
        Which of the disks to fit it contains, as they are before the fit.
    complete : bool
        Whether it shall contain all disks after the fit.
    """

    model: NDArray[np.float32]
    drawn: NDArray[np.bool_]
    complete: bool = True

    @classmethod
    def blank(cls, shape: tuple[int, ...], n: int, *, complete: bool = True) -> "ModelImage":
        """Without a disk; left incomplete, it is not to be used after the fit."""
        # the zeros of `numpy.zeros` become memory page by page as they are drawn on, which is slower
        return cls.over(np.empty(shape, np.float32), n, complete=complete)

    @classmethod
    def over(cls, model: NDArray[np.float32], n: int, *, complete: bool = True) -> "ModelImage":
        """The same in the memory of a model image that is not used any more, which is faster."""
        model.fill(0.0)
        return cls(model, np.zeros(n, np.bool_), complete)


@dataclass(frozen=True, eq=False)
class FittedDisks:
    """Disks fitted to an image.

    Parameters
    ----------
    disks : ndarray, shape (n, 4)
        x, y, radius (px), contrast (grey levels).
    std : ndarray, shape (n, 4)
        Their standard uncertainties from the Fisher information, neighbours included.
    chi_square : ndarray, shape (n,)
        Mean squared residual about the rim, in units of the expected variance.
    pixels : ndarray, shape (n,)
        Number of pixels in it.
    blur : float, px
        Standard deviation of the profile's Gaussian, pixel included.
    model : ndarray, shape (rows, columns)
        Union of all disks.
    iterations : int
    settled : ndarray of bool, shape (n,)
        Whether the last step was below tolerance.
    information : ndarray, shape (n, 5, 5)
        Fisher information of x, y, radius, contrast (with its prior) and blur.
    blur_score : ndarray, shape (n,)
        Derivative of the log-likelihood with respect to the blur.
    brightness : ndarray, shape (n,)
        Relative illumination at each disk.
    """

    disks: NDArray[np.float64]
    std: NDArray[np.float64]
    chi_square: NDArray[np.float64]
    pixels: NDArray[np.int64]
    blur: float
    model: NDArray[np.float32]
    iterations: int
    settled: NDArray[np.bool_]
    information: NDArray[np.float64]
    blur_score: NDArray[np.float64]
    brightness: NDArray[np.float64]


def render_disks(
    disks: NDArray[np.float64], blur: float, shape: tuple[int, int], *, profile: EdgeTable | None = None
) -> NDArray[np.float32]:
    """Image of blurred disks; where two overlap, of their union.

    Parameters
    ----------
    disks : ndarray, shape (n, 4)
        x, y, radius (px), contrast (grey levels).
    blur : float, px
        Standard deviation, pixel included.
    shape : (int, int)
    profile : EdgeTable or None
        None for the uniform disk.

    Examples
    --------
    >>> image = render_disks(np.array([[8.0, 8.0, 4.0, 100.0]]), 1.0, (17, 17))
    >>> float(image[8, 8].round(1)), float(image.sum().round(-1))  # pi 4^2 x 100
    (100.0, 5030.0)
    """
    blank = ModelImage.blank(shape, len(disks))
    everything = np.ones(len(disks), np.bool_)
    pairs = find_pairs(disks, 0.0)
    draw_disks(blank.model, disks, blur, blank.drawn, everything, pairs, profile or disk_table())
    return blank.model


def erase_disks(problem: FitProblem, fit: FittedDisks, erased: NDArray[np.bool_]) -> None:
    """Take some disks out of the model image of a fit, in place."""
    drawn = np.ones(len(fit.disks), np.bool_)
    if 2 * np.count_nonzero(erased) > len(drawn):  # those that stay are sooner drawn anew
        fit.model.fill(0.0)
        drawn[:] = False
    pairs = find_pairs(fit.disks, 0.0)
    draw_disks(fit.model, fit.disks, fit.blur, drawn, ~erased, pairs, problem.profile)


@stage("fit")
def fit_disks(
    problem: FitProblem,
    disks: NDArray[np.float64],
    *,
    blur: float,
    control: FitControl = FitControl(),
    brightness: NDArray[np.float64] | None = None,
    largest: NDArray[np.float64] | None = None,
    active: NDArray[np.bool_] | None = None,
    start: ModelImage | None = None,
) -> FittedDisks:
    """Fit all disks of an image.

    Parameters
    ----------
    problem : FitProblem
    disks : ndarray, shape (n, 4)
        Starting values.
    blur : float, px
        Starting value (or the value, if not free), pixel included.
    control : FitControl
    brightness : ndarray or None, shape (n,)
        Relative illumination at each disk; None: that of the problem at the starting values.
    largest : ndarray or None, shape (n,), px
        Upper bounds of the radii.
    active : ndarray of bool or None, shape (n,)
        Disks to fit; the others stay as they are.
    start : ModelImage or None
        Model image to continue with; None: a blank one.

    Returns
    -------
    FittedDisks

    """
    n = len(disks)
    brightness = problem.brightness_at(disks) if brightness is None else brightness
    start = start or ModelImage.blank(problem.image.shape, n)
    fitted, std, chi_square, pixels, blur, model, steps, settled, information, blur_score = iterate(
        problem.image,
        for_kernel(problem.valid, problem.saturated),
        np.array(disks, float),
        float(blur),
        np.array(astuple(problem.noise)),
        _contrast_bounds(problem, disks, blur, brightness),
        np.ascontiguousarray(brightness, float),
        control.free_blur,
        control.robust,
        np.ones(n, np.bool_) if active is None else active.copy(),
        problem.profile,
        control.iterations,
        control.tolerance,
        start.model,
        start.drawn.copy(),
        start.complete,
        _largest_radii(problem, disks, blur) if largest is None else largest,
    )
    # the kernel takes derivatives of whole disks, but the part of a rim inside a neighbour has no information
    std = std / visible_share(fitted)[:, None]
    return FittedDisks(
        fitted, std, chi_square, pixels, blur, model, steps, settled, information, blur_score, brightness
    )


def _largest_radii(problem: FitProblem, disks: NDArray, blur: float) -> NDArray[np.float64]:
    """Upper bounds of the radii of disks that are about right; none for those cut by the border."""
    (x, y, a), (rows, columns) = disks[:, :3].T, problem.image.shape
    cut = np.minimum.reduce([x, y, columns - 1 - x, rows - 1 - y]) < a + blur
    return np.where(cut, np.inf, GROWTH_RATIO * a + GROWTH_BLUR_WIDTHS * blur)


def _contrast_bounds(
    problem: FitProblem, disks: NDArray, blur: float, brightness: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Mean and width of the prior of each contrast, and its upper bound, which is higher in dim light."""
    mean, std = problem.prior.of_disks(disks, blur)
    possible = problem.largest_contrast / np.minimum(brightness, 1.0)
    brightest = np.minimum(BRIGHTEST_RATIO * mean, np.maximum(possible, 1.01 * mean))
    return np.stack([mean, std, brightest])


def wide_disks(fit: FittedDisks) -> NDArray[np.bool_]:
    """Disks wide enough to show their own contrast and fitted well enough."""
    wide = fit.disks[:, RADIUS] > WIDE_RADIUS_BLUR_WIDTHS * fit.blur
    return np.asarray(wide & (fit.chi_square < WELL_FITTED_CHI_SQUARE) & (fit.std[:, CONTRAST] > 0))
