"""How many disks: add one where the fit leaves light over, drop one that the pixels do not need.

A disk is added where the matched-filtered residual stands out; it stays if its radius is significant and if it does not lie
in a neighbour by more than contacts of two bodies can: then it describes the neighbour's ragged rim, no contact.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from contactimg.imaging.detect import find_inscribed, find_peaks
from contactimg.imaging.disks import CONTRAST, RADIUS, DiskFit, Noise, Prior, fit_disks
from contactimg.imaging.edge import EdgeTable

__all__ = ["Assembly", "assemble_disks", "overlapping"]

DEEPEST = 0.35  # of the smaller one's diameter: contacts that overlap more are one contact
LEAST_HEIGHT = 0.12  # of the contrast: smaller residual peaks belong to an imperfect rim
SIGNIFICANT = 5.0  # standard deviations of the light of a disk
ROUNDS = 3
LOOSE = 0.1  # relative width of the contrast's prior before the frame's own spread is known


@dataclass(frozen=True, eq=False)
class Assembly:
    """Disks that together explain an image.

    Parameters
    ----------
    fit : DiskFit
    dropped : ndarray, shape (m, 3)
        x, y, radius of disks that were tried and found insignificant.
    """

    fit: DiskFit
    dropped: NDArray[np.float64]


def assemble_disks(
    image: NDArray[np.float32],
    weight: NDArray[np.uint8],
    background: NDArray[np.uint8],
    *,
    plateau: float,
    noise: Noise,
    blur: float,
    free_blur: bool,
    table: EdgeTable | None = None,
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
    blur : float, px
        Pixel included.
    free_blur : bool

    Returns
    -------
    Assembly
    """

    def fit(disks: NDArray, blur: float, active: NDArray | None, iterations: int, *, free: bool) -> DiskFit:
        n = len(disks)
        prior = Prior(np.full(n, plateau), np.full(n, LOOSE * plateau))
        return fit_disks(
            image, weight, disks, blur=blur, noise=noise, prior=prior, brightness=np.ones(n),
            free_blur=free, robust=False, active=active, table=table, iterations=iterations,
        )  # fmt: skip

    inscribed = find_inscribed(image, 0.5 * plateau)
    disks = np.column_stack([inscribed, np.full(len(inscribed), plateau)])
    state = fit(disks, blur, None, 4, free=free_blur and len(disks) > 0)
    dropped: list[NDArray] = []
    for _ in range(ROUNDS):
        height = LEAST_HEIGHT * plateau
        peaks = find_peaks(
            image - state.model, width=state.blur, height=min(height, plateau), background=background
        )
        new = _disks_from_peaks(peaks, state.blur, plateau)
        if not len(new):
            break
        disks = np.vstack([state.disks, new])
        active = _near(disks, len(state.disks), state.blur)
        state = _carry(
            fit(disks, state.blur, active, 5, free=False), state, active, np.arange(len(state.disks))
        )
        keep = ~_unneeded(state, active, noise)
        if not keep.all():
            dropped.append(state.disks[~keep, :3])
            active = _near(state.disks, 0, state.blur, gone=~keep)
            refitted = fit(state.disks[keep], state.blur, active, 4, free=False)
            state = _carry(refitted, state, active, np.flatnonzero(keep))
        if len(peaks) == int((~keep).sum()):
            break
    return Assembly(state, np.vstack([np.empty((0, 3)), *dropped]))


def _disks_from_peaks(peaks: NDArray, blur: float, plateau: float) -> NDArray[np.float64]:
    """Disk whose filtered image has the height of each peak."""
    share = np.clip(peaks[:, 2] / plateau, 1e-3, 0.9)
    radius = np.sqrt(-4.0 * blur**2 * np.log1p(-share))
    return np.column_stack([peaks[:, :2], radius, np.full(len(peaks), plateau)])


def _carry(fit: DiskFit, before: DiskFit, active: NDArray[np.bool_], rows: NDArray[np.int64]) -> DiskFit:
    """The new fit with the quality of the disks that were held fixed; ``rows`` are its first rows in the old fit."""
    still = np.flatnonzero(~active[: len(rows)])
    old = rows[still]
    std, chi_square, pixels = fit.std.copy(), fit.chi_square.copy(), fit.pixels.copy()
    std[still], chi_square[still], pixels[still] = before.std[old], before.chi_square[old], before.pixels[old]
    return fit.replace(std=std, chi_square=chi_square, pixels=pixels)


def _near(disks: NDArray, first_new: int, blur: float, gone: NDArray | None = None) -> NDArray[np.bool_]:
    """New disks and those whose rim they may change; with ``gone``, the neighbours of disks taken away."""
    changed = np.arange(len(disks)) >= first_new if gone is None else gone
    touched = _touched(disks, changed, 3.0 * blur)
    return touched if gone is None else touched[~gone]


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


def _unneeded(state: DiskFit, among: NDArray[np.bool_], noise: Noise) -> NDArray[np.bool_]:
    """Disks whose light is not significant, or that lie inside a larger one."""
    weak = state.disks[:, RADIUS] < 2.0 * SIGNIFICANT * state.std[:, RADIUS]  # light goes as radius^2
    return among & (weak | overlapping(state.disks, DEEPEST))


@njit(cache=True)
def overlapping(disks, deepest):
    """Whether each disk lies in a larger one by more than ``deepest`` of its own diameter."""
    n = len(disks)
    out = np.zeros(n, np.bool_)
    order = np.argsort(disks[:, 0] - disks[:, 2])
    for u in range(n):
        i = order[u]
        for v in range(u + 1, n):
            j = order[v]
            if disks[j, 0] - disks[j, 2] > disks[i, 0] + disks[i, 2]:
                break
            distance = np.hypot(disks[i, 0] - disks[j, 0], disks[i, 1] - disks[j, 1])
            small = min(disks[i, 2], disks[j, 2])
            if disks[i, 2] + disks[j, 2] - distance > 2.0 * deepest * small:
                out[i if disks[i, 2] <= disks[j, 2] else j] = True
    return out
