"""How many disks: fit the candidates, add disks where light is left, drop those that the pixels do not need.

What is left is looked at as the image was at first: wide regions of the residual become candidates, and a
matched filter finds small ones. Groups that fit badly get other covers of the same pixels.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.imaging.detect.candidates import find_candidates
from contactimg.imaging.detect.peaks import FALSE_ALARM_SIGMA, filter_residual, find_peaks, least_peak
from contactimg.imaging.fit.covers import (
    SETTLED_GROWTH_RATIO,
    Replacement,
    are_parts,
    find_better_covers,
    find_pairs_of_disks,
    join_disks,
)
from contactimg.imaging.fit.disks import (
    FitControl,
    FittedDisks,
    ModelImage,
    allow_for_coarse_rims,
    erase_disks,
    find_insignificant,
    fit_disks,
    reach_of,
)
from contactimg.imaging.fit.problem import RADIUS, FitProblem
from contactimg.imaging.fit.shapes import EXACT_OPTICS, NO_ELLIPSES, Ellipses, find_ellipses, made_round
from contactimg.imaging.kernels.pairs import are_entangled, find_pairs
from contactimg.imaging.pixels.blocks import SignedImage, block_means
from contactimg.imaging.profile.limits import EDGE_BLUR_WIDTHS, REACH_BLUR_WIDTHS
from contactimg.timings import stage

MOST_DISKS_PER_PX2 = 1.0 / 40.0
"""Disks over pixels at most: three times as many as contacts of two pixels in radius in a close packing."""
MOST_DISKS = 100_000
"""Disks of a frame at most; five times the largest crowd that was measured."""
GROWTH_RATIO = 1.3
"""Largest fitted radius over that of the candidate, besides one blur width. By hand."""
LEAST_RIM_PEAK = 0.12
"""Height of a residual peak near a rim that becomes a disk, of the contrast. By hand: for imperfect rims."""
ROUGH_RATIO = 1.5
"""Scatter of the residuals around a peak over the noise from which the peak must stand out of that scatter.
By hand: compression and sharpening ring beside contacts."""


@dataclass(frozen=True, eq=False)
class Assembled:
    """Disks that together explain an image.

    Parameters
    ----------
    problem : FitProblem
    fit : FittedDisks
    dropped : ndarray, shape (m, 3)
        x, y, radius (px) of disks that were tried and are not needed.
    smallest : float, px
        Radius of the smallest isolated disk that stands out of the noise.
    limited : bool
        Whether there were more candidates than are fitted.
    ellipses : Ellipses
        Disks that stand for ellipses in the image of the problem.
    """

    problem: FitProblem
    fit: FittedDisks
    dropped: NDArray[np.float64]
    smallest: float
    limited: bool
    ellipses: Ellipses


@stage("detection")
def assemble_disks(
    problem: FitProblem, seen: SignedImage, *, blur: float, free_blur: bool, shapes: str
) -> Assembled:
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
    most = min(int(MOST_DISKS_PER_PX2 * problem.image.size) + 1, MOST_DISKS)
    limited = len(found.places) > most
    (x, y, a), shape = found.places[:most].T, problem.image.shape
    disks = np.column_stack([found.places[:most], np.full(len(a), contrast)])
    # a disk cut by the border may be much larger than what is inscribed
    cut = np.minimum.reduce([x, y, shape[1] - 1 - x, shape[0] - 1 - y]) < a + blur
    largest = np.where(cut, np.inf, GROWTH_RATIO * a + blur)
    work = _Assembly(problem, disks, largest, found.whole[:most], blur=blur, free_blur=free_blur)
    if shapes == "auto":
        work.find_ellipses(found.whole[:most])
    work.drop_insignificant()
    limited |= work.is_entangled()
    if limited:
        most = len(work.fit.disks)
    else:
        work.add_wide_residuals()
    smallest, too_many = work.add_peaks(most)
    limited |= too_many
    if not limited and work.improve_covers():
        work.add_peaks(most, outside=True)
    if shapes == "auto":
        work.join_ellipses()
    work.drop_insignificant(final=True)
    return Assembled(work.problem, work.fit, np.vstack(work.dropped), smallest, limited, work.ellipses)


class _Assembly:
    """The disks of an image while some are added, dropped and replaced.

    Attributes
    ----------
    problem : FitProblem
    fit : FittedDisks
    largest : ndarray, shape (n,), px
        Upper bounds of the radii.
    whole : ndarray of bool, shape (n,)
        Disks that stand for a region that is no disk, but one contact.
    dropped : list of ndarray, shape (m, 3)
        x, y, radius of the disks dropped so far.
    ellipses : Ellipses
    """

    def __init__(
        self, problem: FitProblem, disks: NDArray, largest: NDArray, whole: NDArray[np.bool_],
        *, blur: float, free_blur: bool,
    ):  # fmt: skip
        # disks in the place of ellipses would want a wider blur
        wanted = free_blur and bool(2 * np.count_nonzero(~whole) > len(disks))
        control = FitControl(wanted, robust=False, iterations=3)
        self.largest, self.whole, self.ellipses = largest, whole, NO_ELLIPSES
        fit = fit_disks(problem, disks, blur=blur, control=control, largest=largest)
        self.problem = allow_for_coarse_rims(problem, fit)
        if self.problem.noise.rim > 0.0:
            fit = fit_disks(self.problem, disks, blur=fit.blur, control=control, largest=largest)
            self.problem = allow_for_coarse_rims(problem, fit)
        self.fit = fit
        self.dropped = [np.empty((0, 3))]

    def add(self, disks: NDArray[np.float64]) -> None:
        """Add disks, which are free to grow, and drop those near them that are not significant."""
        rows = np.concatenate([np.arange(len(self.fit.disks)), np.full(len(disks), -1)])
        self.largest = np.concatenate([self.largest, 2.0 * disks[:, RADIUS] + 4.0 * self.fit.blur])
        self.whole = np.concatenate([self.whole, np.zeros(len(disks), np.bool_)])
        active = self._refit(np.vstack([self.fit.disks, disks]), rows, 5)
        self.drop_insignificant(active)

    def is_entangled(self) -> bool:
        """Whether the disks share so many pixels with their neighbours that no more are added."""
        fit = self.fit
        pairs = find_pairs(fit.disks, 0.5 * EDGE_BLUR_WIDTHS * fit.blur)
        return are_entangled(fit.disks, pairs, fit.blur, self.problem.image.size)

    def add_wide_residuals(self) -> None:
        """Add candidates from what the disks leave of the image: contacts that others hid or outshone."""
        problem, fit = self.problem, self.fit
        rest, least = problem.image - fit.model, LEAST_RIM_PEAK * problem.contrast
        # half of a square lies in any wide disk, and little of it in others
        beside = block_means(fit.model, side=4) < 0.5 * problem.contrast
        if float(np.max(block_means(rest, side=4)[beside], initial=0.0)) < 0.5 * least:
            return
        seen = SignedImage(rest, problem.pixel_noise, problem.valid, rounding=problem.rounding)
        found = find_candidates(seen, problem.contrast, blur=fit.blur)
        wide = (found.places[:, 2] > 2.0 * fit.blur) & (found.plateau > least)
        if not wide.any():
            return
        places, plateau = found.places[wide], found.plateau[wide]
        inside = _near_rims(places, fit.disks, 0.0)
        places, plateau = places[~inside], plateau[~inside]
        if not len(places):
            return
        disks = np.column_stack([places, plateau])
        odd = np.vstack([problem.prior.odd, disks[np.abs(plateau / problem.contrast - 1.0) > 0.15]])
        self.problem = replace(problem, prior=replace(problem.prior, odd=odd))
        self.add(disks)

    def add_peaks(self, most: int, *, outside: bool = False) -> tuple[float, bool]:
        """Add a disk for each peak that the disks leave, at most ``most`` in all.

        ``outside`` leaves out peaks in contacts of other shapes. Returned are the radius of the smallest
        isolated disk that stands out of the noise, and whether peaks were left.
        """
        problem, fit, contrast = self.problem, self.fit, self.problem.contrast
        smooth = filter_residual(problem.image, fit.model, fit.blur)
        lowest = least_peak(smooth, problem.background, problem.rounding)
        peaks = find_peaks(smooth, lowest, fit.blur)
        smallest = float(_disks_of_peaks(np.array([[0.0, 0.0, lowest]]), fit.blur, contrast)[0, RADIUS])
        if outside:
            peaks = peaks[~are_parts(peaks, fit.disks[self.whole], problem.image, 0.5 * contrast)]
        at_rim = _near_rims(peaks, fit.disks, REACH_BLUR_WIDTHS * fit.blur)
        peaks = peaks[(peaks[:, 2] > np.maximum(lowest, np.where(at_rim, LEAST_RIM_PEAK * contrast, 0.0)))]
        scatter = _scatter_around(problem.image, fit.model, peaks, fit.blur)
        # behind the filter white noise is smaller by this; rests of compression are less so
        behind = 2.0 / (2.0 * np.sqrt(np.pi) * fit.blur)
        rough = scatter > ROUGH_RATIO * problem.pixel_noise
        peaks = peaks[~rough | (peaks[:, 2] > FALSE_ALARM_SIGMA * behind * scatter)]
        room = max(most - len(fit.disks), 0)
        if len(peaks[:room]):
            self.add(_disks_of_peaks(peaks[:room], fit.blur, contrast))
        return smallest, len(peaks) > room

    def drop_insignificant(self, among: NDArray[np.bool_] | None = None, *, final: bool = False) -> None:
        """Drop the disks (all, or among some) that the pixels do not need."""
        dropped = find_insignificant(self.fit, self.problem, final=final)
        dropped = dropped if among is None else among & dropped
        if not dropped.any():
            return
        self.dropped.append(self.fit.disks[dropped, :3])
        erase_disks(self.problem, self.fit, dropped)
        active = _near(self.fit.disks, dropped, self.fit.blur)[~dropped]
        self.largest, self.whole = self.largest[~dropped], self.whole[~dropped]
        self.ellipses = self.ellipses.kept(~dropped)
        self._refit(self.fit.disks[~dropped], np.flatnonzero(~dropped), 4, active)

    def find_ellipses(self, tried: NDArray[np.bool_]) -> None:
        """Replace the regions that are ellipses by disks of equal area in the image."""
        found = find_ellipses(self.problem, self.fit, self.problem.prior, EXACT_OPTICS, among=tried)
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
        self.ellipses = Ellipses(
            np.concatenate([self.ellipses.rows, found.rows]),
            [*self.ellipses.fitted, *found.fitted],
            found.blur,
        )
        self.largest = np.where(changed, 1.5 * disks[:, RADIUS] + 2.0 * self.fit.blur, self.largest)
        self._refit(disks, np.where(changed, -1, np.arange(len(disks))), 3)

    def improve_covers(self) -> bool:
        """Replace the disks of groups that fit badly by better covers; whether some are simpler ones."""
        covers = find_better_covers(self.problem, self.fit, self.whole)
        self._replace(covers)
        return bool(covers.whole.any())

    def _replace(self, covers: Replacement) -> None:
        """Put other disks in the place of some, and fit them and their neighbours."""
        if not covers.replaced.any():
            return
        erase_disks(self.problem, self.fit, covers.replaced)
        kept, new = np.flatnonzero(~covers.replaced), covers.new
        self.ellipses = self.ellipses.kept(~covers.replaced)
        self.whole = np.concatenate([self.whole[kept], covers.whole])
        self.largest = np.concatenate([self.largest[kept], SETTLED_GROWTH_RATIO * new[:, RADIUS]])
        rows = np.concatenate([kept, np.full(len(new), -1)])
        self._refit(np.vstack([self.fit.disks[kept], new]), rows, 5)

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
        # those farther off neither change the fit nor are changed by it
        part = _neighbours(disks, active, 2.0 * reach_of(self.problem.profile) * old.blur)
        control = FitControl(free_blur=False, robust=False, iterations=iterations)
        fit = fit_disks(
            self.problem, disks[part], blur=old.blur, control=control, largest=self.largest[part],
            active=active[part], start=ModelImage(old.model, rows[part] >= 0),
        )  # fmt: skip
        # the disks held fixed keep their uncertainty and misfit
        self.fit = old.rearranged(rows, active, fit, active[part])
        return active


@njit(cache=True)
def _scatter_around(image, model, peaks, blur):
    """Root mean square residual around each peak, the peak itself left out."""
    rows, columns = image.shape
    inner, outer = 2.0 * blur + 1.0, 4.0 * blur + 6.0
    out = np.zeros(len(peaks))
    for i in range(len(peaks)):
        x, y = peaks[i, 0], peaks[i, 1]
        total, count = 0.0, 0
        for row in range(max(int(y - outer), 0), min(int(y + outer) + 1, rows)):
            for column in range(max(int(x - outer), 0), min(int(x + outer) + 1, columns)):
                r = np.hypot(column - x, row - y)
                if inner < r < outer:
                    rest = image[row, column] - model[row, column]
                    total += rest * rest
                    count += 1
        out[i] = np.sqrt(total / max(count, 1))
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


def _near(disks: NDArray, changed: NDArray[np.bool_], blur: float) -> NDArray[np.bool_]:
    """The changed disks, and those whose rim they influence."""
    return _neighbours(disks, changed, EDGE_BLUR_WIDTHS * blur)


def _neighbours(disks: NDArray, changed: NDArray[np.bool_], gap: float) -> NDArray[np.bool_]:
    """The changed disks, and those whose rim is closer than ``gap`` to the rim of one."""
    out = changed.copy()
    i, j = find_pairs(disks, 0.5 * gap).T
    out[i[changed[j]]] = True
    out[j[changed[i]]] = True
    return out
