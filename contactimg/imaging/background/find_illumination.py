"""Find the background of an image and fit its illumination, from blocks or, in a crowd, from smaller squares.

Among many small contacts hardly a block of 8 px is free of light from one of them: what passes for background
is too bright and scatters more than the blocks of the reference. Squares of 2 px fit between such contacts.
Light that falls far across the image has no single level; there the background is flat: its blocks
differ from their neighbours by no more than noise.
"""

from collections.abc import Callable
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.illumination import (
    BACKGROUND_CLIP_SIGMA,
    FIT_BLOCKS,
    Illumination,
    fit_illumination,
    jittered_grid,
)
from contactimg.imaging.pixels import robust
from contactimg.imaging.pixels.blocks import BLOCK, block_means
from contactimg.imaging.pixels.masks import Flags, Values
from contactimg.imaging.profile.limits import LEAST_FRACTION, SQUARE_PX

BackgroundLevel = Literal["lowest", "highest", "nearest_one", "most_common"]
"""Which of several well-populated levels is the background: the lowest (contacts are bright), the highest
(contacts are dark), the one nearest to 1 (for a ratio to a reference) or the most common."""

Rows = NDArray[np.intp] | slice
Shape = tuple[int, int]
ALL_ROWS = slice(None)

# Scatter of squares, in a block or all over, over what noise and texture explain, from which on rims of
# contacts make it. By hand.
RIM_SCATTER = 3.0
# Share of the blocks without a rim in them, below which squares take their place; half as many do without a
# reference, where flat regions of blocks show the background. By hand: dots of 4 px every 18 px leave 0.29 of
# the blocks alone, 500 contacts of 1.5-30 px on 1600 x 1200 pixels leave 0.7, real pins in a lattice 0.61.
QUIET_SHARE = 0.7
# Share of the blocks above which flat ones that are no background are too many for contacts, and of the
# highest bin of a histogram below which a peak is no level. By hand: contacts up to 24 px make 0.02.
NOTABLE_SHARE = 0.05


