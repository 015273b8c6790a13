"""Measure a contact of any shape: area by light, second moments, outline, holes.

Any symmetric blur moves light without creating any: the light of a contact over its contrast is its area. The
blur adds its variance to the second moments. The outline is the level line at half height, between pixels.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from skimage.measure import find_contours

REGION_BLUR_WIDTHS = 4.0
"""Distance from the outline at which the region of a contact ends. Theory: 3e-5 of an edge is left there."""
MOMENT_BLUR_WIDTHS = 2.5
"""The same for second moments, in which distant noise weighs much. Theory: 0.6 % of an edge is left."""
CORE_BLUR_WIDTHS = 3.0
"""Distance inside the outline from which on the plateau shows. Theory: 0.13 % of an edge is missing there."""
FEWEST_CORE_PIXELS = 20
"""Pixels that give a plateau. Chosen: to a fifth of the noise."""
CORE_OUTLIER_SIGMA = 4.0
"""Robust standard deviations beyond which a pixel of the core is dirt. False-alarm rate: 6e-5."""
LEAST_HOLE_BLUR_WIDTHS = 0.7
"""Radius of the smallest hole that counts. Chosen: smaller ones are noise or dirt."""


@dataclass(frozen=True, eq=False)
class FreeShape:
    """A contact of any shape, in pixels of the window.

    Parameters
    ----------
    x, y : float, px
        Centroid.
    area : float, px^2
    semi_major, semi_minor : float, px
        Half-axes of the ellipse with the same second moments.
    angle : float, rad
        Of its major axis, from +x towards +y.
    perimeter : float, px
        Length of the outline, holes included.
    holes : int
    outlines : list of ndarray, shape (k, 2)
        Closed polygons (x, y); the first is the outer one.
    pixels : int
        Of the region whose light was summed.
    """

    x: float
    y: float
    area: float
    semi_major: float
    semi_minor: float
    angle: float
    perimeter: float
    holes: int
    outlines: list[NDArray[np.float64]]
    pixels: int


@dataclass(frozen=True)
class Plateau:
    """Level of a contact well inside its outline.

    Parameters
    ----------
    level : float, grey levels
        NaN for a contact too narrow to show it.
    pixels : int
    """

    level: float
    pixels: int


def find_component(
    image: NDArray[np.float32], level: float, seeds: NDArray[np.bool_], *, smoothing: float = 0.0
) -> NDArray[np.bool_]:
    """The pixels above a level that are connected with the seeds.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
    level : float
    seeds : ndarray of bool
    smoothing : float, px
        Width of a Gaussian that removes notches due to noise; 0 for none.
    """
    smooth = cv2.GaussianBlur(image, (0, 0), smoothing) if smoothing else image
    above = (smooth > level).astype(np.uint8)
    _, labels = cv2.connectedComponents(above, connectivity=8)
    wanted = np.unique(labels[seeds & (above > 0)])
    return np.asarray(np.isin(labels, wanted[wanted > 0]))


def measure_plateau(image: NDArray[np.float32], component: NDArray[np.bool_], *, blur: float) -> Plateau:
    """Mean level of the pixels well inside a component, without dirt."""
    depth = cv2.distanceTransform(np.pad(component, 1).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    values = image[depth[1:-1, 1:-1] > CORE_BLUR_WIDTHS * blur]
    if len(values) < FEWEST_CORE_PIXELS:
        return Plateau(np.nan, 0)
    away = np.abs(values - np.median(values))
    kept = values[away <= CORE_OUTLIER_SIGMA * 1.4826 * np.median(away) + 1e-9]
    return Plateau(float(kept.mean()), len(kept))


def measure_free_shape(
    image: NDArray[np.float32],
    component: NDArray[np.bool_],
    *,
    contrast: float,
    blur: float,
    valid: NDArray[np.uint8] | None = None,
) -> FreeShape:
    """Measure a contact from its light.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        With the background and all other contacts subtracted.
    component : ndarray of bool
        Its pixels above half height.
    contrast : float, grey levels
        Level of the whole contact.
    blur : float, px
        Standard deviation of the blurred edge, pixel included.
    valid : ndarray of uint8 or None
        0 for pixels that are not its own.

    Returns
    -------
    FreeShape

    Examples
    --------
    A ring of radii 8 and 4 px, area pi (64 - 16) = 150.8 px^2:

    >>> y, x = np.mgrid[0:40, 0:40]
    >>> r = np.hypot(x - 20, y - 20)
    >>> sharp = 100.0 * (np.clip(8.5 - r, 0, 1) - np.clip(4.5 - r, 0, 1)).astype(np.float32)
    >>> image = cv2.GaussianBlur(sharp, (0, 0), 1.0)
    >>> ring = measure_free_shape(image, image > 50, contrast=100.0, blur=1.0)
    >>> round(ring.area, 1), ring.holes
    (150.3, 1)
    """
    outside = cv2.distanceTransform((~component).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    usable = np.ones(image.shape, np.bool_) if valid is None else valid > 0
    region = (outside <= REGION_BLUR_WIDTHS * blur) & usable
    area = float(image[region].sum()) / contrast
    x, y, major, minor, angle = _moments(
        np.where((outside <= MOMENT_BLUR_WIDTHS * blur) & usable, image, np.float32(0.0)), blur
    )
    outlines = _outlines(image, outside, 0.5 * contrast, blur)
    return FreeShape(
        x, y, area, major, minor, angle,
        perimeter=float(sum(np.hypot(*np.diff(line, axis=0).T).sum() for line in outlines)),
        holes=max(len([line for line in outlines if enclosed_area(line) < 0]), 0),
        outlines=outlines,
        pixels=int(np.count_nonzero(region)),
    )  # fmt: skip


def _moments(light: NDArray, blur: float) -> tuple[float, float, float, float, float]:
    """Centroid, half-axes and angle of the ellipse with the second moments of the light before the blur."""
    rows, columns = light.shape
    total, x, y = float(light.sum()), np.arange(columns), np.arange(rows)
    across, down = light.sum(axis=0) / total, light.sum(axis=1) / total
    cx, cy = float(across @ x), float(down @ y)
    xx, yy = float(across @ (x - cx) ** 2) - blur**2, float(down @ (y - cy) ** 2) - blur**2
    xy = float((y - cy) @ light @ (x - cx)) / total
    major, minor, angle = ellipse_of_moments(xx, xy, yy)
    return cx, cy, float(major), float(minor), float(angle)


def ellipse_of_moments(xx: ArrayLike, xy: ArrayLike, yy: ArrayLike) -> tuple[NDArray, NDArray, NDArray]:
    """Major and minor half-axis and angle of ellipses with given second moments: ``a^2/4`` along an axis.

    Examples
    --------
    >>> [float(value) for value in ellipse_of_moments(4.0, 0.0, 1.0)]
    [4.0, 2.0, 0.0]
    """
    xx, xy, yy = (np.asarray(part, float) for part in (xx, xy, yy))
    middle, half = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    major, minor = (2.0 * np.sqrt(np.maximum(middle + sign * half, 0.0)) for sign in (1.0, -1.0))
    return major, minor, 0.5 * np.arctan2(2.0 * xy, xx - yy)


def _outlines(
    image: NDArray[np.float32], outside: NDArray, level: float, blur: float
) -> list[NDArray[np.float64]]:
    """Closed level lines (x, y) about a component, the largest first; those of noise are left out."""
    near = np.where(outside <= 1.5, image, np.minimum(image, np.float32(0.999 * level)))
    lines = [line[:, ::-1] for line in find_contours(np.pad(near, 1), level)]
    lines = [line - 1.0 for line in lines if len(line) > 3 and (line[0] == line[-1]).all()]
    least = np.pi * (LEAST_HOLE_BLUR_WIDTHS * blur) ** 2
    lines = [line for line in lines if abs(enclosed_area(line)) > least]
    return sorted(lines, key=lambda line: -enclosed_area(line))


def enclosed_area(line: NDArray[np.float64]) -> float:
    """Area in a closed polygon (x, y), positive for the outline of something bright, negative for a hole.

    Examples
    --------
    >>> enclosed_area(np.array([[0, 0], [0, 2], [2, 2], [2, 0], [0, 0]]))
    -4.0
    """
    x, y = line.T
    return float(0.5 * np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])) * OUTLINE_SENSE


OUTLINE_SENSE = 1.0
"""`skimage.measure.find_contours` keeps what is bright on its left."""
