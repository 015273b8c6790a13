"""How many disks: fit the candidates, add disks where light is left, drop those that the pixels do not need.

What is left is looked at as the image was at first: wide regions of the residual become candidates, and a
matched filter finds small ones. Groups that fit badly get other covers of the same pixels.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.imaging.detect.candidates import find_candidates
from contactimg.imaging.detect.peaks import FALSE_ALARM_SIGMA, filter_residual, find_peaks, least_peak
from contactimg.imaging.fit.disks import (
    FitControl,
    ModelImage,
    allow_for_coarse_rims,
    erase_disks,
    find_insignificant,
    fit_disks,
    largest_radii,
    reach_of,
)
from contactimg.imaging.fit.problem import CONTRAST, RADIUS, FitProblem, X, Y
from contactimg.imaging.fit.shapes import (
    EXACT_OPTICS,
    LEAST_ELONGATION,
    NO_ELLIPSES,
    Ellipses,
    find_ellipses,
    made_round,
)
from contactimg.imaging.fit.split_and_join import (
    LONG_RATIO,
    SETTLED_GROWTH_RATIO,
    Replacement,
    are_parts,
    find_better_covers,
    find_pairs_of_disks,
    join_disks,
)
from contactimg.imaging.kernels.pairs import are_entangled, find_pairs
from contactimg.imaging.pixels.blocks import SignedImage, block_means
from contactimg.imaging.pixels.robust import ROUGH_RATIO
from contactimg.imaging.profile import limits

GROWTH_RATIO = 1.3
"""Largest fitted radius over that of the candidate, besides one blur width. By hand."""


def assemble_disks(
    problem: FitProblem, seen: SignedImage, *, blur: float, free_blur: bool, shapes: str
) -> "Assembly":
    """Find and fit the disks of an image, with a loose prior of the contrasts.

    Parameters
    ----------
    problem : FitProblem
    seen : SignedImage
        Image of the problem.
    blur : float, px
        To start from, pixel included.
    free_blur : bool
        Fit the blur as well.
    shapes : {"auto", "disk", "ellipse", "free"}
        Whether ellipses are looked for.
    """
    contrast = problem.contrast
    found = find_candidates(seen, contrast, blur=blur)
    # Three times as many as contacts of two pixels in radius in a close packing, and five times the largest
    # crowd that was measured.
    most = min(int((1.0 / 40.0) * problem.image.size) + 1, 100_000)
    tiles = found.places[:most, :2] // 64
    near = np.lexsort((tiles[:, X], tiles[:, Y]))  # neighbours one after the other share what is in the cache
    disks, whole = found.places[near], found.whole[near]
    disks = np.column_stack([disks, np.full(len(disks), contrast)])
    largest = largest_radii(disks, problem.image.shape, blur, GROWTH_RATIO, 1.0)
    work = Assembly(problem, disks, largest, whole, blur=blur, free_blur=free_blur)
    if shapes == "auto":
        work.find_ellipses(whole, (LONG_RATIO, np.inf))
    work.drop_insignificant()
    # no more are added where they share so many pixels with their neighbours
    pairs = find_pairs(work.fit.disks, 0.5 * limits.EDGE_BLUR_WIDTHS * work.fit.blur)
    entangled = are_entangled(work.fit.disks, pairs, work.fit.blur, problem.image.size)
    work.limited = entangled or len(found.places) > most
    if work.limited:
        most = len(work.fit.disks)
    else:
        work.add_wide_residuals()
    work.add_peaks(most)
    if shapes == "auto":
        poor = work.fit.chi_square > limits.POOR_CHI_SQUARE * max(work.fit.usual_chi_square, 1.0)
        # neighbours that were not found made disks look slightly longer; pieces of a scratch are far longer
        work.find_ellipses(poor, (LEAST_ELONGATION, LONG_RATIO))
    if not work.limited and work.improve_covers():
        work.add_peaks(most, outside=True)
    if shapes == "auto":
        work.join_ellipses()
    work.drop_insignificant(final=True)
    return work


class Assembly:
    """Disks that together explain an image, while some are added, dropped and replaced.

    Attributes
    ----------
    problem : FitProblem
    fit : FittedDisks
    largest : ndarray, shape (n,), px
        Upper bounds of the radii.
    whole : ndarray of bool, shape (n,)
        Disks that stand for a region that is no disk, but one contact.
    dropped : ndarray, shape (m, 3)
        x, y, radius (px) of disks that were tried and are not needed.
    ellipses : Ellipses
        Disks that stand for ellipses in the image of the problem.
    smallest : float, px
        Radius of the smallest isolated disk that stands out of the noise.
    limited : bool
        Whether there were more candidates than are fitted.
    """

    def __init__(
        self, problem: FitProblem, disks: NDArray, largest: NDArray, whole: NDArray[np.bool_],
        *, blur: float, free_blur: bool,
    ):  # fmt: skip
        # disks in the place of ellipses would want a wider blur
        wanted = free_blur and bool(2 * np.count_nonzero(~whole) > len(disks))
        control = FitControl(wanted, robust=False, iterations=3)
        self.largest, self.whole, self.ellipses = largest, whole, NO_ELLIPSES
        self.dropped, self.smallest, self.limited = np.empty((0, 3)), 0.0, False
        fit = fit_disks(problem, disks, blur=blur, control=control, largest=largest)
        self.problem = allow_for_coarse_rims(problem, fit)
        if self.problem.noise.rim > 0.0:
            fit = fit_disks(self.problem, disks, blur=fit.blur, control=control, largest=largest)
            self.problem = allow_for_coarse_rims(problem, fit)
        self.fit = fit

    def add(self, disks: NDArray[np.float64]) -> None:
        """Add disks, which are free to grow, and drop those near them that are not significant."""
        added = Replacement(np.zeros(len(self.fit.disks), np.bool_), disks)
        self.drop_insignificant(self._exchange(added, 2.0 * disks[:, RADIUS] + 4.0 * self.fit.blur))

    def add_wide_residuals(self) -> None:
        """Add candidates from what the disks leave of the image: contacts that others hid or outshone."""
        problem, fit = self.problem, self.fit
        least = limits.IMPERFECT_RIM * problem.contrast
        # half of a square lies in any wide disk, and little of it in others
        light, model = (block_means(part, side=4) for part in (problem.image, fit.model))
        if float(np.max((light - model)[model < 0.5 * problem.contrast], initial=0.0)) < 0.5 * least:
            return
        rest = problem.image - fit.model
        seen = SignedImage(rest, problem.pixel_noise, problem.valid, rounding=problem.rounding)
        found = find_candidates(seen, problem.contrast, blur=fit.blur)
        wide = (found.places[:, RADIUS] > 2.0 * fit.blur) & (found.plateau > least)
        wide &= ~_near_rims(found.places, fit.disks, 0.0)
        disks = np.column_stack([found.places, found.plateau])[wide]
        if len(disks):
            differs = np.abs(disks[:, CONTRAST] / problem.contrast - 1.0) > 0.15
            odd = np.vstack([problem.prior.odd, disks[differs]])
            self.problem = replace(problem, prior=replace(problem.prior, odd=odd))
            self.add(disks)

    def add_peaks(self, most: int, *, outside: bool = False) -> None:
        """Add a disk for each peak that the disks leave, at most ``most`` in all.

        ``outside`` leaves out peaks in contacts of other shapes.
        """
        problem, fit, contrast = self.problem, self.fit, self.problem.contrast
        smooth = filter_residual(problem.image, fit.model, fit.blur)
        lowest = least_peak(smooth, problem.background, problem.rounding)
        peaks = find_peaks(smooth, lowest, fit.blur)
        if outside:
            peaks = peaks[~are_parts(peaks, fit.disks[self.whole], problem.image, 0.5 * contrast)]
        else:
            of_lowest = _disks_of_peaks(np.array([[0.0, 0.0, lowest]]), fit.blur, contrast)
            self.smallest = float(of_lowest[0, RADIUS])
        at_rim = _near_rims(peaks, fit.disks, limits.REACH_BLUR_WIDTHS * fit.blur)
        lowest_here = np.maximum(lowest, np.where(at_rim, limits.IMPERFECT_RIM * contrast, 0.0))
        peaks = peaks[peaks[:, 2] > lowest_here]
        mean, scatter = _residuals_around(problem.image, fit.model, peaks, fit.blur).T
        # By hand: light that no polynomial describes leaves ridges, on which 0.5 takes specks for contacts; 1
        # loses faint contacts.
        stands_out = peaks[:, 2] - mean > 0.8 * lowest
        # behind the filter white noise is smaller by this; rests of compression are less so
        behind = 2.0 / (2.0 * np.sqrt(np.pi) * fit.blur)
        rough = scatter > ROUGH_RATIO * problem.pixel_noise
        peaks = peaks[stands_out & (~rough | (peaks[:, 2] > FALSE_ALARM_SIGMA * behind * scatter))]
        room = max(most - len(fit.disks), 0)
        if len(peaks[:room]):
            self.add(_disks_of_peaks(peaks[:room], fit.blur, contrast))
        self.limited |= not outside and len(peaks) > room

    def drop_insignificant(self, among: NDArray[np.bool_] | None = None, *, final: bool = False) -> None:
        """Drop the disks (all, or among some) that the pixels do not need."""
        dropped = find_insignificant(self.fit, self.problem, final=final)
        dropped = dropped if among is None else among & dropped
        if dropped.any():
            disks = self.fit.disks
            self.dropped = np.vstack([self.dropped, disks[dropped, :3]])
            active = _neighbours(disks, dropped, limits.EDGE_BLUR_WIDTHS * self.fit.blur)[~dropped]
            self._exchange(Replacement(dropped, disks[:0]), np.empty(0), 4, active)

    def find_ellipses(self, tried: NDArray[np.bool_], elongation: tuple[float, float]) -> None:
        """Replace the regions that are ellipses by disks of equal area in the image."""
        found = find_ellipses(
            self.problem, self.fit, self.problem.prior, EXACT_OPTICS, among=tried, elongation=elongation
        )
        pairs = find_pairs_of_disks(self.problem, self.fit, found)
        self._replace(pairs)
        self._make_round(found.kept(~pairs.replaced))

    def join_ellipses(self) -> None:
        """Replace touching disks by ellipses where most contacts are ellipses."""
        joined = join_disks(self.problem, self.fit, self.ellipses)
        self._replace(joined)
        rows = len(self.fit.disks) - 1 - np.arange(len(joined.new))
        self._make_round(find_ellipses(self.problem, self.fit, self.problem.prior, EXACT_OPTICS, rows=rows))

    def _make_round(self, found: Ellipses) -> None:
        """Put disks of equal area in the place of ellipses, and fit all disks again."""
        if not len(found.rows):
            return
        changed = np.isin(np.arange(len(self.fit.disks)), found.rows)
        erase_disks(self.problem, self.fit, changed)
        self.problem, disks = made_round(self.problem, self.fit, found)
        rows = np.concatenate([self.ellipses.rows, found.rows])
        self.ellipses = Ellipses(rows, [*self.ellipses.fitted, *found.fitted], found.blur)
        self.largest = np.where(changed, 1.5 * disks[:, RADIUS] + 2.0 * self.fit.blur, self.largest)
        self._refit(disks, np.where(changed, -1, np.arange(len(disks))), 3)

    def improve_covers(self) -> bool:
        """Replace the disks of groups that fit badly by better covers; whether some are simpler ones."""
        covers = find_better_covers(self.problem, self.fit, self.ellipses)
        self._replace(covers)
        return bool(np.any(covers.whole))

    def _replace(self, covers: Replacement) -> None:
        """Put other disks of about the right size in the place of some."""
        if covers.replaced.any():
            self._exchange(covers, SETTLED_GROWTH_RATIO * covers.new[:, RADIUS])

    def _exchange(
        self, covers: Replacement, largest: NDArray, iterations: int = 5, active: NDArray | None = None
    ) -> NDArray[np.bool_]:
        """Put other disks, up to radii ``largest``, in the place of some, and fit: see `_refit`."""
        kept, new = np.flatnonzero(~covers.replaced), covers.new
        if covers.replaced.any():
            erase_disks(self.problem, self.fit, covers.replaced)
        self.ellipses = self.ellipses.kept(~covers.replaced)
        self.whole = np.concatenate([self.whole[kept], np.broadcast_to(covers.whole, len(new))])
        self.largest = np.concatenate([self.largest[kept], largest])
        rows = np.concatenate([kept, np.full(len(new), -1)])
        return self._refit(np.vstack([self.fit.disks[kept], new]), rows, iterations, active)

    def _refit(
        self, disks: NDArray, rows: NDArray[np.int64], iterations: int, active: NDArray | None = None
    ) -> NDArray[np.bool_]:
        """Fit the active disks, by default the new ones and their neighbours; which are active.

        ``rows`` are the rows of the disks in the present fit, -1 for new ones.
        """
        old = self.fit
        if active is None:
            active = _neighbours(disks, rows < 0, limits.EDGE_BLUR_WIDTHS * old.blur)
        # those farther off neither change the fit nor are changed by it
        part = _neighbours(disks, active, 2.0 * reach_of(self.problem.profile) * old.blur)
        control = FitControl(free_blur=False, robust=False, iterations=iterations)
        fit = fit_disks(
            self.problem, disks[part], blur=old.blur, control=control, largest=self.largest[part],
            active=active[part], start=ModelImage(old.model, rows[part] >= 0, shared=not part.all()),
        )  # fmt: skip
        # the disks held fixed keep their uncertainty and misfit
        self.fit = old.rearranged(rows, active, fit, active[part])
        return active


@njit(cache=True)
def _residuals_around(image, model, peaks, blur):
    """Mean and root mean square residual around each peak, the peak itself left out."""
    rows, columns = image.shape
    inner, outer = 2.0 * blur + 1.0, 4.0 * blur + 6.0
    out = np.zeros((len(peaks), 2))
    for i in range(len(peaks)):
        x, y = peaks[i, 0], peaks[i, 1]
        total, square, count = 0.0, 0.0, 0
        for row in range(max(int(y - outer), 0), min(int(y + outer) + 1, rows)):
            for column in range(max(int(x - outer), 0), min(int(x + outer) + 1, columns)):
                r = np.hypot(column - x, row - y)
                if inner < r < outer:
                    rest = image[row, column] - model[row, column]
                    total += rest
                    square += rest * rest
                    count += 1
        out[i, 0], out[i, 1] = total / max(count, 1), np.sqrt(square / max(count, 1))
    return out


def _near_rims(places: NDArray, disks: NDArray, reach: float) -> NDArray[np.bool_]:
    """Places in a disk or closer than ``reach`` to its rim."""
    points = np.column_stack([places[:, :2], np.zeros(len(places))])
    is_disk = np.arange(len(disks) + len(places)) < len(disks)
    return _neighbours(np.vstack([disks[:, :3], points]), is_disk, reach)[len(disks) :]


def _disks_of_peaks(peaks: NDArray, blur: float, contrast: float) -> NDArray[np.float64]:
    """Disk whose filtered image has the height of each peak."""
    height = np.clip(peaks[:, 2] / contrast, 1e-3, 0.9)
    radius = np.sqrt(-4.0 * blur**2 * np.log1p(-height))
    return np.column_stack([peaks[:, :2], radius, np.full(len(peaks), contrast)])


def _neighbours(disks: NDArray, changed: NDArray[np.bool_], gap: float) -> NDArray[np.bool_]:
    """The changed disks, and those whose rim is closer than ``gap`` to the rim of one."""
    out = changed.copy()
    i, j = find_pairs(disks, 0.5 * gap).T
    out[i[changed[j]]] = True
    out[j[changed[i]]] = True
    return out
