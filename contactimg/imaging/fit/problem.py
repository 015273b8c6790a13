"""What is fitted: the difference image, binned where the blur is wide, its mask, noise, prior and profile."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.difference_image import DifferenceImage
from contactimg.imaging.background.illumination import Illumination
from contactimg.imaging.contrast.noise import Noise
from contactimg.imaging.fit.settings import LOOSE_CONTRAST_FRACTION
from contactimg.imaging.fit.work import Work
from contactimg.imaging.pixels.blocks import BLOCK, side_of
from contactimg.imaging.pixels.masks import Mask
from contactimg.imaging.profile.blurred_disk import EdgeTable, disk_table
from contactimg.imaging.reject.foreground import Foreground

X, Y, RADIUS, CONTRAST = range(4)
"""Columns of the parameters of a disk: x, y, radius (px), contrast (grey levels)."""


@dataclass(frozen=True)
class ContrastPrior:
    """Normal prior of the contrast of each disk.

    Parameters
    ----------
    mean, std : float
        Grey levels.
    """

    mean: float
    std: float

    @classmethod
    def loose(cls, contrast: float) -> "ContrastPrior":
        """As long as the frame's own spread of contrasts is not known."""
        return cls(contrast, LOOSE_CONTRAST_FRACTION * contrast)


