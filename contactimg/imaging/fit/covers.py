"""Other ways to cover a group of disks that fits badly.

Inscribed disks and peaks of the residual find most contacts, but not the members of a group so compact that
its widest place lies between them, nor two that pass for one. Where a fit is bad, other covers of the same
pixels are tried: circles through the arcs of the outline, one more disk where light is left over, a disk cut
in two or three. A cover is taken if it lowers the squares by more than the disks it adds, and if most of what
was wrong is gone: pieces of a ragged contact describe its rim a little better than one disk does, contacts
describe it well.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from contactimg.imaging.contrast.noise import Noise
from contactimg.imaging.fit.cover_patch import Patch, Surroundings
from contactimg.imaging.fit.disks import RADIUS, DiskFit
from contactimg.imaging.kernels.pairs import find_pairs
from contactimg.imaging.pixels.masks import Mask
from contactimg.imaging.profile.blurred_disk import EdgeTable
from contactimg.imaging.shapes.arcs import cover_outline
from contactimg.imaging.shapes.overlap import hidden

NEAR = 2.0  # blur widths between rims of one group
LARGEST_GROUP = 20  # disks: what is more is no group but a crowd
WORST, SURE = 1.3, 6.0  # times the usual chi-square, and standard deviations above it: a bad fit
BELIEVED = 2.0  # chi-square that noise may have
SLACK = 3.0  # standard deviations of the squares within which nothing is left to explain
PRICE = 40.0  # of a disk in squares: six standard deviations, and four for its freedom
LEFT = 0.35  # of what the squares exceeded their expectation by may be left over
UNSETTLED = 1.5  # times the expectation: squares from which on it is not that disks had not settled
ROUNDS = 5
TALL = 0.3  # of the contrast: light left over that calls for one more disk in an outline
GROWTH, TIGHT = 1.1, 0.3  # of the radius and in blur widths: what a disk that follows an arc may grow
NARROW = 0.75  # level at which necks between contacts open ...
SHRUNK = 0.67  # ... and by how many blur widths rims retreat there: Phi(0.67) = 0.75
SMALLEST_ARC = 0.7  # blur widths: radius below which no arc shows

Cover = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Disks, and how large each may grow."""
Fitted = tuple[NDArray[np.float64], float]
"""Disks, and the squares that they leave over."""


@dataclass(frozen=True, eq=False)
class Regrouping:
    """Disks to take out of a fit and disks to put in their place.

    Parameters
    ----------
    gone : ndarray of bool, shape (n,)
    new : ndarray, shape (m, 4)
        x, y, radius (px), contrast.
    """

    gone: NDArray[np.bool_]
    new: NDArray[np.float64]


def regroup_disks(
    image: NDArray[np.float32],
    valid: Mask,
    fit: DiskFit,
    *,
    plateau: float,
    noise: Noise,
    brightness: NDArray[np.float64],
    keep: Callable[[DiskFit], NDArray[np.bool_]],
    table: EdgeTable | None,
) -> Regrouping:
    """Better covers of the groups that fit badly.

    Parameters
    ----------
    image, valid, noise, table
        As for `contactimg.imaging.fit.disks.fit_disks`.
    fit : DiskFit
        With all its disks in the model.
    plateau : float
        Contrast, grey levels.
    brightness : ndarray, shape (n,)
        Relative illumination at each disk.
    keep : callable
        Which disks of a fit are needed.

    Returns
    -------
    Regrouping
    """
    gone, new = np.zeros(len(fit.disks), np.bool_), [np.empty((0, 4))]
    median = float(np.median(fit.chi_square)) if len(fit.disks) else 1.0
    usual = float(np.clip(median, 1.0, BELIEVED))
    limit = np.maximum(WORST, 1.0 + SURE * np.sqrt(2.0 / np.maximum(fit.pixels, 1)))
    frame = Surroundings(image, valid, fit.blur, plateau, noise, table, keep)
    for members in _groups(fit.disks, fit.chi_square > limit * usual, NEAR * fit.blur):
        # a single contact is looked at if it fits worse than most: in a frame of ragged ones all fit badly
        one = len(members) == 1 and fit.chi_square[members[0]] < limit[members[0]] * median
        if one or len(members) > LARGEST_GROUP:
            continue
        patch = Patch.about(
            fit.disks[members], fit.model, frame, brightness=float(np.median(brightness[members]))
        )
        if patch is None:
            continue
        disks = fit.disks[members] - patch.corner
        better = _simplify(patch, _improve(patch, disks, usual), usual)
        if better is not disks:
            gone[members] = True
            new.append(better + patch.corner)
    return Regrouping(gone, np.vstack(new))


def _groups(disks: NDArray, bad: NDArray[np.bool_], space: float) -> Iterator[NDArray[np.int64]]:
    """Disks whose rims come closer than ``space``, directly or through others, if one of them is bad."""
    if not bad.any():
        return
    pairs = find_pairs(disks, 0.5 * space)
    n = len(disks)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    labels = connected_components(graph, directed=False)[1]
    order = np.argsort(labels, kind="stable")
    for label in np.unique(labels[bad]):
        yield order[slice(*np.searchsorted(labels[order], [label, label + 1]))]


