"""Where contacts may be: disks inscribed in what lies above half height, and peaks of a matched filter.

The first finds every contact that reaches half height, and both of two that touch; the second, applied to
what a fit of the first has left over, finds small contacts (a disk with a < 1.18 blur widths never reaches
half height) down to the noise.
"""

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from contactimg.imaging.blocks import sample_background
from contactimg.imaging.filters import TAPS, filter_image, kernel_of
from contactimg.imaging.order import median, robust_std
from contactimg.imaging.pixels import NO_MASK, share_seen
from contactimg.imaging.segment import label_components

__all__ = [
    "FALSE_ALARM_SIGMA",
    "estimate_blur",
    "find_inscribed",
    "find_peaks",
    "find_peaks_near",
    "select_inscribed",
]

FALSE_ALARM_SIGMA = 6.0
"""Height of a matched-filter peak above the noise that counts as detection. Normal noise has
``pixels/(2 width^2) (2 pi)^(-3/2) z exp(-z^2/2)`` maxima above z: 3e-3 in 1600 x 1200 pixels at 1.4 px."""

MOST_SLOPES = 8000  # pixels at half height that give the blur
STRIP = 64  # pixels of a row looked at together
SMALLEST_INSCRIBED = 2.0  # px: below, pixel noise at the rim looks the same
SMALLEST_ROUND = 1.6  # px: the same of what is round by itself
ROUND = 0.01  # by which the second moment of a region may exceed that of a disk, besides 1/area ...
WIDER = 1.7  # ... and px by which its sides may exceed the diameter
LEAST_SEEN = 0.2  # of a disk's area: what lies in a hole to a larger part is not known to be one
PENETRATION = 0.7  # of its radius: a disk deeper than this inside a larger one is part of its rim


def estimate_blur(image: NDArray[np.float32], plateau: float) -> float:
    """Width of the blur from the gradient where rims cross half height, pixel included, px.

    Notes
    -----
    At half height a straight edge has the gradient ``plateau/(s sqrt(2 pi))``; the smoothing that tames the
    noise here adds 2/3 px^2 (a 3 x 3 mean), central differences 1/3 px^2. Good to 10 %: a start for the fit.
    """
    slopes = _slopes(image, np.float32(0.4 * plateau), np.float32(0.6 * plateau), MOST_SLOPES)
    if len(slopes) < 20:
        return 1.5
    width = plateau / max(median(slopes), 1e-6 * plateau) / np.sqrt(2 * np.pi)
    return float(np.sqrt(max(width**2 - 1.0, 0.35)))


@njit(cache=True)
def _slopes(image, low, high, most):
    """Gradients of the pixels between two levels, every so many rows such that not too many come out."""
    rows, columns = image.shape
    out = np.empty(most)
    column = np.empty(columns, np.float32)
    low, high = np.float32(9.0) * low, np.float32(9.0) * high  # of a sum over 3 x 3 pixels
    count = 0
    for first in range(8):
        for y in range(2 + first, rows - 2, 8):
            _add_rows(column, image[y - 1], image[y], image[y + 1])
            for left in range(2, columns - 2, STRIP):
                right = min(left + STRIP, columns - 2)
                if not _exceeds(column[left - 1 : right + 1], low / np.float32(3.0)):
                    continue
                for x in range(left, right):
                    if low < column[x - 1] + column[x] + column[x + 1] < high and count < most:
                        out[count] = _slope_at(image, x, y)
                        count += 1
        if count > most // 4:
            break
    return out[:count]


@njit(cache=True)
def _slope_at(image, x, y):
    """Gradient, from central differences of means of 3 x 3 pixels."""
    gx = gy = np.float32(0.0)
    for i in range(-1, 2):
        gx += image[y + i, x + 2] + image[y + i, x + 1] - image[y + i, x - 1] - image[y + i, x - 2]
        gy += image[y + 2, x + i] + image[y + 1, x + i] - image[y - 1, x + i] - image[y - 2, x + i]
    return np.sqrt(gx * gx + gy * gy) / np.float32(18.0)


@njit(cache=True, fastmath=True, forceinline=True)
def _add_rows(out, one, two, three):
    """Sum of three rows, in vector instructions."""
    for x in range(len(out)):
        out[x] = one[x] + two[x] + three[x]


@njit(cache=True, fastmath=True, forceinline=True)
def _exceeds(row, level):
    """Whether a value of the row does, in vector instructions."""
    total = np.int32(0)
    for x in range(len(row)):
        total += np.int32(row[x] > level)
    return total > 0


