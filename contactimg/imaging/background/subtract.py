"""Subtract the registered reference, with its texture and dirt, from a frame.

Contacts transmit a fraction of the light that falls on them, so the frame is divided by the background: the
reference, aligned with the frame, times the slowly varying ratio of the two illuminations. The result is
scaled to grey levels at the median level of the reference. Where the light has changed strongly, what is left
of it in the difference image is estimated as in a frame without a reference, and taken out.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.alignment import UNKNOWN, Alignment, move_reference
from contactimg.imaging.background.divide import divide_by_reference
from contactimg.imaging.background.even_out import even_out
from contactimg.imaging.background.find_illumination import (
    NOTABLE_SHARE,
    BackgroundLevel,
    Rows,
    encloses,
    find_illumination,
    neighbour_scatter,
)
from contactimg.imaging.background.illumination import (
    BACKGROUND_CLIP_SIGMA,
    DARKEST_FRACTION,
    DifferenceImage,
    Illumination,
    find_sign,
)
from contactimg.imaging.background.no_reference import estimate_background, scatter_of_blocks
from contactimg.imaging.background.register import BIN_PX, align, search_alignment
from contactimg.imaging.pixels.blocks import BLOCK, block_means, find_clipped, rounding_of_blocks, side_of
from contactimg.imaging.pixels.field_of_view import EDGE_REACH_PX, LIT_SHARE
from contactimg.imaging.pixels.masks import Mask, Values, exclude
from contactimg.imaging.pixels.robust import finite_values, median, quantile
from contactimg.imaging.profile.limits import ROUNDS

BACKGROUND_IS: dict[str, BackgroundLevel] = {"bright": "lowest", "dark": "highest", "auto": "nearest_one"}
"""Level of the background among those of a frame, by the polarity of the contacts."""
SIGNS = {"bright": 1, "dark": -1, "auto": 0}
"""Sign that makes contacts positive, by their polarity; 0 where the frame shows it."""
REGISTERED = Alignment(0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class _Images:
    """A frame, its reference before registration, their holes, and which level is the background.

    ``rounding`` is the standard uncertainty of a block by compression, grey levels.
    """

    frame: NDArray
    reference: NDArray
    valid: Mask
    background_is: BackgroundLevel
    rounding: float


def remove_background(
    frame: NDArray, reference: NDArray, *, valid: Mask = None, polarity: str = "auto", **registration: bool
) -> tuple[DifferenceImage, int]:
    """Frame minus background by `subtract_reference`, with what is left of the light taken out.

    Where much is left on the side on which no contact is, or little of the image is background, the light
    has changed strongly. It is then estimated from the difference as well, in which texture and dirt are
    divided out. This estimate is taken if more blocks agree with it and if they enclose those found before.
    A reference that is too dark to divide by, or was subtracted before, is subtracted, and the light
    estimated from the difference.

    Parameters
    ----------
    frame, reference, valid, **registration
        See `subtract_reference`.
    polarity : {"bright", "dark", "auto"}
        Whether contacts are brighter or darker than the background.

    Returns
    -------
    difference : DifferenceImage
    sign : int
        That makes contacts positive.
    """
    level_is, sign = BACKGROUND_IS[polarity], SIGNS[polarity]
    plain = subtract_reference(frame, reference, valid=valid, background_is=level_is, **registration)
    if plain is None:
        rest, shown = np.subtract(frame, reference, dtype=np.float32), exclude(valid, find_clipped(frame))
        difference, sign = estimate_background(rest, valid=shown, polarity=polarity)
        return replace(difference, alignment=UNKNOWN, valid=valid), sign
    best = even_out(plain, sign=sign)
    valid, light, level = plain.valid, best.illumination, plain.level
    if not sign:
        seen = block_means(best.image, valid, side=side_of(light.background.shape, frame.shape))
        sign = find_sign(seen, light.background)
    blocks = best.blocks
    scatter = max(scatter_of_blocks(part, plain.rounding) for part in (blocks, blocks.T))
    limit = BACKGROUND_CLIP_SIGMA * scatter
    # By hand: light that changed strongly leaves 0.1 to 0.3 of the blocks for the background, a crowd that
    # covers half of the image more.
    changed = np.mean(light.background) < 1.0 / 3.0 or np.mean(sign * blocks < -limit) > NOTABLE_SHARE
    if not (changed and np.isfinite(blocks).any()):
        return _without_clipped(best, frame), sign
    found = np.abs(blocks) < limit
    least = np.mean(found) + NOTABLE_SHARE
    for start in dict.fromkeys((plain, best)):
        other, new_sign = estimate_background(start.image + np.float32(level), valid=valid, polarity=polarity)
        near = np.abs(other.blocks) < limit
        if np.mean(near) > least and encloses(near, found):
            least, sign, brightness = np.mean(near), new_sign, start.brightness * other.brightness
            light = replace(light, background=other.illumination.background)
            best = replace(plain, image=other.image, brightness=brightness, illumination=light)
    return _without_clipped(best, frame), sign


def subtract_reference(
    frame: NDArray,
    reference: NDArray,
    *,
    valid: Mask = None,
    background_is: BackgroundLevel = "nearest_one",
    registered: bool = False,
    whole: bool = False,
) -> DifferenceImage | None:
    """Frame minus background: registered reference times the ratio of the illuminations.

    Parameters
    ----------
    frame, reference : ndarray, shape (rows, columns)
        Grey levels of any type; holes filled with anything finite.
    valid : Mask
        0 where either image has a hole.
    background_is : BackgroundLevel
        Which level is background, see `contactimg.imaging.background.find_illumination`.
    registered : bool
        The images are known to be registered: no shift is looked for.
    whole : bool
        The shift is found from all rows at once, not from strips first.

    Returns
    -------
    DifferenceImage or None
        None for a reference that is dark or was subtracted before: it cannot be divided by.
    """
    images = _Images(frame, reference, valid, background_is, rounding_of_blocks(frame, reference))
    placed = _PlacedReference.of(images, UNKNOWN)
    if placed is None:
        return None
    residual, missed = REGISTERED, False
    if not registered:
        placed, residual, missed = _register(placed, whole=whole)
    found = residual.after(placed.alignment) if residual.known else placed.alignment
    light, level = placed.illumination, placed.level
    image = divide_by_reference(frame, placed.reference, placed.valid, light, residual=residual, level=level)
    if placed.valid is not None:
        image[placed.valid == 0] = 0.0
    return DifferenceImage(
        image,
        level,
        placed.brightness,
        light,
        found,
        ratio=True,
        valid=placed.valid,
        registration_failed=missed and not residual.known,
        rounding=images.rounding,
    )


def _without_clipped(difference: DifferenceImage, frame: NDArray) -> DifferenceImage:
    """The difference without the background blocks that are clipped in the frame: they show no noise."""
    background, clipped = difference.illumination.background, find_clipped(frame)
    if clipped is None:
        return difference
    shown = background & (block_means(clipped, side=side_of(background.shape, frame.shape)) < 0.5)
    if not shown.any():
        return difference
    return replace(difference, illumination=replace(difference.illumination, background=shown))


@dataclass(frozen=True, eq=False)
class _PlacedReference:
    """The reference moved to where it lies under the frame, and the ratio of the illuminations.

    ``alignment`` is the move: by whole pixels if it is a pure shift. ``valid`` is 0 at holes and where the
    reference has no pixel or no light; ``level`` is its median over the lit blocks, and ``brightness`` its
    blocks relative to that.
    """

    images: _Images
    reference: NDArray
    valid: Mask
    level: float
    brightness: Values
    illumination: Illumination
    alignment: Alignment

    @classmethod
    def of(cls, images: _Images, alignment: Alignment) -> "_PlacedReference | None":
        """The reference moved by an alignment; None if it is too dark to divide by."""
        moved, valid = move_reference(images.reference, images.valid, alignment)
        blocks, frame_blocks = (block_means(image, valid) for image in (moved, images.frame))
        finite = finite_values(blocks)
        if not finite.size:
            return None
        brightest = float(np.nanmax(np.abs(frame_blocks)) + np.abs(finite).max())
        lit = finite[finite > DARKEST_FRACTION * quantile(finite, LIT_SHARE)]
        level = median(lit) if len(lit) else 0.0
        if level < DARKEST_FRACTION * brightest:
            return None
        if len(lit) < blocks.size:
            dark = (cv2.blur(moved, (3, 3)) < DARKEST_FRACTION * level).astype(np.uint8)
            window = np.ones((2 * EDGE_REACH_PX + 1, 2 * EDGE_REACH_PX + 1), np.uint8)
            valid = exclude(valid, np.asarray(cv2.dilate(dark, window), np.uint8))
            blocks, frame_blocks = (block_means(image, valid) for image in (moved, images.frame))

        def ratio(side: int, rows: Rows) -> tuple[NDArray, float]:
            above, below = frame_blocks, blocks
            if side != BLOCK:
                seen = None if valid is None else valid[rows]
                above, below = (block_means(image[rows], seen, side=side) for image in (images.frame, moved))
            noise = np.sqrt(2.0) * neighbour_scatter(below)
            # By hand: a reference with so little noise was smoothed.
            if side != BLOCK and noise < 0.1 * neighbour_scatter(above):
                noise = neighbour_scatter(above)  # contacts leave most squares alone
            return above / np.maximum(below, DARKEST_FRACTION * level), float(noise) / level

        rounding, which = images.rounding / level, images.background_is
        illumination = find_illumination(ratio, images.frame.shape, background_is=which, rounding=rounding)
        if valid is not None:  # blocks with holes are noisier than whole ones
            side = side_of(illumination.background.shape, images.frame.shape)
            whole = block_means(valid.astype(np.float32), side=side) == 1.0
            illumination = replace(illumination, background=illumination.background & whole)
        lit_blocks = np.maximum(blocks, DARKEST_FRACTION * level) / level
        brightness = np.where(np.isfinite(blocks), lit_blocks, np.float32(1.0)).astype(np.float32)
        return cls(images, moved, valid, level, brightness, illumination, alignment)

    def moved_by(self, residual: Alignment) -> "_PlacedReference":
        """The reference moved further; by whole pixels if the total is a pure shift."""
        total, now = residual.after(self.alignment), self.alignment
        if total.is_shift:
            total = replace(total, x_px=float(round(total.x_px)), y_px=float(round(total.y_px)))
            if now.is_shift and (total.x_px, total.y_px) == (now.x_px, now.y_px):
                return self
        return _PlacedReference.of(self.images, total) or self

    def align(self, *, all_rows: bool) -> Alignment:
        """Alignment that is left."""
        frame = self.images.frame
        return align(frame, self.reference, self.illumination, self.valid, all_rows=all_rows)


def _register(placed: _PlacedReference, *, whole: bool) -> tuple[_PlacedReference, Alignment, bool]:
    """The reference moved to within a pixel, the alignment that is left, and whether texture was missed.

    Where neither strips nor all rows of the image tell the alignment well, a far search comes first. It may
    find a faint texture that is too weak for the rest.
    """
    # small blocks are the sign of a crowd: it leaves strips too little, and all rows tell what can be told
    crowded = side_of(placed.illumination.background.shape, placed.images.frame.shape) < BLOCK
    for all_rows in dict.fromkeys((whole, True)):
        residual = placed.align(all_rows=all_rows)
        if residual.good or (crowded and all_rows and residual.known and residual.consistent):
            return *_approach(placed, residual, all_rows=all_rows), False
        if not (residual.known or crowded):  # nor do all rows tell it where there is nothing to find
            break
    pair = placed.images.frame, placed.reference
    shift, textured = search_alignment(*pair, placed.illumination, placed.valid, near=residual)
    if shift is not None and not (residual.known and shift.is_shift):
        candidate = placed.moved_by(shift)
        left = candidate.align(all_rows=True)
        if left.std_px < residual.std_px or (not residual.known and shift.largest_px > BIN_PX):
            placed, residual = candidate, left
    elif textured and not residual.known:
        residual = placed.align(all_rows=True)
    return *_approach(placed, residual, all_rows=True), textured and shift is None


def _approach(
    placed: _PlacedReference, residual: Alignment, *, all_rows: bool
) -> tuple[_PlacedReference, Alignment]:
    """Move the reference until less than a pixel is left, as long as the uncertainty falls."""
    for _ in range(ROUNDS):
        # A larger shift is first taken out in whole pixels.
        if not residual.known or (residual.is_shift and residual.largest_px < 0.75):
            break
        candidate = placed.moved_by(residual)
        left = candidate.align(all_rows=all_rows)
        if left.std_px < residual.std_px or residual.is_shift:
            placed, residual = candidate, left
        else:
            residual = replace(residual, rotation=0.0, scale=1.0)
    return placed, residual
