"""Split a disk into several, or join several into one, where a group of disks fits badly (method "disk").

Inscribed disks and residual peaks find most contacts. They take two close contacts for one, and miss members
of a compact group. Where a fit is bad, other covers of the same pixels are tried: one more disk where light
is unexplained, a disk split in two or three. A cover is kept if it lowers chi-square by more than the price
of the disks it adds and if it removes most of the excess chi-square. The second condition distinguishes
contacts from a ragged rim, which several disks describe only a little better than one.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.detect.inscribed_disks import (
    LARGEST_WHOLE_HOLES,
    LEAST_CONVEX,
    as_one_contact,
    fill,
    find_holes,
    inscribed_in,
)
from contactimg.imaging.detect.peaks import FALSE_ALARM_SIGMA, filter_residual
from contactimg.imaging.fit import shapes
from contactimg.imaging.fit.contact_pixels import look_at_pixels
from contactimg.imaging.fit.disks import (
    WELL_FITTED_CHI_SQUARE,
    FitControl,
    FittedDisks,
    find_insignificant,
    fit_disks,
    render_disks,
)
from contactimg.imaging.fit.problem import CONTRAST, RADIUS, ContrastPrior, FitProblem, X, Y
from contactimg.imaging.kernels.pairs import count_touching, label_groups
from contactimg.imaging.pixels.masks import nearest_pixels
from contactimg.imaging.pixels.robust import CLIP_SIGMA
from contactimg.imaging.profile import limits

CONTROL = FitControl(free_blur=False, robust=False, iterations=limits.ITERATIONS)
SETTLED_GROWTH_RATIO, GROWTH_BLUR_WIDTHS = 1.1, 0.3
"""Largest fitted radius of a disk that is about right over that before, and an additional margin. By hand."""
DISK_PRICE = 40.0
"""Decrease of chi-square required for one more disk. Theory: 6^2 for 6 sigma, 4 for its parameters."""
EXCESS_LEFT_FRACTION = 0.35
"""Fraction of the excess chi-square that a new cover may leave. By hand."""
ENOUGH_TRIED = 20
"""Groups, or single disks, for which covers are tried in any case; more are tried only while a fifth of them
have one. By hand: in a frame with fewer the contacts are no disks."""
LONG_RATIO = 1.12
"""Ratio of the axes from which two disks are tried for an ellipse. By hand: two told apart make 1.24."""

Cover = tuple[NDArray[np.float64], float]
"""Fitted disks, and their chi-square."""


class GroupWindow:
    """The pixels about a group of disks, with all other disks subtracted.

    Attributes
    ----------
    problem : FitProblem
        Of the window.
    blur : float, px
    near : ndarray of bool
        Pixels that chi-square is summed over: all, or those on and about a few disks that fit badly, which
        wide neighbours would outweigh.
    offset : ndarray, shape (4,)
        Parameters of a disk in the image minus those in the window.
    corner : ndarray, shape (6,)
        The same for an ellipse.
    """

    def __init__(self, problem: FitProblem, blur: float):
        self.problem, self.blur, self.near = problem, blur, np.ones(problem.image.shape, np.bool_)
        self.corner = np.array([*problem.corner, 0.0, 0.0, 0.0, 0.0])
        self.offset = self.corner[:4]
        self._misfits: dict[bytes, NDArray[np.float32]] = {}

    @classmethod
    def about(
        cls, problem: FitProblem, fit: FittedDisks, members: NDArray[np.int64], *, margin: float = 0.0
    ) -> "GroupWindow | None":
        """The window about some disks of a fit, and so far around; None if nothing lies in the image."""
        disks = fit.disks[members]
        reach = disks[:, RADIUS] + limits.FIT_BLUR_WIDTHS * fit.blur + margin
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

    def fit(self, disks: NDArray, largest: NDArray) -> Cover:
        """The disks fitted, without the insignificant ones, and their chi-square.

        ``largest`` are upper bounds of the radii, px.
        """
        while True:
            fit = fit_disks(self.problem, disks, blur=self.blur, control=CONTROL, largest=largest)
            kept = ~find_insignificant(fit, self.problem, final=True)
            if kept.all() or not kept.any():
                self._misfits[fit.disks.tobytes()] = self.misfit_of(fit.model)
                return fit.disks, self.chi_square(fit.disks)
            disks, largest = fit.disks[kept], largest[kept]

    def model(self, disks: NDArray) -> NDArray[np.float32]:
        """Image of some disks."""
        return render_disks(disks, self.blur, self.problem.image.shape, profile=self.problem.profile)

    @property
    def pixels(self) -> int:
        """Number of pixels that chi-square is summed over."""
        return int(np.count_nonzero(self.near))

    def chi_square(self, disks: NDArray) -> float:
        """Sum of the squared residuals of some disks in units of their variance."""
        return float(self.misfit(disks)[self.near].sum())

    def misfit(self, disks: NDArray) -> NDArray[np.float32]:
        """The terms of `chi_square`, pixel by pixel; each set of disks is computed once."""
        key = disks.tobytes()
        if key not in self._misfits:
            self._misfits[key] = self.misfit_of(self.model(disks))
        return self._misfits[key]

    def misfit_of(self, model: NDArray[np.float32]) -> NDArray[np.float32]:
        """Square each residual of a model image over the expected variance."""
        problem = self.problem
        height = np.clip(model / np.float32(problem.contrast), np.float32(0.0), np.float32(1.0))
        residual = problem.image - model
        squares = np.square(residual) / (np.float32(problem.noise.variance) * problem.noise.at(height))
        if problem.valid is not None:
            squares[problem.valid == 0] = 0.0
        if problem.saturated is not None:
            squares[(problem.saturated == 1) & (residual < 0.0)] = 0.0
        return np.asarray(squares, np.float32)

    def pixels_of(self, *disks: NDArray) -> NDArray[np.bool_]:
        """The pixels on and about some disks."""
        near = np.zeros(self.problem.image.shape, np.bool_)
        for x, y, a, _ in disks:
            reach = a + limits.NEAR_BLUR_WIDTHS * self.blur
            left, top = max(int(x - reach), 0), max(int(y - reach), 0)
            part = near[top : max(int(y + reach) + 2, 0), left : max(int(x + reach) + 2, 0)]
            rows, columns = np.ogrid[: part.shape[0], : part.shape[1]]
            part |= np.hypot(columns + (left - x), rows + (top - y)) < reach
        return near

    def from_centre(self, disk: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Columns and rows counted from the centre of a disk, to be broadcast."""
        rows, columns = self.problem.image.shape
        return np.arange(columns) - disk[0], np.arange(rows)[:, None] - disk[1]


