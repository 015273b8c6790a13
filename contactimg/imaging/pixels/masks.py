"""Masks: which pixels of an image are used, and which fraction of a disk they leave visible."""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float32]
"""Values of pixels, squares or blocks, in single precision."""
Flags = NDArray[np.bool_]
"""Whether something holds of each of them."""
Mask = NDArray[np.uint8] | None
"""One value for each pixel, 0 or 1; None where no pixel is masked."""


def for_kernel(mask: Mask, saturated: Mask = None) -> NDArray[np.uint8]:
    """The mask as compiled functions take it: an array of another shape than the image masks nothing.

    Saturated pixels that are not masked have the value 2. A part of a mask is copied: functions compiled for
    whole masks would be compiled once more for it.
    """
    if saturated is None:
        return np.zeros((1, 1), np.uint8) if mask is None else np.ascontiguousarray(mask)
    return 1 + saturated if mask is None else mask * (1 + saturated)


def exclude(valid: Mask, marked: Mask) -> Mask:
    """Valid pixels (1) without the marked ones.

    Examples
    --------
    >>> exclude(None, np.array([[0, 1]], np.uint8)).tolist()
    [[1, 0]]
    """
    if marked is None:
        return valid
    return 1 - marked if valid is None else valid & (1 - marked)


def nearest_pixels(x: NDArray, y: NDArray, shape: tuple[int, ...]) -> tuple[NDArray, NDArray]:
    """Rows and columns of the pixels of an image of ``shape`` that are nearest to places (px)."""
    rows, columns = (np.clip(np.rint(z), 0, n - 1).astype(int) for z, n in zip((y, x), shape, strict=True))
    return rows, columns


def touches(mask: Mask, value: int, places: NDArray, reach: NDArray) -> NDArray[np.bool_]:
    """Places (x, y, ...) within ``reach`` (px) of which a pixel of the mask has the value."""
    other = None if mask is None else (mask != value).astype(np.uint8)
    if other is None or other.all():
        return np.zeros(len(places), np.bool_)
    distance = cv2.distanceTransform(other, cv2.DIST_L2, cv2.DIST_MASK_5)
    return np.asarray(distance[nearest_pixels(places[:, 0], places[:, 1], other.shape)] < reach)


def mean_of_seen(blur: Callable[[NDArray], NDArray], image: NDArray, seen: Flags) -> tuple[Values, Values]:
    """Mean of the pixels seen around each one, with the weights of a blur; and their weight.

    Examples
    --------
    >>> image, seen = np.array([[2.0, 4.0, np.nan]], np.float32), np.array([[True, True, False]])
    >>> mean, weight = mean_of_seen(lambda part: cv2.blur(part, (3, 1)), image, seen)
    >>> mean.round(3).tolist(), weight.round(3).tolist()
    ([[3.333, 3.0, 4.0]], [[1.0, 0.667, 0.667]])
    """
    parts = (seen.astype(np.float32), np.where(seen, image, np.float32(0.0)))
    weight, total = (np.asarray(blur(part), np.float32) for part in parts)
    return np.asarray(total / np.maximum(weight, np.float32(1e-3)), np.float32), weight


def clear_disks(mask: NDArray[np.uint8], disks: NDArray[np.float64]) -> None:
    """Set the disks (x, y, radius in pixels of the mask) to 0: centres rounded, radii rounded up.

    Examples
    --------
    >>> mask = np.ones((3, 4), np.uint8)
    >>> clear_disks(mask, np.array([[1.1, 0.9, 0.6]]))
    >>> mask.tolist()
    [[1, 0, 1, 1], [0, 0, 0, 1], [1, 0, 1, 1]]
    """
    places = np.column_stack([np.rint(disks[:, :2]), np.ceil(disks[:, 2])]).astype(int)
    # no list for each disk, of which thousands make the garbage collector run
    for x, y, radius in zip(*places.T.tolist(), strict=True):
        cv2.circle(mask, (x, y), radius, 0, cv2.FILLED)
