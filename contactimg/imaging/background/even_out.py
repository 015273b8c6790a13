"""Take out of a difference image what no polynomial describes: flicker, regions of another level, slow waves.

A step or a patch of another level, and light less even than a cubic, are followed in the flat regions of the
image: connected blocks that differ from their neighbours by no more than noise. A flat region is background
if contacts stand on it, or if it is on the side of the background on which no contact is: a shadow, say.
Another one is a wide contact.
"""

from dataclasses import replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.find_illumination import (
    NOTABLE_SHARE,
    find_flat_blocks,
    fit_region,
    flat_regions,
    neighbour_scatter,
)
from contactimg.imaging.background.illumination import (
    BACKGROUND_CLIP_SIGMA,
    DifferenceImage,
    find_sign,
    one_sided_scatter,
)
from contactimg.imaging.pixels.blocks import BLOCK, to_pixels
from contactimg.imaging.pixels.masks import Flags, Values, mean_of_seen
from contactimg.imaging.pixels.noise import estimate_noise
from contactimg.imaging.pixels.robust import LIGHT_SIGMA, SIGNIFICANT_SIGMA, SOME
from contactimg.imaging.profile.limits import FEWEST, LEAST_FRACTION

Regions = NDArray[np.int32]

BRIGHTEST_RATIO = 2.2  # of a contact over another one beside it, more than which a region is none. By hand
MESH_BLOCKS = 2.0  # standard deviation of the Gaussian that smooths the mesh, blocks: about 4 blocks wide
# Root mean square of what is left, in scatters of a block, that is worth a correction. By hand.
LEAST_UNEVEN = 0.5