def find_inscribed(
    image: NDArray[np.float32], level: float, *, smoothing: float, weight: NDArray[np.uint8]
) -> NDArray[np.float64]:
    """Disks inscribed in the regions above ``level``, largest first.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
    level : float
    smoothing : float, px
        Standard deviation of a Gaussian that keeps noise from making holes; about the blur, or 0.
    weight : ndarray of uint8
        0 for pixels without a value, which cut no contact (shape (1, 1): all have one).

    Returns
    -------
    ndarray, shape (n, 3)
        x, y, radius (px); overlaps only as touching contacts overlap.
    """
    smooth = image
    if smoothing > 0:
        smooth = cv2.GaussianBlur(image, (0, 0), smoothing, borderType=cv2.BORDER_REPLICATE)
    if weight.shape != image.shape:
        return _inscribed_by_region(smooth, level)
    # a hole cuts no contact, but a hole alone is none
    disks = _inscribed(((smooth > level) | (weight == 0)).astype(np.uint8), (True, True, True, True))
    return disks[share_seen(disks, image.shape, weight) > LEAST_SEEN]


def _inscribed_by_region(image: NDArray[np.float32], level: float) -> NDArray[np.float64]:
    """Disks for the regions above ``level``: one for a round region, those inscribed in the others."""
    regions = label_components(image, level, marks=NO_MASK)
    radius = np.sqrt(regions["area"] / np.pi)
    longest = np.maximum(regions["right"] - regions["left"], regions["bottom"] - regions["top"]) + 1
    cut = (
        (regions["left"] == 0) | (regions["right"] == image.shape[1] - 1)
        | (regions["top"] == 0) | (regions["bottom"] == image.shape[0] - 1)
    )  # fmt: skip
    # of all regions of an area a disk has the least second moment, area^2/(2 pi)
    excess = 2.0 * np.pi * regions["moment"] / regions["area"] ** 2.0 - 1.0
    round_ = ~cut & (excess < ROUND + 1.0 / regions["area"]) & (longest < 2.0 * radius + WIDER)
    disks = np.column_stack([regions["x"], regions["y"], radius])[round_ & (radius > SMALLEST_ROUND)]
    found = [_inscribed_in(region, image, level) for region in regions[~round_ & (radius > SMALLEST_ROUND)]]
    disks = np.vstack([disks, *found])
    return disks[np.argsort(-disks[:, 2], kind="stable")]


def _inscribed_in(region: np.void, image: NDArray[np.float32], level: float) -> NDArray[np.float64]:
    """Disks inscribed in one region."""
    top, bottom, left, right = (int(region[name]) for name in ("top", "bottom", "left", "right"))
    above = (image[top : bottom + 1, left : right + 1] > level).astype(np.uint8)
    labels = cv2.connectedComponents(above, connectivity=8)[1]
    own = (labels == labels[region["peak_y"] - top, region["peak_x"] - left]).astype(np.uint8)
    cut = (top == 0, bottom == image.shape[0] - 1, left == 0, right == image.shape[1] - 1)
    return _inscribed(own, cut) + np.array([left, top, 0.0])


def _inscribed(mask: NDArray[np.uint8], cut: tuple[bool, bool, bool, bool]) -> NDArray[np.float64]:
    """Disks inscribed in a mask, largest first; the mask goes on beyond its sides ``cut``, top to right."""
    # a contact cut by the border goes on beyond it: repeat the border instead of closing it
    closed = cv2.copyMakeBorder(mask, 1, 1, 1, 1, cv2.BORDER_CONSTANT)
    for side, rim, inside in zip(cut, _rims(closed, 0), _rims(closed, 1), strict=True):
        if side:
            rim[:] = inside
    if closed.all():
        return np.empty((0, 3))  # nothing bounds a disk
    distance = cv2.distanceTransform(closed, cv2.DIST_L2, cv2.DIST_MASK_5)[1:-1, 1:-1]
    return select_inscribed(distance)


