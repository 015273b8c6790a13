"""Sums over each contact's own pixels, without a model of its edge (compiled).

A pixel belongs to the contact whose rim is nearest to it. Each contact has a core (well inside its rim), a
region (out to where its blurred rim has ended) and a ring around the region.
"""

import numpy as np

from contactimg.compiled import njit
from contactimg.imaging.kernels.pairs import find_pairs, list_neighbours

DIRECTIONS, DISTANCES = 24, 3
"""The surroundings are sampled in so many directions and at so many distances from the rim: their scatter is
then known to a tenth (theory: 72 pixels)."""
QUARTILES_TO_STD = 0.7413
"""Standard deviation of normal deviates over the distance of their quartiles. Theory."""
FEWEST_AROUND = 8
"""Pixels of them that must be seen: they give the scatter to a third."""
CLEAR_SHARE = 0.3
"""Share of a sample of the ring as bright as the contact up to which the contact is brighter than the median.
Chosen: of 72 pixels, 0.3 is 3.7 standard deviations below one half."""
ANGLES = 2.0 * np.pi * (np.arange(DIRECTIONS) + 0.25) / DIRECTIONS
COSINES, SINES = np.cos(ANGLES), np.sin(ANGLES)

LEAST_INSIDE_PX = 0.75
"""Smallest radius of the inside of a contact: a pixel centre lies in such a circle anywhere."""
SEEN, MISSING, LIGHT, CORE_SEEN, CORE_LIGHT, RING_SEEN, RING_LIGHT = range(7)
"""Columns of `sum_light`: pixels of the region that are seen and that are not, their light; pixels of the
core and of the ring that are seen, with their light."""
COLUMNS = 7


@njit(cache=True)
def sum_light(image, valid, disks, core_px, limits_px, out):
    """Fill the rows of ``out``, one a contact, with the columns above.

    Parameters
    ----------
    image : ndarray of float32, shape (rows, columns)
        0 at pixels that are not seen.
    valid : ndarray of uint8
        0 for pixels that are not seen; another shape than the image masks nothing.
    disks : ndarray, shape (n, 3)
        x, y, radius, px.
    core_px : ndarray, shape (n,)
        Radius of each core; 0 for none.
    limits_px : ndarray, shape (2,)
        Distance from the rim at which the ring and the space beyond it begin.
    out : ndarray of zeros, shape (n, COLUMNS)
    """
    start, link = list_neighbours(len(disks), find_pairs(disks, limits_px[1]))
    for i in range(len(disks)):
        neighbours = disks[link[start[i] : start[i + 1], 2]]
        _sum_contact(image, valid, disks[i], neighbours, core_px[i], limits_px, out[i])


@njit(cache=True)
def _sum_contact(image, valid, disk, neighbours, core, limits, out):
    """Pixels and light of one contact, row by row: whole runs where no neighbour can be nearer."""
    x, y, a = disk
    region, far = a + limits[0], a + limits[1]
    free, near = a + _free_distance(disk, neighbours), np.empty_like(neighbours)
    whole = valid.shape != image.shape
    for row in range(int(np.ceil(y - far)), int(np.floor(y + far)) + 1):
        square = (row - y) ** 2
        left, end = _chord(x, far * far - square)
        count = _select_near(neighbours, (row, left, end), limits[1], near)
        if not count and whole and 0 <= row < len(image) and left >= 0 and end <= image.shape[1]:
            region_chord, core_chord = _chord(x, region * region - square), _chord(x, core * core - square)
            _add_whole_row(image[row, left:end], left, region_chord, core_chord, out)
            continue
        inner = min(region, free) if count else region
        start, stop = _chord(x, inner * inner - square)
        if start == stop:
            start = stop = end
        _add_run(image, valid, (row, *_chord(x, core * core - square)), out[CORE_SEEN : CORE_LIGHT + 1])
        seen = out[SEEN]
        _add_run(image, valid, (row, start, stop), out[SEEN : LIGHT + 1 : LIGHT])
        out[MISSING] += stop - start - (out[SEEN] - seen)
        for run in ((row, left, start), (row, stop, end)):
            if count:
                _add_pixels(image, valid, run, disk, near[:count], limits[0], out)
            else:
                _add_run(image, valid, run, out[RING_SEEN : RING_LIGHT + 1])


