"""Least-squares fit of blurred disks to an image, all contacts of a frame together.

Each contact has a centre, a radius and a contrast. The model image is the sum of contrast x profile, minus
the light counted twice where contacts overlap. The blur is common to all contacts. Contrasts have a normal
prior, whose mean and width come from the wide contacts of the frame. The radius and contrast of a small disk
are degenerate, so the prior determines its contrast; a wide disk determines its own.

Each disk has a 4 x 4 block of the normal matrix, summed over its rim and interior; two disks whose windows
overlap have a 4 x 4 block between them (`contactimg.imaging.kernels.normal_equations`), and the linear system
is solved block by block (`contactimg.imaging.kernels.solve`). The common blur is one more unknown. Only what
looks at pixels or goes through pairs is compiled, each part alone: compiled code is optimised once more with
every compiled function that calls it.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.fit.problem import CONTRAST, RADIUS, WIDE_RADIUS_BLUR_WIDTHS, FitProblem
from contactimg.imaging.kernels.model_image import draw_disks
from contactimg.imaging.kernels.normal_equations import SATURATED, build_normal_equations, build_pair_blocks
from contactimg.imaging.kernels.pairs import (
    DEEPEST,
    are_entangled,
    count_touching,
    find_pairs,
    largest_move,
    overlapping,
    select_close,
    visible_share,
)
from contactimg.imaging.kernels.solve import marginal_variances, solve_coupled, take_steps
from contactimg.imaging.pixels.blocks import BLOCK
from contactimg.imaging.pixels.masks import for_kernel
from contactimg.imaging.pixels.robust import MAD_TO_STD, QUARTILE_TO_STD, SIGNIFICANT_SIGMA, quantile
from contactimg.imaging.profile.blurred_disk import INNER_BLUR_WIDTHS, PIXEL_VARIANCE, EdgeTable, disk_table
from contactimg.imaging.profile.limits import FAINT_FRACTION, FEW, SUSPICIOUS_CHI_SQUARE, USUAL_CHI_SQUARE

SHARPEST_BLUR_PX = 0.75
"""Blur, pixel included, below which a misfit at the rims is that of coarse pixels, not of the edge. By hand:
the edge then rises within 1.5 px."""
QUANTILES_TO_STD = {0.25: QUARTILE_TO_STD, 0.5: MAD_TO_STD}
"""Standard deviation of normal deviates over quantiles of their size: ``1/Phi^-1(1/2 + share/2)``."""
PAIR_MARGIN_PX = 2.0  # move of a rim (or 10 % of the blur) after which pairs are searched again; speed only
SMALLEST_BLUR_WIDTHS = 0.1  # least radius: keeps a disk from vanishing; accuracy
LEAST = (SMALLEST_BLUR_WIDTHS, FAINT_FRACTION)  # radius in blur widths, contrast over its mean
NARROWEST_BLUR_PX = PIXEL_VARIANCE**0.5  # theory: that of the pixel alone
WELL_FITTED_CHI_SQUARE = 3.0  # worse fits do not determine the blur or the contrast; by hand
GROWTH_RATIO, GROWTH_BLUR_WIDTHS = 1.5, 2.0
"""Bound of the growth of a disk in one fit, of its radius and in blur widths. By hand: no start is worse."""
BRIGHTEST_RATIO = 5.0
"""Largest contrast of a contact over the expected one. By hand."""


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
    tolerance: float = 0.1


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
    shared : bool
        Whether it contains other disks as well, which stay in it.
    """

    model: NDArray[np.float32]
    drawn: NDArray[np.bool_]
    complete: bool = True
    shared: bool = False

    @classmethod
    def blank(cls, shape: tuple[int, ...], n: int) -> "ModelImage":
        """A model image without a disk."""
        # the zeros of `numpy.zeros` become memory page by page as they are drawn on, which is slower
        return cls.over(np.empty(shape, np.float32), n)

    @classmethod
    def over(cls, model: NDArray[np.float32], n: int, *, complete: bool = True) -> "ModelImage":
        """Blank a model image that is not used any more; its memory is there already, which is faster.

        Left incomplete, it is not to be used after the fit.
        """
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
    information: NDArray[np.float64]
    blur_score: NDArray[np.float64]
    brightness: NDArray[np.float64]

    @property
    def usual_chi_square(self) -> float:
        """The median of the disks; 1 where there is none."""
        return float(np.median(self.chi_square)) if len(self.disks) else 1.0

    def rearranged(
        self, rows: NDArray[np.int64], fitted: NDArray[np.bool_], part: "FittedDisks", of: NDArray[np.bool_]
    ) -> "FittedDisks":
        """The disks in other ``rows`` (-1: new ones), those ``fitted`` as ``of`` the fit of a part."""
        values: dict[str, Any] = {}
        kept = rows >= 0
        for name, value in vars(self).items():
            if name not in ("blur", "model"):
                values[name] = np.empty((len(rows), *value.shape[1:]), value.dtype)
                values[name][kept] = value[rows[kept]]
                values[name][fitted] = vars(part)[name][of]
        return replace(part, **values)


