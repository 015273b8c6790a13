"""How large a contact may be where none is seen: the light at its place, forced."""

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special
from scipy.integrate import cumulative_trapezoid

from contactimg.imaging.profile.limits import CLEAR_BLUR_WIDTHS

Values = NDArray[np.float64]

APERTURE_BLURS, LEAST_APERTURE_PX = 1.6, 1.0
"""Radius of the aperture in blurs. Theory: 1.585 gives a point of light the best ratio to even noise."""

PIXELS_STD = 6**-0.5
"""Blur by the pixels of the camera and by those of the aperture, each 12**-0.5 px: it adds in squares."""

LARGEST_BLURS, TABLE_POINTS = 6.0, 241
"""Largest radius of the table of the light, in blurs, and its points; a larger contact fills the aperture."""


def limit_radii(
    image: NDArray,
    places: ArrayLike,
    *,
    contrast: float,
    blur_px: float,
    contacts: ArrayLike,
    valid: NDArray[np.uint8] | None = None,
    confidence: float = 0.95,
) -> Values:
    """Upper limits of the radii of contacts at given places.

    The light within an aperture of the blur's size, minus its median at places of background, plus the
    quantile of its spread there: whatever is left of noise, texture and alignment counts as it occurs. The
    limit is the radius of the blurred disk with this light at the frame's contrast; light below zero counts
    as zero.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Difference image, contacts positive.
    places : array_like, shape (n, 2), px
        x, y.
    contrast : float
        Of a contact, in the unit of the image, positive.
    blur_px : float
        Standard deviation of the blur.
    contacts : array_like, shape (m, 3), px
        x, y, radius of the measured contacts, whose surroundings are no background.
    valid : ndarray, optional
        0 where there is no image.
    confidence : float
        One-sided.

    Returns
    -------
    ndarray, shape (n,), px
        NaN at places whose aperture is not inside the image.

    Notes
    -----
    Light of a contact nearby, or of one that was rejected, makes the limit larger, not wrong. A contact that
    shows less than the frame's contrast may be larger; so may one with a dark air film around it.

    Examples
    --------
    >>> image = np.random.default_rng(1).normal(0, 1, (80, 90)).astype(np.float32)
    >>> bool(0.1 < limit_radii(image, [[40, 30]], contrast=100.0, blur_px=1.4, contacts=[])[0] < 0.3)
    True
    """
    image, places = np.asarray(image, np.float32), np.asarray(places, float).reshape(-1, 2)
    contacts = np.asarray(contacts, float).reshape(-1, 3)
    radius = max(APERTURE_BLURS * blur_px, LEAST_APERTURE_PX)
    half = int(np.ceil(radius + 0.5))
    inside: NDArray = np.ones(image.shape, np.uint8)
    if valid is not None:
        inside = (np.asarray(valid) > 0).astype(np.uint8)
    free = inside.copy()
    for x, y, size in contacts:
        cv2.circle(free, (round(x), round(y)), int(np.ceil(size + CLEAR_BLUR_WIDTHS * blur_px)), 0, -1)
    # apertures that overlap no contact, no hole and no border, and not each other
    kernel = np.ones((2 * half + 1,) * 2, np.uint8)
    free, inside = (
        cv2.erode(one, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0) for one in (free, inside)
    )
    centred = _aperture(0.0, 0.0, radius, half)
    sums = cv2.filter2D(image, cv2.CV_32F, centred, borderType=cv2.BORDER_REPLICATE)
    step = slice(half, None, 2 * half + 1)
    background = sums[step, step][free[step, step] > 0]
    limits = np.full(len(places), np.nan)
    if background.size < 30 or not contrast > 0:  # fewer tell the scatter of the light to 13 % at best
        return limits
    middle = float(np.median(background))
    spread = float(np.median(np.abs(background - middle))) / float(special.ndtri(0.75))
    least = float(special.ndtri(confidence)) * spread
    nearest = np.rint(places)
    shown = ((nearest >= 0) & (nearest < image.shape[::-1])).all(axis=1)
    sizes, light = _light_of_disks(radius, float(np.hypot(blur_px, PIXELS_STD)))
    for k in np.flatnonzero(shown):
        column, row = nearest[k].astype(int)
        if not inside[row, column]:
            continue
        window = image[row - half : row + half + 1, column - half : column + half + 1]
        weights = _aperture(places[k, 0] - column, places[k, 1] - row, radius, half)
        seen = float(np.sum(window * weights)) - middle * float(weights.sum() / centred.sum())
        limits[k] = np.interp((max(seen, 0.0) + least) / contrast, light, sizes, right=np.inf)
    return limits


def _aperture(x: float, y: float, radius: float, half: int) -> Values:
    """Share of each pixel that lies in a disk about (x, y), on a window of 2 half + 1 pixels about (0, 0)."""
    around = np.arange(-half, half + 1)
    return np.clip(radius + 0.5 - np.hypot(around[None, :] - x, around[:, None] - y), 0.0, 1.0)


def _light_of_disks(radius: float, blur: float) -> tuple[Values, Values]:
    """Radii of blurred disks, and the light (px^2 at contrast 1) that each sends into the aperture."""
    sizes = np.linspace(0.0, LARGEST_BLURS * blur + radius, TABLE_POINTS)
    # share of a point at distance r: Rice's distribution, a noncentral chi-square
    share = special.chndtr((radius / blur) ** 2, 2.0, (sizes / blur) ** 2)
    return sizes, cumulative_trapezoid(2 * np.pi * sizes * share, sizes, initial=0)