@njit(cache=True, forceinline=True)
def _add_whole_row(levels, left, region, core, out):
    """Add a row of pixels that are all seen and all the contact's own, from the ring's first on."""
    all_light, light, core_light = _sum_nested(
        levels,
        (np.int32(region[0] - left), np.int32(region[1] - left)),
        (np.int32(core[0] - left), np.int32(core[1] - left)),
    )
    out[SEEN] += region[1] - region[0]
    out[LIGHT] += light
    out[CORE_SEEN] += core[1] - core[0]
    out[CORE_LIGHT] += core_light
    out[RING_SEEN] += len(levels) - (region[1] - region[0])
    out[RING_LIGHT] += all_light - light


@njit(cache=True, fastmath=True, forceinline=True)
def _sum_nested(values, outer, inner):
    """Sums of contiguous values: all, those between two places, and those between two others."""
    total = middle = core = zero = np.float32(0.0)
    for k in range(len(values)):
        place, value = np.int32(k), values[k]
        total += value
        middle += value if (place >= outer[0]) & (place < outer[1]) else zero
        core += value if (place >= inner[0]) & (place < inner[1]) else zero
    return np.float64(total), np.float64(middle), np.float64(core)


@njit(cache=True)
def _select_near(neighbours, run, reach, near):
    """Copy the neighbours whose rims come closer than ``reach`` to a run of pixels; their number."""
    count = 0
    for k in range(len(neighbours)):
        x, y, far = neighbours[k, 0], neighbours[k, 1], neighbours[k, 2] + reach
        if abs(run[0] - y) < far and run[1] < x + far and run[2] > x - far:
            near[count, 0], near[count, 1], near[count, 2] = x, y, neighbours[k, 2]
            count += 1
    return count


@njit(cache=True, forceinline=True)
def _chord(x, square):
    """First pixel of a row within ``sqrt(square)`` of x, and the one after the last."""
    if square < 0.0:
        return 0, 0
    half = np.sqrt(square)
    first = int(np.ceil(x - half))
    return first, max(int(np.floor(x + half)) + 1, first)


@njit(cache=True, forceinline=True)
def _add_pixels(image, valid, run, disk, neighbours, reach, out):
    """Add the pixels of a run (row, first column, end) one by one, where no neighbour is nearer."""
    row, x, square, a = run[0], disk[0], (run[0] - disk[1]) ** 2, disk[2]
    seen = light = ring_seen = ring_light = missing = 0.0
    last_x, last_y, last_a = neighbours[0]
    for column in range(run[1], run[2]):
        outside = np.sqrt((column - x) ** 2 + square) - a
        least = last_a + outside  # mostly the neighbour that had the pixel before
        if least > 0.0 and (column - last_x) ** 2 + (row - last_y) ** 2 < least * least:
            continue
        nearer = _find_nearer(neighbours, column, row, outside)
        if nearer >= 0:
            last_x, last_y, last_a = neighbours[nearer]
        elif not _is_seen(valid, row, column, image.shape):
            missing += outside < reach
        elif outside < reach:
            seen += 1.0
            light += image[row, column]
        else:
            ring_seen += 1.0
            ring_light += image[row, column]
    out[SEEN] += seen
    out[MISSING] += missing
    out[LIGHT] += light
    out[RING_SEEN] += ring_seen
    out[RING_LIGHT] += ring_light


@njit(cache=True, forceinline=True)
def _add_run(image, valid, run, out):
    """Add seen pixels and light of a run (row, first column, end)."""
    row, left, right = run[0], max(run[1], 0), min(run[2], image.shape[1])
    if right > left and 0 <= row < len(image):
        out[1] += _row_sum(image[row, left:right])
        out[0] += right - left if valid.shape != image.shape else _row_sum(valid[row, left:right])


@njit(cache=True)
def _mean_inside(image, valid, disk):
    """Mean of the pixels inside a contact that are seen; NaN without one."""
    x, y, a, sums = disk[0], disk[1], max(disk[2], LEAST_INSIDE_PX), np.zeros(2)
    for row in range(int(np.ceil(y - a)), int(np.floor(y + a)) + 1):
        _add_run(image, valid, (row, *_chord(x, a * a - (row - y) ** 2)), sums)
    return sums[1] / sums[0] if sums[0] > 0 else np.nan


@njit(cache=True, fastmath=True, forceinline=True)
def _row_sum(values):
    """Sum of contiguous values; apart, so that it compiles to vector instructions."""
    total = np.float32(0.0)
    for k in range(len(values)):
        total += values[k]
    return total


@njit(cache=True, forceinline=True)
def _is_seen(valid, row, column, shape):
    """Whether a pixel lies in the image and is not masked."""
    if row < 0 or row >= shape[0] or column < 0 or column >= shape[1]:
        return False
    return valid.shape != shape or valid[row, column] > 0


