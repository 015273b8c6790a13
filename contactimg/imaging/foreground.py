"""What is measured: a difference image in which contacts are positive, its noise and its contrast."""

from dataclasses import dataclass
from functools import cached_property, partial

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.illumination import DifferenceImage
from contactimg.imaging.detect.bars_and_scratches import NONE, Foreign, find_foreign
from contactimg.imaging.detect.candidates import ODD_RATIO, Contrast, measure_contrast
from contactimg.imaging.pixels.blocks import SignedImage
from contactimg.imaging.pixels.frame_pair import FramePair
from contactimg.imaging.pixels.masks import mean_of_seen
from contactimg.imaging.pixels.noise import estimate_noise
from contactimg.imaging.pixels.robust import SIGNIFICANT_SIGMA
from contactimg.imaging.profile.optics import SharedOptics

BRIGHT_STEP = 4
"""Step of the rows and columns that are looked at for bright pixels. Accuracy."""


@dataclass(frozen=True, eq=False)
class Foreground:
    """A difference image with contacts positive, and what is known of it before a fit.

    Parameters
    ----------
    seen : SignedImage
        Holes filled from the pixels next to them.
    sign : int
        1 for contacts brighter than the background, else -1.
    frame_pair : FramePair
        Frame and reference.
    difference : DifferenceImage
    shown : Contrast
        As the frame itself shows it.
    contrast : Contrast
        To measure with: the prior, unless the frame contradicts it; else the one shown.
    prior_optics : SharedOptics
        Prior knowledge of contrast and blur, without what the frame contradicts.
    refused : SharedOptics
        Prior contrast and blur that the frame contradicts.
    foreign : Foreign
        Objects that are no contacts, which are holes in the frame.
    dust : bool
        Whether there may be dust and other foreign objects.
    """

    seen: SignedImage
    sign: int
    frame_pair: FramePair
    difference: DifferenceImage
    shown: Contrast
    contrast: Contrast
    prior_optics: SharedOptics
    refused: SharedOptics
    foreign: Foreign = NONE
    dust: bool = True

    @property
    def image(self) -> NDArray[np.float32]:
        """The difference image, shape (rows, columns)."""
        return self.seen.image

    @property
    def noise(self) -> float:
        """Standard deviation of a background pixel."""
        return self.seen.noise

    @cached_property
    def bright(self) -> NDArray[np.bool_]:
        """Which pixels of every `BRIGHT_STEP`-th row and column stand out as contacts do."""
        level = max(0.5 * self.contrast.plateau, SIGNIFICANT_SIGMA * self.noise)
        return np.asarray(self.image[::BRIGHT_STEP, ::BRIGHT_STEP] > level)

    @property
    def largest_contrast(self) -> float:
        """Largest contrast that the grey levels can show; infinite where no full scale is known."""
        return self.frame_pair.largest_contrast(self.difference.level, self.sign)

    @property
    def shown_contrast(self) -> float:
        """Largest contrast of contacts that show theirs."""
        return self.frame_pair.shown_contrast(self.difference.level, self.sign)


def _filled(image: NDArray[np.float32], valid: NDArray[np.uint8]) -> NDArray[np.float32]:
    """The image with holes filled from the pixels beside them: a line without data does not cut a contact."""
    # By hand, 2 px from a hole and where 0.3 of the pixels are seen: dead pixels, not masks.
    blur = partial(cv2.blur, ksize=(5, 5), borderType=cv2.BORDER_REPLICATE)
    around, weight = mean_of_seen(blur, image, valid > 0)
    return np.where(valid > 0, image, np.where(weight > 0.3, around, np.float32(0.0)))


def find_foreground(
    frame_pair: FramePair, difference: DifferenceImage, sign: int, prior: SharedOptics, *, dust: bool = True
) -> Foreground:
    """Noise and contrast of a difference image without foreign objects; ``sign`` makes contacts positive."""
    image = difference.image if sign > 0 else -difference.image
    if frame_pair.valid is not None:
        image = _filled(image, frame_pair.valid)
    noise = estimate_noise(image, difference.illumination.background)
    noise = max(frame_pair.with_rounding(noise), difference.rounding)
    seen = SignedImage(image, noise, frame_pair.valid, rounding=difference.rounding)
    shown, refused, foreign = Contrast(0.0, resolved=False), SharedOptics(), NONE
    largest = frame_pair.shown_contrast(difference.level, sign)
    if not frame_pair.trivial:
        shown = measure_contrast(seen).within(largest)
    if shown.resolved and dust:
        foreign = find_foreign(seen, shown.plateau)
    if foreign.mask is not None:
        frame_pair = frame_pair.without(foreign.mask)
        image = np.where(foreign.mask > 0, np.float32(0.0), image)
        seen = SignedImage(image, noise, frame_pair.valid, rounding=difference.rounding)
        shown = measure_contrast(seen).within(largest)
    contrast = shown
    if np.isfinite(prior.contrast) and not frame_pair.trivial:
        if shown.resolved and shown.plateau > ODD_RATIO * prior.contrast:
            refused = SharedOptics(prior.contrast)
            prior = prior.without_contrast()
        else:
            contrast = Contrast(prior.contrast, shown.resolved, prior.contrast_std)
    return Foreground(seen, sign, frame_pair, difference, shown, contrast, prior, refused, foreign, dust)
