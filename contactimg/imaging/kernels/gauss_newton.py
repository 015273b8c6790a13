"""Gauss-Newton iteration of all disks of an image, with the common blur (compiled).

Each disk has a 4 x 4 block of the normal matrix, summed over its rim and interior; two disks whose windows
overlap have a 4 x 4 block between them (`contactimg.imaging.kernels.normal_equations`), and the linear system
is solved block by block (`contactimg.imaging.kernels.solve`). The common blur is one more unknown.
"""

import numpy as np

from contactimg.compiled import njit
from contactimg.imaging.kernels.disk_union import EDGE_REACH_BLUR_WIDTHS, add_lens, lens_nodes, overlaps
from contactimg.imaging.kernels.normal_equations import (
    CHI_SQUARE,
    CROSS,
    GRADIENT,
    PIXEL_COUNT,
    REACH_BLUR_WIDTHS,
    SATURATED,
    SUMS,
    add_disk,
    sum_disk,
    sum_pair,
    unpack_sums,
)
from contactimg.imaging.kernels.pairs import find_pairs, list_neighbours, select_close
from contactimg.imaging.kernels.solve import invert_4x4, marginal_variances, solve_coupled
from contactimg.imaging.profile.blurred_disk import INNER_BLUR_WIDTHS, PIXEL_VARIANCE

PAIR_MARGIN_PX = 2.0  # move of a rim (or 10 % of the blur) after which pairs are searched again; speed only
ISOLATION_GAP_BLUR_WIDTHS = 5.5  # gap of isolated disks; theory: nearer, one changes the other by 1e-4
COUPLING_REACH_BLUR_WIDTHS = 2.6  # reach of a rim within which disks are solved for together; by hand
BLUR_TOLERANCE = 2e-3  # relative step of the blur at which it is held fixed; accuracy
ROUGH_BLUR_TOLERANCE = 1e-2  # the same of a rough fit that only provides a start; accuracy
FAINTEST_FRACTION = 0.05  # lower bound of the contrasts over the expected one; by hand
MOST_SWEEPS = 40  # of the Gauss-Seidel iteration, which stops at 1e-4 px; accuracy
SMALLEST_BLUR_WIDTHS = 0.1  # least radius: keeps a disk from vanishing; accuracy
CLEARED_PIXELS = 6000  # of the model image for each disk to erase, up to which all is cleared; speed only
NARROWEST_BLUR_PX = PIXEL_VARIANCE**0.5  # theory: that of the pixel alone
WORK_PER_DISK = 200.0  # pixels: what a disk, or a coupled pair, costs besides its own; by hand, not measured
WORK_PER_LENS_PIXEL = 4.0  # of the edge of a lens, drawn twice: an integral over 12 nodes; by hand
WORK_PER_LENS_NODE = 0.6  # of each such pixel, where disks overlap deeply; measured: 9 to 15 ns, drawn twice
LENS_INNER_SHARE = 0.7  # of the rectangle about a lens and of what lies inside its edges; theory: pi/4 to 2/3
WELL_FITTED_CHI_SQUARE = 3.0  # worse fits do not determine the blur or the contrast; by hand


