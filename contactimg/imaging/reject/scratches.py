"""Scratches: a faint line that both methods take for a chain of small contacts.

Between the centres of two contacts the image falls to the background, or to a neck where they touch. Along a
scratch it does not.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from contactimg.imaging.kernels.pairs import find_pairs

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


def find_scratches(image: NDArray[np.float32], disks: NDArray, *, blur_px: float) -> NDArray[np.bool_]:
    """Which disks are pieces of a scratch.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Difference image, contacts positive.
    disks : ndarray, shape (n, >= 3)
        x, y, radius (px).
    blur_px : float
        Standard deviation of the blurred edge.

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
    out = np.zeros(len(disks), np.bool_)
    small = np.flatnonzero(disks[:, 2] < LARGEST_BLUR_WIDTHS * blur_px)
    if len(small) < FEWEST_PIECES:
        return out
    places = np.ascontiguousarray(disks[small, :3], float)
    pairs = find_pairs(places, 0.5 * LARGEST_GAP_BLUR_WIDTHS * blur_px)
    one, two = places[pairs[:, 0], :2], places[pairs[:, 1], :2]
    height = np.minimum(_brightness(image, one), _brightness(image, two))
    between = np.min([_brightness(image, one + share * (two - one)) for share in (0.4, 0.5, 0.6)], axis=0)
    pairs = pairs[(between > BRIDGE_FRACTION * height) & (height > 0)]
    n = len(small)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    count, labels = connected_components(graph, directed=False)
    sizes = np.bincount(labels, minlength=count)
    for label in np.flatnonzero(sizes >= FEWEST_PIECES):
        members = places[labels == label]
        length = float(np.hypot(*np.ptp(members[:, :2], axis=0)))
        if length > FEWEST_DIAMETERS * 2.0 * float(members[:, 2].mean()):
            out[small[labels == label]] = True
    return out


def _brightness(image: NDArray[np.float32], places: NDArray) -> NDArray[np.float64]:
    """Mean of the image over the four pixels around each place."""
    rows, columns = image.shape
    x, y = np.floor(places[:, 0]).astype(int), np.floor(places[:, 1]).astype(int)
    total = np.zeros(len(places))
    for dy in (0, 1):
        for dx in (0, 1):
            total += image[np.clip(y + dy, 0, rows - 1), np.clip(x + dx, 0, columns - 1)]
    return 0.25 * total
