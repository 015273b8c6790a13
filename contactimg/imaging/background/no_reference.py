"""Estimate the background of a frame from the frame itself, and the polarity of its contacts.

Where contacts leave a flat background between them, a polynomial follows that, and which side the rest of the
frame is on tells the polarity. In a crowd, squares of 2 px between the contacts take the place of the blocks:
their lower envelope is followed by a polynomial, and the lowest well-populated level of what is left is the
background. With the wrong polarity a crowd shows a net between disks, not disks.
"""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.even_out import even_out
from contactimg.imaging.background.find_illumination import (
    NOTABLE_SHARE,
    QUIET_SHARE,
    RIM_SCATTER,
    find_background_level,
    find_rims,
    fit_region,
    flat_regions,
    neighbour_scatter,
    scatter_of_extreme,
)
from contactimg.imaging.background.illumination import (
    BACKGROUND_CLIP_SIGMA,
    DARKEST_FRACTION,
    DifferenceImage,
    Illumination,
    find_sign,
    fit_illumination,
    one_sided_scatter,
)
from contactimg.imaging.detect.bars_and_scratches import label_regions
from contactimg.imaging.detect.candidates import measure_contrast
from contactimg.imaging.pixels.blocks import (
    BLOCK,
    SignedImage,
    block_means,
    find_clipped,
    rounding_of_blocks,
    to_pixels,
)
from contactimg.imaging.pixels.frame_pair import SPAN_LEVELS
from contactimg.imaging.pixels.masks import Mask, Values, exclude
from contactimg.imaging.pixels.noise import estimate_noise
from contactimg.imaging.pixels.robust import finite_values, median, robust_std
from contactimg.imaging.profile.limits import LEAST_FRACTION, SQUARE_PX

FLAT_SHARE = 0.2  # share of the blocks: so large a flat region is the background. By hand
# Squares in one side of the tiles over which the light between small contacts is followed beyond the
# polynomial: 64 px, many contacts wide where blocks of 8 px are not free of them.
TILE_SQUARES = 32


def estimate_background(
    frame: NDArray, *, valid: Mask = None, polarity: str = "bright"
) -> tuple[DifferenceImage, int]:
    """Frame minus a slowly varying background fitted to the frame itself.

    Parameters
    ----------
    frame : ndarray, shape (rows, columns)
        Grey levels; holes filled with anything finite.
    valid : Mask
        0 at holes.
    polarity : {"bright", "dark", "auto"}
        Whether contacts are brighter or darker than the background.

    Returns
    -------
    difference : DifferenceImage
        Still with texture and dirt.
    sign : int
        That makes contacts positive. A background that is flat between contacts shows it; in a crowd both are
        tried, and the one whose foreground is more like disks is taken.

    Notes
    -----
    Where much lies on the wrong side of what flat blocks show, the frame is divided by its envelope first if
    more blocks agree with the background then.

    Examples
    --------
    >>> y, x = np.mgrid[0:160, 0:240]
    >>> frame = (50 + 0.2 * x + 30 * (np.hypot(x - 80, y - 70) < 12)).astype(np.float32)
    >>> difference, sign = estimate_background(frame, polarity="auto")
    >>> image = difference.image
    >>> [bool(abs(image[row, column]) < 1) for row, column in ((20, 200), (150, 10), (70, 80))], sign
    ([True, True, False], 1)
    """
    signs = {"bright": (1,), "dark": (-1,)}.get(polarity, (1, -1))
    rounding, shown = rounding_of_blocks(frame), exclude(valid, find_clipped(frame))
    flat = _flat_background(frame, shown, rounding, sum(signs))
    if flat is None:
        both = [(_background_of_crowd(frame, shown, sign, rounding), sign) for sign in signs]
        roundness = [_roundness(one, sign, valid) for one, sign in both] if len(both) > 1 else [1.0]
        crowd, sign = both[int(np.argmax(roundness))]
        return replace(crowd, valid=valid), sign
    blocks = flat.blocks
    sign = sum(signs) or find_sign(blocks, flat.illumination.background)
    limit = BACKGROUND_CLIP_SIGMA * flat.illumination.scatter
    if np.mean(sign * blocks < -limit) > NOTABLE_SHARE:  # no contact is darker than the background
        other = _flat_behind_envelope(frame, shown, sign, rounding)
        if other is not None:
            near = np.abs(other.blocks) < limit
            flat = other if np.mean(near) > np.mean(np.abs(blocks) < limit) else flat
    return replace(flat, valid=valid), sign


