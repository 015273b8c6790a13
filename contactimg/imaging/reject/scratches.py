"""Scratches: a faint line that both methods take for a chain of small contacts.

Between the centres of two contacts the image falls to the background, or to a neck where they touch. Along a
scratch it does not. A contact of another shape than a disk is a chain as well, but it is wide for its length,
or it closes a ring.
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from contactimg.imaging.kernels.pairs import find_pairs
from contactimg.imaging.shapes.holes import hole_areas

LARGEST_BLUR_WIDTHS = 2.5
"""Radius over the blur up to which a disk may be a piece of a scratch. Chosen: wider ones show a plateau."""
LARGEST_GAP_BLUR_WIDTHS = 4.0
"""Gap between neighbours in a chain. Theory: beyond it two rims leave 5 % of the contrast between them."""
BRIDGE_FRACTION = 0.6
"""Least brightness between two pieces over that of the fainter one. Chosen: where two disks of two blur
widths in radius touch, it is half."""
FEWEST_PIECES = 5
"""Pieces of a scratch. Chosen: pairs and triples of small contacts that touch are real."""
FEWEST_DIAMETERS = 3.0
"""Length of a scratch in mean diameters of its pieces, at least. Chosen: shorter chains are no line."""
LEAST_SLENDERNESS = 3.0
"""Area of a scratch over its squared width, at least. Theory: length over width; 0.8 for a disk, 1.8 for a
bone, 2.5 for a crescent."""
LEAST_HOLE_BLUR_WIDTHS = 1.0
"""Radius of the smallest hole that makes a chain a ring. Chosen."""


def find_scratches(
    image: NDArray[np.float32], disks: NDArray, *, blur_px: float, candidates: NDArray | None = None
) -> NDArray[np.bool_]:
    """Which disks are pieces of a scratch.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Difference image, contacts positive.
    disks : ndarray, shape (n, >= 3)
        x, y, radius (px).
    blur_px : float
        Standard deviation of the blurred edge.
    candidates : ndarray, shape (m, 2), optional
        x, y of candidates that were rejected as superfluous: of a scratch they are pieces as well.

    Returns
    -------
    ndarray of bool, shape (n,)

    Examples
    --------
    >>> y, x = np.mgrid[0:40, 0:80]
    >>> line = (50 * np.exp(-((y - 20.0) ** 2) / 4)).astype(np.float32)
    >>> pieces = np.array([[10.0 + 6 * k, 20.0, 1.5] for k in range(8)])
    >>> find_scratches(line, pieces, blur_px=1.4).all()
    np.True_
    """
    pieces = disks[:, :3]
    if candidates is not None:
        pieces = np.vstack([pieces, np.column_stack([candidates, np.full(len(candidates), blur_px)])])
    out = np.zeros(len(pieces), np.bool_)
    chains = find_chains(image, pieces, blur_px=blur_px)
    wide = disks[disks[:, 2] >= LARGEST_BLUR_WIDTHS * blur_px, :3] if chains else disks[:0, :3]
    for chain in chains:
        out[chain] = _is_line(image, pieces[chain], wide, blur_px)
    return out[: len(disks)]


def find_chains(image: NDArray[np.float32], disks: NDArray, *, blur_px: float) -> list[NDArray[np.intp]]:
    """Chains of small disks between which the image hardly falls: the rows of each.

    The parameters are those of `find_scratches`.
    """
    small = np.flatnonzero(disks[:, 2] < LARGEST_BLUR_WIDTHS * blur_px)
    if len(small) < FEWEST_PIECES:
        return []
    places = np.ascontiguousarray(disks[small, :3], float)
    pairs = find_pairs(places, 0.5 * LARGEST_GAP_BLUR_WIDTHS * blur_px)
    one, two = places[pairs[:, 0], :2], places[pairs[:, 1], :2]
    along = [one, two, *(one + share * (two - one) for share in (0.4, 0.5, 0.6))]
    levels = _brightness(image, np.vstack(along)).reshape(len(along), -1)
    height, between = levels[:2].min(axis=0), levels[2:].min(axis=0)
    pairs = pairs[(between > BRIDGE_FRACTION * height) & (height > 0)]
    if len(pairs) < FEWEST_PIECES - 1:  # fewer bonds hold no such chain together
        return []
    n = len(small)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    count, labels = connected_components(graph, directed=False)
    sizes = np.bincount(labels, minlength=count)
    chains = [small[labels == label] for label in np.flatnonzero(sizes >= FEWEST_PIECES)]
    length = [float(np.hypot(*np.ptp(disks[chain, :2], axis=0))) for chain in chains]
    width = [2.0 * float(disks[chain, 2].mean()) for chain in chains]
    return [chain for chain, a, b in zip(chains, length, width, strict=True) if a > FEWEST_DIAMETERS * b]


def _is_line(image: NDArray[np.float32], pieces: NDArray, wide: NDArray, blur_px: float) -> bool:
    """Whether the pixels above half the brightness of a chain of disks are a line that does not close.

    Wide disks, which a scratch may cross, are left out.
    """
    reach = float(pieces[:, 2].max()) + LARGEST_GAP_BLUR_WIDTHS * blur_px
    low = np.maximum(np.floor(pieces[:, :2].min(axis=0) - reach).astype(int), 0)
    high = np.ceil(pieces[:, :2].max(axis=0) + reach).astype(int) + 1
    part = image[low[1] : high[1], low[0] : high[0]]
    above = np.pad(part > 0.5 * np.median(_brightness(image, pieces[:, :2])), 1).astype(np.uint8)
    outside = np.maximum(low - 1 - wide[:, :2], wide[:, :2] - high - 1).max(axis=1)
    for x, y, radius in wide[outside < wide[:, 2] + blur_px + 1]:
        place = (round(x - low[0]) + 1, round(y - low[1]) + 1)
        cv2.circle(above, place, math.ceil(radius + blur_px), 0, thickness=-1)
    labels = cv2.connectedComponents(above, connectivity=8)[1]
    rows, columns = np.rint(pieces[:, 1::-1] - low[::-1] + 1).astype(int).T
    found = np.bincount(
        labels[np.clip(rows, 0, labels.shape[0] - 1), np.clip(columns, 0, labels.shape[1] - 1)], minlength=2
    )
    if not found[1:].any():
        return False  # pieces on the rims of wide disks
    chain = (labels == 1 + int(np.argmax(found[1:]))).astype(np.uint8)
    half_width = float(cv2.distanceTransform(chain, cv2.DIST_L2, cv2.DIST_MASK_5).max())
    slender = np.count_nonzero(chain) > LEAST_SLENDERNESS * (2.0 * half_width) ** 2
    return bool(
        slender and max(hole_areas(chain), default=0.0) <= np.pi * (LEAST_HOLE_BLUR_WIDTHS * blur_px) ** 2
    )


def _brightness(image: NDArray[np.float32], places: NDArray) -> NDArray[np.float64]:
    """Mean of the image over the four pixels around each place."""
    rows, columns = image.shape
    x, y = np.floor(places[:, 0]).astype(int), np.floor(places[:, 1]).astype(int)
    total = np.zeros(len(places))
    for dy in (0, 1):
        for dx in (0, 1):
            total += image[np.clip(y + dy, 0, rows - 1), np.clip(x + dx, 0, columns - 1)]
    return 0.25 * total
