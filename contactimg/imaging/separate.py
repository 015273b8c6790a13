"""How many disks: add one where the fit leaves light over, drop one that the pixels do not need.

A disk is added where the matched-filtered residual stands out; it stays if its radius is significant and if
it does not lie in a neighbour by more than contacts of two bodies can: then it describes the neighbour's
ragged rim, no contact.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from contactimg.imaging.detect import find_inscribed, find_peaks, find_peaks_near
from contactimg.imaging.disks import CONTRAST, RADIUS, DiskFit, Drawing, Prior, erase_disks, fit_disks
from contactimg.imaging.edge import EdgeTable
from contactimg.imaging.noise import Noise
from contactimg.imaging.regroup import Regrouping, regroup_disks
from contactimg.imaging.touching import DEEPEST, count_touching, overlapping
from contactimg.timings import stage

__all__ = ["Assembly", "assemble_disks", "count_touching", "overlapping"]

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
    weight: NDArray[np.uint8],
    background: NDArray[np.uint8],
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
    image, weight, table
        As for `contactimg.imaging.disks.fit_disks`.
    background : ndarray of uint8
        As for `contactimg.imaging.detect.find_peaks`.
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

    def fit(start: _Start, state: DiskFit | None, active: NDArray | None, iterations: int) -> DiskFit:
        n = len(start.disks)
        drawing = None if state is None else Drawing(state.model, start.rows >= 0)
        found = fit_disks(
            image, weight, start.disks, blur=blur if state is None else state.blur, noise=noise,
            prior=Prior(np.full(n, plateau), np.full(n, LOOSE * plateau)), brightness=brightness(start.disks),
            free_blur=free_blur and state is None and n > 0, robust=False, active=active, table=table,
            iterations=iterations, drawing=drawing, largest=start.largest,
        )  # fmt: skip
        return found if state is None or active is None else _carry(found, state, active, start.rows)

    def prune(
        start: _Start, state: DiskFit, among: NDArray[np.bool_], *, last: bool
    ) -> tuple[_Start, DiskFit]:
        gone = among & _unneeded(state, plateau, last=last)
        if not gone.any():
            return start, state
        dropped.append(state.disks[gone, :3])
        erase_disks(state.model, state.disks, gone, state.blur, table=table)
        active = _near(state.disks, gone, state.blur)[~gone]
        kept = _Start(state.disks[~gone], start.largest[~gone], np.flatnonzero(~gone))
        return kept, fit(kept, state, active, 4)

    dropped: list[NDArray] = []
    width = blur if plateau < QUIET * np.sqrt(noise.variance) else 0.0
    start = _Start.inscribed(
        find_inscribed(image, 0.5 * plateau, smoothing=width, weight=weight), image.shape, plateau, blur
    )
    state = fit(start, None, None, 3)
    start, state = prune(start, state, np.ones(len(start.disks), np.bool_), last=False)
    peaks, lowest = find_peaks(image - state.model, width=state.blur, height=0.0, background=background)
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
        start, state = prune(start, fit(start, state, active, 5), active, last=False)
        if len(state.disks) <= before:
            break
        bad = state.disks[state.chi_square > SUSPICIOUS]
        peaks = find_peaks_near(image, state.model, bad, width=state.blur, lowest=lowest)
    if thorough:
        better = regroup_disks(
            image, weight, state, plateau=plateau, noise=noise, brightness=brightness(state.disks),
            keep=lambda found: ~_unneeded(found, plateau, last=True), table=table,
        )  # fmt: skip
        erase_disks(state.model, state.disks, better.gone, state.blur, table=table)
        start = start.exchanged(state.disks, better)
        state = fit(start, state, _near(start.disks, start.rows < 0, state.blur), 5)
    start, state = prune(start, state, np.ones(len(state.disks), np.bool_), last=True)
    return Assembly(state, np.vstack([np.empty((0, 3)), *dropped]), smallest)


@njit(cache=True)
def _at_a_rim(peaks, disks, space):
    """Peaks in a disk or closer than ``space`` to its rim."""
    out = np.zeros(len(peaks), np.bool_)
    for k in range(len(peaks)):
        for i in range(len(disks)):
            limit = disks[i, 2] + space
            if (disks[i, 0] - peaks[k, 0]) ** 2 + (disks[i, 1] - peaks[k, 1]) ** 2 < limit * limit:
                out[k] = True
                break
    return out


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
    for i in np.flatnonzero(changed):
        for j in range(len(disks)):
            limit = disks[i, 2] + disks[j, 2] + space
            if (disks[i, 0] - disks[j, 0]) ** 2 + (disks[i, 1] - disks[j, 1]) ** 2 < limit * limit:
                out[j] = True
    return out


def _unneeded(state: DiskFit, plateau: float, *, last: bool) -> NDArray[np.bool_]:
    """Disks whose light is not significant, that are much too faint, or that lie inside a larger one.

    A faint disk that fits badly may be two that stand close; until the last time it stays to be looked at.
    """
    weak = state.disks[:, RADIUS] < 2.0 * SIGNIFICANT * state.std[:, RADIUS]  # light goes as radius^2
    faint = state.disks[:, CONTRAST] < FAINTEST * plateau
    if not last:
        faint &= state.chi_square < SUSPICIOUS
    speck = (state.disks[:, RADIUS] < SPECK) & (count_touching(state.disks, 2.0 * state.blur) > 0)
    return np.asarray(weak | faint | speck | overlapping(state.disks, DEEPEST))
