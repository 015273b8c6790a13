"""Gauss-Newton iteration of all disks of an image, with the common blur.

Each disk has a 4 x 4 block of the normal matrix, summed over its rim and interior; two disks whose windows
overlap have a 4 x 4 block between them (`contactimg.imaging.kernels.normal_equations`), and the linear system
is solved block by block (`contactimg.imaging.kernels.solve`). The common blur is one more unknown. Only what
looks at pixels or goes through pairs is compiled, each part alone: machine code that calls machine code is
optimised once more with every caller.
"""

import numpy as np

from contactimg.compiled import njit
from contactimg.imaging.kernels.disk_union import add_lens, overlaps
from contactimg.imaging.kernels.normal_equations import (
    CHI_SQUARE,
    CROSS,
    GRADIENT,
    PIXEL_COUNT,
    SATURATED,
    SUMS,
    add_disk,
    sum_disk,
    sum_pair,
    unpack_sums,
)
from contactimg.imaging.kernels.pairs import find_pairs, select_close
from contactimg.imaging.kernels.solve import invert_4x4, marginal_variances, solve_coupled
from contactimg.imaging.profile.blurred_disk import INNER_BLUR_WIDTHS, PIXEL_VARIANCE

PAIR_MARGIN_PX = 2.0  # move of a rim (or 10 % of the blur) after which pairs are searched again; speed only
ISOLATION_GAP_BLUR_WIDTHS = 5.5  # gap of isolated disks; theory: nearer, one changes the other by 1e-4
COUPLING_REACH_BLUR_WIDTHS = 2.6  # reach of a rim within which disks are solved for together; by hand
BLUR_TOLERANCE = 2e-3  # relative step of the blur at which it is held fixed; accuracy
ROUGH_BLUR_TOLERANCE = 1e-2  # the same of a rough fit that only provides a start; accuracy
FAINTEST_FRACTION = 0.05  # lower bound of the contrasts over the expected one; by hand
SMALLEST_BLUR_WIDTHS = 0.1  # least radius: keeps a disk from vanishing; accuracy
CLEARED_PIXELS = 6000  # of the model image for each disk to erase, up to which all is cleared; speed only
NARROWEST_BLUR_PX = PIXEL_VARIANCE**0.5  # theory: that of the pixel alone
WELL_FITTED_CHI_SQUARE = 3.0  # worse fits do not determine the blur or the contrast; by hand