@dataclass(frozen=True, eq=False)
class Replacement:
    """Disks to take out of a fit and disks to put in their place.

    Parameters
    ----------
    replaced : ndarray of bool, shape (n,)
    new : ndarray, shape (m, 4)
        x, y, radius (px), contrast.
    whole : ndarray of bool, shape (m,), or bool
        Those that stand for one contact of another shape.
    """

    replaced: NDArray[np.bool_]
    new: NDArray[np.float64]
    whole: NDArray[np.bool_] | bool = False


def find_better_covers(problem: FitProblem, fit: FittedDisks, ellipses: shapes.Ellipses) -> Replacement:
    """Better covers of the groups that fit badly.

    Parameters
    ----------
    problem : FitProblem
        With a loose prior of the contrasts.
    fit : FittedDisks
        With all its disks in the model image.
    ellipses : Ellipses
        Disks that stand for ellipses: alone, they are not cut up.

    Returns
    -------
    Replacement
    """
    replaced, new, one = np.zeros(len(fit.disks), np.bool_), [np.empty((0, 4))], [np.empty(0, np.bool_)]
    median = fit.usual_chi_square
    usual = float(np.clip(median, 1.0, limits.USUAL_CHI_SQUARE))
    chance = FALSE_ALARM_SIGMA * np.sqrt(2.0 / np.maximum(fit.pixels, 1))
    limit = np.maximum(limits.SUSPICIOUS_CHI_SQUARE, 1.0 + chance)
    bad = fit.chi_square > limit * usual
    left_over = np.sqrt(np.maximum(fit.chi_square - 1.0, 0.0)) * problem.pixel_noise
    imperfect = bad & (left_over < limits.IMPERFECT_RIM * problem.contrast)
    if imperfect.any():
        seen = look_at_pixels(problem, fit, rows=np.flatnonzero(imperfect))
        imperfect[imperfect] = seen.elongation < shapes.LEAST_ELONGATION
    # the smallest groups, and of these the smallest disks first: wide ones that touch are told apart before
    groups = _groups_with(bad, fit.disks, limits.NEAR_BLUR_WIDTHS * fit.blur)
    order = sorted(groups, key=lambda members: (len(members), fit.disks[members, RADIUS].max()))
    # By hand: a crowd of which half is covered takes 0.7 of the pixels of the image.
    coarse, left = _no_finer_than_shapes(problem), 1.5 * problem.image.size
    tried, found = np.zeros((2, 2), np.int64)  # groups, and single disks
    for members in order:
        # a single disk must fit worse than most, as in a frame of ragged contacts all do, and be longer
        # than wide, as two disks are, or leave more than an imperfect rim, as three do
        usual_ones, alone = fit.chi_square[members] < limit[members] * median, len(members) == 1
        kind = int(alone)
        hopeless = tried[kind] >= ENOUGH_TRIED and tried[kind] > 5 * found[kind]
        if alone and (hopeless or usual_ones[0] or imperfect[members[0]] or members[0] in ellipses.rows):
            continue
        window = GroupWindow.about(coarse, fit, members)
        if window is None:
            continue
        left -= 3000.0 + window.near.size  # that many pixels take as long as the smallest group
        if left < 0.0:
            break
        disks = fit.disks[members] - window.offset
        # what a small part of the group leaves does not stand out of the noise of all its pixels
        if 2 * fit.pixels[members[bad[members]]].sum() < fit.pixels[members].sum():
            window.near = window.pixels_of(*disks[bad[members]])
        better = disks
        if not hopeless and len(members) <= 20:  # covers of larger groups take too long. By hand
            better = _find_cover(window, disks, usual)
            tried[kind] += 1
        if alone and len(better) == 2:
            one_ellipse = shapes.find_ellipses(coarse, fit, coarse.prior, shapes.EXACT_OPTICS, rows=members)
            # the first two that describe the pixels need not have settled
            better, chi_square = window.fit(better, np.full(2, np.inf))
            if any(_misfit(window, each) < chi_square for each in one_ellipse.fitted):
                continue
        simple = _simpler(window, better, usual)
        found[kind] += simple is None and better is not disks
        better, shaped = (better, np.zeros(len(better), np.bool_)) if simple is None else simple
        if better is not disks:
            replaced[members] = True
            new.append(better + window.offset)
            one.append(shaped)
    return Replacement(replaced, np.vstack(new), np.concatenate(one))