def find_illumination(
    means: Callable[[int, Rows], tuple[NDArray, float]],
    shape: tuple[int, int],
    *,
    background_is: BackgroundLevel,
    rounding: float = 0.0,
) -> Illumination:
    """Fit a slowly varying illumination to the background.

    Parameters
    ----------
    means : callable
        For a side in px, and the rows of the image to use, the means of the quantity (ratio to
        the reference, or difference from it) over squares of that side, NaN = no data, and the scatter that
        noise and texture give one of them.
    shape : (int, int)
        Shape of the image in pixels.
    background_is : BackgroundLevel
    rounding : float
        Standard uncertainty of each mean by compression (`rounding_of_blocks`), in units of the quantity.

    Returns
    -------
    Illumination
        Its background consists of blocks, or of squares of `SQUARE_PX` where contacts leave no block free.
    """
    blocks, expected = means(BLOCK, ALL_ROWS)
    scatter = max(neighbour_scatter(blocks), rounding)
    level, scatter = find_background_level(blocks, background_is=background_is, scatter=scatter)
    coarse = fit_illumination(blocks, shape, level=level, scatter=scatter, least_scatter=rounding)
    coarse = _on_flat_blocks(coarse, blocks, shape, rounding)
    # Blocks that scatter more than noise and texture explain may hold contacts. By hand.
    even = coarse.scatter <= 1.1 * max(expected, rounding)
    white = expected * BLOCK / SQUARE_PX  # for squares whose scatter whole grey levels hide
    # where the blocks are even, only a lattice can hide the background from them, which some rows show; where
    # they are not, and do not hide it, the illumination is less even than a cubic
    some = np.flatnonzero(np.arange(shape[0]) // BLOCK % max(shape[0] * shape[1] // robust.MANY, 1) == 0)
    squares, expected = means(SQUARE_PX, some if even else ALL_ROWS)
    if not np.isfinite(squares).any():
        return coarse
    _, quiet = find_rims(squares, max(expected, rounding) or white)
    if quiet > (0.5 if even else 1.0) * QUIET_SHARE:
        return coarse
    squares, expected = means(SQUARE_PX, ALL_ROWS) if even else (squares, expected)
    expected = max(expected or white, scatter_of_extreme(squares, background_is))
    expected = max(min(expected, neighbour_scatter(squares)), rounding)
    level, scatter = find_background_level(squares, background_is=background_is, scatter=expected)
    return fit_illumination(squares, shape, level=level, scatter=min(scatter, 2.0 * expected))


def scatter_of_extreme(squares: NDArray, background_is: BackgroundLevel) -> float:
    """Scatter of a square from the differences of neighbours whose mean is most like the background.

    The difference of two values that differ by noise alone does not depend on their mean.
    """
    means = 0.5 * (squares[:, 1:] + squares[:, :-1])
    covered = {"highest": -means, "nearest_one": np.abs(means - 1.0)}.get(background_is, means)
    known = robust.finite_values(covered)
    if not known.size:
        return 0.0
    like = covered <= np.float32(robust.quantile(known, NOTABLE_SHARE))
    differences = np.diff(squares, axis=1)[like]
    return robust.robust_std(differences, centre=0.0) / np.sqrt(2) if len(differences) else 0.0


def find_rims(squares: NDArray, expected: float) -> tuple[Flags, float]:
    """Blocks whose squares scatter more than ``expected``, and the share of those with data that do not."""
    mean, square = (block_means(part, side=BLOCK // SQUARE_PX) for part in (squares, squares**2))
    inside = np.sqrt(np.maximum(square - mean**2, 0.0))
    rims, known = inside > RIM_SCATTER * expected, np.isfinite(inside)
    return rims, float(np.mean(~rims[known])) if known.any() else 1.0


def find_background_level(
    blocks: NDArray, *, background_is: BackgroundLevel, scatter: float
) -> tuple[float, float]:
    """Most likely level of the background among block means, and the scatter of a block.

    Parameters
    ----------
    blocks : ndarray
        Block means; NaN = no data.
    background_is : BackgroundLevel
        Which peak of the histogram is the background.
    scatter : float
        Standard deviation of a background block.

    Returns
    -------
    level, scatter : float
    """
    values = robust.finite_values(blocks)
    if not len(values):
        return 1.0, LEAST_FRACTION
    low, high = float(values.min()), float(values.max())
    scatter = max(scatter, LEAST_FRACTION * max(abs(low), abs(high)), 1e-9)
    bins = int(np.clip((high - low) / scatter, 1, FIT_BLOCKS)) + 4
    edges = np.linspace(low - 2 * scatter, high + 2 * scatter, bins + 1)
    places = ((values - edges[0]) * (bins / (edges[-1] - edges[0]))).astype(np.int64)
    counts = np.bincount(np.minimum(places, bins - 1), minlength=bins)
    smooth = np.convolve(counts, [1, 4, 6, 4, 1], mode="same") / 16.0
    left, right = np.r_[0.0, smooth[:-1]], np.r_[smooth[1:], 0.0]
    populated = smooth >= max(NOTABLE_SHARE * smooth.max(), 1e-9)
    peaks = np.flatnonzero((smooth > left) & (smooth >= right) & populated)
    centres = (edges[:-1] + edges[1:]) / 2
    choice = {
        "lowest": 0,
        "highest": -1,
        "nearest_one": int(np.argmin(np.abs(centres[peaks] - 1.0))),
        "most_common": int(np.argmax(smooth[peaks])),
    }[background_is]
    level, width = float(centres[peaks[choice]]), float(edges[1] - edges[0])
    return level, 2.0 * max(scatter, width)


def neighbour_scatter(blocks: NDArray) -> float:
    """Scatter of a block from the differences of neighbours, some of which lie across rims."""
    rows = jittered_grid((1, len(blocks)), max(blocks.size // FIT_BLOCKS, 1))[1][0]
    difference = robust.finite_values(np.diff(blocks[rows], axis=1))
    if not len(difference):
        return 0.0
    return robust.QUARTILE_TO_STD * robust.quantile(np.abs(difference), 0.25) / np.sqrt(2)


def find_flat_blocks(blocks: Values, scatter: float) -> Flags:
    """Blocks whose surroundings differ by no more than noise, single blocks that stand out apart."""
    finite = np.isfinite(blocks)
    filled = blocks if finite.all() else np.where(finite, blocks, np.float32(np.nanmedian(blocks)))
    middle, square = cv2.medianBlur(np.ascontiguousarray(filled, np.float32), 3), np.ones((3, 3), np.uint8)
    range_around = cv2.dilate(middle, square) - cv2.erode(middle, square)
    return np.asarray((range_around < BACKGROUND_CLIP_SIGMA * scatter) & finite)


def flat_regions(blocks: Values, scatter: float) -> tuple[NDArray[np.int32], list[int]]:
    """Number of the flat region of each block, and the numbers of large regions, the largest first."""
    flat = find_flat_blocks(blocks, scatter).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(flat, connectivity=4)
    area = stats[:, cv2.CC_STAT_AREA]
    # a contact that fills so many blocks has a radius of 35 px
    # The eight largest are followed, which bounds the work.
    largest = [int(k) for k in np.argsort(-area)[: 8 + 1] if k and area[k] >= robust.SOME]
    return np.asarray(labels, np.int32), largest


def fit_region(blocks: Values, members: Flags, shape: Shape, *, scatter: float, least: float) -> Illumination:
    """Fit the illumination of a flat region of blocks; its background are all blocks of that level.

    ``scatter`` is that of its blocks about their median to start from, ``least`` about the illumination.
    """
    level = float(np.median(blocks[members]))
    return fit_illumination(blocks, shape, level=level, scatter=scatter, least_scatter=least, members=members)


def _on_flat_blocks(found: Illumination, blocks: Values, shape: Shape, least: float) -> Illumination:
    """The illumination of flat blocks, if it describes more blocks; else the one found.

    What was found must lie within the outline of the new background, as a part of that or as contacts on it,
    and blocks may scatter little more than before: those of light that flickers scatter far more.
    """
    if not found.background.any():
        return found
    flat = find_flat_blocks(blocks, max(neighbour_scatter(blocks), neighbour_scatter(blocks.T), least, 1e-9))
    if np.mean(flat & ~found.background) < NOTABLE_SHARE:  # no more blocks than before can agree with it
        return found
    light = fit_region(blocks, flat, shape, scatter=np.inf, least=least)
    limit = BACKGROUND_CLIP_SIGMA * min(found.scatter, light.scatter)
    rests = (blocks - one.at_blocks(blocks.shape, shape) for one in (light, found))
    more, usual = (np.mean(np.abs(rest) < limit) for rest in rests)
    better = more > usual + NOTABLE_SHARE and light.scatter < robust.ROUGH_RATIO * found.scatter
    return light if better and encloses(light.background, found.background) else found


def encloses(outer: Flags, inner: Flags) -> bool:
    """Whether most of some blocks lie within the outlines of others."""
    outlines, _ = cv2.findContours(outer.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    whole = cv2.drawContours(np.zeros(outer.shape, np.uint8), outlines, -1, 1, cv2.FILLED) > 0
    return bool(2 * np.count_nonzero(whole & inner) > np.count_nonzero(inner))