def even_out(difference: DifferenceImage, *, sign: int = 0, relative: bool = True) -> DifferenceImage:
    """The difference image without flicker of its rows and columns and with all of its background at zero.

    ``sign`` is that of contacts; 0: that of most of what stands out. ``relative``: contacts transmit a
    fraction of the light, so that they are corrected with it.
    """
    light_level = difference.level if relative else 0.0
    flickering, background = difference, difference.illumination.background
    if background.shape != difference.blocks.shape:  # small contacts leave no block free
        return difference
    for axis in (1, 0):
        difference = _without_flicker(difference, axis, light_level)
    blocks = difference.blocks
    used = background & np.isfinite(blocks)
    flat = blocks[used]
    if flat.size < SOME:
        return difference
    scatter = min(neighbour_scatter(blocks), one_sided_scatter(flat[:: max(flat.size // 4000, 1)]))
    scatter = max(scatter, difference.rounding, LEAST_FRACTION * max(difference.level, 1.0))
    if difference is not flickering:
        background = np.abs(blocks) < BACKGROUND_CLIP_SIGMA * scatter
        difference = replace(difference, illumination=replace(difference.illumination, background=background))
        used = background & np.isfinite(blocks)
    uneven = np.mean(_mesh(blocks, used)[used] ** 2) > (LEAST_UNEVEN * scatter) ** 2
    if not uneven and np.mean(find_flat_blocks(blocks, scatter) & ~background) < NOTABLE_SHARE:
        return difference
    sign = sign or find_sign(blocks, background)
    regions = _find_background_regions(np.float32(sign) * blocks, scatter, background)
    members = regions > 0
    if np.mean(members) < NOTABLE_SHARE:
        return difference
    left = np.stack([follow_region(blocks, regions == k, difference.image.shape, scatter)
                     for k in range(1, int(regions.max()) + 1)])  # fmt: skip
    levels = np.choose(_nearest(regions) - 1, left)
    if np.sqrt(np.mean(levels[members] ** 2)) < LEAST_UNEVEN * scatter:
        return difference
    background = np.abs(blocks - levels) < BACKGROUND_CLIP_SIGMA * scatter
    return replace(
        difference,
        image=_subtract_left(difference.image, _at_pixels(difference.image, left, regions), light_level),
        brightness=difference.brightness * _light(levels, light_level),
        illumination=replace(difference.illumination, background=background),
    )


def _find_background_regions(blocks: Values, scatter: float, known: Flags) -> Regions:
    """Number of the flat background region that each block is in, the largest region first; 0 for none.

    A region is background where most of its blocks are ``known`` to be, where it is darker than those are,
    since contacts are brighter, or where contacts stand on it. Regions of one level are one.
    """
    labels, largest = flat_regions(blocks, scatter)
    number, levels = np.zeros(int(labels.max()) + 1, np.int32), list[float]()
    for k in largest:
        inside = labels == k
        level = float(np.median(blocks[inside]))
        contact = level + LIGHT_SIGMA * scatter
        if np.mean(known[inside]) > 0.5 or level < 0.0 or _has_contacts(blocks, inside, contact, level):
            same = [n for n, other in enumerate(levels, start=1) if abs(level - other) < scatter]
            number[k] = same[0] if same else len(levels) + 1
            levels += [] if same else [level]
    return np.asarray(number[labels])


def _has_contacts(blocks: Values, inside: Flags, contact: float, level: float) -> bool:
    """Whether what a region surrounds is brighter than contacts at least in some blocks.

    In its convex hull, where a contact may lie beside another one that is not convex, it must be far brighter
    than the ``level`` of the region.
    """
    closed = cv2.morphologyEx(inside.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    outlines, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    hull = [cv2.convexHull(np.concatenate(outlines))]
    for around, least in ((outlines, contact), (hull, max(contact, BRIGHTEST_RATIO * level))):
        whole = cv2.drawContours(np.zeros(inside.shape, np.uint8), around, -1, 1, cv2.FILLED) > 0
        # Two blocks that stand out as contacts do are contacts on the region. By hand: one may be dirt.
        if np.count_nonzero(blocks[whole & ~inside] > least) >= 2:
            return True
    return False


def follow_region(blocks: Values, members: Flags, shape: tuple[int, int], scatter: float) -> Values:
    """Level of a region at each block: a polynomial, and a mesh where it is less even than that."""
    smooth = fit_region(blocks, members, shape, scatter=2.0 * scatter, least=scatter)
    level = smooth.at_blocks(blocks.shape, shape).astype(np.float32)
    used = smooth.background & members
    left = _mesh(blocks - level, used)
    if np.any(used) and np.mean(left[used] ** 2) > (LEAST_UNEVEN * scatter) ** 2:
        level = level + left
    return np.clip(level, blocks[members].min(), blocks[members].max())


def _mesh(blocks: NDArray, used: Flags) -> Values:
    """Mean of the used blocks around each; it tends to zero far from them."""
    blur = partial(cv2.GaussianBlur, ksize=(0, 0), sigmaX=MESH_BLOCKS, borderType=cv2.BORDER_REFLECT)
    mean, weight = mean_of_seen(blur, blocks, used)
    # as if one block in the weight of the Gaussian, 4 pi s^2, were known to be zero
    return mean * weight / (weight + np.float32(1.0 / (4.0 * np.pi * MESH_BLOCKS**2)))


def _nearest(regions: Regions) -> Regions:
    """Number of the region nearest to each place; 0 in ``regions`` is outside all."""
    outside = (regions == 0).astype(np.uint8)
    _, nearest = cv2.distanceTransformWithLabels(outside, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    number = np.zeros(int(nearest.max()) + 1, np.int32)
    number[nearest[regions > 0]] = regions[regions > 0]
    return np.asarray(number[nearest])


def _at_pixels(image: Values, left: Values, regions: Regions) -> Values:
    """The level at each pixel: that of its region; between two the one nearer to the image around the pixel.

    What is far from both, and what is next to that, is a contact, and has the level of what surrounds it. So
    is what has the level of another region and is not connected with it.
    """
    fields = np.stack([to_pixels(part, image.shape, interpolation=cv2.INTER_LINEAR) for part in left])
    if len(fields) == 1:
        return fields[0]
    places = to_pixels(regions, image.shape)
    smooth = cv2.blur(image, (5, 5))
    highest, lowest = fields.max(axis=0), fields.min(axis=0)
    beyond = 0.5 * (highest - lowest)
    contact = ((smooth > highest + beyond) | (smooth < lowest - beyond)).astype(np.uint8)
    contact = cv2.dilate(contact, np.ones((7, 7), np.uint8))
    nearest = np.argmin(np.abs(smooth - fields), axis=0).astype(np.int32) + 1
    chosen = np.where((places == 0) & (contact == 0), nearest, places)
    for k in range(1, len(fields) + 1):
        count, parts = cv2.connectedComponents((chosen == k).astype(np.uint8), connectivity=4)
        connected = np.zeros(count, np.bool_)
        connected[parts[places == k]] = True
        chosen[(chosen == k) & ~connected[parts]] = 0
    return np.choose(_nearest(chosen) - 1, fields)


def _subtract_left(image: Values, left: Values, level: float) -> Values:
    """The image with a background that is brighter by ``left``: contacts transmit a fraction of the light."""
    return (image - left) / _light(left, level)


def _light(left: Values, level: float) -> Values | np.float32:
    """Light of a background that is brighter by ``left`` than a level; 1 at a level of 0."""
    return np.maximum(1.0 + left / np.float32(level), np.float32(0.1)) if level > 0 else np.float32(1.0)


def _in_common(image: NDArray, used: Flags, fewest: int = 0) -> tuple[float, NDArray, NDArray]:
    """Variance that both halves of rows share, 0 where it is chance; mean and number of used values."""
    half = image.shape[1] // 2
    sides = [(image[:, side], used[:, side]) for side in (slice(None, half), slice(half, None))]
    total = np.stack([np.sum(part, axis=1, where=seen, dtype=float) for part, seen in sides], axis=1)
    number = np.stack([np.count_nonzero(seen, axis=1) for _, seen in sides], axis=1)
    halves = (total / np.maximum(number, 1))[(number > fewest).all(axis=1)]
    count = number.sum(axis=1, keepdims=True)
    mean = total.sum(axis=1, keepdims=True) / np.maximum(count, 1)
    if len(halves) < 2:
        return 0.0, mean, count
    shared = np.prod(halves - halves.mean(axis=0), axis=1)
    significant = shared.mean() > SIGNIFICANT_SIGMA * shared.std() / np.sqrt(shared.size)
    return float(shared.mean()) if significant else 0.0, mean, count


def _without_flicker(difference: DifferenceImage, axis: int, level: float) -> DifferenceImage:
    """The difference image without what the background of a row (axis 1) or column (axis 0) has in common."""
    image, blocks = difference.image, difference.blocks
    background = difference.illumination.background & np.isfinite(blocks)
    if not axis:
        image, blocks, background = image.T, blocks.T, background.T
    near, hides = _near_the_median_of_lines(blocks, background)
    by_blocks = 0.0 if hides else _in_common(blocks, background)[0]
    if hides:
        background = near
    elif by_blocks > 0.0:
        share = background.mean(axis=1, keepdims=True)
        background = np.where(share < 0.5 * np.median(share), near, background)  # flicker took a line out
    else:
        return difference
    noise = estimate_noise(image, background)
    # Theory: of less, the 2 a lines of a contact of radius a = 10 px add a fifth to that of the noise.
    least = 0.01 * noise**2
    # flicker of single lines is less by their number in the lines of blocks: pixels show no more than that
    if not hides and by_blocks * len(image) / len(blocks) < least:
        return difference
    used = to_pixels(background.astype(np.uint8), image.shape) > 0
    shared, offset, count = _in_common(image, used, BLOCK)
    if not shared > least:
        return difference
    left = (offset * shared / (shared + noise**2 / np.maximum(count, 1e-3))).astype(np.float32)
    return replace(difference, image=_subtract_left(difference.image, left if axis else left.T, level))


def _near_the_median_of_lines(blocks: Values, known: Flags) -> tuple[Flags, bool]:
    """Blocks at the median of their line, and whether flicker hides that they are the background.

    These blocks are background if they are far more than those ``known`` to be, the others stand out to one
    side, and the median changes from line to line, by more than blocks near it differ and by less than the
    others stand out.
    """
    finite = np.isfinite(blocks)
    filled = blocks if finite.all() else np.where(finite, blocks, np.float32(0.0))
    ordered, count = np.sort(filled, axis=1), filled.shape[1]
    middle = 0.5 * (ordered[:, (count - 1) // 2, None] + ordered[:, count // 2, None])
    rest, limit = filled - middle, BACKGROUND_CLIP_SIGMA * neighbour_scatter(blocks)
    near = finite & (np.abs(rest) < limit)
    if len(middle) < FEWEST or near.mean() < known.mean() + NOTABLE_SHARE:
        return near, False
    rest = rest[finite]
    sides = [np.count_nonzero(side > limit) for side in (-rest, rest)]
    # by hand: steps of the light and plates are less steep (0.26), ridges stand out as far as the others
    steep = np.diff(middle, axis=0).std() > 0.3 * middle.std()
    low = np.ptp(middle) < 0.7 * np.abs(rest).max()
    # what moves the median alone are contacts: flicker moves the blocks on the other side of it as well
    opposite = ordered[:, count // 4 if sides[1] > sides[0] else -1 - count // 4]
    moved = opposite.std() > 0.5 * middle.std()
    return near, bool(steep and low and moved and min(sides) < 0.1 * max(sides))
