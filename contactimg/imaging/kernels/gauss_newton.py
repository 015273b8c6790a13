"""Gauss-Newton on the disks of an image, all that share pixels together (compiled).

Every disk accumulates its own 4 x 4 normal matrix over its rim and its interior, disks whose windows
overlap the 4 x 4 matrix between them (`contactimg.imaging.kernels.normal_equations`), and the linear system
is solved block by block (`contactimg.imaging.kernels.solve`), with the common blur as one more unknown.
"""

import numpy as np
from numba import njit

from contactimg.imaging.kernels.disk_union import add_lens, overlaps
from contactimg.imaging.kernels.normal_equations import (
    CHI,
    COUNT,
    CROSS,
    RIGHT,
    SUMS,
    add_disk,
    disk_sums,
    pair_sums,
    unpack,
)
from contactimg.imaging.kernels.pairs import closer, find_pairs, links
from contactimg.imaging.kernels.solve import invert, relax, variances
from contactimg.imaging.profile.blurred_disk import INNER

ALLOWED = 2.0  # px: by as much a rim may move, and by a tenth the blur grow, before pairs are sought anew
SEPARATE = 5.5  # blur widths between rims: nearer, one rim adds 1e-4 to what the other's fit sees
COUPLED = 2.6  # blur widths from each rim within which two disks are solved for together
BLUR_SETTLED = 2e-3  # relative step of the blur that no radius feels ...
BLUR_NEAR = 1e-2  # ... and after which a start is close enough
FAINTEST, BRIGHTEST = 0.05, 5.0  # of the expected contrast: bounds of the iteration
SWEEPS = 40  # of the block relaxation, which stops at 1e-4 px
SMALLEST = 0.1  # blur widths: radius at which the iteration is stopped from collapsing
WELL_FITTED_CHI_SQUARE = 3.0  # chi-square of disks that may tell about the blur


@njit(cache=True)
def iterate(
    image, weight, disks, s, noise, prior, brightness, free_blur, robust, moving, table, iterations,
    tolerance, model, drawn, draw, largest,
):  # fmt: skip
    """Gauss-Newton on all disks that move, until none of them moves any more.

    ``model`` holds the disks marked in ``drawn``. While they move, disks that stand alone are kept out of it.
    """
    n = len(disks)
    far = 1.1 * max(0.5 * SEPARATE, COUPLED) if table.outer <= INNER else 1.1 * table.outer
    normals, inverse = np.zeros((n, 4, 4)), np.zeros((n, 4, 4))
    right, cross, steps = np.zeros((n, 4)), np.zeros((n, 4)), np.zeros((n, 4))
    blurs = np.zeros((n, 2))
    chi, pixels = np.ones(n), np.zeros(n, np.int64)
    started = moving.copy()
    near, known, known_blur = find_pairs(disks, far * s + ALLOWED), disks.copy(), s
    pairs = np.empty((0, 2), np.int64)
    blocks = np.zeros((0, 4, 4))
    done = 0
    for iteration in range(iterations):
        done += 1
        if s > 1.1 * known_blur or _strayed(disks, known) > ALLOWED:
            near, known, known_blur = find_pairs(disks, far * s + ALLOWED), disks.copy(), s
        alone = _stand_alone(n, closer(near, disks, 0.5 * _separate(table) * s))
        draw_disks(model, disks, s, drawn, ~(alone & moving), near, table)
        pairs = closer(near, disks, (COUPLED if table.outer <= INNER else table.outer) * s)
        blocks = np.zeros((len(pairs), 4, 4))
        every = 1 if robust else (4 if iteration == 0 else 2)
        for i in range(n):
            if moving[i]:
                level = np.array([noise[0] / brightness[i], noise[1] / prior[0, i], prior[0, i], prior[1, i]])
                _linearise(
                    image, model, weight, disks[i], s, level, alone[i], robust, every, table,
                    normals[i], inverse[i], right[i], cross[i], blurs[i], chi, pixels, i,
                )  # fmt: skip
        _couple(model, weight, disks, s, noise, prior, brightness, started, pairs, table, blocks)
        change = 0.0
        if free_blur:
            change = _blur_step(disks, s, moving, inverse, cross, right, blurs, chi, iteration)
        _solve(inverse, right, cross, change, moving, pairs, blocks, steps)
        draw_disks(model, disks, s, drawn, ~moving & (change == 0.0), near, table)
        s += change
        steady = abs(change) < (BLUR_SETTLED if robust else BLUR_NEAR) * s and (robust or iteration >= 1)
        free_blur = free_blur and not steady
        before = disks.copy()
        _move(disks, steps, s, prior, inverse, largest, moving, steady, tolerance)
        blurs[:, 1] -= blurs[:, 0] * change + np.sum(cross * (disks - before), axis=1)
        if not moving.any():
            break
    if draw:
        draw_disks(model, disks, s, drawn, np.ones(n, np.bool_), find_pairs(disks, 0.0), table)
    return (
        disks,
        np.sqrt(variances(normals, inverse, pairs, blocks, started)),
        chi,
        pixels,
        s,
        model,
        done,
        ~moving,
        _with_blur(normals, cross, blurs),
        blurs[:, 1].copy(),
    )


@njit(cache=True)
def _with_blur(normals, cross, blurs):
    """Normal matrices of the disks with the blur as a fifth parameter."""
    full = np.empty((len(normals), 5, 5))
    full[:, :4, :4], full[:, 4, 4] = normals, blurs[:, 0]
    full[:, :4, 4] = full[:, 4, :4] = cross
    return full