def _simpler(window: GroupWindow, disks: NDArray, usual: float) -> tuple[NDArray, NDArray[np.bool_]] | None:
    """The fewer disks that take the place of disks that do not describe a group; None if there are none.

    `_coarser_cover` proposes them. The more disks a group has, the more of the excess chi-square of the fewer
    they must remove to stay. Where they describe nothing, one contact of any shape may take their place. The
    second array says which of the fewer disks are proposed, and which stood beside them before.
    """
    lit = window.model(disks) > limits.FAINT_FRACTION * window.problem.contrast
    misfit = float(window.misfit(disks)[lit].mean()) / usual if lit.any() else 0.0
    if misfit < limits.USUAL_CHI_SQUARE:
        return None
    coarse, region = _coarser_cover(window, disks)
    if not len(coarse):
        return None
    beside = disks[:, CONTRAST] > 0.5 * coarse[0, CONTRAST]
    beside &= disks[:, RADIUS] < coarse[:, RADIUS].max()
    beside &= region[nearest_pixels(disks[:, X], disks[:, Y], region.shape)] == 0
    fewer = np.vstack([coarse, disks[beside]])
    moved = len(fewer) == len(disks) == 1 and np.abs(fewer - disks)[0, :3].max() > window.blur
    if len(fewer) > len(disks) - 2 and (misfit < WELL_FITTED_CHI_SQUARE or len(coarse) > 1):
        return None
    if len(fewer) > len(disks) - 1 and not moved:
        return None
    _, chi_square = window.fit(fewer, _bounds(window, fewer))
    expected = usual * window.pixels
    left = (window.chi_square(disks) - expected) * len(disks) / len(fewer)
    if left < EXCESS_LEFT_FRACTION * (chi_square - expected):
        return None
    return fewer, np.arange(len(fewer)) < len(coarse)