def _rims(array: NDArray, depth: int) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Rows and columns so far inside the four sides of an array."""
    return array[depth], array[-1 - depth], array[:, depth], array[:, -1 - depth]


@njit(cache=True)
def select_inscribed(distance):
    """Disks (x, y, radius) from the distances of pixels to the rim, largest first."""
    summits = _summits(distance, SMALLEST_INSCRIBED)
    return _select(summits[np.argsort(-summits[:, 2], kind="mergesort")])


@njit(cache=True)
def _summits(distance, smallest):
    """Local maxima of the distance transform."""
    rows, columns = distance.shape
    out = np.empty((1024, 3))
    count = 0
    for y in range(rows):
        for x in range(columns):
            d = distance[y, x]
            if d < smallest:
                continue
            top = True
            for j in range(max(y - 1, 0), min(y + 2, rows)):
                for i in range(max(x - 1, 0), min(x + 2, columns)):
                    if distance[j, i] > d:
                        top = False
                        break
                if not top:
                    break
            if not top:
                continue
            if count == len(out):
                grown = np.empty((2 * count, 3))
                grown[:count] = out
                out = grown
            # distances end at the centre of the first pixel outside, on average 0.4 px beyond the rim
            out[count, 0], out[count, 1], out[count, 2] = x, y, d
            count += 1
    return out[:count]


@njit(cache=True)
def _select(summits):
    """Greedy choice, largest first, of disks that do not lie inside one another; a grid keeps it linear."""
    n = len(summits)
    kept = np.empty((n, 3))
    if n == 0:
        return kept
    size = 32.0
    wide = int(summits[:, 0].max() // size) + 1
    high = int(summits[:, 1].max() // size) + 1
    head = np.full((high, wide), -1, np.int64)
    capacity = 4 * n + 64
    follow, owner = np.empty(capacity, np.int64), np.empty(capacity, np.int64)
    count = links = 0
    for k in range(n):
        x, y, r = summits[k]
        free = True
        q = head[int(y // size), int(x // size)]
        while q >= 0:
            other = kept[owner[q]]
            dx, dy = x - other[0], y - other[1]
            limit = other[2] + (1.0 - PENETRATION) * r
            if dx * dx + dy * dy < limit * limit:
                free = False
                break
            q = follow[q]
        if not free:
            continue
        kept[count] = summits[k]
        # later disks are no larger, so this one matters to centres within its radius plus a part of it
        reach = (2.0 - PENETRATION) * r
        for j in range(max(int((y - reach) // size), 0), min(int((y + reach) // size) + 1, high)):
            for i in range(max(int((x - reach) // size), 0), min(int((x + reach) // size) + 1, wide)):
                if links == capacity:
                    follow = np.append(follow, np.empty(capacity, np.int64))
                    owner = np.append(owner, np.empty(capacity, np.int64))
                    capacity *= 2
                follow[links], owner[links] = head[j, i], count
                head[j, i] = links
                links += 1
        count += 1
    return kept[:count]


def find_peaks(
    image: NDArray[np.float32],
    model: NDArray[np.float32],
    *,
    width: float,
    height: float,
    background: NDArray[np.bool_],
) -> tuple[NDArray[np.float64], float]:
    """Peaks of what the model leaves over, after a matched filter.

    Parameters
    ----------
    image, model : ndarray, shape (rows, columns)
        Difference image and the model found so far.
    width : float, px
        Standard deviation of the Gaussian filter: that of the blur.
    height : float
        Smallest peak, grey levels, however quiet the background.
    background : ndarray of bool
        Background blocks, see `contactimg.imaging.blocks`, where the noise of the filtered image is measured.

    Returns
    -------
    peaks : ndarray, shape (n, 3)
        x, y, height of the filtered peak (grey levels); largest first.
    lowest : float
        Height that counted as a peak.
    """
    smooth = _smooth(image, model, width)
    sample = sample_background(smooth, background, (7, 11))
    if len(sample) < 50:
        sample = smooth[::5, ::7].ravel()
    lowest = max(median(sample) + FALSE_ALARM_SIGMA * robust_std(sample), height)
    return _sorted_peaks(smooth, lowest, width), lowest


def find_peaks_near(
    image: NDArray[np.float32], model: NDArray[np.float32], disks: NDArray, *, width: float, lowest: float
) -> NDArray[np.float64]:
    """Peaks of what the model leaves over in the windows of some disks; as `find_peaks`."""
    found = [np.empty((0, 3))]
    for x, y, a in disks[:, :3]:
        reach = int(np.ceil(a + 6.0 * width))
        x0, y0 = max(round(x) - reach, 0), max(round(y) - reach, 0)
        part = (slice(y0, max(round(y) + reach + 1, 0)), slice(x0, max(round(x) + reach + 1, 0)))
        if image[part].size:
            found.append(
                _sorted_peaks(_smooth(image[part], model[part], width), lowest, width)
                + np.array([x0, y0, 0.0])
            )
    return np.unique(np.vstack(found), axis=0)


def _smooth(image: NDArray[np.float32], model: NDArray[np.float32], width: float) -> NDArray[np.float32]:
    """What the model leaves over, blurred."""
    taps = 2 * int(np.ceil(2.5 * width)) + 1
    if taps > TAPS:
        return cv2.GaussianBlur(image - model, (taps, taps), width, borderType=cv2.BORDER_REPLICATE)
    kernel = kernel_of(cv2.getGaussianKernel(taps, width)[:, 0])
    return filter_image(image, kernel, kernel, minus=model)


def _sorted_peaks(smooth: NDArray[np.float32], lowest: float, width: float) -> NDArray[np.float64]:
    found = _peaks(smooth, np.flatnonzero(smooth.ravel() > np.float32(lowest)), int(np.ceil(width)))
    return found[np.argsort(-found[:, 2], kind="stable")]


@njit(cache=True)
def _peaks(image, places, half):
    """Pixels among ``places``, counted row by row, that are the largest of a square of that half width."""
    rows, columns = image.shape
    out = np.empty((len(places), 3))
    count = 0
    for place in places:
        y, x = place // columns, place % columns
        value = image[y, x]
        top = True
        for j in range(max(y - half, 0), min(y + half + 1, rows)):
            for i in range(max(x - half, 0), min(x + half + 1, columns)):
                if image[j, i] > value or (image[j, i] == value and (j < y or (j == y and i < x))):
                    top = False
                    break
            if not top:
                break
        if top:
            out[count, 0], out[count, 1], out[count, 2] = x, y, value
            count += 1
    return out[:count]
