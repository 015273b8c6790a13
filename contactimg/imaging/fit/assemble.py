"""How many disks: add one where the fit leaves light over, drop one that the pixels do not need.

A disk is added where the matched-filtered residual stands out; it stays if its radius is significant and if
it does not lie in a neighbour by more than contacts of two bodies can: then it describes the neighbour's
ragged rim, no contact.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from contactimg.imaging.contrast.noise import Noise
from contactimg.imaging.fit.covers import Regrouping, regroup_disks
from contactimg.imaging.fit.disks import (
    CONTRAST,
    RADIUS,
    DiskFit,
    Drawing,
    Prior,
    erase_disks,
    fit_disks,
)
from contactimg.imaging.kernels.pairs import find_pairs
from contactimg.imaging.pixels.masks import Mask
from contactimg.imaging.profile.blurred_disk import EdgeTable
from contactimg.imaging.shapes.inscribed_disks import find_inscribed
from contactimg.imaging.shapes.overlap import DEEPEST, count_touching, overlapping
from contactimg.imaging.shapes.peaks import find_peaks, find_peaks_near
from contactimg.timings import stage

LEAST_HEIGHT = 0.12  # of the contrast: smaller residual peaks belong to an imperfect rim ...
RIM = 5.0  # blur widths: ... if they are as close to one as that
SIGNIFICANT = 5.0  # standard deviations of the light of a disk
SETTLED = 1.1  # of a disk that was fitted before: what grows more runs away
GROWTH = 1.3  # of an inscribed disk: one that grows more takes in its neighbours
FAINTEST = 0.4  # of the contrast
SPECK = 0.5  # px: what is smaller than a pixel and touches a contact is its rim
QUIET = 12.0  # contrast/noise below which noise would make holes at half height
ROUNDS = 4
SUSPICIOUS = 1.3  # chi-square of a disk beside which another is looked for again
LOOSE = 0.1  # relative width of the contrast's prior before the frame's own spread is known


@dataclass(frozen=True, eq=False)
class Assembly:
    """Disks that together explain an image.

    Parameters
    ----------
    fit : DiskFit
    dropped : ndarray, shape (m, 3)
        x, y, radius of disks that were tried and found insignificant.
    smallest : float, px
        Radius of a disk, away from others, that just stands out of the noise.
    """

    fit: DiskFit
    dropped: NDArray[np.float64]
    smallest: float


@dataclass(frozen=True, eq=False)
class _Start:
    """Disks to fit, the largest radius that each may take, and its row in the fit before (-1: new)."""

    disks: NDArray[np.float64]
    largest: NDArray[np.float64]
    rows: NDArray[np.int64]

    @classmethod
    def inscribed(cls, found: NDArray, shape: tuple[int, int], plateau: float, blur: float) -> "_Start":
        """From inscribed disks, which grow little unless the border of the image cuts them."""
        x, y, a = found.T
        cut = np.minimum.reduce([x, y, shape[1] - 1 - x, shape[0] - 1 - y]) < a + blur
        largest = np.where(cut, np.inf, GROWTH * a + blur)
        return cls(np.column_stack([found, np.full(len(found), plateau)]), largest, np.full(len(found), -1))

    def extended(self, fitted: NDArray, new: NDArray) -> "_Start":
        """The fitted disks and new ones, which are free to grow."""
        return _Start(
            np.vstack([fitted, new]),
            np.concatenate([self.largest, np.full(len(new), np.inf)]),
            np.concatenate([np.arange(len(fitted)), np.full(len(new), -1)]),
        )

    def exchanged(self, fitted: NDArray, better: Regrouping) -> "_Start":
        """The fitted disks but those gone, and in their place new ones, which grow little."""
        kept, new = ~better.gone, better.new
        return _Start(
            np.vstack([fitted[kept], new]),
            np.concatenate([self.largest[kept], SETTLED * new[:, RADIUS]]),
            np.concatenate([np.flatnonzero(kept), np.full(len(new), -1)]),
        )


@stage("detection")
def assemble_disks(
    image: NDArray[np.float32],
    valid: Mask,
    background: NDArray[np.bool_],
    *,
    plateau: float,
    noise: Noise,
    brightness: Callable[[NDArray], NDArray],
    blur: float,
    free_blur: bool,
    table: EdgeTable | None = None,
    thorough: bool = True,
) -> Assembly:
    """Find and fit the disks of an image.

    Parameters
    ----------
    image, valid, table
        As for `contactimg.imaging.fit.disks.fit_disks`.
    background : ndarray of bool
        As for `contactimg.imaging.shapes.peaks.find_peaks`.
    plateau : float
        Contrast, grey levels.
    noise : Noise
    brightness : callable
        Relative illumination at each of an array of disks.
    blur : float, px
        Pixel included.
    free_blur : bool
    thorough : bool
        Look again at groups that fit badly.

    Returns
    -------
    Assembly
    """
    fits = _Fits(image, valid, plateau, noise, brightness, blur, free_blur, table)
    width = blur if plateau < QUIET * np.sqrt(noise.variance) else 0.0
    start = _Start.inscribed(
        find_inscribed(image, 0.5 * plateau, smoothing=width, valid=valid), image.shape, plateau, blur
    )
    start, state = fits.pruned(start, fits.first(start))
    peaks, lowest = find_peaks(image, state.model, width=state.blur, height=0.0, background=background)
    smallest = float(_disks_from_peaks(np.array([[0.0, 0.0, lowest]]), state.blur, plateau)[0, 2])
    lowest = max(lowest, LEAST_HEIGHT * plateau)
    peaks = peaks[(peaks[:, 2] > lowest) | ~_at_a_rim(peaks, state.disks, RIM * state.blur)]
    for _ in range(ROUNDS):
        new = _disks_from_peaks(peaks, state.blur, plateau)
        if not len(new):
            break
        before = len(state.disks)
        start = start.extended(state.disks, new)
        active = _near(start.disks, start.rows < 0, state.blur)
        start, state = fits.pruned(start, fits.again(start, state, active, 5), active)
        if len(state.disks) <= before:
            break
        bad = state.disks[state.chi_square > SUSPICIOUS]
        peaks = find_peaks_near(image, state.model, bad, width=state.blur, lowest=lowest)
    if thorough:
        start, state = fits.regrouped(start, state)
    start, state = fits.pruned(start, state, last=True)
    return Assembly(state, np.vstack([np.empty((0, 3)), *fits.dropped]), smallest)


@dataclass(frozen=True, eq=False)
class _Fits:
    """Fits of one image, each from the one before; and the disks dropped on the way."""

    image: NDArray[np.float32]
    valid: Mask
    plateau: float
    noise: Noise
    brightness: Callable[[NDArray], NDArray]
    blur: float
    free_blur: bool
    table: EdgeTable | None
    dropped: list[NDArray] = field(default_factory=list)

    def first(self, start: _Start) -> DiskFit:
        """A fit of all disks."""
        return self._fit(start, self.blur, free_blur=self.free_blur and len(start.disks) > 0, iterations=3)

    def again(self, start: _Start, state: DiskFit, active: NDArray[np.bool_], iterations: int) -> DiskFit:
        """A fit of the active disks, the others as they were."""
        drawing = Drawing(state.model, start.rows >= 0)
        found = self._fit(
            start, state.blur, free_blur=False, iterations=iterations, active=active, drawing=drawing
        )
        return _carry(found, state, active, start.rows)

    def _fit(self, start: _Start, blur: float, **options: Any) -> DiskFit:
        n = len(start.disks)
        return fit_disks(
            self.image, self.valid, start.disks, blur=blur, noise=self.noise,
            prior=Prior(np.full(n, self.plateau), np.full(n, LOOSE * self.plateau)),
            brightness=self.brightness(start.disks), robust=False, table=self.table, largest=start.largest,
            **options,
        )  # fmt: skip

    def pruned(
        self, start: _Start, state: DiskFit, among: NDArray[np.bool_] | None = None, *, last: bool = False
    ) -> tuple[_Start, DiskFit]:
        """Without the disks (all, or among some) that are not needed."""
        gone = unneeded(state, self.plateau, last=last)
        gone = gone if among is None else among & gone
        if not gone.any():
            return start, state
        self.dropped.append(state.disks[gone, :3])
        erase_disks(state.model, state.disks, gone, state.blur, table=self.table)
        active = _near(state.disks, gone, state.blur)[~gone]
        kept = _Start(state.disks[~gone], start.largest[~gone], np.flatnonzero(~gone))
        return kept, self.again(kept, state, active, 4)

    def regrouped(self, start: _Start, state: DiskFit) -> tuple[_Start, DiskFit]:
        """With better covers of the groups that fit badly."""
        better = regroup_disks(
            self.image, self.valid, state, plateau=self.plateau, noise=self.noise,
            brightness=self.brightness(state.disks), table=self.table,
            keep=lambda found: ~unneeded(found, self.plateau, last=True),
        )  # fmt: skip
        if not better.gone.any():
            return start, state
        erase_disks(state.model, state.disks, better.gone, state.blur, table=self.table)
        start = start.exchanged(state.disks, better)
        return start, self.again(start, state, _near(start.disks, start.rows < 0, state.blur), 5)


def _at_a_rim(peaks: NDArray, disks: NDArray, space: float) -> NDArray[np.bool_]:
    """Peaks in a disk or closer than ``space`` to its rim."""
    points = np.column_stack([peaks[:, :2], np.zeros(len(peaks))])
    seen = np.arange(len(disks) + len(peaks)) < len(disks)
    return _touched(np.vstack([disks[:, :3], points]), seen, space)[len(disks) :]


def _disks_from_peaks(peaks: NDArray, blur: float, plateau: float) -> NDArray[np.float64]:
    """Disk whose filtered image has the height of each peak."""
    share = np.clip(peaks[:, 2] / plateau, 1e-3, 0.9)
    radius = np.sqrt(-4.0 * blur**2 * np.log1p(-share))
    return np.column_stack([peaks[:, :2], radius, np.full(len(peaks), plateau)])


def _carry(fit: DiskFit, before: DiskFit, active: NDArray[np.bool_], rows: NDArray[np.int64]) -> DiskFit:
    """The new fit with the quality of the disks held fixed, which were in the given rows of the old one."""
    still = np.flatnonzero(~active)
    old = rows[still]
    std, chi_square, pixels = fit.std.copy(), fit.chi_square.copy(), fit.pixels.copy()
    std[still], chi_square[still], pixels[still] = before.std[old], before.chi_square[old], before.pixels[old]
    return fit.replace(std=std, chi_square=chi_square, pixels=pixels)


def _near(disks: NDArray, changed: NDArray[np.bool_], blur: float) -> NDArray[np.bool_]:
    """Disks that are new or gone, and those whose rim they may change."""
    return _touched(disks, changed, 3.0 * blur)


@njit(cache=True)
def _touched(disks, changed, space):
    """Disks that are changed or closer than ``space`` to one that is."""
    out = changed.copy()
    pairs = find_pairs(disks, 0.5 * space)
    for p in range(len(pairs)):
        i, j = pairs[p]
        out[i] |= changed[j]
        out[j] |= changed[i]
    return out


def unneeded(state: DiskFit, plateau: float, *, last: bool) -> NDArray[np.bool_]:
    """Disks whose light is not significant, that are much too faint, or that lie inside a larger one.

    A faint disk that fits badly may be two that stand close; until the last time it stays to be looked at.
    """
    weak = state.disks[:, RADIUS] < 2.0 * SIGNIFICANT * state.std[:, RADIUS]  # light goes as radius^2
    faint = state.disks[:, CONTRAST] < FAINTEST * plateau
    if not last:
        faint &= state.chi_square < SUSPICIOUS
    speck = (state.disks[:, RADIUS] < SPECK) & (count_touching(state.disks, 2.0 * state.blur) > 0)
    return np.asarray(weak | faint | speck | overlapping(state.disks, DEEPEST))