@dataclass(frozen=True, eq=False)
class FitProblem:
    """An image of disks, and all that a fit needs to know about it.

    Parameters
    ----------
    image : ndarray of float32, shape (rows, columns)
        Difference image, contacts positive, grey levels.
    noise : Noise
        Variance of a pixel.
    prior : ContrastPrior
        Of the contrasts; its mean is the contrast at which disks are detected.
    valid : Mask
        0 for pixels to leave out.
    saturated : Mask
        1 for pixels at full scale of contacts that are brighter than the background: their light is at least
        what they show.
    profile : EdgeTable
        Of a contact; with a film it holds for one blur.
    background : ndarray of bool
        Background blocks, see `contactimg.imaging.pixels.blocks`.
    brightness : ndarray, shape (block rows, block columns)
        Relative illumination of blocks of `BLOCK` pixels of the frame.
    binning : int
        Pixels of the frame in one pixel of the image, each way.
    corner : (int, int)
        Column and row of the image's first pixel, where it is a window of a larger one.
    largest_contrast : float
        That the grey levels can show.
    shown_contrast : float
        Largest contrast of contacts that show theirs.
    work : Work
        Done for the frame; shared by all problems of it.
    removed_background : ndarray, shape (4, 4)
        Polynomial subtracted from the image so far, as the coefficients of an
        `contactimg.imaging.background.illumination.Illumination`.
    """

    image: NDArray[np.float32]
    noise: Noise
    prior: ContrastPrior
    valid: Mask = None
    saturated: Mask = None
    profile: EdgeTable = field(default_factory=disk_table)
    background: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((1, 1), np.bool_))
    brightness: NDArray[np.float32] = field(default_factory=lambda: np.ones((1, 1), np.float32))
    binning: int = 1
    corner: tuple[int, int] = (0, 0)
    largest_contrast: float = float("inf")
    shown_contrast: float = float("inf")
    work: Work = field(default_factory=Work)
    removed_background: NDArray[np.float64] = field(default_factory=lambda: np.zeros((4, 4)))

    @classmethod
    def of(cls, foreground: Foreground, difference: DifferenceImage, *, binning: int) -> "FitProblem":
        """Of a foreground, with so many pixels each way averaged into one.

        The noise is that of a pixel of the frame, and the prior of the contrasts is loose.
        """
        image, frame_pair = foreground.image, foreground.frame_pair
        # a saturated background is as dark contacts see it
        valid, saturated = frame_pair.valid, frame_pair.saturated if foreground.sign > 0 else None
        background = difference.illumination.background
        if binning > 1:
            rows, columns = (max(size // binning, 1) for size in image.shape)
            side = side_of(background.shape, image.shape)
            y = np.minimum(np.arange(-(-rows // side)) * binning, background.shape[0] - 1)
            x = np.minimum(np.arange(-(-columns // side)) * binning, background.shape[1] - 1)
            background = background[y][:, x]
            valid, saturated = _binned(valid, binning, np.min), _binned(saturated, binning, np.max)
            whole = image[: rows * binning, : columns * binning]
            image = np.asarray(cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA), np.float32)
        return cls(
            image, Noise(foreground.noise**2), ContrastPrior.loose(foreground.contrast.plateau), valid=valid,
            saturated=saturated, background=background, brightness=difference.brightness, binning=binning,
            largest_contrast=max(foreground.largest_contrast, foreground.contrast.plateau),
            shown_contrast=max(foreground.shown_contrast, foreground.contrast.plateau),
            work=Work.of_frame(foreground.image.size),
        )  # fmt: skip

    def window(self, box: tuple[slice, slice], image: NDArray[np.float32], brightness: float) -> "FitProblem":
        """A part of the image, with other pixels there and one illumination for all its disks."""
        return FitProblem(
            image,
            replace(self.noise, variance=self.noise.variance / brightness),
            self.prior,
            valid=None if self.valid is None else self.valid[box],
            saturated=None if self.saturated is None else self.saturated[box],
            profile=self.profile,
            binning=self.binning,
            corner=(box[1].start, box[0].start),
            largest_contrast=self.largest_contrast,
            shown_contrast=self.shown_contrast,
            work=self.work,
        )

    @property
    def contrast(self) -> float:
        """Expected contrast, grey levels."""
        return self.prior.mean

    @property
    def pixel_noise(self) -> float:
        """Standard deviation of a background pixel."""
        return float(np.sqrt(self.noise.variance))

    def with_noise(self, variance: float) -> "FitProblem":
        """With another variance of a background pixel."""
        return replace(self, noise=replace(self.noise, variance=variance))

    def with_contrast(self, contrast: float) -> "FitProblem":
        """With a loose prior about another contrast."""
        return replace(self, prior=ContrastPrior.loose(contrast))

    def without_background(self, coefficients: NDArray[np.float64]) -> "FitProblem":
        """With a slow polynomial subtracted from the image."""
        if not coefficients.any():
            return self
        image = Illumination(coefficients, self.background, 0.0).subtract_from(self.image)
        return replace(self, image=image, removed_background=self.removed_background + coefficients)

    def brightness_at(self, disks: NDArray) -> NDArray[np.float64]:
        """Relative illumination at the centres of disks."""
        rows, columns = self.brightness.shape
        x = np.clip(disks[:, X] * self.binning / BLOCK, 0, columns - 1).astype(int)
        y = np.clip(disks[:, Y] * self.binning / BLOCK, 0, rows - 1).astype(int)
        return self.brightness[y, x].astype(float)

    def in_frame(self, position: NDArray) -> NDArray[np.float64]:
        """Position in pixels of the frame."""
        return np.asarray(position * self.binning + (self.binning - 1) / 2)


def touches(mask: Mask, value: int, disks: NDArray, reach: NDArray) -> NDArray[np.bool_]:
    """Disks within ``reach`` (px) of which a pixel of the mask has the value."""
    other = None if mask is None else (mask != value).astype(np.uint8)
    if other is None or other.all():
        return np.zeros(len(disks), np.bool_)
    distance = cv2.distanceTransform(other, cv2.DIST_L2, cv2.DIST_MASK_5)
    x = np.clip(np.rint(disks[:, X]), 0, other.shape[1] - 1).astype(int)
    y = np.clip(np.rint(disks[:, Y]), 0, other.shape[0] - 1).astype(int)
    return np.asarray(distance[y, x] < reach)


def _binned(mask: Mask, binning: int, combine: Callable[..., NDArray]) -> Mask:
    """Minimum or maximum of the mask over each bin."""
    if mask is None:
        return None
    rows, columns = mask.shape[0] // binning, mask.shape[1] // binning
    bins = mask[: rows * binning, : columns * binning].reshape(rows, binning, columns, binning)
    return np.ascontiguousarray(combine(bins, axis=(1, 3)))