def iterate(
    image, weight, disks, s, noise, prior, brightness, free_blur, robust, moving, table, iterations,
    tolerance, model, drawn, complete, largest,
):  # fmt: skip
    """Iterate the moving disks until all have settled.

    ``model`` contains the disks marked in ``drawn``. Isolated disks are kept out of it while they move; at
    the end it contains all disks if it is to be ``complete``.
    """
    n = len(disks)
    is_plain = table.outer <= INNER_BLUR_WIDTHS
    coupling = COUPLING_REACH_BLUR_WIDTHS if is_plain else table.outer
    isolation = ISOLATION_GAP_BLUR_WIDTHS if is_plain else 2.0 * table.outer
    far = 1.1 * max(0.5 * ISOLATION_GAP_BLUR_WIDTHS, coupling)
    # variance of a background pixel at each disk, its slope with the model level, its excess at the rim
    levels = np.column_stack([noise[0] / brightness, noise[1] / prior[0], np.full(n, noise[2])])
    normals, inverse = np.zeros((n, 4, 4)), np.zeros((n, 4, 4))
    gradient, cross, steps = np.zeros((n, 4)), np.zeros((n, 4)), np.zeros((n, 4))
    blurs = np.zeros((n, 2))
    chi_square, pixels = np.ones(n), np.zeros(n, np.int64)
    started, saturated = moving.copy(), bool((weight == SATURATED).any())
    near_pairs, paired, paired_blur = find_pairs(disks, far * s + PAIR_MARGIN_PX), disks.copy(), s
    pairs, blocks, count = np.empty((0, 2), np.int64), np.zeros((0, 4, 4)), 0
    for iteration in range(iterations):
        if s > 1.1 * paired_blur or _largest_move(disks, paired) > PAIR_MARGIN_PX:
            near_pairs, paired, paired_blur = find_pairs(disks, far * s + PAIR_MARGIN_PX), disks.copy(), s
        pairs, count = select_close(near_pairs, disks, coupling * s), count + 1
        isolated = np.full(n, not saturated)
        isolated[select_close(near_pairs, disks, 0.5 * isolation * s)] = False
        draw_disks(model, disks, s, drawn, ~(isolated & moving), near_pairs, table)
        blocks = np.zeros((len(pairs), 4, 4))
        row_step = 1 if robust else (4 if iteration == 0 else 2)
        _build_normal_equations(
            image, model, weight, disks, s, levels, prior, moving, isolated, robust, row_step, table,
            normals, inverse, gradient, cross, blurs, chi_square, pixels,
        )  # fmt: skip
        if len(pairs):
            _build_pair_blocks(model, weight, disks, s, levels, started, pairs, table, blocks)
        change = 0.0
        if free_blur:
            chosen = moving & (disks[:, 2] > s)
            change = _blur_step(s, chosen, moving, inverse, cross, gradient, blurs, chi_square, iteration)
        gradient[moving] -= change * cross[moving]
        alone = np.where(moving[:, None], np.einsum("iuv,iv->iu", inverse, gradient), 0.0)
        steps[:] = alone
        if len(pairs) and not solve_coupled(inverse, gradient, moving, pairs, blocks, steps):
            steps[:] = alone
        draw_disks(model, disks, s, drawn, ~moving & (change == 0.0), near_pairs, table)
        s = max(s + change, NARROWEST_BLUR_PX)
        blur_tolerance = BLUR_TOLERANCE if robust else ROUGH_BLUR_TOLERANCE
        steady = abs(change) < blur_tolerance * s and (robust or iteration >= 1)
        free_blur = free_blur and not steady
        before = disks.copy()
        _take_steps(disks, steps, s, prior, inverse, largest, moving, steady, tolerance)
        blurs[:, 1] -= blurs[:, 0] * change + np.einsum("iu,iu->i", cross, disks - before)
        if not moving.any():
            break
    if complete and count > 0:
        draw_disks(model, disks, s, drawn, np.ones(n, np.bool_), find_pairs(disks, 0.0), table)
    information = np.empty((n, 5, 5))
    information[:, :4, :4], information[:, 4, 4] = normals, blurs[:, 0]
    information[:, :4, 4] = information[:, 4, :4] = cross
    std = np.sqrt(marginal_variances(normals, inverse, pairs, blocks, started))
    return disks, std, chi_square, pixels, s, model, count, ~moving, information, blurs[:, 1].copy()


def _largest_move(disks, paired):
    """Largest distance that a rim has moved since the pairs were searched."""
    moved = np.hypot(disks[:, 0] - paired[:, 0], disks[:, 1] - paired[:, 1])
    return np.max(moved + disks[:, 2] - paired[:, 2], initial=0.0)


def draw_disks(model, disks, s, drawn, wanted, near_pairs, table):
    """Add disks to the model image, or subtract them, until it contains those wanted, each with its overlaps.

    ``near_pairs`` contains all pairs that overlap.
    """
    change = np.flatnonzero(drawn != wanted)
    if not len(change):
        return
    if len(change) * CLEARED_PIXELS > model.size and not wanted.any():
        model.fill(0.0)
        drawn[:] = False
        return
    touching = select_close(near_pairs, disks, 0.0)
    _draw(model, disks, s, wanted, table, change)
    if len(touching):
        _draw_overlaps(model, disks, s, drawn, wanted, touching)
    drawn[change] = wanted[change]


@njit(cache=True, error_model="numpy")
def _draw(model, disks, s, wanted, table, change):
    """Add or subtract the disks that ``change``."""
    for i in change:
        add_disk(model, disks[i], s, table, 1.0 if wanted[i] else -1.0)


@njit(cache=True)
def _draw_overlaps(model, disks, s, drawn, wanted, pairs):
    """Subtract or add what the pairs that are drawn after, or were before, share."""
    for p in range(len(pairs)):
        i, j = pairs[p]
        before, after = drawn[i] and drawn[j], wanted[i] and wanted[j]
        if before != after and overlaps(disks[i], disks[j]):
            add_lens(model, disks[i], disks[j], s, -1.0 if after else 1.0)