@njit(cache=True, forceinline=True)
def _nearest_rim(neighbours, x, y):
    """Distance from the nearest rim of the neighbours, negative inside; infinite without any."""
    nearest = np.inf
    for k in range(len(neighbours)):
        dx, dy = x - neighbours[k, 0], y - neighbours[k, 1]
        nearest = min(nearest, np.sqrt(dx * dx + dy * dy) - neighbours[k, 2])
    return nearest


@njit(cache=True, forceinline=True)
def _is_free(neighbours, x, y, reach):
    """Whether a pixel is at least so far from the rims of all neighbours, a negative distance inside."""
    return _find_nearer(neighbours, x, y, reach) < 0


@njit(cache=True, forceinline=True)
def _find_nearer(neighbours, x, y, reach):
    """The first neighbour from whose rim a pixel is not so far; -1 for none."""
    for k in range(len(neighbours)):
        dx, dy, least = x - neighbours[k, 0], y - neighbours[k, 1], neighbours[k, 2] + reach
        if least > 0.0 and dx * dx + dy * dy < least * least:
            return k
    return -1


@njit(cache=True)
def _free_distance(disk, neighbours):
    """Distance from the rim up to which no rim of a neighbour can be nearer: half the smallest gap."""
    return 0.5 * (_nearest_rim(neighbours, disk[0], disk[1]) - disk[2])