@njit(cache=True)
def iterate(
    image, weight, disks, s, noise, prior, brightness, free_blur, robust, moving, table, iterations,
    tolerance, model, drawn, complete, largest, most_work, most_first,
):  # fmt: skip
    """Gauss-Newton iteration of the moving disks until all have settled.

    ``model`` contains the disks marked in ``drawn``. Isolated disks are kept out of it while they move; at
    the end it contains all disks if it is to be ``complete``. No iteration is begun that would take the work
    (`_iteration_work`) beyond ``most_work``, but the first one, which may take ``most_first``: if it would
    take more, no disk is drawn or fitted, and the number of iterations is 0. Last in what is returned are the
    work and what deep overlaps take besides.
    """
    # longer than 40 lines: its parts would need nearly all of these arrays
    n = len(disks)
    coupling = COUPLING_REACH_BLUR_WIDTHS if table.outer <= INNER_BLUR_WIDTHS else table.outer
    far = 1.1 * max(0.5 * ISOLATION_GAP_BLUR_WIDTHS, coupling)
    normals, inverse = np.zeros((n, 4, 4)), np.zeros((n, 4, 4))
    gradient, cross, steps = np.zeros((n, 4)), np.zeros((n, 4)), np.zeros((n, 4))
    blurs = np.zeros((n, 2))
    chi_square, pixels = np.ones(n), np.zeros(n, np.int64)
    started, saturated = moving.copy(), bool(np.any(weight == SATURATED))
    near_pairs, paired, paired_blur = find_pairs(disks, far * s + PAIR_MARGIN_PX), disks.copy(), s
    pairs = np.empty((0, 2), np.int64)
    blocks = np.zeros((0, 4, 4))
    count, work, deep = 0, 0.0, 0.0
    for iteration in range(iterations):
        if s > 1.1 * paired_blur or _largest_move(disks, paired) > PAIR_MARGIN_PX:
            near_pairs, paired, paired_blur = find_pairs(disks, far * s + PAIR_MARGIN_PX), disks.copy(), s
        close = select_close(near_pairs, disks, coupling * s)
        next_work, next_deep = _iteration_work(disks, s, moving, close, saturated)
        if iteration == 0 and next_work + next_deep > most_first:
            break
        if iteration > 0 and max(work + next_work, deep + next_deep) > most_work:
            break
        pairs, count, work, deep = close, count + 1, work + next_work, deep + next_deep
        isolated = _find_isolated(n, select_close(near_pairs, disks, 0.5 * _isolation_gap(table) * s))
        isolated &= not saturated
        draw_disks(model, disks, s, drawn, ~(isolated & moving), near_pairs, table)
        blocks = np.zeros((len(pairs), 4, 4))
        row_step = 1 if robust else (4 if iteration == 0 else 2)
        for i in range(n):
            if moving[i]:
                level, expected = _noise_of(noise, brightness, prior, i), prior[:, i]
                _build_normal_equations(
                    image, model, weight, disks[i], s, level, expected, isolated[i], robust, row_step, table,
                    normals[i], inverse[i], gradient[i], cross[i], blurs[i], chi_square, pixels, i,
                )  # fmt: skip
        _build_pair_blocks(model, weight, disks, s, noise, prior, brightness, started, pairs, table, blocks)
        change = 0.0
        if free_blur:
            change = _step_blur(disks, s, moving, inverse, cross, gradient, blurs, chi_square, iteration)
        _solve_steps(inverse, gradient, cross, change, moving, pairs, blocks, steps)
        draw_disks(model, disks, s, drawn, ~moving & (change == 0.0), near_pairs, table)
        s = max(s + change, NARROWEST_BLUR_PX)
        blur_tolerance = BLUR_TOLERANCE if robust else ROUGH_BLUR_TOLERANCE
        steady = abs(change) < blur_tolerance * s and (robust or iteration >= 1)
        free_blur = free_blur and not steady
        before = disks.copy()
        _take_steps(disks, steps, s, prior, inverse, largest, moving, steady, tolerance)
        blurs[:, 1] -= blurs[:, 0] * change + np.sum(cross * (disks - before), axis=1)
        if not moving.any():
            break
    if complete and count > 0:
        pairs_drawn = find_pairs(disks, 0.0)
        deep += _drawing_work(disks, s, pairs_drawn)
        draw_disks(model, disks, s, drawn, np.ones(n, np.bool_), pairs_drawn, table)
    return (
        disks,
        np.sqrt(marginal_variances(normals, inverse, pairs, blocks, started)),
        chi_square,
        pixels,
        s,
        model,
        count,
        ~moving,
        _with_blur(normals, cross, blurs),
        blurs[:, 1].copy(),
        work,
        deep,
    )


@njit(cache=True)
def _iteration_work(disks, s, moving, pairs, saturated):
    """Pixels at the rims of the moving disks, and those that two disks share; with what else these cost.

    Where pixels may be ``saturated``, all pixels of a disk are looked at, not only those of its rim. The
    second number is what lenses take besides, where disks overlap deeply.
    """
    reach, work, deep = REACH_BLUR_WIDTHS * s, 0.0, 0.0
    for i in range(len(disks)):
        if moving[i]:
            a = disks[i, 2]
            inner = 0.0 if saturated else max(a - reach, 0.0)
            work += WORK_PER_DISK + np.pi * ((a + reach) ** 2 - inner**2)
    for p in range(len(pairs)):
        first, second = disks[pairs[p, 0]], disks[pairs[p, 1]]
        narrow = 2.0 * (min(first[2], second[2]) + reach)
        gap = np.hypot(first[0] - second[0], first[1] - second[1]) - first[2] - second[2]
        work += WORK_PER_DISK + narrow * min(max(2.0 * reach - gap, 0.0), narrow)
        if gap < 0.0:  # the lens that they share is drawn and erased
            lens = WORK_PER_LENS_PIXEL * min(4.0 * narrow * reach, narrow * (2.0 * reach - gap))
            work += lens
            deep += max(WORK_PER_LENS_NODE * _lens_work(first[2], second[2], gap, s) - lens, 0.0)
    return work, deep