@njit(cache=True, error_model="numpy")
def _build_normal_equations(
    image, model, weight, disks, s, levels, prior, moving, isolated, robust, row_step, table,
    normals, inverse, gradient, cross, blurs, chi_square, pixels,
):  # fmt: skip
    """Normal equations of each moving disk with its prior, and the inverse of the normal matrix.

    ``prior`` holds mean, width and upper bound of the contrasts.
    Every ``row_step``-th row of a wide disk is used.
    """
    out, damped = np.empty(SUMS), np.empty((4, 4))
    for i in range(len(disks)):
        if not moving[i]:
            continue
        expected, spread = prior[0, i], prior[1, i]
        sum_disk(image, model, weight, disks[i], s, levels[i], isolated[i], robust, row_step, table, out)
        unpack_sums(out, normals[i], gradient[i])
        normals[i, 3, 3] += 1.0 / spread**2
        gradient[i, 3] += (expected - disks[i, 3]) / spread**2
        for u in range(4):
            cross[i, u] = out[CROSS + u]
        blurs[i, 0], blurs[i, 1] = out[CROSS + 4], out[GRADIENT + 4]
        pixels[i] = int(out[PIXEL_COUNT])
        chi_square[i] = out[CHI_SQUARE] / max(out[PIXEL_COUNT] - 3.0, 1.0)
        # a disk much smaller than the blur, or outside the image, has little information: keep steps finite
        floor = 1e-3 * expected**2 / levels[i, 0]
        for u in range(4):
            for v in range(4):
                damped[u, v] = normals[i, u, v]
            if u < 3:
                damped[u, u] = damped[u, u] * (1.0 + 1e-6) + floor
        invert_4x4(damped, inverse[i])


@njit(cache=True, error_model="numpy")
def _build_pair_blocks(model, weight, disks, s, levels, started, pairs, table, blocks):
    """Blocks of the normal matrix between disks; settled disks still count for the uncertainties."""
    for p in range(len(pairs)):
        i, j = pairs[p]
        if started[i] and started[j]:
            sum_pair(model, weight, disks[i], disks[j], s, levels[i], table, blocks[p])


def _blur_step(s, chosen, moving, inverse, cross, gradient, blurs, chi_square, iteration):
    """Gauss-Newton step of the common blur, with the parameters of each disk eliminated."""
    # disks that fit worse than most (two taken for one, for instance) would increase the blur
    if moving.any() and iteration > 0:
        chosen = chosen & (chi_square < max(WELL_FITTED_CHI_SQUARE, 2.0 * np.median(chi_square[moving])))
    t = np.einsum("iuv,iv->iu", inverse[chosen], cross[chosen])
    weight = 1.0 / np.maximum(chi_square[chosen], 1.0)
    bottom = weight @ (blurs[chosen, 0] - np.einsum("iu,iu->i", cross[chosen], t))
    top = weight @ (blurs[chosen, 1] - np.einsum("iu,iu->i", gradient[chosen], t))
    return 0.0 if bottom <= 0.0 else min(max(top / bottom, -0.2 * s), 0.2 * s)


def _take_steps(disks, steps, s, prior, inverse, largest, moving, steady, tolerance):
    """Apply the steps within limits; a settled disk does not move any more."""
    (x, y, a, c), step = disks[moving].T, steps[moving].T
    limit = 0.5 * np.maximum(a, s)
    wider = a + np.clip(step[2], -0.4 * a, np.maximum(0.4 * a, 0.5 * s))
    mean, _, brightest = prior[:, moving]
    disks[moving] = np.column_stack([
        x + np.clip(step[0], -limit, limit),
        y + np.clip(step[1], -limit, limit),
        np.minimum(np.maximum(wider, SMALLEST_BLUR_WIDTHS * s), largest[moving]),
        np.minimum(np.maximum(c + step[3], FAINTEST_FRACTION * mean), brightest),
    ])  # fmt: skip
    # quadratic convergence: the next step is of the order of this one squared over the blur
    longest = np.abs(step[:3]).max(axis=0)
    settled = longest * longest < tolerance * np.sqrt(inverse[moving, 2, 2]) * s
    if steady:
        moving[moving] = ~settled