@njit(cache=True)
def _strayed(disks, known):
    """By how much a rim has moved at most since its place was known."""
    most = 0.0
    for i in range(len(disks)):
        moved = np.hypot(disks[i, 0] - known[i, 0], disks[i, 1] - known[i, 1])
        most = max(most, moved + disks[i, 2] - known[i, 2])
    return most


@njit(cache=True)
def draw_disks(model, disks, s, drawn, wanted, near, table):
    """Add disks to the model image, or take them out, until those wanted are in it, each with its lenses.

    Disks that overlap are among the pairs ``near``.
    """
    change = np.flatnonzero(drawn != wanted)
    if not len(change):
        return
    start, link = links(len(disks), closer(near, disks, 0.0))
    for i in change:
        sign = 1.0 if wanted[i] else -1.0
        add_disk(model, disks[i], s, table, sign)
        for q in range(start[i], start[i + 1]):
            j = link[q, 2]
            if drawn[j] and overlaps(disks[i], disks[j]):
                add_lens(model, disks[i], disks[j], s, -sign)
        drawn[i] = wanted[i]


@njit(cache=True)
def _separate(table):
    """Blur widths between rims from which on no pixel is reached by both disks."""
    return SEPARATE if table.outer <= INNER else 2.0 * table.outer


@njit(cache=True)
def _stand_alone(n, pairs):
    """Disks that are in no pair."""
    alone = np.ones(n, np.bool_)
    for p in range(len(pairs)):
        alone[pairs[p, 0]] = alone[pairs[p, 1]] = False
    return alone


@njit(cache=True)
def _linearise(
    image, model, weight, disk, s, level, alone, robust, every, table,
    normal, inverse, right, cross, blur, chi, pixels, i,
):  # fmt: skip
    """Normal equations of one disk with its prior, and the inverse of their matrix.

    ``level`` is the variance of a background pixel, its slope, and mean and width of the contrast's prior.
    One row in up to ``every`` is looked at.
    """
    variance, slope, expected, spread = level
    out = np.empty(SUMS)
    disk_sums(image, model, weight, disk, s, variance, slope, alone, robust, every, table, out)
    unpack(out, normal, right)
    normal[3, 3] += 1.0 / spread**2
    right[3] += (expected - disk[3]) / spread**2
    cross[:] = out[CROSS : CROSS + 4]
    blur[0], blur[1] = out[CROSS + 4], out[RIGHT + 4]
    pixels[i] = int(out[COUNT])
    chi[i] = out[CHI] / max(out[COUNT] - 3.0, 1.0)
    damped = normal.copy()
    # a disk much smaller than the blur, or outside the image, hardly tells anything: keep its steps finite
    floor = 1e-3 * expected**2 / variance
    for u in range(3):
        damped[u, u] = damped[u, u] * (1.0 + 1e-6) + floor
    invert(damped, inverse)


@njit(cache=True)
def _couple(model, weight, disks, s, noise, prior, brightness, started, pairs, table, blocks):
    """Blocks of the normal matrix between disks (a disk come to rest still matters to the uncertainties)."""
    for p in range(len(pairs)):
        i, j = pairs[p]
        if started[i] and started[j]:
            variance, slope = noise[0] / brightness[i], noise[1] / prior[0, i]
            pair_sums(model, weight, disks[i], disks[j], s, variance, slope, table, blocks[p])


@njit(cache=True)
def _solve(inverse, right, cross, change, moving, pairs, blocks, steps):
    """Steps of the disks that move, given that of the blur."""
    for i in range(len(right)):
        steps[i] = 0.0
        if moving[i]:
            right[i] -= cross[i] * change
            steps[i] = inverse[i] @ right[i]
    relax(inverse, right, moving, pairs, blocks, steps, SWEEPS)


@njit(cache=True)
def _blur_step(disks, s, moving, inverse, cross, right, blurs, chi, iteration):
    """Gauss-Newton step of the common blur, the parameters of each disk eliminated."""
    top, bottom = 0.0, 0.0
    # disks that fit worse than most (two taken for one, say) would widen the blur
    worst = (
        max(WELL_FITTED_CHI_SQUARE, 2.0 * np.median(chi[moving])) if moving.any() else WELL_FITTED_CHI_SQUARE
    )
    for i in range(len(disks)):
        if moving[i] and disks[i, 2] > s and (chi[i] < worst or iteration == 0):
            t = inverse[i] @ cross[i]
            gain = blurs[i, 0] - cross[i] @ t
            if chi[i] > 1.0:
                gain, t = gain / chi[i], t / chi[i]
                top += blurs[i, 1] / chi[i] - right[i] @ t
            else:
                top += blurs[i, 1] - right[i] @ t
            bottom += gain
    if bottom <= 0.0:
        return 0.0
    return min(max(top / bottom, -0.2 * s), 0.2 * s)


@njit(cache=True)
def _move(disks, steps, s, prior, inverse, largest, moving, steady, tolerance):
    """Take the steps, within limits; a disk that has settled moves no more."""
    for i in range(len(disks)):
        if not moving[i]:
            continue
        disk, step = disks[i], steps[i]
        a = disk[2]
        limit = 0.5 * max(a, s)
        disk[0] += min(max(step[0], -limit), limit)
        disk[1] += min(max(step[1], -limit), limit)
        wider = a + min(max(step[2], -0.4 * a), max(0.4 * a, 0.5 * s))
        disk[2] = min(max(wider, SMALLEST * s), largest[i])
        disk[3] = min(max(disk[3] + step[3], FAINTEST * prior[0, i]), BRIGHTEST * prior[0, i])
        # the next step is of the order of this one squared over the blur
        longest = max(abs(step[0]), abs(step[1]), abs(step[2]))
        settled = longest * longest < tolerance * np.sqrt(inverse[i, 2, 2]) * s
        moving[i] = not (settled and steady)
