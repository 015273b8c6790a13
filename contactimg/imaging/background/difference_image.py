"""Frame minus background: the record that all later steps start from."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.illumination import Illumination
from contactimg.imaging.background.resample import Shift
from contactimg.imaging.pixels.blocks import block_means
from contactimg.imaging.pixels.masks import Mask
from contactimg.timings import stage


@dataclass(frozen=True, eq=False)
class DifferenceImage:
    """Frame minus background, light corrected.

    Parameters
    ----------
    image : ndarray of float32, shape (rows, columns)
        Grey levels at the median level of the background; contacts stand out, the rest is noise about zero.
    level : float
        Median grey level of the background.
    brightness : ndarray of float32, shape (block rows, block columns)
        Brightness of the background of each block relative to ``level``.
    illumination : Illumination
        Slow ratio (with a reference) or level (without) of the background, and which blocks are background.
    shift : Shift or None
        Of the frame against the reference, NaN if nothing tells it; None without reference.
    ratio : bool
        Whether ``illumination`` is a ratio to the reference.
    valid : ndarray of uint8 or None
        0 where the frame or the registered reference has no pixel, or no light; None if nowhere.
    registration_failed : bool
        Whether the reference shows a texture that was not found in the frame.
    dust_free : bool
        Whether frame and reference are known to be free of dust.
    """

    image: NDArray[np.float32]
    level: float
    brightness: NDArray[np.float32]
    illumination: Illumination
    shift: Shift | None
    ratio: bool = False
    valid: Mask = None
    registration_failed: bool = False
    dust_free: bool = False

    @property
    def remark(self) -> str:
        """One sentence on how frame and reference lie together; empty if it is as usual or there is none."""
        if self.registration_failed:
            return "the surface shown by the reference was not found in the frame: their shift is unknown"
        if self.shift is None or (self.shift.known and self.shift.plain):
            return ""
        if not self.shift.known:
            return "nothing on the surface tells the shift against the reference"
        return (
            f"turned by {np.degrees(self.shift.rotation):.3f} degrees and scaled by {self.shift.scale:.5f} "
            "against the reference, which was taken out"
        )


@stage("light")
def plain_difference(image: NDArray[np.float32]) -> DifferenceImage:
    """A plain difference in which nothing can be registered or corrected: all of it counts as background."""
    blocks = np.zeros_like(block_means(image))
    light = Illumination(np.zeros((4, 4)), np.ones(blocks.shape, np.bool_), 0.0)
    return DifferenceImage(image, 0.0, np.ones_like(blocks), light, None)