def _improve(patch: Patch, disks: NDArray, usual: float) -> NDArray[np.float64]:
    """A cover that is better than the present one, or that one."""
    expected = usual * patch.image.size
    slack = SLACK * usual * np.sqrt(2.0 * patch.image.size)
    first = squares = patch.squares(disks)
    best = disks
    for number in range(-1 if first < UNSETTLED * expected else 0, ROUNDS):
        if squares < expected + slack:
            break
        tried = list(_other_covers(patch, best, number, expected + slack))
        prices = [value + PRICE * (len(cover) - len(best)) for cover, value in tried]
        if prices and min(prices) < squares:
            best, squares = tried[int(np.argmin(prices))]
        elif number > 0:
            break
    return disks if squares - expected > LEFT * (first - expected) + slack else best


def _simplify(patch: Patch, disks: NDArray, usual: float) -> NDArray[np.float64]:
    """The disks without those that only mend the rim of a larger one; the same array if there are none.

    Without a contact most of what its pixels show is left unexplained.
    """
    misfit = patch.misfit(disks)
    for disk in disks[np.argsort(disks[:, RADIUS])][:-1]:
        window = patch.window(disk)
        expected = usual * np.count_nonzero(window)
        rest = float(misfit[window].sum()) - expected
        if rest < SLACK * usual * np.sqrt(2.0 * expected):
            continue
        others = disks[(disks != disk).any(axis=1)]
        fitted, _ = patch.fit(others, np.full(len(others), np.inf))
        without = patch.misfit(fitted)
        if rest > LEFT * (float(without[window].sum()) - expected):
            disks, misfit = fitted, without
    return disks


def _other_covers(patch: Patch, disks: NDArray, number: int, enough: float) -> Iterator[Fitted]:
    """What to try: the same disks, if they had not settled; those of the outline; then one more and more."""
    if number < 0:
        yield patch.fit(disks, np.full(len(disks), np.inf))
    else:
        yield from _outlined(patch, enough) if number == 0 else _enlarged(patch, disks)


def _outlined(patch: Patch, enough: float) -> Iterator[Fitted]:
    """Fits of disks that follow the outline of the group, until the squares are few enough."""
    for level, shrunk in ((0.5, 0.0), (NARROW, SHRUNK)):
        arcs = cover_outline(
            patch.image, level * patch.frame.plateau, smallest=SMALLEST_ARC * patch.frame.blur
        )
        arcs = arcs[np.argsort(-arcs[:, 3], kind="stable")]
        arcs[:, RADIUS] += shrunk * patch.frame.blur
        arcs[:, 3] = patch.frame.plateau
        if len(arcs):
            cover = _completed(patch, arcs[~hidden(arcs)])
            yield cover
            if cover[1] < enough:
                break


def _completed(patch: Patch, disks: NDArray) -> Fitted:
    """A fit of some disks, and of others where they leave light over, one after the other.

    As long as some are missing, the others would grow into their place.
    """
    tight = TIGHT * patch.frame.blur
    fitted, squares = patch.fit(disks, disks[:, RADIUS] + tight)
    for _ in range(LARGEST_GROUP):
        top = patch.peak(fitted)
        if top is None or top[2] < TALL * patch.frame.plateau:
            break
        more = np.vstack([fitted, _small_disk(patch, top)])
        tried, value = patch.fit(more, np.append(fitted[:, RADIUS] + tight, np.inf))
        if len(tried) <= len(fitted) or value > squares - PRICE:
            break
        fitted, squares = tried, value
    return patch.fit(fitted, _bounds(patch, fitted))


def _enlarged(patch: Patch, disks: NDArray) -> Iterator[Fitted]:
    """Fits of one disk or two more than before."""
    top = patch.peak(disks)
    if top is not None:
        more = np.vstack([disks, _small_disk(patch, top)])
        yield patch.fit(more, np.full(len(more), np.inf))
    residual = patch.image - patch.model(disks)
    windows = [patch.window(disk) for disk in disks]
    worst = int(np.argmax([np.sum(residual[w] ** 2) / max(np.count_nonzero(w), 1) for w in windows]))
    rest = np.delete(disks, worst, axis=0)
    for count in (2, 3):
        pieces, largest = _pieces(patch, residual, disks[worst], count)
        yield patch.fit(np.vstack([rest, pieces]), np.concatenate([_bounds(patch, rest), largest]))


def _bounds(patch: Patch, disks: NDArray) -> NDArray[np.float64]:
    """How large disks may grow that are about right."""
    return np.asarray(GROWTH * disks[:, RADIUS] + TIGHT * patch.frame.blur)


def _small_disk(patch: Patch, peak: NDArray) -> NDArray[np.float64]:
    """A disk as small as the blur at a peak."""
    return np.array([peak[0], peak[1], patch.frame.blur, patch.frame.plateau])


def _pieces(patch: Patch, residual: NDArray, disk: NDArray, count: int) -> Cover:
    """Two or three touching disks that share the light of one, turned to where light is left over."""
    x, y = patch.from_centre(disk)
    light = np.where(patch.window(disk), residual, 0.0)
    angle = np.angle(np.sum(light * (x + 1j * y) ** count)) / count
    a = disk[RADIUS] / np.sqrt(count)
    angles = angle + 2.0 * np.pi * np.arange(count) / count
    pieces = np.tile(np.array([disk[0], disk[1], a, disk[3]]), (count, 1))
    pieces[:, :2] += a / np.sin(np.pi / count) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return pieces, np.full(count, disk[RADIUS])