def _flat_background(frame: Values, valid: Mask, rounding: float, sign: int) -> DifferenceImage | None:
    """Frame minus the light that flat blocks show; None in a crowd.

    The background is the largest flat region. Where the ``sign`` of contacts is known (else 0), it is the
    darkest of large ones, for dark contacts the brightest: contacts may cover more of the frame.
    """
    squares = block_means(frame, valid, side=SQUARE_PX)
    rims, quiet = find_rims(squares, _scatter_of_squares(squares, frame, rounding))
    if quiet < 0.5 * QUIET_SHARE:
        return None
    blocks = block_means(frame, valid)
    finite = np.isfinite(blocks)
    # among many contacts most blocks differ from their neighbours, and only those without rims are flat
    # By hand: disks of 4 px every 20 px leave 0.5 of them without a rim, real pins in a lattice 0.6.
    flat = np.where(rims & (quiet < 0.55), np.float32(np.nan), blocks)
    # the light may differ more from row to row than along a row, and rounded means by two steps
    scatter = max(scatter_of_blocks(flat, rounding), scatter_of_blocks(flat.T, rounding), 2.0 * rounding)
    labels, regions = flat_regions(flat, scatter)
    if not regions:
        return None
    large = [k for k in regions if np.mean(labels == k) > FLAT_SHARE * np.mean(finite)] or regions[:1]
    largest = members = labels == min(large, key=lambda k: sign * float(np.median(blocks[labels == k])))
    if np.mean(largest) < FLAT_SHARE * np.mean(finite):
        members = labels > 0  # uneven light, or the rounding of a file, has cut the background into pieces
        if quiet < QUIET_SHARE or np.mean(members) < FLAT_SHARE * np.mean(finite):
            return None
    light = fit_region(blocks, members, frame.shape, scatter=2.0 * scatter, least=scatter)
    level = float(np.median(np.abs(blocks[largest])))
    return _divide_by_illumination(frame, light, level, valid, rounding, sign)


def _flat_behind_envelope(frame: Values, valid: Mask, sign: int, rounding: float) -> DifferenceImage | None:
    """The flat background of a frame that has been divided by its envelope: light that falls steeply."""
    light = sign * _envelope(sign * block_means(frame, valid))
    level = float(np.median(light))
    if not level > 0.0:  # a background had been subtracted before
        return None
    light = np.maximum(cv2.GaussianBlur(light, (0, 0), 1.0), DARKEST_FRACTION * level)
    wide = to_pixels(light, frame.shape, interpolation=cv2.INTER_LINEAR)
    even = np.asarray(frame * (np.float32(level) / wide), np.float32)
    flat = _flat_background(even, valid, rounding, sign)
    return None if flat is None else replace(flat, brightness=flat.brightness * (light / np.float32(level)))


def _background_of_crowd(frame: Values, valid: Mask, sign: int, rounding: float) -> DifferenceImage:
    """Frame minus the light in the gaps of a crowd, where contacts times ``sign`` are bright.

    The light is a polynomial and, at each pixel, what tiles of the image show beyond it.
    """
    squares, shape = np.float32(sign) * block_means(frame, valid, side=SQUARE_PX), frame.shape
    expected = _scatter_of_squares(squares, frame, rounding)
    # the lowest square of a block lies between contacts; that it is low by its noise, the rest corrects
    side, highest = BLOCK // SQUARE_PX, np.finfo(np.float32).max
    window = np.ones((side, side), np.uint8)
    filled = np.where(np.isfinite(squares), squares, highest)
    lowest = cv2.erode(filled, window, anchor=(0, 0))[::side, ::side].astype(np.float32)
    lowest[lowest == highest] = np.nan
    envelope = _envelope(lowest)
    middle = float(np.median(envelope))
    scatter = 2.0 * robust_std(envelope, centre=middle)
    envelope[~np.isfinite(lowest)] = np.nan
    lower = fit_illumination(envelope, shape, level=middle, scatter=scatter)
    flat = (squares - lower.at_blocks(squares.shape, shape)).astype(np.float32)
    level, scatter = find_background_level(flat, background_is="lowest", scatter=expected)
    rest = fit_illumination(flat, shape, level=level, scatter=min(scatter, 2.0 * expected))
    flat -= rest.at_blocks(squares.shape, shape).astype(np.float32)
    known = block_means(rest.background.astype(np.float32), side=TILE_SQUARES)
    total = block_means(np.where(rest.background, flat, np.float32(0.0)), side=TILE_SQUARES)
    mean = np.divide(total, known, out=np.zeros_like(total), where=known > NOTABLE_SHARE)
    uneven = to_pixels(mean, shape, side=TILE_SQUARES * SQUARE_PX, interpolation=cv2.INTER_LINEAR)
    flat -= uneven[::SQUARE_PX, ::SQUARE_PX]
    scatter = one_sided_scatter(flat[rest.background])
    background = np.abs(flat) < BACKGROUND_CLIP_SIGMA * max(scatter, expected)
    light = Illumination(sign * (lower.coefficients + rest.coefficients), background, scatter)
    level = abs(float(np.median(light.at_blocks(flat.shape, shape))))
    return _divide_by_illumination(frame - np.float32(sign) * uneven, light, level, valid, rounding, sign)


