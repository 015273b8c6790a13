"""Components of pixels that are several contacts, parted where they touch.

A component whose pixels lie further from their centroid than a disk's is looked at: the disks inscribed in
it, as far as they overlap no more than contacts do, share its pixels, each pixel to the disk in which it lies
deepest (its power with respect to the circle). Pixels are parted, none is lost: the areas add up.
"""

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from contactimg.imaging.detect import find_inscribed
from contactimg.imaging.pixels import NO_MASK
from contactimg.imaging.segment import COMPONENT, add_pixel, finish_component
from contactimg.imaging.touching import hidden

__all__ = ["split_components"]

ELONGATED = 1.015  # moment of the pixels over that of a disk: two that touch have 1.5, a small one on a
# large one of five times its radius 1.03; rims in noise stay below
FEWEST = 25  # pixels: two disks of 2 px, below which no inscribed disk is told from noise


def split_components(
    image: NDArray[np.float32],
    level: float,
    found: NDArray[np.void],
    *,
    marks: NDArray[np.uint8],
    smoothing: float = 0.0,
) -> tuple[NDArray[np.void], NDArray[np.bool_]]:
    """Components with those parted that are several contacts.

    Parameters
    ----------
    image, level, marks
        As for `contactimg.imaging.segment.label_components`.
    found : ndarray of `COMPONENT`
        The components.
    smoothing : float, px
        Gaussian that keeps noise from notching the components while disks are inscribed; 0 for none.

    Returns
    -------
    parts : ndarray of `COMPONENT`
        Whole components, and parts in the place of those that were split.
    split : ndarray of bool
        Which are parts.

    Examples
    --------
    >>> from contactimg.imaging.segment import label_components
    >>> y, x = np.mgrid[0:24, 0:44]
    >>> disks = (np.hypot(x - 12, y - 12) < 9) | (np.hypot(x - 29, y - 12) < 9)
    >>> image = disks.astype(np.float32)
    >>> found = label_components(image, 0.5, marks=np.zeros((1, 1), np.uint8))
    >>> parts, split = split_components(image, 0.5, found, marks=np.zeros((1, 1), np.uint8))
    >>> len(found), [int(area) for area in parts["area"]], split.tolist()
    (1, [249, 249], [True, True])
    """
    area = np.maximum(found["area"], 1)
    # n pixels in a disk have the moment n^2/(2 pi), of which n/6 is that of each pixel about its centre
    shape = 2.0 * np.pi * (found["moment"] + area / 6.0) / area**2 - 2.0 * np.pi / 6.0 / area
    doubtful = np.flatnonzero((shape > ELONGATED) & (area >= FEWEST))
    tried = {int(i): _parts(image, level, found[i], marks, smoothing) for i in doubtful}
    parts = {i: part for i, part in tried.items() if part is not None}
    whole = np.delete(np.arange(len(found)), list(parts))
    source = np.concatenate([whole, *(np.full(len(part), i) for i, part in parts.items())])
    order = np.argsort(source, kind="stable")
    return np.concatenate([found[whole], *parts.values()])[order], order >= len(whole)


def _parts(
    image: NDArray, level: float, component: NDArray[np.void], marks: NDArray[np.uint8], smoothing: float
) -> NDArray[np.void] | None:
    """Parts of a component, or None if it is one contact."""
    top, left = max(component["top"] - 1, 0), max(component["left"] - 1, 0)
    box = (slice(top, component["bottom"] + 2), slice(left, component["right"] + 2))
    labels = cv2.connectedComponents((image[box] > level).view(np.uint8))[1]
    mask = labels == labels[component["peak_y"] - top, component["peak_x"] - left]
    alone = np.where(mask, image[box], np.float32(0.0))
    disks = find_inscribed(alone, level, smoothing=smoothing, weight=NO_MASK)
    disks = disks[~hidden(disks)]
    if len(disks) < 2:
        return None
    parts = np.zeros(len(disks), COMPONENT)
    _share(alone, mask, marks[box] if marks.shape == image.shape else NO_MASK, disks, parts)
    for corner, names in ((left, ("x", "peak_x", "left", "right")), (top, ("y", "peak_y", "top", "bottom"))):
        for name in names:
            parts[name] += corner
    return parts


@njit(cache=True)
def _share(image, mask, marks, disks, parts):
    """Give each pixel of a mask to the disk with the least power ``|p - c|^2 - r^2``."""
    parts["left"][:] = image.shape[1]
    parts["top"][:] = image.shape[0]
    marked = marks.shape == image.shape
    for j in range(mask.shape[0]):
        for i in range(mask.shape[1]):
            if not mask[j, i]:
                continue
            best, least = 0, np.inf
            for k in range(len(disks)):
                power = (i - disks[k, 0]) ** 2 + (j - disks[k, 1]) ** 2 - disks[k, 2] ** 2
                if power < least:
                    best, least = k, power
            add_pixel(parts[best], i, j, image[j, i], marked and marks[j, i] > 0)
    for part in parts:
        finish_component(part)
