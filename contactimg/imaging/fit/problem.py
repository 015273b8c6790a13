"""What the fit looks at: the difference image, binned where the blur is wide, and what belongs to it."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.difference_image import DifferenceImage
from contactimg.imaging.background.illumination import Illumination
from contactimg.imaging.fit.disks import X, Y
from contactimg.imaging.pixels.blocks import BLOCK, side_of
from contactimg.imaging.pixels.frame_pair import FramePair
from contactimg.imaging.pixels.masks import Mask, exclude


@dataclass(frozen=True, eq=False)
class Field:
    """A difference image and what belongs to it.

    Parameters
    ----------
    image : ndarray of float32, shape (rows, columns)
        Contacts positive.
    valid : Mask
        0 for pixels to leave out.
    saturated : Mask
        1 at full scale.
    blocks : ndarray of bool
        Background, see `contactimg.imaging.pixels.blocks`.
    illumination : ndarray, shape (block rows, block columns)
        Relative brightness of the blocks of the frame.
    bin : int
        Pixels of the frame that one pixel stands for, each way.
    light : ndarray, shape (4, 4)
        Slow polynomial that was taken out of the image since, see
        `contactimg.imaging.background.illumination.Illumination`.
    """

    image: NDArray[np.float32]
    valid: Mask
    saturated: Mask
    blocks: NDArray[np.bool_]
    illumination: NDArray[np.float32]
    bin: int
    light: NDArray[np.float64]

    @classmethod
    def of(cls, image: NDArray, frame_pair: FramePair, difference: DifferenceImage, bin_: int) -> "Field":
        """Of an image of which so many pixels each way are put together."""
        blocks = difference.illumination.background
        saturated = frame_pair.saturated
        valid = exclude(frame_pair.valid, saturated)
        if bin_ > 1:
            rows, columns = max(image.shape[0] // bin_, 1), max(image.shape[1] // bin_, 1)
            side = side_of(blocks.shape, image.shape)
            valid, saturated = _binned_mask(valid, bin_, 0), _binned_mask(saturated, bin_, 1)
            image = cv2.resize(
                image[: rows * bin_, : columns * bin_], (columns, rows), interpolation=cv2.INTER_AREA
            )
            y = np.minimum(np.arange(-(-rows // side)) * bin_, blocks.shape[0] - 1)
            x = np.minimum(np.arange(-(-columns // side)) * bin_, blocks.shape[1] - 1)
            blocks = blocks[y][:, x]
        return cls(image, valid, saturated, blocks, difference.brightness, bin_, np.zeros((4, 4)))

    def without_light(self, coefficients: NDArray[np.float64]) -> "Field":
        """The field with a slow polynomial taken out of its image."""
        if not coefficients.any():
            return self
        light = Illumination(coefficients, self.blocks, 0.0)
        return replace(self, image=light.subtract_from(self.image), light=self.light + coefficients)

    def brightness(self, disks: NDArray) -> NDArray[np.float64]:
        """Relative illumination where the disks stand."""
        rows, columns = self.illumination.shape
        x = np.clip(disks[:, X] * self.bin / BLOCK, 0, columns - 1).astype(int)
        y = np.clip(disks[:, Y] * self.bin / BLOCK, 0, rows - 1).astype(int)
        return self.illumination[y, x].astype(float)

    def unbin(self, position: NDArray) -> NDArray[np.float64]:
        """Position in pixels of the frame."""
        return np.asarray(position * self.bin + (self.bin - 1) / 2)

    def touches(self, mask: Mask, wanted: int, disks: NDArray, reach: NDArray) -> NDArray[np.bool_]:
        """Disks within ``reach`` of which a pixel of the mask has the wanted value."""
        out = np.zeros(len(disks), np.bool_)
        if mask is None:
            return out
        source = (mask != wanted).astype(np.uint8)
        if source.all():
            return out
        distance = cv2.distanceTransform(source, cv2.DIST_L2, cv2.DIST_MASK_5)
        x = np.clip(np.rint(disks[:, X]), 0, mask.shape[1] - 1).astype(int)
        y = np.clip(np.rint(disks[:, Y]), 0, mask.shape[0] - 1).astype(int)
        return np.asarray(distance[y, x] < reach)


def _binned_mask(mask: Mask, bin_: int, marked: int) -> Mask:
    """Mask of binned pixels: ``marked`` where one pixel of the bin is."""
    if mask is None:
        return None
    rows, columns = mask.shape[0] // bin_, mask.shape[1] // bin_
    bins = mask[: rows * bin_, : columns * bin_].reshape(rows, bin_, columns, bin_)
    return np.ascontiguousarray(bins.max(axis=(1, 3)) if marked else bins.min(axis=(1, 3)))
