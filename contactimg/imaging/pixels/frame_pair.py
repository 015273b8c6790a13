"""A frame and its reference, prepared for the measurement: scaled, holes filled, defects named."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.pixels.blocks import SOME_CLIPPED
from contactimg.imaging.pixels.masks import Mask, exclude
from contactimg.imaging.pixels.robust import MANY, median, quantile
from contactimg.tables import Status

LARGEST_KEPT_BYTES = 31 * 2**20
"""Largest array that is kept. Theory: glibc keeps none beyond 32 MB, 8 megapixels in single precision."""
Levels = NDArray[np.float32] | NDArray[np.uint8]
"""Grey levels of an image."""
SPAN_LEVELS = 200.0  # range of the internal levels of an image: about that of 8 bits, whatever the unit
ROUNDING_STD = 12.0**-0.5
"""Standard deviation of the rounding error of whole numbers (theory)."""
FEW_LEVELS = 16  # that a frame shows at least; accuracy
MESSAGES: dict[str, str] = {
    Status.BLACK: "the frame is black: no light reached the sensor",
    Status.WHITE: "the frame is white: every pixel is at full scale",
    Status.CONSTANT: "every pixel of the frame has the same value",
    Status.IDENTICAL: "the frame is identical to its reference: no contact can show",
    Status.ALL_HOLES: "the frame has no finite pixel",
    Status.HOLES: "masked pixels, or pixels without a finite value, were left out",
    Status.BAD_REFERENCE: "the reference is black or white throughout, or at full scale where the frame is "
    "not: the background was estimated from the frame",
}
"""What is said of a frame with a defect."""
SHOWS_NOTHING = {Status.BLACK, Status.WHITE, Status.CONSTANT, Status.IDENTICAL, Status.ALL_HOLES}
"""Defects of frames that carry no information on contacts."""


@dataclass(frozen=True, eq=False)
class FramePair:
    """A frame and its reference.

    Parameters
    ----------
    frame, reference : ndarray of float32 or uint8, shape (rows, columns)
        In units of ``unit`` grey levels, holes filled; 8-bit images unchanged. The reference is None if there
        is none or it shows no light.
    valid : Mask
        0 where either has a hole.
    saturated : Mask
        1 where the frame is at full scale.
    unit : float
        Grey levels of the input for one internal level.
    defect : str
        What is wrong with the frame, a key of ``MESSAGES``; empty if nothing is.
    full_scale : float
        Level at which the sensor saturates, in units of ``unit``; infinite if it is not known.
    black : float
        Level of no light; minus infinity if negative levels show that it is not known.
    whole_levels : bool
        Whether the frame has whole grey levels.
    lit_in_one : float
        Share of the pixels that light reaches in one of the images alone.
    """

    frame: Levels
    reference: Levels | None
    valid: Mask
    saturated: Mask
    unit: float
    defect: str
    full_scale: float = float("inf")
    black: float = 0.0
    whole_levels: bool = False
    lit_in_one: float = 0.0

    def with_rounding(self, noise: float) -> float:
        """A standard deviation of pixels, at least that of rounding where they are whole grey levels."""
        if not self.whole_levels:
            return noise
        # where there is no noise the steps of few levels are none either: a threshold has made them
        # By hand: of two levels a larger share would hide dots.
        largest = np.inf if noise > 0.0 else 0.02 * float(np.ptp(self.frame[::8, ::8]))
        return max(noise, min(ROUNDING_STD / self.unit, largest))

    @property
    def step(self) -> float:
        """Smallest difference of the grey levels that occur, in units of ``unit``; 0 where there are many."""
        if len(np.unique(self.frame[::32, ::32])) > FEW_LEVELS:
            return 0.0
        return float(np.min(np.diff(np.unique(self.frame).astype(float)), initial=np.inf))

    def largest_contrast(self, level: float, sign: int) -> float:
        """Largest contrast that the levels can show above (``sign`` 1) or below (-1) a background level.

        A level of 0 stands for a background that had been subtracted before: then there is no limit below.
        """
        if sign < 0:
            return min(level, self.full_scale) - self.black if level > 0 else float("inf")
        return self.full_scale - max(level, 0.0) if self.full_scale > level else self.full_scale

    def shown_contrast(self, level: float, sign: int) -> float:
        """Largest contrast that a plateau can have that the frame shows: at most its range of levels."""
        largest = self.largest_contrast(level, sign)
        return largest if np.isfinite(largest) else float(self.frame.max()) - float(self.frame.min())

    @property
    def trivial(self) -> bool:
        """Whether the frame carries no information on contacts."""
        return self.defect in SHOWS_NOTHING

    @property
    def message(self) -> str:
        """One sentence on the defect."""
        return MESSAGES.get(self.defect, "")

    def within(self, valid: Mask) -> "FramePair":
        """The pair with other holes: also those of the registered reference."""
        return replace(self, valid=valid)

    def without(self, mask: Mask) -> "FramePair":
        """The pair with further holes, where ``mask`` is 1."""
        return replace(self, valid=exclude(self.valid, mask))

    @classmethod
    def of(cls, image: NDArray, reference: NDArray | None, full_scale: float | None) -> "FramePair":
        """A pair of arrays: uint8, uint16 or float, non-finite at holes; see `contactimg.imaging.measure`."""
        whole = image.dtype.kind == "u"
        if full_scale is None:
            full_scale = np.iinfo(image.dtype).max if whole else np.inf
        scale = float(np.float32(full_scale))  # as the pixels are stored and compared
        valid = _finite([image] if reference is None else [image, reference])
        frame = _fill_holes(image, valid)
        other = None if reference is None else _fill_holes(reference, valid)
        unlit = other is not None and _shows_no_light(frame, other, scale)
        if unlit:
            other = None
        full = np.isfinite(scale) and float(frame.max()) >= scale
        saturated = (frame >= np.float32(scale)).view(np.uint8) if full else None
        defect = _defect(frame, other, valid, scale) or (Status.BAD_REFERENCE if unlit else "")
        unit = _unit(image, frame, other)
        if unit != 1.0:
            exact = np.float64 if unit < np.finfo(np.float32).tiny else np.float32
            frame = np.divide(frame, exact(unit), out=frame)
            other = None if other is None else (other / exact(unit)).astype(np.float32, copy=False)
            scale = float(np.float32(np.float32(scale) / exact(unit)))
        black = 0.0 if whole or float(frame.min()) >= 0 else -np.inf
        return cls(frame, other, valid, saturated, unit, defect, scale, black, whole)


def _finite(arrays: list[NDArray]) -> Mask:
    """1 where all arrays are finite; None if they are everywhere."""
    if all(array.dtype.kind != "f" for array in arrays):
        return None
    good = np.logical_and.reduce([np.isfinite(array) for array in arrays])
    return None if good.all() else good.astype(np.uint8)


def _shows_no_light(frame: NDArray, reference: NDArray, scale: float) -> bool:
    """Whether a reference is black or white throughout, or has lost much of the light of the frame."""
    if _constant(reference):
        return float(reference[0, 0]) in (0.0, scale)
    some, other = (image[::7, ::11] < np.float32(scale) for image in (frame, reference))
    return bool(np.mean(some & ~other) > SOME_CLIPPED)


def _constant(image: NDArray) -> bool:
    """Whether all pixels have the same value; a coarse sample rules it out for most images."""
    some = image[::16, ::16]
    return bool(some.min() == some.max() == image.min() == image.max())


def _fill_holes(array: NDArray, valid: Mask) -> Levels:
    """The image as float32 or 8 bits, holes filled with the median of the other pixels."""
    if valid is None:
        return array if array.dtype == np.uint8 else array.astype(np.float32)
    good = valid > 0
    fill = array[good][0] * 0 + np.median(array[good]) if good.any() else 0.0
    return np.where(good, array, fill).astype(np.float32)


def _unit(image: NDArray, frame: NDArray, reference: NDArray | None) -> float:
    """Grey levels for one internal level: 1 for 8 bits, else for a range of about `SPAN_LEVELS`."""
    if image.dtype == np.uint8:
        return 1.0
    rows = slice(None, None, max(frame.size // MANY, 1))
    levels = [quantile(frame[rows], share) for share in (0.001, 0.999)]
    levels += [] if reference is None else [median(reference[rows])]
    span = max(levels) - min(levels)
    return span / SPAN_LEVELS if span > 0 else max(float(np.abs(frame).max()), 1.0) / SPAN_LEVELS


def _defect(frame: NDArray, reference: NDArray | None, valid: Mask, scale: float) -> str:
    """A sentence on what is wrong with a frame as a whole; empty if nothing."""
    if valid is not None and not valid.any():
        return Status.ALL_HOLES
    if _constant(frame):
        level = float(frame[0, 0])
        return Status.BLACK if level <= 0 else (Status.WHITE if level >= scale else Status.CONSTANT)
    # most images differ in a coarse sample
    if reference is not None and all(np.array_equal(frame[::n, ::n], reference[::n, ::n]) for n in (16, 1)):
        return Status.IDENTICAL
    return Status.HOLES if valid is not None else ""


@lru_cache(maxsize=1)
def keep_freed_memory() -> None:
    """Let the process keep up to twice `LARGEST_KEPT_BYTES` that it has freed.

    glibc keeps freed arrays up to the size of the largest that was ever freed: one that is never written to
    tells it. It has no memory of its own, and other C libraries take no notice.
    """
    np.empty(LARGEST_KEPT_BYTES, np.uint8)