@njit(cache=True)
def stand_out(image, valid, disks, near_px, far_px, prominence):
    """Mean inside each contact minus the median of its surroundings, and their robust scatter: shape (n, 2).

    The surroundings lie between two distances from the rim, in those of no other contact. NaN where either is
    not seen. Where the inside exceeds the brightest pixel around by ``prominence`` times the largest possible
    scatter, these two are given instead, a lower and an upper bound, for time. Parameters as for `sum_light`.
    """
    out = np.full((len(disks), 2), np.nan)
    start, link = list_neighbours(len(disks), find_pairs(disks, 0.5 * (near_px + far_px + 1.0)))
    for i in range(len(disks)):
        neighbours = disks[link[start[i] : start[i + 1], 2]]
        around = _sample_surroundings(image, valid, disks[i], neighbours, (near_px, far_px))
        count, level = len(around), _mean_inside(image, valid, disks[i])
        if count < FEWEST_AROUND or np.isnan(level):
            continue
        highest = around.max()
        out[i] = level - highest, QUARTILES_TO_STD * (highest - around.min())
        if not (out[i, 0] > 0.0 and out[i, 0] >= prominence * out[i, 1]):
            around = np.sort(around)
            out[i, 0] = level - around[count // 2]
            out[i, 1] = QUARTILES_TO_STD * (around[(3 * count) // 4] - around[count // 4])
    return out


@njit(cache=True)
def find_outshone(image, disks, limits_px, margin, look_for_crowd):
    """Which contacts are no brighter than the median of a ring around them, and what lies in it: shape (n,).

    0: brighter; 1: no brighter; 2: no brighter because other contacts fill half the ring or more, but
    brighter than the rest of it. The ring lies between two distances from the rim. It is looked at pixel by
    pixel where a sample of it does not decide, or half of it is not in the image; contacts with fewer than
    `FEWEST_AROUND` pixels around them pass.

    Parameters
    ----------
    image : ndarray of float32, shape (rows, columns)
    disks : ndarray, shape (n, 3)
        x, y, radius, px.
    limits_px : (float, float)
    margin : float, grey levels
        By which the inside must be brighter.
    look_for_crowd : bool
        Tell 2 from 1.
    """
    out, everything = np.zeros(len(disks), np.int64), np.ones((1, 1), np.uint8)
    pairs = find_pairs(disks, limits_px[1]) if look_for_crowd else np.empty((0, 2), np.int64)
    start, link = list_neighbours(len(disks), pairs)
    for i in range(len(disks)):
        level = _mean_inside(image, everything, disks[i]) - margin
        if np.isnan(level):
            continue
        around = _sample_surroundings(image, everything, disks[i], disks[:0], limits_px)
        many = 2 * len(around) >= DIRECTIONS * DISTANCES
        if many and not np.sum(around >= level) / len(around) > CLEAR_SHARE:
            continue
        ring = _ring_pixels(image, disks[i], disks[:0], limits_px)
        if len(ring) > FEWEST_AROUND and level <= np.median(ring):
            out[i] = 1
            if look_for_crowd:
                free = _ring_pixels(image, disks[i], disks[link[start[i] : start[i + 1], 2]], limits_px)
                crowded = 2 * len(free) <= len(ring) and (len(free) == 0 or level > np.median(free))
                out[i] += crowded
    return out


@njit(cache=True)
def _ring_pixels(image, disk, neighbours, limits):
    """Pixels of a ring around a contact that lie in no neighbour."""
    x, y, inner, outer = disk[0], disk[1], disk[2] + limits[0], disk[2] + limits[1]
    top, bottom = max(int(np.ceil(y - outer)), 0), min(int(np.floor(y + outer)) + 1, len(image))
    left, right = max(int(np.ceil(x - outer)), 0), min(int(np.floor(x + outer)) + 1, image.shape[1])
    pixels, count = np.empty(max(bottom - top, 0) * max(right - left, 0), np.float32), 0
    for row in range(top, bottom):
        for column in range(left, right):
            square = (row - y) ** 2 + (column - x) ** 2
            if inner * inner < square < outer * outer and _is_free(neighbours, column, row, 0.0):
                pixels[count] = image[row, column]
                count += 1
    return pixels[:count]


@njit(cache=True)
def _sample_surroundings(image, valid, disk, neighbours, limits):
    """Pixels around one contact that lie in the surroundings of no other."""
    sample = np.empty(DIRECTIONS * DISTANCES, np.float32)
    count = 0
    for k in range(DIRECTIONS):
        for j in range(DISTANCES):
            r = disk[2] + limits[0] + (limits[1] - limits[0]) * j / (DISTANCES - 1.0)
            column = int(np.floor(disk[0] + r * COSINES[k] + 0.5))
            row = int(np.floor(disk[1] + r * SINES[k] + 0.5))
            if not _is_seen(valid, row, column, image.shape):
                continue
            if _is_free(neighbours, column, row, limits[0]):
                sample[count] = image[row, column]
                count += 1
    return sample[:count]


@njit(cache=True)
def area_above(image, disks, levels, reach_px, out):
    """Area (px^2) within ``reach_px`` of each rim where the image exceeds the contact's level.

    Between pixels the level line is that of marching squares: straight in each square of four pixels. NaN for
    contacts without a level and for those whose reach leaves the image.
    """
    rows, columns = image.shape
    for i in range(len(disks)):
        x, y, reach, level = disks[i, 0], disks[i, 1], disks[i, 2] + reach_px, levels[i]
        top, bottom = int(np.floor(y - reach)), int(np.ceil(y + reach))
        if not level > 0.0 or top < 0 or bottom >= rows or x - reach < 0 or np.ceil(x + reach) >= columns:
            out[i] = np.nan
            continue
        total = 0.0
        for row in range(top, bottom):
            left = reach * reach - (row + 0.5 - y) ** 2
            if left < 0.0:
                continue
            half = np.sqrt(left)
            first, last = int(np.ceil(x - half - 0.5)), int(np.floor(x + half - 0.5)) + 1
            total += _row_above(image[row, first : last + 1], image[row + 1, first : last + 1], level)
        out[i] = total


@njit(cache=True)
def _row_above(upper, lower, level):
    """Area above a level in the squares between two rows of pixels."""
    total, before = 0.0, 2
    for k in range(len(upper)):
        here = (upper[k] > level) + (lower[k] > level)
        if k > 0 and here == before == 2:
            total += 1.0
        elif k > 0 and here + before > 0:
            total += _share_above(
                upper[k - 1] - level, upper[k] - level, lower[k] - level, lower[k - 1] - level
            )
        before = here
    return total


@njit(cache=True, forceinline=True)
def _share_above(one, two, three, four):
    """Share of a square where a function is positive at some corners, from its values there in turn."""
    if (one > 0) + (two > 0) + (three > 0) + (four > 0) == 3:
        return 1.0 - _share_above_few(-one, -two, -three, -four)
    return _share_above_few(one, two, three, four)


@njit(cache=True)
def _share_above_few(one, two, three, four):
    """The same with one or two corners above: a triangle, a trapezium, or two triangles."""
    values = (one, two, three, four)
    total = 0.0
    for k in range(4):
        here, before, after = values[k], values[(k + 3) % 4], values[(k + 1) % 4]
        if here <= 0:
            continue
        if after > 0:
            # a side above: the trapezium between the crossings of the two sides next to it
            beyond = values[(k + 2) % 4]
            return 0.5 * (here / (here - before) + after / (after - beyond))
        if before <= 0:
            total += 0.5 * (here / (here - before)) * (here / (here - after))
    return total