def render_disks(
    disks: NDArray[np.float64], blur: float, shape: tuple[int, int], *, profile: EdgeTable | None = None,
    over: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:  # fmt: skip
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
    over : ndarray of float32 or None
        An image of this shape that is not used any more, whose memory is taken.

    Examples
    --------
    >>> image = render_disks(np.array([[8.0, 8.0, 4.0, 100.0]]), 1.0, (17, 17))
    >>> float(image[8, 8].round(1)), float(image.sum().round(-1))  # pi 4^2 x 100
    (100.0, 5030.0)
    """
    blank = ModelImage.blank(shape, len(disks)) if over is None else ModelImage.over(over, len(disks))
    everything = np.ones(len(disks), np.bool_)
    pairs = find_pairs(disks, 0.0)
    draw_disks(blank.model, disks, blur, blank.drawn, everything, pairs, profile or disk_table())
    return blank.model


def erase_disks(problem: FitProblem, fit: FittedDisks, erased: NDArray[np.bool_]) -> None:
    """Take some disks out of the model image of a fit, in place."""
    drawn, pairs = np.ones(len(fit.disks), np.bool_), find_pairs(fit.disks, 0.0)
    draw_disks(fit.model, fit.disks, fit.blur, drawn, ~erased, pairs, problem.profile)


def fit_disks(  # noqa: PLR0915 -- one iteration, whose parts share these arrays
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
    n, s, disks = len(disks), float(blur), np.array(disks, float)
    disks[:, RADIUS] = np.maximum(disks[:, RADIUS], SMALLEST_BLUR_WIDTHS * s)
    image, weight, table = problem.image, for_kernel(problem.valid, problem.saturated), problem.profile
    brightness = problem.brightness_at(disks) if brightness is None else brightness
    prior = _contrast_bounds(problem, disks, blur, brightness)
    if largest is None:
        largest = largest_radii(disks, image.shape, blur, GROWTH_RATIO, GROWTH_BLUR_WIDTHS)
    start = start or ModelImage.blank(image.shape, n)
    model, drawn, shared = start.model, start.drawn.copy(), start.shared
    started, before = np.ones(n, np.bool_) if active is None else active, disks
    moving, free_blur = started.copy(), control.free_blur
    reach = reach_of(table)
    far = 1.1 * reach
    # variance of a background pixel at each disk, its slope with the model level, its excess at the rim
    noise = problem.noise
    levels = np.column_stack([noise.variance / brightness, noise.slope / prior[0], np.full(n, noise.rim)])
    normals, inverse = np.zeros((n, 4, 4)), np.zeros((n, 4, 4))
    gradient, cross, blurs = np.zeros((n, 4)), np.zeros((n, 4)), np.zeros((n, 2))
    chi_square, pixels = np.ones(n), np.zeros(n, np.int64)
    saturated = bool((weight == SATURATED).any())
    near_pairs, paired, paired_blur = find_pairs(disks, far * s + PAIR_MARGIN_PX), disks.copy(), s
    pairs, blocks, count = np.empty((0, 2), np.int64), np.zeros((0, 4, 4)), 0
    for iteration in range(control.iterations):
        if s > 1.1 * paired_blur or largest_move(disks, paired) > PAIR_MARGIN_PX:
            wider_pairs = find_pairs(disks, far * s + PAIR_MARGIN_PX)
            if are_entangled(disks, select_close(wider_pairs, disks, 0.0), s, image.size):
                disks = before  # nothing that moved since is drawn
                break
            near_pairs, paired, paired_blur = wider_pairs, disks.copy(), s
        pairs, count = select_close(near_pairs, disks, reach * s), count + 1
        # isolated disks are their own model: nobody needs a drawing of them
        isolated = np.full(n, not saturated)
        isolated[pairs] = False
        draw_disks(model, disks, s, drawn, ~isolated | (drawn & ~moving), near_pairs, table, shared=shared)
        row_step = 1 if control.robust else (4 if iteration == 0 else 2)
        build_normal_equations(
            image, model, weight, disks, s, levels, prior, moving, isolated, control.robust, row_step, table,
            normals, inverse, gradient, cross, blurs, chi_square, pixels,
        )  # fmt: skip
        blocks = np.zeros((len(pairs), 4, 4))
        if len(pairs):
            build_pair_blocks(model, weight, disks, s, levels, started, pairs, table, blocks)
        change = 0.0
        if free_blur:
            chosen = moving & (disks[:, RADIUS] > s)
            if iteration > 0:
                # disks that fit worse than most, two taken for one say, would increase the blur
                usual = float(np.median(chi_square[moving]))
                chosen &= chi_square < max(WELL_FITTED_CHI_SQUARE, 2.0 * usual)
            change = _blur_step(s, *(part[chosen] for part in (inverse, cross, gradient, blurs, chi_square)))
        gradient[moving] -= change * cross[moving]
        steps = solve_coupled(inverse, gradient, moving, pairs, blocks)
        still = drawn & ~moving & (change == 0.0)
        draw_disks(model, disks, s, drawn, still, near_pairs, table, shared=shared)
        s = max(s + change, NARROWEST_BLUR_PX)
        # Accuracy; a rough fit only provides a start.
        blur_tolerance = 2e-3 if control.robust else 1e-2
        steady = abs(change) < blur_tolerance * s and (control.robust or iteration >= 1)
        free_blur = free_blur and not steady
        before = disks.copy()
        take_steps(disks, steps, moving, s, prior, largest, LEAST)
        blurs[:, 1] -= blurs[:, 0] * change + np.einsum("iu,iu->i", cross, disks - before)
        if steady:
            # quadratic convergence: the next step is of the order of this one squared over the blur
            longest = np.abs(steps[:, :CONTRAST]).max(axis=1)
            moving &= longest**2 >= control.tolerance * np.sqrt(inverse[:, RADIUS, RADIUS]) * s
        if not moving.any():
            break
    if start.complete and count > 0:
        draw_disks(model, disks, s, drawn, np.ones(n, np.bool_), find_pairs(disks, 0.0), table)
    information = np.empty((n, 5, 5))
    information[:, :4, :4], information[:, 4, 4] = normals, blurs[:, 0]
    information[:, :4, 4] = information[:, 4, :4] = cross
    std = np.sqrt(marginal_variances(normals, inverse, pairs, blocks, started))
    # the kernel takes derivatives of whole disks, but the part of a rim inside a neighbour has no information
    std = std / visible_share(disks)[:, None]
    return FittedDisks(disks, std, chi_square, pixels, s, model, information, blurs[:, 1].copy(), brightness)


def reach_of(table: EdgeTable) -> float:
    """Distance from a rim, in blur widths, within which it changes what others show."""
    # Theory: beyond 2.75 on either side, disks change each other by less than 1e-4.
    return 2.75 if table.outer <= INNER_BLUR_WIDTHS else table.outer


def _blur_step(
    s: float, inverse: NDArray, cross: NDArray, gradient: NDArray, blurs: NDArray, chi_square: NDArray
) -> float:
    """Gauss-Newton step of the common blur, with the parameters of each disk eliminated."""
    t, weight = np.einsum("iuv,iv->iu", inverse, cross), 1.0 / np.maximum(chi_square, 1.0)
    bottom = weight @ (blurs[:, 0] - np.einsum("iu,iu->i", cross, t))
    top = weight @ (blurs[:, 1] - np.einsum("iu,iu->i", gradient, t))
    return 0.0 if bottom <= 0.0 else float(min(max(top / bottom, -0.2 * s), 0.2 * s))


def largest_radii(
    disks: NDArray, shape: tuple[int, ...], blur: float, ratio: float, blur_widths: float
) -> NDArray[np.float64]:
    """Upper bounds of the radii; none for disks cut by the border, which may be larger than what is seen."""
    (x, y, a), (rows, columns) = disks[:, :3].T, shape
    cut = np.minimum.reduce([x, y, columns - 1 - x, rows - 1 - y]) < a + blur
    return np.where(cut, np.inf, ratio * a + blur_widths * blur)


def _contrast_bounds(problem: FitProblem, disks: NDArray, blur: float, brightness: NDArray) -> NDArray:
    """Mean and width of the prior of each contrast, and its upper bound, which is higher in dim light."""
    mean, std = problem.prior.of_disks(disks, blur)
    possible = problem.largest_contrast / np.minimum(brightness, 1.0)
    brightest = np.minimum(BRIGHTEST_RATIO * mean, np.maximum(possible, 1.01 * mean))
    return np.stack([mean, std, brightest])


def wide_disks(fit: FittedDisks) -> NDArray[np.bool_]:
    """Disks wide enough to show their own contrast and fitted well enough."""
    wide = fit.disks[:, RADIUS] > WIDE_RADIUS_BLUR_WIDTHS * fit.blur
    return np.asarray(wide & (fit.chi_square < WELL_FITTED_CHI_SQUARE) & (fit.std[:, CONTRAST] > 0))


def allow_for_coarse_rims(problem: FitProblem, fit: FittedDisks, *, share: float = 0.25) -> FitProblem:
    """The problem with the noise of its rims as large as their misfit.

    Parameters
    ----------
    problem : FitProblem
    fit : FittedDisks
        Of this problem, with all its disks in the model image.
    share : float
        Quantile of the residuals that decides, 0.25 or 0.5: the lower one, so that rims of disks still to be
        told apart hardly count.

    Notes
    -----
    Behind a blur s the places of the edge in neighbouring pixels are averaged: their variance is at most that
    of a place anywhere in a pixel, 1/12 px^2, times ``int g^2 = 1/(2 sqrt(pi) s)``. Compression that rounds
    the mean of a block rounds its detail at the rims as well: where it rounds all 64 coefficients of a block,
    which are 8 times its mean, by the same step, the error of a pixel is 8 times that of the mean.
    """
    plain = replace(problem.noise, rim=0.0)
    most = (BLOCK * problem.rounding) ** 2
    if fit.blur <= SHARPEST_BLUR_PX and len(problem.profile.powers):  # a film blurs its rim by itself
        slope = problem.contrast / (fit.blur * np.sqrt(2.0 * np.pi))
        most += PIXEL_VARIANCE / max(2.0 * np.sqrt(np.pi) * fit.blur, 1.0) * slope**2
    if not most:
        return replace(problem, noise=plain)
    # Accuracy: of so many pixels a thousand lie at rims and give their scatter to 4 %.
    every = max(int(np.sqrt(problem.image.size / 250_000)), 1)
    height, image = fit.model[::every] / problem.contrast, problem.image[::every]
    rim = (height > 0.2) & (height < 0.8)  # by hand
    if problem.valid is not None:
        rim &= problem.valid[::every] > 0
    if np.count_nonzero(rim) < FEW:
        return problem
    scatter = (image[rim] - fit.model[::every][rim]) ** 2 / (plain.variance * plain.at(height[rim]))
    excess = QUANTILES_TO_STD[share] ** 2 * quantile(scatter, share)
    if excess < USUAL_CHI_SQUARE:
        return replace(problem, noise=plain)
    rim_noise = min((excess - 1.0) * float(plain.at(0.5)), most / plain.variance)
    return replace(problem, noise=replace(plain, rim=rim_noise))


def find_insignificant(fit: FittedDisks, problem: FitProblem, *, final: bool) -> NDArray[np.bool_]:
    """Disks whose light is not significant, that lie in a larger one, or that are a faint part of another.

    A faint disk that stands alone is a faint contact. One that fits badly may be two close ones: it is
    dropped only in the ``final`` selection.
    """
    radius = fit.disks[:, RADIUS]
    weak = radius < 2.0 * SIGNIFICANT_SIGMA * fit.std[:, RADIUS]  # light goes as radius^2
    expected, _ = problem.prior.of_disks(fit.disks, fit.blur)
    beside = count_touching(fit.disks, 2.0 * fit.blur) > 0
    # one that was taken for a brighter one than it is may still be as bright as the others
    # By hand: a disk beside another is part of it below 0.4 of the contrast expected, or half a pixel.
    faint = (fit.disks[:, CONTRAST] < 0.4 * np.minimum(expected, problem.contrast)) & beside
    if not final:
        faint &= fit.chi_square < SUSPICIOUS_CHI_SQUARE
    dropped = np.asarray(weak | faint | ((radius < 0.5) & beside))
    # a disk that lies in a larger one is needed where the larger one is dropped
    dropped[~dropped] = overlapping(fit.disks[~dropped], DEEPEST)
    return dropped