@njit(cache=True)
def _drawing_work(disks, s, pairs):
    """Work of drawing the lenses of all pairs once."""
    work = 0.0
    for p in range(len(pairs)):
        first, second = disks[pairs[p, 0]], disks[pairs[p, 1]]
        gap = np.hypot(first[0] - second[0], first[1] - second[1]) - first[2] - second[2]
        work += 0.5 * WORK_PER_LENS_NODE * _lens_work(first[2], second[2], gap, s)
    return work


@njit(cache=True)
def _lens_work(a, b, gap, s):
    """Pixels near the edges of the lens that two disks share, times the nodes of the integral at each."""
    reach = EDGE_REACH_BLUR_WIDTHS * s
    tall, nodes = lens_nodes(a, b, a + b + gap, s)
    deep = min(-gap, 2.0 * min(a, b))
    inner = max(deep - 2.0 * reach, 0.0) * max(2.0 * tall - 2.0 * reach, 0.0)
    pixels = (deep + 2.0 * reach) * (2.0 * tall + 2.0 * reach) - LENS_INNER_SHARE * inner
    return pixels * min(float(nodes), 2.0 * reach / (2.0 * tall / nodes)) if tall > 0.0 else 0.0


@njit(cache=True)
def _noise_of(noise, brightness, prior, i):
    """Variance of a background pixel at a disk, its slope with the model level, its excess at the rim."""
    return noise[0] / brightness[i], noise[1] / prior[0, i], noise[2]


@njit(cache=True)
def _with_blur(normals, cross, blurs):
    """Normal matrices of the disks with the blur as a fifth parameter."""
    full = np.empty((len(normals), 5, 5))
    full[:, :4, :4], full[:, 4, 4] = normals, blurs[:, 0]
    full[:, :4, 4] = full[:, 4, :4] = cross
    return full


@njit(cache=True)
def _largest_move(disks, paired):
    """Largest distance that a rim has moved since the pairs were searched."""
    most = 0.0
    for i in range(len(disks)):
        moved = np.hypot(disks[i, 0] - paired[i, 0], disks[i, 1] - paired[i, 1])
        most = max(most, moved + disks[i, 2] - paired[i, 2])
    return most


@njit(cache=True)
def draw_disks(model, disks, s, drawn, wanted, near_pairs, table):
    """Add disks to the model image, or subtract them, until it contains those wanted, each with its overlaps.

    ``near_pairs`` contains all pairs that overlap.
    """
    change = np.flatnonzero(drawn != wanted)
    if not len(change):
        return
    if len(change) * CLEARED_PIXELS > model.size and not wanted.any():
        model[:] = 0.0
        drawn[:] = False
        return
    start, link = list_neighbours(len(disks), select_close(near_pairs, disks, 0.0))
    for i in change:
        sign = 1.0 if wanted[i] else -1.0
        add_disk(model, disks[i], s, table, sign)
        for q in range(start[i], start[i + 1]):
            j = link[q, 2]
            if drawn[j] and overlaps(disks[i], disks[j]):
                add_lens(model, disks[i], disks[j], s, -sign)
        drawn[i] = wanted[i]


@njit(cache=True)
def _isolation_gap(table):
    """Gap between rims, in blur widths, beyond which no pixel is reached by both disks."""
    return ISOLATION_GAP_BLUR_WIDTHS if table.outer <= INNER_BLUR_WIDTHS else 2.0 * table.outer


@njit(cache=True)
def _find_isolated(n, pairs):
    """Disks without a close neighbour."""
    isolated = np.ones(n, np.bool_)
    for p in range(len(pairs)):
        isolated[pairs[p, 0]] = isolated[pairs[p, 1]] = False
    return isolated


