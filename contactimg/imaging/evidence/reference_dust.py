"""Dust of the reference: where it darkened the reference and has gone, the difference shows a contact."""

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.fit.contact_pixels import measure_rise
from contactimg.imaging.foreground import Foreground
from contactimg.imaging.pixels.masks import nearest_pixels
from contactimg.imaging.pixels.robust import AGREEMENT_SIGMA
from contactimg.imaging.profile.limits import CLEAR_BLUR_WIDTHS

CROSS = (0, 1, -1, 0, 0), (0, 0, 0, 1, -1)
"""Columns and rows of the pixels about a place that are read."""


def find_dust(foreground: Foreground, places: NDArray[np.float64], blur: float) -> NDArray[np.bool_]:
    """Places (x, y, radius, px) that the reference makes by a dip more than the frame by its own rise."""
    pair, dust = foreground.frame_pair, np.zeros(len(places), np.bool_)
    if pair.reference is None or not len(places) or not foreground.dust:
        return dust
    # most contacts lie where the reference shows nothing: a few pixels of it tell
    dip = -foreground.sign * _rise_of_pixels(pair.reference, places, places[:, 2] + CLEAR_BLUR_WIDTHS * blur)
    rows = np.flatnonzero(dip > AGREEMENT_SIGMA * foreground.noise)
    if len(rows):
        own, other = (
            foreground.sign * measure_rise(np.ascontiguousarray(image), places[rows], blur)
            for image in (pair.frame, pair.reference)
        )
        dust[rows] = (own > other) & (own < -other)
    return dust


def _rise_of_pixels(image: NDArray, places: NDArray, distance: NDArray) -> NDArray[np.float64]:
    """Mean of five pixels at each place minus the median of eight around it."""
    (x, y), turns = places[:, :2, None].swapaxes(0, 1), np.arange(8) * np.pi / 4
    near = image[nearest_pixels(x + np.array(CROSS[0]), y + np.array(CROSS[1]), image.shape)]
    x, y = x + distance[:, None] * np.cos(turns), y + distance[:, None] * np.sin(turns)
    around = np.sort(image[nearest_pixels(x, y, image.shape)])
    return np.asarray(near.mean(axis=1, dtype=float) - around[:, 3:5].mean(axis=1, dtype=float))