def are_parts(places: NDArray, disks: NDArray, image: NDArray[np.float32], level: float) -> NDArray[np.bool_]:
    """Whether places lie in disks, or are connected with their centres above a level."""
    if not len(disks) or not len(places):
        return np.zeros(len(places), np.bool_)
    labels = cv2.connectedComponents((image > level).astype(np.uint8), connectivity=8)[1]
    numbers = [labels[nearest_pixels(points[:, X], points[:, Y], image.shape)] for points in (places, disks)]
    apart = np.hypot(*(places[:, None, k] - disks[:, k] for k in (0, 1)))
    return (apart < disks[:, RADIUS]).any(axis=1) | np.isin(numbers[0], np.setdiff1d(numbers[1], [0]))


def _coarser_cover(window: GroupWindow, disks: NDArray) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """The disks inscribed in a group behind a wider blur with its holes filled, and the pixels of the group.

    The level is half of the median height within the disks of the group; a blur moves a rim there only in
    second order.
    """
    image, blur = window.problem.image, 2.0 * window.blur  # much coarser. By hand
    smooth = cv2.GaussianBlur(image, (0, 0), blur, borderType=cv2.BORDER_REPLICATE)
    inside = window.model(disks) > 0.5 * window.problem.contrast
    if not inside.any():
        return np.empty((0, 4)), np.zeros_like(inside, np.uint8)
    plateau = float(np.median(smooth[inside]))
    above = (smooth > 0.5 * plateau).astype(np.uint8)
    labels = cv2.connectedComponents(above, connectivity=8)[1]
    found, region = [np.empty((0, 3))], np.zeros_like(above)
    for k in np.setdiff1d(labels[inside], [0]):
        own = (labels == k).astype(np.uint8)
        cut = tuple(bool(side.any()) for side in (own[0], own[-1], own[:, 0], own[:, -1]))
        filled = fill(own, find_holes(own), LARGEST_WHOLE_HOLES * float(own.sum()))
        disks = inscribed_in(filled, cut)
        one = None if any(cut) or len(disks) > 1 else as_one_contact(filled, own, LEAST_CONVEX)
        found.append(disks if one is None else one)
        region |= filled
    places = np.vstack(found)
    return np.column_stack([places, np.full(len(places), plateau)]), region