@njit(cache=True)
def _build_normal_equations(
    image, model, weight, disk, s, noise, prior, isolated, robust, row_step, table,
    normal, inverse, gradient, cross, blur, chi_square, pixels, i,
):  # fmt: skip
    """Normal equations of one disk with its prior, and the inverse of the normal matrix.

    ``prior`` holds mean, width and upper bound of the contrast.
    Every ``row_step``-th row of a wide disk is used.
    """
    expected, spread = prior[0], prior[1]
    out = np.empty(SUMS)
    sum_disk(image, model, weight, disk, s, noise, isolated, robust, row_step, table, out)
    unpack_sums(out, normal, gradient)
    normal[3, 3] += 1.0 / spread**2
    gradient[3] += (expected - disk[3]) / spread**2
    cross[:] = out[CROSS : CROSS + 4]
    blur[0], blur[1] = out[CROSS + 4], out[GRADIENT + 4]
    pixels[i] = int(out[PIXEL_COUNT])
    chi_square[i] = out[CHI_SQUARE] / max(out[PIXEL_COUNT] - 3.0, 1.0)
    damped = normal.copy()
    # a disk much smaller than the blur, or outside the image, has little information: keep its steps finite
    floor = 1e-3 * expected**2 / noise[0]
    for u in range(3):
        damped[u, u] = damped[u, u] * (1.0 + 1e-6) + floor
    invert_4x4(damped, inverse)


@njit(cache=True)
def _build_pair_blocks(model, weight, disks, s, noise, prior, brightness, started, pairs, table, blocks):
    """Blocks of the normal matrix between disks; settled disks still count for the uncertainties."""
    for p in range(len(pairs)):
        i, j = pairs[p]
        if started[i] and started[j]:
            level = _noise_of(noise, brightness, prior, i)
            sum_pair(model, weight, disks[i], disks[j], s, level, table, blocks[p])


@njit(cache=True)
def _solve_steps(inverse, gradient, cross, change, moving, pairs, blocks, steps):
    """Steps of the moving disks, given the step of the blur."""
    for i in range(len(gradient)):
        steps[i] = 0.0
        if moving[i]:
            gradient[i] -= cross[i] * change
            steps[i] = inverse[i] @ gradient[i]
    solve_coupled(inverse, gradient, moving, pairs, blocks, steps, MOST_SWEEPS)


@njit(cache=True)
def _step_blur(disks, s, moving, inverse, cross, gradient, blurs, chi_square, iteration):
    """Gauss-Newton step of the common blur, with the parameters of each disk eliminated."""
    top, bottom = 0.0, 0.0
    # disks that fit worse than most (two taken for one, for instance) would increase the blur
    worst = WELL_FITTED_CHI_SQUARE
    if moving.any():
        worst = max(worst, 2.0 * np.median(chi_square[moving]))
    for i in range(len(disks)):
        if moving[i] and disks[i, 2] > s and (chi_square[i] < worst or iteration == 0):
            t = inverse[i] @ cross[i]
            gain = blurs[i, 0] - cross[i] @ t
            if chi_square[i] > 1.0:
                gain, t = gain / chi_square[i], t / chi_square[i]
                top += blurs[i, 1] / chi_square[i] - gradient[i] @ t
            else:
                top += blurs[i, 1] - gradient[i] @ t
            bottom += gain
    if bottom <= 0.0:
        return 0.0
    return min(max(top / bottom, -0.2 * s), 0.2 * s)


@njit(cache=True)
def _take_steps(disks, steps, s, prior, inverse, largest, moving, steady, tolerance):
    """Apply the steps within limits; a settled disk does not move any more."""
    for i in range(len(disks)):
        if not moving[i]:
            continue
        disk, step = disks[i], steps[i]
        a = disk[2]
        limit = 0.5 * max(a, s)
        disk[0] += min(max(step[0], -limit), limit)
        disk[1] += min(max(step[1], -limit), limit)
        wider = a + min(max(step[2], -0.4 * a), max(0.4 * a, 0.5 * s))
        disk[2] = min(max(wider, SMALLEST_BLUR_WIDTHS * s), largest[i])
        disk[3] = min(max(disk[3] + step[3], FAINTEST_FRACTION * prior[0, i]), prior[2, i])
        # quadratic convergence: the next step is of the order of this one squared over the blur
        longest = max(abs(step[0]), abs(step[1]), abs(step[2]))
        settled = longest * longest < tolerance * np.sqrt(inverse[i, 2, 2]) * s
        moving[i] = not (settled and steady)
