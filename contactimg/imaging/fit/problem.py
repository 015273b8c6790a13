"""What is fitted: the difference image, binned where the blur is wide, its mask, noise, prior and profile."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.foreground import Foreground
from contactimg.imaging.pixels.blocks import BLOCK, side_of
from contactimg.imaging.pixels.masks import Mask
from contactimg.imaging.pixels.noise import Noise
from contactimg.imaging.profile.blurred_disk import EdgeTable, disk_table
from contactimg.imaging.profile.limits import ROUGH_STD, SAME_PLACE_RADII

X, Y, RADIUS, CONTRAST = range(4)
"""Columns of the parameters of a disk: x, y, radius (px), contrast (grey levels)."""

WIDE_RADIUS_BLUR_WIDTHS = 2.5
"""Wider contacts show their contrast. Theory: 1 - exp(-2.5^2/2) = 96 % of it at the centre."""


@dataclass(frozen=True, eq=False)
class ContrastPrior:
    """Normal prior of the contrast of each disk: that of the frame, or of its own plateau.

    Parameters
    ----------
    mean, std : float
        Of contacts that show the contrast of the frame, grey levels.
    small_std : float
        Of contacts too small to show theirs: the spread of all, those with a contrast of their own included.
    odd : ndarray, shape (m, 4)
        x, y, radius (px), contrast of the contacts that show a contrast of their own.
    """

    mean: float
    std: float
    small_std: float = 0.0
    odd: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 4)))

    @classmethod
    def loose(cls, contrast: float, odd: NDArray[np.float64] | None = None) -> "ContrastPrior":
        """The prior as long as the frame's own spread of contrasts is not known."""
        std = ROUGH_STD * contrast
        return cls(contrast, std, std, np.empty((0, 4)) if odd is None else odd)

    def at(self, contrast: float) -> "ContrastPrior":
        """The prior at another common contrast, with the same relative spreads."""
        ratio = contrast / self.mean
        return replace(self, mean=contrast, std=ratio * self.std, small_std=ratio * self.small_std)

    def is_odd(self, disks: NDArray) -> NDArray[np.int64]:
        """Row in ``odd`` of each disk; -1 where it has the contrast of the frame."""
        rows = np.full(len(disks), -1)
        if len(self.odd) and len(disks):
            reach = SAME_PLACE_RADII * np.maximum(self.odd[:, [RADIUS]], 1.0)
            low, high = (self.odd[:, :2] + side * reach for side in (-1.0, 1.0))
            # a group of disks lies beside few of them
            beside = (high >= disks[:, :2].min(axis=0)) & (low <= disks[:, :2].max(axis=0))
            for k in np.flatnonzero(beside.all(axis=1)):
                apart = np.hypot(disks[:, X] - self.odd[k, X], disks[:, Y] - self.odd[k, Y]) / reach[k]
                ratio = disks[:, RADIUS] / max(self.odd[k, RADIUS], 1e-3)
                apart[(ratio < 0.4) | (ratio > 2.5)] = np.inf
                nearest = int(np.argmin(apart))
                if apart[nearest] <= 1.0:
                    rows[nearest] = k
        return rows

    def of_disks(self, disks: NDArray, blur: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean and width for each disk, shape (n,)."""
        mean = np.full(len(disks), self.mean)
        wide = disks[:, RADIUS] > WIDE_RADIUS_BLUR_WIDTHS * blur
        std = np.where(wide, self.std, max(self.small_std, self.std))
        rows = self.is_odd(disks)
        own = rows >= 0
        mean[own] = self.odd[rows[own], CONTRAST]
        std[own] = 0.3 * mean[own]  # wide, for its pixels decide. By hand
        return mean, std


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
    rounding : float
        Part of the noise that the pixels of a block share (`rounding_of_blocks`), grey levels.
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
    rounding: float = 0.0

    @classmethod
    def of(cls, foreground: Foreground, *, binning: int) -> "FitProblem":
        """The problem of a foreground, with so many pixels each way averaged into one.

        The noise is that of a pixel of the frame, and the prior of the contrasts is loose.
        """
        image, frame_pair, difference = foreground.image, foreground.frame_pair, foreground.difference
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
            rounding=difference.rounding,
        )  # fmt: skip

    def window(self, box: tuple[slice, slice], image: NDArray[np.float32], brightness: float) -> "FitProblem":
        """A part of the image, with other pixels there and one illumination for all its disks."""
        corner = box[1].start, box[0].start
        return replace(
            self,
            image=image,
            noise=replace(self.noise, variance=self.noise.variance / brightness),
            prior=replace(self.prior, odd=self.prior.odd - np.array([*corner, 0.0, 0.0])),
            valid=None if self.valid is None else self.valid[box],
            saturated=None if self.saturated is None else self.saturated[box],
            brightness=np.ones((1, 1), np.float32),
            corner=corner,
        )

    @property
    def contrast(self) -> float:
        """Expected contrast, grey levels."""
        return self.prior.mean

    @property
    def pixel_noise(self) -> float:
        """Standard deviation of a background pixel."""
        return float(np.sqrt(self.noise.variance))

    def brightness_at(self, disks: NDArray) -> NDArray[np.float64]:
        """Relative illumination at the centres of disks."""
        rows, columns = self.brightness.shape
        x = np.clip(disks[:, X] * self.binning / BLOCK, 0, columns - 1).astype(int)
        y = np.clip(disks[:, Y] * self.binning / BLOCK, 0, rows - 1).astype(int)
        return self.brightness[y, x].astype(float)

    def in_frame(self, position: NDArray) -> NDArray[np.float64]:
        """Position in pixels of the frame."""
        return np.asarray(position * self.binning + (self.binning - 1) / 2)


def _binned(mask: Mask, binning: int, combine: Callable[..., NDArray]) -> Mask:
    """Minimum or maximum of the mask over each bin."""
    if mask is None:
        return None
    rows, columns = mask.shape[0] // binning, mask.shape[1] // binning
    bins = mask[: rows * binning, : columns * binning].reshape(rows, binning, columns, binning)
    return np.ascontiguousarray(combine(bins, axis=(1, 3)))
