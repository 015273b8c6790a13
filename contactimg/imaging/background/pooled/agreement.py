"""Where the views of a background agree: overlooked contacts, dirt and bad frames stand out."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.pooled.views import FEWEST_SEEN, SQUARE_PX, pixels_outside
from contactimg.imaging.pixels.blocks import block_means
from contactimg.imaging.pixels.robust import robust_std

DISAGREEMENT_SIGMA = 6.0
"""Robust standard deviations by which a square may differ from the second lowest of its values. Theory: of 24
normal deviates the second lowest lies 1.6 below the mean, so that 10^-5 of the squares are left out."""


LIGHT_PX = 64.0
"""Standard deviation of the Gaussian over which slow differences of the light are followed. Chosen: much
wider than a contact, narrower than the cubic that describes the light of a frame."""


WORST_SCATTER = 1.5
"""A frame whose squares scatter by so many times the median of the frames is left out. Chosen by hand: the
scatter of equal frames varies by a few per cent."""


FEWEST_SQUARES = 30
"""Squares that a scatter is measured on: to 13 % (theory: sqrt(1/2n))."""


FEWEST_WITNESSES = 3
"""Other views that must agree where one is said to differ."""


@dataclass(frozen=True, eq=False)
class Agreement:
    """The squares in which the views agree, and the slow differences of their light.

    Parameters
    ----------
    used : ndarray of bool, shape (views, square rows, square columns)
        Whether a view is used in a square.
    light : ndarray of float32, same shape
        By how much a view is brighter than the others, slowly varying; grey levels.
    deviation : ndarray of float32, same shape
        Of the squares of a view, its light corrected, from the median of the views; NaN where not seen.
    scatter : ndarray, shape (views,)
        Robust standard deviation of these.
    """

    used: NDArray[np.bool_]
    light: NDArray[np.float32]
    deviation: NDArray[np.float32]
    scatter: NDArray[np.float64]

    @property
    def left_out(self) -> NDArray[np.bool_]:
        """Views that do not agree with the others as a whole."""
        return np.asarray(~self.used.any(axis=(1, 2)))

    @property
    def pixel_noise(self) -> float:
        """Standard deviation of a pixel of a view, from the scatter of the squares."""
        return SQUARE_PX * float(np.median(self.scatter[np.isfinite(self.scatter)]))

    def scatter_inside(self, x: NDArray, y: NDArray, reach: NDArray, *, view: int) -> float:
        """Scatter of a view in the squares within ``reach`` of some points (px), over that in the others."""
        inside = pixels_outside(np.column_stack([x, y, reach]), self._pixels) == 0
        near = block_means(inside.astype(np.float32), side=SQUARE_PX) > FEWEST_SEEN
        here, there = self.deviation[view][near], self.deviation[view][~near]
        here, there = here[np.isfinite(here)], there[np.isfinite(there)]
        if len(here) < FEWEST_SQUARES or len(there) < FEWEST_SQUARES:
            return 0.0
        return robust_std(here, centre=0.0) / max(robust_std(there, centre=0.0), 1e-9)

    @property
    def _pixels(self) -> tuple[int, int]:
        """Shape of the image, filled up to whole squares."""
        return self.used.shape[1] * SQUARE_PX, self.used.shape[2] * SQUARE_PX

    def spots_of(self, view: int, *, sign: int) -> int:
        """Places of more than one square where a view is brighter (sign -1: darker) than all that agree."""
        others = np.delete(self.used, view, axis=0).sum(axis=0) >= FEWEST_WITNESSES
        differs = (~self.used[view] & others & (sign * self.deviation[view] > 0)).astype(np.uint8)
        areas = cv2.connectedComponentsWithStats(differs)[2][1:, cv2.CC_STAT_AREA]
        return int(np.count_nonzero(areas > 1))


def compare_views(squares: NDArray[np.float32], *, sign: int) -> Agreement:
    """Compare what the frames of a series show of the background.

    Parameters
    ----------
    squares : ndarray, shape (views, square rows, square columns)
        `View.squares` of each.
    sign : int
        1 if contacts are brighter than the background, else -1: where views differ, contacts that were
        overlooked show in the brighter (darker) ones.
    """
    missing = np.isnan(squares).all(axis=0)
    filled = np.where(missing, np.float32(0.0), squares)
    middle = np.nanmedian(filled, axis=0)
    light = np.stack([_slow(part - middle) for part in filled])
    flat = filled - light
    middle = np.nanmedian(flat, axis=0)
    deviation = flat - middle
    scatter = np.array([robust_std(part[np.isfinite(part)], centre=0.0) if np.isfinite(part).any() else np.inf
                        for part in deviation])  # fmt: skip
    usual = float(np.median(scatter[np.isfinite(scatter)])) if np.isfinite(scatter).any() else 0.0
    good = scatter <= WORST_SCATTER * usual
    low = _second_lowest(np.where(good[:, None, None], sign * flat, np.float32(np.nan)))
    used = ~(np.abs(sign * flat - low) > DISAGREEMENT_SIGMA * usual)
    return Agreement(used & good[:, None, None], light, deviation, scatter)


def _slow(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """The image, NaN where it is not known, blurred by `LIGHT_PX`; outliers count little."""
    known = np.isfinite(image)
    if not known.any():
        return np.zeros(image.shape, np.float32)
    limit = 4.0 * robust_std(image[known]) + 1e-6
    middle = np.float32(np.median(image[known]))
    values = np.where(known, np.clip(image, middle - limit, middle + limit), np.float32(0.0))
    width = LIGHT_PX / SQUARE_PX
    total, weight = (
        cv2.GaussianBlur(part.astype(np.float32), (0, 0), width, borderType=cv2.BORDER_REFLECT)
        for part in (values, known)
    )
    return np.where(weight > 1e-2, total / np.maximum(weight, np.float32(1e-2)), middle).astype(np.float32)


def _second_lowest(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Second lowest value along the first axis without NaN; the lowest where there are only two."""
    ordered = np.sort(values, axis=0)  # NaN last
    count = np.isfinite(values).sum(axis=0)
    if len(ordered) < 2:
        return np.asarray(ordered[0])
    return np.where(count >= 3, ordered[1], ordered[0])