def find_pairs_of_disks(problem: FitProblem, fit: FittedDisks, ellipses: shapes.Ellipses) -> Replacement:
    """Two disks of the common contrast in the place of each ellipse that describes its pixels worse.

    Both have as many parameters that the pixels determine: the likelihood decides.
    """
    replaced, new = np.zeros(len(fit.disks), np.bool_), [np.empty((0, 4))]
    common = replace(_no_finer_than_shapes(problem), prior=ContrastPrior.loose(problem.contrast))
    for row, ellipse in zip(ellipses.rows, ellipses.fitted, strict=True):
        major, minor = ellipse.half_axes
        margin = max(float(major - fit.disks[row, RADIUS]), 0.0)
        window = GroupWindow.about(common, fit, np.array([row]), margin=margin)
        if window is None or major < LONG_RATIO * minor:
            continue
        # only the pixels that the ellipse lights count: neighbours may still be described badly
        shape = window.problem.image.shape
        model = shapes.render_ellipse(ellipse.parameters - window.corner, window.blur, shape)
        near = model > limits.FAINT_FRACTION * problem.contrast
        misfit, expected = window.misfit_of(model)[near].sum(), np.count_nonzero(near)
        # wide disks leave dark notches between them, which an ellipse would not describe
        if minor > limits.CLEAR_BLUR_WIDTHS * fit.blur and misfit < expected + np.sqrt(2.0 * expected):
            continue
        covers = (disks for disks, _ in _larger_covers(window, fit.disks[[row]] - window.offset, 2))
        better = (two for two in covers if len(two) == 2 and window.misfit(two)[near].sum() < misfit)
        two = next(better, None)
        if two is not None:
            replaced[row] = True
            new.append(two + window.offset)
    return Replacement(replaced, np.vstack(new))


def join_disks(problem: FitProblem, fit: FittedDisks, ellipses: shapes.Ellipses) -> Replacement:
    """One disk, to become an ellipse, for disks that touch, where most contacts are ellipses.

    An ellipse takes their place unless they lower chi-square by the price of more disks.
    """
    replaced, new = np.zeros(len(fit.disks), np.bool_), [np.empty((0, 4))]
    touching = count_touching(fit.disks, fit.blur) > 0
    if not touching.any() or 2 * len(ellipses.rows) <= np.count_nonzero(~touching):
        return Replacement(replaced, new[0])
    touching[ellipses.rows] = False
    for members in _groups_with(touching, fit.disks, fit.blur):
        window = GroupWindow.about(_no_finer_than_shapes(problem), fit, members)
        if window is None or len(members) > 4:  # by hand: three disks in a row are an ellipse of 3 : 1
            continue
        disks = fit.disks[members] - window.offset
        share = disks[:, RADIUS] ** 2 / np.sum(disks[:, RADIUS] ** 2)
        centre, radius = share @ disks[:, :2], float(np.sqrt(np.sum(disks[:, RADIUS] ** 2)))
        away = (disks[:, 0] - centre[0] + 1j * (disks[:, 1] - centre[1])) ** 2
        turn = 0.3 * np.exp(1j * np.angle(share @ away))  # a start, by hand
        start = np.array([*centre, radius, turn.real, turn.imag, problem.contrast])
        ellipse = shapes.fit_ellipse(
            window.problem, start, blur=fit.blur, prior=(problem.contrast, problem.contrast),
            covariance=shapes.EXACT_OPTICS,
        )  # fmt: skip
        price = DISK_PRICE * (len(members) - 1)
        if _misfit(window, ellipse) < window.chi_square(disks) + price:
            replaced[members] = True
            x, y, a, _, _, c = ellipse.parameters
            new.append(np.array([[x, y, a, c]]))
    return Replacement(replaced, np.vstack(new), whole=True)


def _misfit(window: GroupWindow, ellipse: shapes.FittedEllipse) -> float:
    """Chi-square of an ellipse in a window."""
    model = shapes.render_ellipse(ellipse.parameters - window.corner, window.blur, window.problem.image.shape)
    return float(window.misfit_of(model)[window.near].sum())


def _no_finer_than_shapes(problem: FitProblem) -> FitProblem:
    """The problem with at least the noise by which the shapes of contacts differ from disks.

    Where there is hardly any noise, the pixel that a digitised disk has more on one side is significant.
    """
    variance = max(problem.noise.variance, (limits.LEAST_NOISE_FRACTION * problem.contrast) ** 2)
    return replace(problem, noise=replace(problem.noise, variance=variance))


