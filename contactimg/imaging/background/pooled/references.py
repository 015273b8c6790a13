"""The mean of several references."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.pooled.agreement import compare_views
from contactimg.imaging.background.pooled.sums import PooledBackground
from contactimg.imaging.background.pooled.views import View, place_frame, view_background

OUTLIER_FRACTION = 0.003
"""Fraction of its squares in which a reference may differ from the others. Chosen: three times what dust and
chance make; a contact of 30 px on a megapixel makes as many."""


@dataclass(frozen=True, eq=False)
class AveragedReference:
    """The mean of several references.

    Parameters
    ----------
    image : ndarray of float32, shape (rows, columns)
        In the coordinates and in the light of the first.
    left_out : tuple of int
        Numbers of the references that differ from the others as a whole or in many places.
    """

    image: NDArray[np.float32]
    left_out: tuple[int, ...]


def average_references(images: Sequence[NDArray]) -> AveragedReference:
    """Register references on the first of them and average them, without those that differ from the others.

    Parameters
    ----------
    images : sequence of ndarray, shape (rows, columns)
        At least two, of equal shape; grey levels, non-finite pixels are holes.
    """
    first = images[0]
    views, numbers = [View.plain(first)], [0]
    for number, image in enumerate(images[1:], start=1):
        placement = place_frame(image, first, background_is="most_common")
        if placement is None and np.array_equal(image, first):
            continue  # a copy
        if placement is not None and placement.found:
            views.append(view_background(image, placement, np.empty((0, 3))))
            numbers.append(number)
    agreement = compare_views(np.stack([view.squares() for view in views]), sign=1)
    differs = (~agreement.used & np.isfinite(agreement.deviation)).mean(axis=(1, 2)) > OUTLIER_FRACTION
    good = [k for k in range(len(views)) if not differs[k] or not (~differs).any()]
    pooled = PooledBackground.empty((first.shape[0], first.shape[1]))
    for k in good:
        pooled = pooled.plus(views[k].restricted(agreement.used[k], agreement.light[k]))
    used = {numbers[k] for k in good}
    left_out = [k for k in range(len(images)) if k not in used and not np.array_equal(images[k], first)]
    return AveragedReference(pooled.mean(), tuple(left_out))
