"""Take out of a difference image what no polynomial describes: flicker, regions of another level, slow waves.

A step or a patch of another level, and light less even than a cubic, are followed in the flat regions of the
image: connected blocks that differ from their neighbours by no more than noise. A flat region that is much
larger than the largest disk in it is background, since contacts pierce a background and are disks themselves.
"""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.find_illumination import neighbour_scatter
from contactimg.imaging.background.illumination import (
    BACKGROUND_CLIP_SIGMA,
    SMALLEST_SCATTER_FRACTION,
    DifferenceImage,
    fit_illumination,
    one_sided_scatter,
)
from contactimg.imaging.pixels.blocks import BLOCK, block_means, sample_background, side_of

# Flicker
FLICKER_SAMPLE = 12  # rows or columns of blocks that are looked at; accuracy: the scatter of 96 lines to 7 %
NOISE_SAMPLE = (13, 31)  # rows and columns from one pixel to the next of which the noise is read; accuracy
FLICKER_SIGMA = 5.0  # significance of what both halves of the lines share; false-alarm rate 3e-7
FLICKER_PART = 0.1
"""Scatter of the lines, of that of a pixel, below which it is left. Theory: over the 2 a lines of a contact
of radius a = 10 px it then adds a fifth to the variance of the noise."""
# Flat regions
FLAT_SPAN = (
    4.0  # range over 3 x 3 blocks after a median, in scatters of a block; by hand: steps of 8 scatters
)
PIERCED = 2.0  # area over that of the inscribed disk: a disk has 1, an ellipse its ratio of axes; by hand
NO_DISK, LARGE_SHARE = (
    1.3,
    0.05,
)  # the same of a region as large as this share of the blocks: a square has 1.3
FEWEST_BEYOND = 2
"""Blocks in a region that lie beyond it as seen from the background: contacts on it. By hand: one may be
dirt."""
WIDE_SHARE = 0.1  # of the blocks: no contact at the border of a frame without reference is so large; by hand
FEWEST_BLOCKS = 60  # of a region: a contact that fills so many has a radius of 35 px; by hand
MOST_REGIONS = 8  # that are followed, the largest; a bound of the work
# Their levels
MESH_BLOCKS = 2.0  # standard deviation of the Gaussian that smooths the mesh, blocks: about 4 blocks wide
MESH_PRIOR_BLOCKS = (
    4.0  # blocks of no deviation that each node of the mesh counts beside those it has; by hand
)
UNEVEN_RATIO = (
    3.0  # variance of the mesh over that from the noise of its blocks, above which it is used; by hand
)
LEAST_UNEVEN = 0.5  # rms of what is left, in scatters of a block, that is worth a correction; by hand
WINDOW_BLOCKS = 5  # side of the squares whose means show that, blocks: as many as in the mesh
UNEXPLAINED_SHARE = (
    0.04  # of the blocks that are flat and no background; by hand: contacts up to 24 px make 0.02
)
LEAST_SHARE = 0.05  # of the blocks that are flat background; by hand: fewer do not tell


