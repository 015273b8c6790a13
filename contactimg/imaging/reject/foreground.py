"""What stands out of a difference image: how much, and what of it is no contact."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.difference_image import DifferenceImage
from contactimg.imaging.contrast.noise import estimate_noise
from contactimg.imaging.contrast.plateau import Contrast, measure_contrast
from contactimg.imaging.pixels.binned_image import BinnedImage
from contactimg.imaging.pixels.frame_pair import FramePair
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.imaging.reject.foreign_objects import NOTHING_FOREIGN, Foreign, find_foreign

BRIGHTER = 1.3  # times the contrast that is known: a frame that shows as much has another one


@dataclass(frozen=True, eq=False)
class Foreground:
    """A difference image in which contacts are positive, and its contrast.

    Parameters
    ----------
    image : ndarray of float32, shape (rows, columns)
        0 at holes and foreign objects.
    sign : int
        1 for contacts brighter than the background, else -1.
    frame_pair : FramePair
        Without what is foreign.
    noise : float
        Of a pixel.
    shown : Contrast
        What the frame shows.
    contrast : Contrast
        What it is measured with: what was known before, where the frame does not contradict it.
    known : SharedOptics
        What was known before and holds.
    refused : float
        Contrast that was known before and does not hold; NaN if there is none.
    foreign : Foreign
    """

    image: NDArray[np.float32]
    sign: int
    frame_pair: FramePair
    noise: float
    shown: Contrast
    contrast: Contrast
    known: SharedOptics
    refused: float
    foreign: Foreign

    def doubt(self, unit: float) -> str:
        """What to say where knowledge was refused; ``unit`` is that of the grey levels."""
        if not np.isfinite(self.refused):
            return ""
        return (
            f"the frame shows a contrast of {self.shown.plateau * unit:.3g} grey levels, not the "
            f"{self.refused * unit:.3g} handed over, which were not used"
        )


def find_foreground(
    frame_pair: FramePair, difference: DifferenceImage, sign: int, known: SharedOptics
) -> Foreground:
    """Measure the contrast of a difference image, with what is known of it, and leave out what is foreign.

    Parameters
    ----------
    frame_pair : FramePair
    difference : DifferenceImage
    sign : int
        What makes contacts positive.
    known : SharedOptics
        In the grey levels of the difference.

    Returns
    -------
    Foreground
    """
    image = difference.image if sign > 0 else -difference.image
    noise = estimate_noise(image, difference.illumination.background)
    coarse = BinnedImage.of(image)
    shown = Contrast(0.0, resolved=False) if frame_pair.trivial else measure_contrast(coarse, noise)
    doubtful = _contradicts(shown, known)
    contrast = _believed(shown, SharedOptics() if doubtful or frame_pair.trivial else known)
    foreign = NOTHING_FOREIGN
    if shown.resolved and not difference.dust_free:
        foreign = find_foreign(image, coarse, contrast.plateau, frame=frame_pair.frame, difference=difference)
    frame_pair = frame_pair.without(foreign.mask)
    if frame_pair.valid is not None:
        image = np.where(frame_pair.valid > 0, image, np.float32(0.0))
    refused = np.nan
    if doubtful:
        shown = measure_contrast(BinnedImage.of(image), noise)  # what was brightest was perhaps no contact
        if _contradicts(shown, known):
            refused = known.contrast
            known = replace(known, contrast=np.nan, contrast_std=0.0, correlation=0.0)
        contrast = _believed(shown, known)
    return Foreground(image, sign, frame_pair, noise, shown, contrast, known, refused, foreign)


def _believed(shown: Contrast, known: SharedOptics) -> Contrast:
    """The contrast that is known before, else what the frame shows."""
    if not np.isfinite(known.contrast):
        return shown
    return Contrast(known.contrast, shown.resolved, known.contrast_std)


def _contradicts(shown: Contrast, known: SharedOptics) -> bool:
    """Whether a frame shows more contrast than is known; less it may show because of the blur."""
    return bool(shown.resolved and shown.plateau > BRIGHTER * known.contrast)
