"""Least-squares fit of blurred disks to an image, all contacts of a frame together.

Each contact has a centre, a radius and a contrast; the model image is the sum of contrast x profile, less
what overlapping contacts share. The blur is one more unknown shared by all
(`contactimg.imaging.kernels.gauss_newton`). Contrasts carry a normal prior, whose mean and width come from
the frame's own large contacts: a small disk, whose radius and contrast cannot be told apart, borrows it, a
large one ignores it.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.contrast.noise import Noise
from contactimg.imaging.kernels.gauss_newton import WELL_FITTED, iterate, redraw
from contactimg.imaging.kernels.pairs import find_pairs
from contactimg.imaging.pixels.masks import Mask, for_kernel
from contactimg.imaging.profile.blurred_disk import EdgeTable, disk_table
from contactimg.imaging.shapes.overlap import visible_share
from contactimg.timings import stage

X, Y, RADIUS, CONTRAST = range(4)
"""Columns of the parameters of a disk."""

SETTLED = 0.1  # of its standard deviation: error of a radius at which the iteration ends
WIDE = 2.5  # blur widths: a larger contact shows its own contrast
UNKNOWN_SPREAD = 0.03
"""Spread of the contrasts, relative, of a frame whose contacts do not show it."""
ENOUGH = 3
"""Wide contacts that tell the contrast."""


@dataclass(frozen=True, eq=False)
class Prior:
    """Normal prior of the contrast of each contact.

    Parameters
    ----------
    mean, std : ndarray, shape (n,)
        Grey levels.
    """

    mean: NDArray[np.float64]
    std: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Drawing:
    """A model image to go on with.

    Parameters
    ----------
    model : ndarray of float32, shape (rows, columns)
    drawn : ndarray of bool, shape (n,)
        Which of the disks to fit it holds, as they are before the fit.
    complete : bool
        Whether all disks are to be in it after the fit.
    """

    model: NDArray[np.float32]
    drawn: NDArray[np.bool_]
    complete: bool = True

    @classmethod
    def partly(cls, shape: tuple[int, int], n: int) -> "Drawing":
        """Of those of ``n`` disks that a fit needs to see, and no more."""
        return cls(_blank(shape), np.zeros(n, np.bool_), complete=False)


@dataclass(frozen=True, eq=False)
class DiskFit:
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
        Number of pixels that enters it.
    blur : float, px
        Standard deviation of the profile's Gaussian, pixel included.
    model : ndarray, shape (rows, columns)
        Union of all disks.
    iterations : int
    settled : ndarray of bool, shape (n,)
        Whether the last step was below tolerance.
    information : ndarray, shape (n, 5, 5)
        Of x, y, radius, contrast with its prior, and blur.
    pull : ndarray, shape (n,)
        Derivative of the logarithm of the likelihood with respect to the blur.
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
    pull: NDArray[np.float64]

    def replace(self, **changes: Any) -> "DiskFit":
        """A copy with other fields."""
        return replace(self, **changes)


def render_disks(
    disks: NDArray[np.float64], blur: float, shape: tuple[int, int], *, table: EdgeTable | None = None
) -> NDArray[np.float32]:
    """Blurred disks; where two overlap, their union.

    Parameters
    ----------
    disks : ndarray, shape (n, 4)
        x, y, radius (px), contrast (grey levels).
    blur : float, px
        Pixel included.
    shape : (int, int)
    table : EdgeTable or None
        Profile; None for the uniform disk.

    Examples
    --------
    >>> image = render_disks(np.array([[8.0, 8.0, 4.0, 100.0]]), 1.0, (17, 17))
    >>> float(image[8, 8].round(1)), float(image.sum().round(-1))  # pi 4^2 x 100
    (100.0, 5030.0)
    """
    table = table or disk_table()
    model = _blank(shape)
    everything = np.ones(len(disks), np.bool_)
    redraw(model, disks, blur, ~everything, everything, find_pairs(disks, 0.0), table)
    return model


def erase_disks(
    model: NDArray[np.float32],
    disks: NDArray[np.float64],
    gone: NDArray[np.bool_],
    blur: float,
    *,
    table: EdgeTable | None = None,
) -> None:
    """Take some of the disks of a model image out of it, in place."""
    table = table or disk_table()
    redraw(model, disks, blur, np.ones(len(disks), np.bool_), ~gone, find_pairs(disks, 0.0), table)


@stage("fit")
def fit_disks(
    image: NDArray[np.float32],
    valid: Mask,
    disks: NDArray[np.float64],
    *,
    blur: float,
    noise: Noise,
    prior: Prior,
    brightness: NDArray[np.float64],
    free_blur: bool = True,
    robust: bool = True,
    active: NDArray[np.bool_] | None = None,
    table: EdgeTable | None = None,
    iterations: int = 12,
    tolerance: float = SETTLED,
    drawing: Drawing | None = None,
    largest: NDArray[np.float64] | None = None,
) -> DiskFit:
    """Fit all disks of an image.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Difference image, contacts positive.
    valid : Mask
        0 for pixels to leave out.
    disks : ndarray, shape (n, 4)
        Starting values.
    blur : float, px
        Starting value (or the value, if not free), pixel included.
    noise, prior
        Variance of a pixel and prior of the contrasts.
    brightness : ndarray, shape (n,)
        Relative illumination at each contact.
    free_blur : bool
        Fit the blur as well.
    robust : bool
        For a start that is close: pixels far off the model lose weight, and every row is used. Otherwise
        every second row of disks that have rows to spare.
    active : ndarray of bool or None
        Disks to move; the others stay as they are.
    table : EdgeTable or None
        Profile; None for the uniform disk.
    iterations : int
        At most.
    tolerance : float
        Error of a radius, in its standard deviations, at which a disk has settled.
    drawing : Drawing or None
        Model image to go on with (it is overwritten), and whether it is needed afterwards; None: from
        nothing.
    largest : ndarray or None, shape (n,), px
        Bounds of the radii.

    Returns
    -------
    DiskFit
    """
    table = table or disk_table()
    n = len(disks)
    moving = np.ones(n, np.bool_) if active is None else active.copy()
    result = iterate(
        image,
        for_kernel(valid),
        np.array(disks, float),
        float(blur),
        np.array([noise.variance, noise.slope]),
        np.stack([prior.mean, prior.std]) if n else np.zeros((2, 0)),
        np.ascontiguousarray(brightness, float),
        free_blur,
        robust,
        moving,
        table,
        iterations,
        tolerance,
        _blank(image.shape) if drawing is None else drawing.model,
        np.zeros(n, np.bool_) if drawing is None else drawing.drawn.copy(),
        drawing is None or drawing.complete,
        np.full(n, np.inf) if largest is None else largest,
    )
    fit = DiskFit(*result)
    # the derivatives are those of whole disks: what neighbours hide of a rim tells nothing about it
    return fit.replace(std=fit.std / visible_share(fit.disks)[:, None])


def _blank(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """An image of zeros (those of `numpy.zeros` become memory page by page as they are drawn on: slower)."""
    image = np.empty(shape, np.float32)
    image.fill(0.0)
    return image


def wide_disks(fit: DiskFit) -> NDArray[np.bool_]:
    """Disks wide enough to show their own contrast, as far as they fit."""
    wide = (fit.disks[:, RADIUS] > WIDE * fit.blur) & (fit.chi_square < WELL_FITTED)
    return np.asarray(wide & (fit.std[:, CONTRAST] > 0))


def contrast_prior(fit: DiskFit, *, plateau: float, inflation: NDArray[np.float64]) -> Prior:
    """Prior of the contrasts from the contacts wide enough to show their own.

    Parameters
    ----------
    fit : DiskFit
        With contrasts only loosely bound.
    plateau : float
        Contrast to assume when fewer than three contacts tell, with `UNKNOWN_SPREAD`.
    inflation : ndarray, shape (n,)
        Factor of the variance of each contrast for noise that neighbouring pixels share.

    Returns
    -------
    Prior
        Mean and spread of the contrasts beyond what their uncertainties explain.
    """
    n, wide = len(fit.disks), wide_disks(fit)
    values, stds = fit.disks[wide, CONTRAST], fit.std[wide, CONTRAST] * np.sqrt(inflation[wide])
    if len(values) < ENOUGH:
        return Prior(np.full(n, plateau), np.full(n, UNKNOWN_SPREAD * plateau))
    middle = float(np.median(values))
    usual = np.abs(values - middle) < 5.0 * 1.4826 * np.median(np.abs(values - middle)) + 1e-6 * middle
    values, stds = values[usual], stds[usual]
    excess = max(float(np.var(values) - np.mean(stds**2)), 0.0)
    weights = 1.0 / (stds**2 + excess)
    mean = float(np.average(values, weights=weights))
    std = float(np.sqrt(excess + 1.0 / weights.sum() + (1e-4 * mean) ** 2))
    return Prior(np.full(n, mean), np.full(n, std))