def _groups_with(bad: NDArray[np.bool_], disks: NDArray, gap: float) -> Iterator[NDArray[np.int64]]:
    """Groups of disks with gaps below ``gap``, directly or through others, that contain a bad one."""
    if not bad.any():
        return
    labels = label_groups(disks, gap)
    order = np.argsort(labels, kind="stable")
    for label in np.unique(labels[bad]):
        yield order[slice(*np.searchsorted(labels[order], [label, label + 1]))]


def _find_cover(window: GroupWindow, disks: NDArray, usual: float) -> NDArray[np.float64]:
    """A better cover than the present disks, or the same array if there is none."""
    expected = usual * window.pixels
    slack = CLIP_SIGMA * usual * np.sqrt(2.0 * window.pixels)
    first = chi_square = window.chi_square(disks)
    allowed = expected + max(EXCESS_LEFT_FRACTION * (first - expected), slack)
    best = disks
    unsettled = first < limits.POOR_CHI_SQUARE * expected
    for number in range(-1 if unsettled else 0, limits.ROUNDS):
        if chi_square < expected + slack:
            break
        count, before = len(best), chi_square
        # at first the same disks again
        again, least = number < 0, np.inf
        for cover in [window.fit(best, np.full(count, np.inf))] if again else _larger_covers(window, best):
            cost = cover[1] + DISK_PRICE * (len(cover[0]) - count)
            if cost < least:
                least, cheapest = cost, cover
            if len(cover[0]) > count and cover[1] < expected + slack:
                break  # it describes the pixels
        gain = chi_square - least
        if gain > 0.0:
            best, chi_square = cheapest
        same = len(best) == count and gain <= 0.0
        # rounds that gain as much as this one are not enough
        hopeless = chi_square - (before - chi_square) * (limits.ROUNDS - 1 - number) > allowed
        if not again and (same or hopeless):
            break
    return disks if chi_square > allowed else best


def _larger_covers(window: GroupWindow, disks: NDArray, most: int = 3) -> Iterator[Cover]:
    """Covers with one disk or two more than before; a disk is split in ``most`` at most."""
    # a disk as small as the blur where the residual behind the blur is highest
    model = window.model(disks)
    smooth = filter_residual(window.problem.image, model, window.blur)
    row, column = np.unravel_index(np.argmax(smooth), smooth.shape)
    more = np.vstack([disks, np.array([column, row, window.blur, window.problem.contrast])])
    yield window.fit(more, np.full(len(more), np.inf))
    residual = window.problem.image - model
    parts = (residual[window.pixels_of(disk)] for disk in disks)
    mean_squares = [np.sum(part**2) / max(part.size, 1) for part in parts]
    worst = int(np.argmax(mean_squares))
    others = np.delete(disks, worst, axis=0)
    for count in range(2, most + 1):
        pieces = _split(window, residual, disks[worst], count)
        largest = np.append(_bounds(window, others), np.full(count, disks[worst, RADIUS]))
        yield window.fit(np.vstack([others, pieces]), largest)


def _bounds(window: GroupWindow, disks: NDArray) -> NDArray[np.float64]:
    """Upper bounds of the radii of disks that are about right."""
    return np.asarray(SETTLED_GROWTH_RATIO * disks[:, RADIUS] + GROWTH_BLUR_WIDTHS * window.blur)


def _split(window: GroupWindow, residual: NDArray, disk: NDArray, count: int) -> NDArray[np.float64]:
    """Two or three touching disks with the area of one, turned to where light is unexplained."""
    x, y = window.from_centre(disk)
    light = np.where(window.pixels_of(disk), residual, 0.0)
    angle = np.angle(np.sum(light * (x + 1j * y) ** count)) / count
    a = disk[RADIUS] / np.sqrt(count)
    angles = angle + 2.0 * np.pi * np.arange(count) / count
    pieces = np.tile(np.array([disk[0], disk[1], a, disk[3]]), (count, 1))
    pieces[:, :2] += a / np.sin(np.pi / count) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return pieces