def _envelope(blocks: Values) -> Values:
    """Lower envelope of blocks, an opening by a disk; blocks without data (NaN) as high as the median."""
    finite = np.isfinite(blocks)
    filled = np.where(finite, blocks, np.median(blocks[finite]) if finite.any() else 0.0).astype(np.float32)
    # By hand: the envelope goes below contacts narrower than a sixth of the image.
    side = max(int(max(blocks.shape) * (1.0 / 6.0)) | 1, 3)
    window = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    smooth = cv2.medianBlur(filled, 3)
    opened = cv2.morphologyEx(smooth, cv2.MORPH_OPEN, window, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(opened, np.float32)


def scatter_of_blocks(blocks: NDArray, rounding: float) -> float:
    """Scatter of blocks from the differences of neighbours, at least what accuracy and compression leave.

    Blocks most of which are exactly equal differ by less than a grey level from what they would be.
    """
    finite = finite_values(blocks)
    level = median(np.abs(finite)) if len(finite) else 0.0
    scatter = neighbour_scatter(blocks)
    least = 1.0 / SPAN_LEVELS if scatter < LEAST_FRACTION * level else LEAST_FRACTION
    return max(scatter, least * level, rounding, 1e-9)


def _scatter_of_squares(squares: NDArray, frame: NDArray, rounding: float) -> float:
    """Scatter of squares; where rims make most neighbours differ, that of the darkest or brightest ones.

    Where the camera has cut off a part of the levels, the darkest scatter less than others.
    """
    usual = scatter_of_blocks(squares, rounding)
    if find_clipped(frame) is not None:
        return usual
    flattest = max(min(scatter_of_extreme(squares, side) for side in ("lowest", "highest")), rounding)
    return flattest if neighbour_scatter(squares) > RIM_SCATTER * flattest > 0.0 else usual


def _divide_by_illumination(
    frame: NDArray, light: Illumination, level: float, valid: Mask, rounding: float, sign: int
) -> DifferenceImage:
    """Frame minus background, relative to it: contacts transmit a fraction of the light."""
    at_blocks = light.at_blocks((-(-frame.shape[0] // BLOCK), -(-frame.shape[1] // BLOCK)), frame.shape)
    # else subtracted before, or hardly lit
    relative = bool(at_blocks.min() >= 2.0 * DARKEST_FRACTION * level > 0)
    image = light.subtract_from(frame, level if relative else 0.0)
    brightness = (at_blocks / level if relative else np.ones(at_blocks.shape)).astype(np.float32)
    difference = DifferenceImage(image, level, brightness, light, None, valid=valid, rounding=rounding)
    return even_out(difference, sign=sign, relative=relative)


def _roundness(difference: DifferenceImage, sign: int, valid: Mask) -> float:
    """Fraction of the foreground's area that lies in the largest disks that fit into its components."""
    image = difference.image * np.float32(sign)
    if valid is not None:
        image = np.where(valid > 0, image, np.float32(0.0))
    noise = estimate_noise(image, difference.illumination.background)
    contrast = measure_contrast(SignedImage(image, noise, valid, rounding=difference.rounding))
    if contrast.plateau <= 0.0:
        return 0.0
    regions = label_regions(image > 0.5 * contrast.plateau)
    total = float(regions.area.sum())
    return float(np.minimum(np.pi * regions.half_width**2, regions.area).sum()) / total if total else 0.0