def even_out(difference: DifferenceImage, *, relative: bool = True) -> DifferenceImage:
    """The difference image without flicker of its rows and columns and with all of its background at zero.

    ``relative``: contacts transmit a fraction of the light, so that they are corrected with it.
    """
    flickering, light_level = difference, difference.level if relative else 0.0
    for axis in (1, 0):
        difference = _without_flicker(difference, axis, light_level)
    blocks = block_means(difference.image, difference.valid)
    background = difference.illumination.background
    if background.shape != blocks.shape:  # small contacts leave no block free
        return difference
    flat = blocks[background & np.isfinite(blocks)]
    if flat.size < FEWEST_BLOCKS:
        return difference
    scatter = min(neighbour_scatter(blocks), one_sided_scatter(flat[:: max(flat.size // 4000, 1)]))
    scatter = max(scatter, SMALLEST_SCATTER_FRACTION * max(difference.level, 1.0))
    if difference is not flickering:
        background = np.abs(blocks) < BACKGROUND_CLIP_SIGMA * scatter
        difference = replace(difference, illumination=replace(difference.illumination, background=background))
    if not _is_uneven(blocks, background, scatter):
        return difference
    regions = find_background_regions(blocks, scatter, background, with_reference=difference.ratio)
    members = regions > 0
    if np.mean(members) < LEAST_SHARE:
        return difference
    left = np.stack([follow_region(blocks, regions == k, difference.image.shape, scatter)
                     for k in range(1, int(regions.max()) + 1)])  # fmt: skip
    levels = _at_places(left, _nearest(regions))
    if np.sqrt(np.mean(levels[members] ** 2)) < LEAST_UNEVEN * scatter:
        return difference
    background = np.abs(blocks - levels) < BACKGROUND_CLIP_SIGMA * scatter
    light = 1.0 + levels / light_level if light_level > 0 else np.float32(1.0)
    return replace(
        difference,
        image=_subtract_left(difference.image, _at_pixels(difference.image, left, regions), light_level),
        brightness=np.asarray(difference.brightness * np.maximum(light, 0.1), np.float32),
        illumination=replace(difference.illumination, background=background),
    )


def _is_uneven(blocks: NDArray[np.float32], background: NDArray[np.bool_], scatter: float) -> bool:
    """Whether flat blocks are no background, or the background is less even than its noise explains."""
    if np.mean(_flat_blocks(blocks, scatter) & ~background) > UNEXPLAINED_SHARE:
        return True
    used = background & np.isfinite(blocks)
    window = (WINDOW_BLOCKS, WINDOW_BLOCKS)
    weight = cv2.blur(used.astype(np.float32), window)
    mean = cv2.blur(np.where(used, blocks, np.float32(0.0)), window) / np.maximum(weight, np.float32(1e-3))
    enough = used & (weight > 0.5)
    variance = float(np.mean(mean[enough] ** 2)) if enough.any() else 0.0
    return variance > scatter**2 * max(UNEVEN_RATIO / WINDOW_BLOCKS**2, LEAST_UNEVEN**2)


def _flat_blocks(blocks: NDArray[np.float32], scatter: float) -> NDArray[np.bool_]:
    """Blocks whose surroundings differ by no more than noise, single blocks that stand out apart."""
    finite = np.isfinite(blocks)
    filled = blocks if finite.all() else np.where(finite, blocks, np.float32(np.nanmedian(blocks)))
    middle, square = cv2.medianBlur(np.ascontiguousarray(filled, np.float32), 3), np.ones((3, 3), np.uint8)
    return np.asarray((cv2.dilate(middle, square) - cv2.erode(middle, square) < FLAT_SPAN * scatter) & finite)


def find_background_regions(
    blocks: NDArray[np.float32],
    scatter: float,
    known: NDArray[np.bool_] | None = None,
    *,
    with_reference: bool = False,
) -> NDArray[np.int32]:
    """Number of the flat background region that each block is in, the largest region first; 0 for none.

    A region is background where most of its blocks are ``known`` to be (without such knowledge the largest
    one), or where it is larger than the largest disk in it; without a reference also where it lies at the
    border and is larger than contacts are.
    """
    flat = _flat_blocks(blocks, scatter)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(flat.astype(np.uint8), connectivity=4)
    # where the background is known a region ends at the border of the image; else a contact cut by it may not
    width = int(known is not None)
    half_width = cv2.distanceTransform(np.pad(flat, width).astype(np.uint8), cv2.DIST_L2, 5)
    half_width = half_width[width : len(half_width) - width, width : half_width.shape[1] - width]
    area = stats[:, cv2.CC_STAT_AREA]
    largest = [k for k in np.argsort(-area)[: MOST_REGIONS + 1] if k and area[k] >= FEWEST_BLOCKS]
    chosen = []
    for k in largest:
        inside = labels == k
        # between whole blocks the largest disk is known to half a block; without holes it may be the larger
        radius = float(half_width[inside].max()) - (0.5 if known is not None or _has_holes(inside) else 0.0)
        disk = np.pi * radius**2
        pierced = area[k] > disk * (NO_DISK if area[k] > LARGE_SHARE * labels.size else PIERCED)
        at_border = any(side.any() for side in (inside[0], inside[-1], inside[:, 0], inside[:, -1]))
        wide = not with_reference and at_border and area[k] > WIDE_SHARE * labels.size
        pierced = pierced and (known is None or _has_contacts(blocks, inside, scatter))
        if pierced or wide or (k == largest[0] if known is None else np.mean(known[inside]) > 0.5):
            chosen.append(k)
    number = np.zeros(count, np.int32)
    number[chosen] = np.arange(1, len(chosen) + 1)
    return np.asarray(number[labels])


def _has_contacts(blocks: NDArray[np.float32], inside: NDArray[np.bool_], scatter: float) -> bool:
    """Whether a flat region has contacts on it: blocks beyond its level and beyond that of the background.

    A wide contact with specks of dirt has none: what is darker in it lies between both levels.
    """
    closed = cv2.morphologyEx(np.pad(inside, 2).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    outlines, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    whole = cv2.drawContours(np.zeros_like(closed), outlines, -1, 1, cv2.FILLED)[2:-2, 2:-2] > 0
    levels, level = blocks[whole & ~inside], float(np.median(blocks[inside]))
    low, high = min(0.0, level) - FLAT_SPAN * scatter, max(0.0, level) + FLAT_SPAN * scatter
    return int(np.count_nonzero((levels < low) | (levels > high))) >= FEWEST_BEYOND


def _has_holes(region: NDArray[np.bool_]) -> bool:
    """Whether a region surrounds others: contacts pierce a background."""
    rest = np.pad((~region).astype(np.uint8), 1, constant_values=1)
    return int(cv2.connectedComponents(rest, connectivity=4)[0]) > 2


def follow_region(
    blocks: NDArray[np.float32], members: NDArray[np.bool_], shape: tuple[int, int], scatter: float
) -> NDArray[np.float64]:
    """Level of a region at each block: a polynomial, and a mesh where it is less even than that."""
    inside = np.where(members, blocks, np.float32(np.nan))
    middle = float(np.median(blocks[members]))
    smooth = fit_illumination(inside, shape, level=middle, scatter=2.0 * scatter, least_scatter=scatter)
    level = smooth.at_blocks(blocks.shape, shape)
    used = smooth.background & members
    weight = used.astype(np.float32)
    rest = np.where(used, blocks - level, 0.0).astype(np.float32)
    total, known = (
        cv2.GaussianBlur(part, (0, 0), MESH_BLOCKS, borderType=cv2.BORDER_REFLECT) for part in (rest, weight)
    )
    independent = 4.0 * np.pi * MESH_BLOCKS**2
    mesh = total / (known + np.float32(MESH_PRIOR_BLOCKS / independent))
    expected = scatter**2 / independent / max(float(known[used].mean()), 1e-3) if used.any() else np.inf
    if used.any() and np.mean(mesh[used] ** 2) > UNEVEN_RATIO * expected:
        level = level + mesh
    return np.clip(level, blocks[members].min(), blocks[members].max())


def _nearest(regions: NDArray[np.int32]) -> NDArray[np.int32]:
    """Number of the region nearest to each place; 0 in ``regions`` is outside all."""
    outside = (regions == 0).astype(np.uint8)
    _, nearest = cv2.distanceTransformWithLabels(outside, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    number = np.zeros(int(nearest.max()) + 1, np.int32)
    number[nearest[regions > 0]] = regions[regions > 0]
    return np.asarray(number[nearest])


def _at_places(levels: NDArray, regions: NDArray[np.int32]) -> NDArray[np.float32]:
    """At each place the level of its region."""
    return np.asarray(np.take_along_axis(levels, regions[None].astype(np.int64) - 1, axis=0)[0], np.float32)


def _at_pixels(
    image: NDArray[np.float32], left: NDArray[np.float64], regions: NDArray[np.int32]
) -> NDArray[np.float32]:
    """The level at each pixel: that of its region; between two the one nearer to the image around the pixel.

    What is far from both, and what is next to that, is a contact, and has the level of what surrounds it.
    """
    rows, columns = image.shape
    size = (regions.shape[1] * BLOCK, regions.shape[0] * BLOCK)
    fields = np.stack([cv2.resize(part.astype(np.float32), size)[:rows, :columns] for part in left])
    if len(fields) == 1:
        return np.asarray(fields[0])

    def wide(blocks: NDArray) -> NDArray:
        return blocks.repeat(BLOCK, 0).repeat(BLOCK, 1)[:rows, :columns]

    places = wide(regions).astype(np.int32)
    smooth = cv2.blur(image, (5, 5))
    highest, lowest = fields.max(axis=0), fields.min(axis=0)
    beyond = 0.5 * (highest - lowest)
    contact = ((smooth > highest + beyond) | (smooth < lowest - beyond)).astype(np.uint8)
    contact = cv2.dilate(contact, np.ones((7, 7), np.uint8))
    nearest = np.argmin(np.abs(smooth - fields), axis=0).astype(np.int32) + 1
    places = np.where((places == 0) & (contact == 0), nearest, places)
    return _at_places(fields, _nearest(places))


def _subtract_left(
    image: NDArray[np.float32], left: NDArray[np.float32], level: float
) -> NDArray[np.float32]:
    """The image with a background that is brighter by ``left``: contacts transmit a fraction of the light."""
    if level <= 0:
        return image - left
    return np.asarray((image - left) / np.maximum(1.0 + left / np.float32(level), np.float32(0.1)))


def _without_flicker(difference: DifferenceImage, axis: int, level: float) -> DifferenceImage:
    """The difference image without what the background of a row (axis 1) or column (axis 0) has in common."""
    image, background = difference.image, difference.illumination.background
    noise = one_sided_scatter(sample_background(image, background, NOISE_SAMPLE))
    image, background = (image, background) if axis else (image.T, background.T)
    every = max(len(background) // FLICKER_SAMPLE, 1)
    means, count = _line_means(image, background, every, halves=2)
    used = (count > BLOCK).all(axis=1)
    if np.count_nonzero(used) < FEWEST_BLOCKS // 2:
        return difference
    shared = np.prod(means[used] - means[used].mean(axis=0), axis=1)
    significant = shared.mean() > FLICKER_SIGMA * shared.std() / np.sqrt(shared.size)
    if not (significant and shared.mean() > (FLICKER_PART * noise) ** 2):
        return difference
    if side_of(background.shape, image.shape) == BLOCK:
        background = _with_lost_lines(block_means(image), background)
    means, count = _line_means(image, background, 1, halves=1)
    offset = means * shared.mean() / (shared.mean() + noise**2 / np.maximum(count, 1e-3))
    left = offset.astype(np.float32)
    return replace(difference, image=_subtract_left(difference.image, left if axis else left.T, level))


def _line_means(
    image: NDArray[np.float32], background: NDArray[np.bool_], every: int, *, halves: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and number of the background pixels in parts of each line, for each so many lines of blocks."""
    side, width = side_of(background.shape, image.shape), image.shape[1]
    total, count = [], []
    for k in range(0, len(background), every):
        lines = image[k * side : (k + 1) * side]
        weight = np.zeros((halves, width), np.float32)
        for half in range(halves):
            part = slice(half * width // halves, (half + 1) * width // halves)
            weight[half, part] = background[k].repeat(side)[:width][part]
        total.append(lines @ weight.T)
        count.append(np.broadcast_to(weight.sum(axis=1), total[-1].shape))
    number = np.concatenate(count).astype(float)
    return np.concatenate(total) / np.maximum(number, 1.0), number


def _with_lost_lines(blocks: NDArray[np.float32], background: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Background with the lines that flicker has taken out of it: in them, what is near their median."""
    share = background.mean(axis=1)
    lost = share < 0.5 * np.median(share)
    scatter = neighbour_scatter(blocks.T)
    near = np.abs(blocks - np.median(blocks, axis=1)[:, None]) < BACKGROUND_CLIP_SIGMA * scatter
    return np.where(lost[:, None], near, background)
