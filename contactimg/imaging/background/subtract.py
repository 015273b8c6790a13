"""Take the background out of a frame: registered reference, slow light, texture and dirt of both frames.

Contacts transmit a fraction of the light that falls on them, so the frame is divided by the background (the
reference where it lies under the frame, times the slow ratio of the two), and the difference is given at the
background's median level.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.align import GOOD_STD, Found, estimate_shift, estimate_shift_closely
from contactimg.imaging.background.align_far import search_shift
from contactimg.imaging.background.difference_image import DifferenceImage
from contactimg.imaging.background.divide import FLOOR, divide_by_reference
from contactimg.imaging.background.illumination import Illumination, neighbour_scatter
from contactimg.imaging.background.illumination_in_crowds import find_illumination
from contactimg.imaging.background.resample import Shift, move_reference
from contactimg.imaging.pixels.blocks import BLOCK, block_means, side_of
from contactimg.imaging.pixels.masks import Mask
from contactimg.timings import stage

FAINTEST = 0.05  # of the brightest blocks: a darker background cannot be divided by
BRIGHT = 98.0  # percentile of the blocks of the reference that is lit in any case
RIM = 3  # px: width of the rim of a field stop
NEAR = 0.75  # px: shifts beyond are taken in whole pixels first
ROUNDS = 5
NO_SHIFT, UNKNOWN, STILL = Shift(0.0, 0.0, np.inf), Shift(np.nan, np.nan, np.inf), Shift(0.0, 0.0, 0.0)


@stage("light")
def subtract_reference(
    frame: NDArray,
    reference: NDArray,
    *,
    valid: Mask = None,
    background_is: str = "nearest_one",
    registered: bool = False,
) -> DifferenceImage:
    """Frame minus registered, light-corrected reference.

    Parameters
    ----------
    frame, reference : ndarray, shape (rows, columns)
        Grey levels of any type; holes filled with anything finite.
    valid : ndarray of uint8 or None
        0 where either image has a hole.
    background_is : str
        Which level is background, see `contactimg.imaging.background.illumination.background_mode`.
    registered : bool
        Nothing has moved: the reference is taken where it lies.

    Returns
    -------
    DifferenceImage
    """
    view = _View.of(frame, reference, valid, background_is, NO_SHIFT)
    if view is None:
        return _subtract_offset(frame, reference, valid)
    rest, textured = STILL, False
    if not registered:
        view, rest, textured = _register(frame, reference, valid, background_is, view)
    image = divide_by_reference(frame, view.reference, view.half, view.light, shift=rest, level=view.level)
    if view.valid is not None:
        image[view.valid == 0] = 0.0
    shift = rest.after(view.shift) if rest.known else UNKNOWN
    return DifferenceImage(
        image, view.level, view.illumination, view.light, shift, ratio=True, valid=view.valid,
        registration_failed=textured and not rest.known,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _View:
    """The reference as it lies under the frame, to whole pixels, its half resolution, and the slow ratio.

    ``valid`` is 0 at holes and where the moved reference has no pixel or no light; ``level`` is its median
    over the lit blocks, to which ``illumination`` is relative.
    """

    reference: NDArray
    half: NDArray[np.float32]
    valid: Mask
    level: float
    illumination: NDArray[np.float32]
    light: Illumination
    shift: Shift

    @classmethod
    def of(
        cls, frame: NDArray, reference: NDArray, valid: NDArray | None, background_is: str, shift: Shift
    ) -> "_View | None":
        """Of the unmoved reference and its holes; None if it is too dark to divide by."""
        moved, valid = move_reference(reference, valid, shift)
        half = block_means(moved, valid, side=2)
        blocks_f, blocks_r = block_means(frame, valid), _blocks(moved, valid, half)
        known = blocks_r if valid is None else blocks_r[np.isfinite(blocks_r)]
        if not known.size:
            return None
        brightest = float(np.nanmax(np.abs(blocks_f)) + np.abs(known).max())
        lit = known[known > FLOOR * np.percentile(known.ravel()[::5], BRIGHT)]
        level = float(np.median(lit)) if len(lit) else 0.0
        if level < FAINTEST * brightest:
            return None
        if len(lit) < blocks_r.size:
            valid = _lit(moved, valid, FLOOR * level)
            half = block_means(moved, valid, side=2)
            blocks_f, blocks_r = block_means(frame, valid), _blocks(moved, valid, half)

        def ratio(side: int) -> tuple[NDArray, float]:
            means, of_reference = (
                (blocks_f, blocks_r)
                if side == BLOCK
                else (block_means(frame, valid, side=side), block_means(moved, valid, side=side))
            )
            return means / np.maximum(of_reference, FLOOR * level), _noise_of_two(of_reference) / level

        light = find_illumination(ratio, frame.shape, background_is=background_is)
        if valid is not None:  # what holes leave of a block is noisier than a block
            side = side_of(light.background.shape, frame.shape)
            whole = block_means(valid.astype(np.float32), side=side) == 1.0
            light = replace(light, background=light.background & whole)
        illumination = np.maximum(blocks_r, FLOOR * level) / level
        illumination[~np.isfinite(illumination)] = 1.0
        return cls(moved, half, valid, level, illumination.astype(np.float32), light, shift)


def _blocks(image: NDArray, valid: NDArray | None, half: NDArray[np.float32]) -> NDArray[np.float32]:
    """Block means of an image of which those of two pixels are known."""
    whole = all(size % BLOCK == 0 for size in image.shape)
    return block_means(half, side=BLOCK // 2) if valid is None and whole else block_means(image, valid)


def _noise_of_two(reference: NDArray) -> float:
    """Scatter of the difference of two images without contacts, from the means of one of them."""
    return float(np.sqrt(2.0) * neighbour_scatter(reference))


def _lit(reference: NDArray, valid: NDArray | None, lowest: float) -> NDArray[np.uint8]:
    """1 where the reference is brighter than ``lowest`` and far enough from where it is not."""
    dark = (cv2.blur(reference, (3, 3)) < lowest).astype(np.uint8)
    lit = 1 - cv2.dilate(dark, np.ones((2 * RIM + 1, 2 * RIM + 1), np.uint8))
    return lit if valid is None else lit & valid


def _register(
    frame: NDArray, reference: NDArray, valid: NDArray | None, background_is: str, view: _View
) -> tuple[_View, Shift, bool]:
    """View of the reference moved to within a pixel, the shift left, and whether there is texture."""
    for estimate in (estimate_shift, estimate_shift_closely):
        found = estimate(frame, view.reference, view.light, view.valid)
        if found.shift.std_px < GOOD_STD and found.even:
            return *_approach(frame, reference, valid, background_is, view, found, estimate), True
        if not found.shift.known:
            break
    search = search_shift(frame, view.reference, view.light, view.valid, near=found.shift)
    if not search.textured:
        return view, found.shift, False
    if estimate is estimate_shift:
        found = estimate_shift_closely(frame, view.reference, view.light, view.valid)
    if search.found and not (found.shift.known and search.shift.plain):
        nearer = _moved(frame, reference, valid, background_is, view, search.shift)
        better = estimate_shift_closely(frame, nearer.reference, nearer.light, nearer.valid)
        if better.shift.std_px < found.shift.std_px:
            view, found = nearer, better
    return *_approach(
        frame, reference, valid, background_is, view, found, estimate_shift_closely
    ), search.rich


def _moved(
    frame: NDArray, reference: NDArray, valid: NDArray | None, background_is: str, view: _View, rest: Shift
) -> _View:
    """View of the reference moved by the rest as well: to whole pixels if that is a shift alone."""
    total = rest.after(view.shift)
    if total.plain:
        total = replace(total, x_px=float(round(total.x_px)), y_px=float(round(total.y_px)))
    return _View.of(frame, reference, valid, background_is, total) or view


def _approach(
    frame: NDArray,
    reference: NDArray,
    valid: NDArray | None,
    background_is: str,
    view: _View,
    found: Found,
    estimate: Callable[..., Found],
) -> tuple[_View, Shift]:
    """Move the reference until less than a pixel is left, as long as the images become more alike."""
    for _ in range(ROUNDS):
        if not found.shift.known or (found.shift.plain and found.shift.longest < NEAR):
            break
        nearer = _moved(frame, reference, valid, background_is, view, found.shift)
        better = estimate(frame, nearer.reference, nearer.light, nearer.valid)
        if better.shift.std_px >= found.shift.std_px and not found.shift.plain:
            found = replace(found, shift=replace(found.shift, rotation=0.0, scale=1.0))
            if found.shift.longest < NEAR:
                break
            continue
        view, found = nearer, better
    return view, found.shift


def _subtract_offset(frame: NDArray, reference: NDArray, valid: NDArray | None) -> DifferenceImage:
    """Plain difference for a background that is dark or was subtracted before: nothing to divide by."""

    def difference(side: int) -> tuple[NDArray, float]:
        of_reference = block_means(reference, valid, side=side)
        return block_means(frame, valid, side=side) - of_reference, _noise_of_two(of_reference)

    light = find_illumination(difference, frame.shape, background_is="most_common")
    image = light.subtract_from(np.subtract(frame, reference, dtype=np.float32))
    illumination = np.ones([-(-size // BLOCK) for size in frame.shape], np.float32)
    return DifferenceImage(image, 0.0, illumination, light, UNKNOWN)
