"""The difference image: frame minus background, which all later steps start from."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.alignment import Alignment
from contactimg.imaging.background.illumination import Illumination
from contactimg.imaging.pixels.blocks import block_means
from contactimg.imaging.pixels.masks import Mask
from contactimg.timings import stage


@dataclass(frozen=True, eq=False)
class DifferenceImage:
    """Frame minus background, corrected for uneven and changed illumination.

    Parameters
    ----------
    image : ndarray of float32, shape (rows, columns)
        Grey levels at the median level of the background; contacts stand out, the rest is noise about zero.
    level : float
        Median grey level of the background.
    brightness : ndarray of float32, shape (block rows, block columns)
        Brightness of the background of each block relative to ``level``.
    illumination : Illumination
        Of the background: ratio to the reference, or grey level without one; and which blocks are background.
    alignment : Alignment or None
        Of the frame against the reference, NaN if the images do not determine it; None without reference.
    ratio : bool
        Whether ``illumination`` is a ratio to the reference.
    valid : ndarray of uint8 or None
        0 where the frame or the registered reference has no pixel, or no light; None if nowhere.
    registration_failed : bool
        Whether the reference shows a texture that was not found in the frame.
    """

    image: NDArray[np.float32]
    level: float
    brightness: NDArray[np.float32]
    illumination: Illumination
    alignment: Alignment | None
    ratio: bool = False
    valid: Mask = None
    registration_failed: bool = False

    @property
    def remark(self) -> str:
        """One sentence on the alignment with the reference; empty for a pure shift or without reference."""
        if self.registration_failed:
            return "the surface shown by the reference was not found in the frame: their shift is unknown"
        if self.alignment is None or (self.alignment.known and self.alignment.is_shift):
            return ""
        if not self.alignment.known:
            return "the surface shows nothing that determines the shift against the reference"
        degrees, scale = np.degrees(self.alignment.rotation), self.alignment.scale
        return f"rotated by {degrees:.3f} degrees and scaled by {scale:.5f} against the reference; corrected"


@stage("light")
def plain_difference(image: NDArray[np.float32]) -> DifferenceImage:
    """A difference image in which nothing was registered or corrected: all of it counts as background."""
    blocks = np.zeros_like(block_means(image))
    illumination = Illumination(np.zeros((4, 4)), np.ones(blocks.shape, np.bool_), 0.0)
    return DifferenceImage(image, 0.0, np.ones_like(blocks), illumination, None)
