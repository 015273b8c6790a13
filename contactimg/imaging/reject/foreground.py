"""The foreground of a difference image: contacts positive, foreign objects masked, contrast measured."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.difference_image import DifferenceImage
from contactimg.imaging.contrast.noise import estimate_noise
from contactimg.imaging.contrast.plateau import Contrast, measure_contrast
from contactimg.imaging.pixels.binned_image import BinnedImage
from contactimg.imaging.pixels.frame_pair import FramePair
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.imaging.reject.foreign_objects import NO_FOREIGN_OBJECTS, ForeignObjects, find_foreign_objects

CONTRADICTION_RATIO = 1.3
"""Ratio of measured to prior contrast above which the frame contradicts the prior. Chosen by hand on rendered
frames; sensitivity not measured."""


@dataclass(frozen=True, eq=False)
class Foreground:
    """What both methods measure: a difference image in which contacts are positive, with contrast and noise.

    Parameters
    ----------
    image : ndarray of float32, shape (rows, columns)
        0 in holes and on foreign objects.
    sign : int
        1 for contacts brighter than the background, else -1.
    frame_pair : FramePair
        Frame and reference, with the foreign objects as holes.
    noise : float
        Standard deviation of a background pixel.
    measured_contrast : Contrast
        As the frame itself shows it.
    contrast : Contrast
        To measure with: the prior if there is one that the frame does not contradict, else the measured one.
    prior_optics : SharedOptics
        Prior knowledge of contrast and blur, without what the frame contradicts.
    refused_contrast : float
        Prior contrast that the frame contradicts; NaN if there is none.
    foreign : ForeignObjects
    largest_contrast : float
        That the grey levels can show; infinite where no full scale is known.
    shown_contrast : float
        Largest contrast of contacts that show theirs.
    """

    image: NDArray[np.float32]
    sign: int
    frame_pair: FramePair
    noise: float
    measured_contrast: Contrast
    contrast: Contrast
    prior_optics: SharedOptics
    refused_contrast: float
    foreign: ForeignObjects
    largest_contrast: float = float("inf")
    shown_contrast: float = float("inf")

    def seen(self, contrast: float) -> float:
        """A contrast, no larger than the frame shows."""
        return min(contrast, self.shown_contrast)

    @property
    def remark(self) -> str:
        """One sentence if a prior contrast was refused, else empty."""
        if not np.isfinite(self.refused_contrast):
            return ""
        unit = self.frame_pair.unit
        return (
            f"the frame shows a contrast of {self.measured_contrast.plateau * unit:.3g} grey levels, not the "
            f"{self.refused_contrast * unit:.3g} given, which were not used"
        )


def find_foreground(
    frame_pair: FramePair, difference: DifferenceImage, sign: int, prior: SharedOptics
) -> Foreground:
    """Measure noise and contrast of a difference image and mask the foreign objects in it.

    Parameters
    ----------
    frame_pair : FramePair
    difference : DifferenceImage
    sign : int
        Factor that makes contacts positive.
    prior : SharedOptics
        Prior knowledge of contrast and blur, in the grey levels of the difference.

    Returns
    -------
    Foreground
    """
    image = difference.image if sign > 0 else -difference.image
    noise = max(estimate_noise(image, difference.illumination.background), frame_pair.least_noise)
    coarse, largest = BinnedImage.of(image), frame_pair.largest_contrast(difference.level, sign)
    measured, shown = Contrast(0.0, resolved=False), frame_pair.shown_contrast(difference.level, sign)
    if not frame_pair.trivial:
        measured = measure_contrast(coarse, noise).within(shown)
    contradicted = _contradicts(measured, prior)
    contrast = _select_contrast(measured, SharedOptics() if contradicted or frame_pair.trivial else prior)
    foreign = NO_FOREIGN_OBJECTS
    if measured.resolved and not measured.hidden and not difference.dust_free:
        foreign = find_foreign_objects(
            image, coarse, contrast.plateau, frame=frame_pair.frame, difference=difference
        )
    frame_pair = frame_pair.without(foreign.mask)
    if frame_pair.valid is not None:
        image = np.where(frame_pair.valid > 0, image, np.float32(0.0))
    refused = np.nan
    if contradicted:
        # the brightest objects may have been foreign: measure again without them
        measured = measure_contrast(BinnedImage.of(image), noise).within(shown)
        if _contradicts(measured, prior):
            refused = prior.contrast
            prior = replace(prior, contrast=np.nan, contrast_std=0.0, correlation=0.0)
        contrast = _select_contrast(measured, prior)
    return Foreground(
        image, sign, frame_pair, noise, measured, contrast, prior, refused, foreign, largest, shown
    )


def _select_contrast(measured: Contrast, prior: SharedOptics) -> Contrast:
    """The prior contrast if there is one, else the measured one."""
    if not np.isfinite(prior.contrast):
        return measured
    return Contrast(prior.contrast, measured.resolved, prior.contrast_std)


def _contradicts(measured: Contrast, prior: SharedOptics) -> bool:
    """Whether the frame shows clearly more contrast than the prior; blur can only make it show less."""
    return bool(measured.resolved and measured.plateau > CONTRADICTION_RATIO * prior.contrast)
