"""Find the circle of a wide contact roughly, and average the image along its edge.

The rough circle follows the outline at half contrast. The image is averaged over narrow sectors and rings
around it, to which `contactimg.imaging.smooth.fit_circle` fits the light across the edge.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from contactimg.errors import FrameError
from contactimg.imaging.detect.rim_blur import DEFAULT_BLUR_PX
from contactimg.imaging.pixels.masks import Flags
from contactimg.imaging.pixels.robust import MAD_TO_STD

Values = NDArray[np.float64]

SMALLEST_RADIUS_PX = 8.0
"""Radius below which a contact is too small to be the contact of a smooth sphere. Chosen by hand."""
SHORTEST_ARC = 0.25
"""Least fraction of the circumference that must be visible. Chosen by hand."""
SECTORS, RING_PX = 72, 0.5
"""Number of sectors (5 degrees each) and width of the rings that the image is averaged over. By hand."""


@dataclass(frozen=True)
class Circle:
    """A wide contact's circle.

    Parameters
    ----------
    x_px, y_px, radius_px : float
    radius_std_px, centre_std_px : float
        Standard uncertainties from the scatter of the sectors; NaN for a rough circle.
    contrast, background : float
        Grey levels.
    blur_px : float
        Standard deviation of the optical blur, without the pixel.
    arc : float
        Fraction of the circumference that was used.
    misfit : float
        Root mean square of the residuals in units of the noise.
    ellipse_px : (float, float)
        How far the outline exceeds the circle along x and along the diagonal between x and y (and falls short
        of it at right angles): components of the second harmonic. NaN for a rough circle.
    ellipse_std_px : float
        Standard uncertainty of each; infinite where too little of the outline is visible.
    """

    x_px: float
    y_px: float
    radius_px: float
    radius_std_px: float = np.nan
    centre_std_px: float = np.nan
    contrast: float = np.nan
    background: float = 0.0
    blur_px: float = np.nan
    arc: float = np.nan
    misfit: float = np.nan
    ellipse_px: tuple[float, float] = (np.nan, np.nan)
    ellipse_std_px: float = np.inf


@dataclass(frozen=True, eq=False)
class EdgeSamples:
    """Means of an image over sectors and rings around a rough circle, see `sample_edge`.

    Parameters
    ----------
    circle : Circle
        The rough one; its radius is that of the outline at half contrast, film included.
    azimuth, distance, value, weight : ndarray, shape (n,)
        Of each sample: direction from the centre of the rough circle (rad), distance from it (px), mean grey
        level, and inverse standard deviation.
    sector : ndarray of int, shape (n,)
        Number of its sector.
    """

    circle: Circle
    azimuth: Values
    distance: Values
    value: Values
    weight: Values
    sector: NDArray[np.intp]

    @cached_property
    def waves(self) -> Values:
        """Change of the place of the edge, shape (5, n), with x, y, radius and the two axes of an ellipse."""
        once, twice = np.exp(1j * self.azimuth), np.exp(2j * self.azimuth)
        return np.stack([once.real, once.imag, np.ones(len(once)), twice.real, twice.imag])


def find_circle(image: NDArray[np.float32], plateau: float, *, valid: Flags | None = None) -> Circle:
    """Rough circle of the widest contact of an image.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Difference image, the contact positive.
    plateau : float
        Grey level of the contact.
    valid : ndarray of bool, shape (rows, columns), optional
        False where the image has a hole: the outline of that is none of the contact.

    Returns
    -------
    Circle
        Good to about a pixel.

    Raises
    ------
    FrameError
        If nothing stands out, the widest contact is too small or too little of it is seen, or its outline
        is no circle.

    Examples
    --------
    >>> y, x = np.mgrid[0:90, 0:120]
    >>> image = 50 * (np.hypot(x - 60, y - 42) < 30).astype(np.float32)
    >>> found = find_circle(image, 50.0)
    >>> round(found.x_px), round(found.y_px), bool(abs(found.radius_px - 30) < 1)
    (60, 42, True)
    """
    # closes holes and specks; an outline within two blurs of what is not seen is none of the contact. By hand
    smooth = cv2.GaussianBlur(image, (0, 0), DEFAULT_BLUR_PX, borderType=cv2.BORDER_REPLICATE)
    mask = (smooth > 0.5 * plateau).astype(np.uint8)
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not (plateau > 0 and outlines):
        raise FrameError("nothing stands out of the noise")
    outline = max(outlines, key=cv2.contourArea)[:, 0, :]
    seen = np.ones(image.shape, np.uint8) if valid is None else valid.astype(np.uint8)
    around = np.ones((2 * int(2.0 * DEFAULT_BLUR_PX) + 1,) * 2, np.uint8)
    seen = np.asarray(cv2.erode(seen, around, borderType=cv2.BORDER_CONSTANT, borderValue=0), np.uint8)
    outline = outline[seen[outline[:, 1], outline[:, 0]] > 0].astype(float)
    if len(outline) < 2 * np.pi * SMALLEST_RADIUS_PX * SHORTEST_ARC:
        raise FrameError(f"the contact's edge is not in the field: {len(outline)} px of it are seen")
    x, y, radius = _circle_through(outline)
    distance = np.hypot(outline[:, 0] - x, outline[:, 1] - y)
    scatter = MAD_TO_STD * float(np.median(np.abs(distance - np.median(distance))))
    visible = len(np.unique(_sectors(np.arctan2(outline[:, 1] - y, outline[:, 0] - x)))) / SECTORS
    if radius < SMALLEST_RADIUS_PX or not radius < 10 * max(image.shape):
        raise FrameError(f"the widest contact has a radius of {radius:.3g} px: no wide smooth contact")
    if visible < SHORTEST_ARC:
        raise FrameError(f"only {visible:.0%} of the contact's edge are seen; {SHORTEST_ARC:.0%} are needed")
    if scatter > 0.05 * radius:  # by hand
        raise FrameError(f"the outline is no circle: its radius scatters by {scatter / radius:.0%}")
    return Circle(x, y, radius, arc=visible)


def _circle_through(points: Values) -> tuple[float, float, float]:
    """Circle (x, y, radius) through points in least squares with Cauchy weights, robust against outliers."""
    middle = points.mean(axis=0)
    shifted = points - middle
    design = np.column_stack([2 * shifted, np.ones(len(points))])
    x, y, c = np.linalg.lstsq(design, (shifted**2).sum(axis=1), rcond=None)[0]
    start = [x, y, np.sqrt(max(c + x**2 + y**2, 1.0))]

    def residuals(p: Values) -> Values:
        return np.hypot(shifted[:, 0] - p[0], shifted[:, 1] - p[1]) - p[2]

    fit = optimize.least_squares(residuals, start, loss="cauchy", f_scale=1.0)
    return float(fit.x[0] + middle[0]), float(fit.x[1] + middle[1]), float(abs(fit.x[2]))


def _sectors(azimuth: Values) -> NDArray[np.intp]:
    """Number of the sector of each direction."""
    return np.minimum(((azimuth / (2 * np.pi) + 0.5) * SECTORS).astype(np.intp), SECTORS - 1)


def sample_edge(
    image: NDArray[np.float32],
    circle: Circle,
    *,
    outside_px: float,
    noise: float,
    valid: NDArray[np.bool_] | None = None,
) -> EdgeSamples:
    """Average an image over sectors and rings around a rough circle.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Difference image, the contact positive.
    circle : Circle
    outside_px : float
        How far outside the edge the samples reach.
    noise : float
        Standard deviation of a pixel, grey levels.
    valid : ndarray of bool, shape (rows, columns), optional
        False where the image has a hole.

    Returns
    -------
    EdgeSamples
        Without the sectors whose edge is not in the image.
    """
    inside_px = min(outside_px, 0.8 * circle.radius_px)
    low, high = circle.radius_px - inside_px, circle.radius_px + outside_px
    top, left = (max(int(centre - high), 0) for centre in (circle.y_px, circle.x_px))
    part = image[top : int(circle.y_px + high) + 2, left : int(circle.x_px + high) + 2]
    x = left + np.arange(part.shape[1]) - circle.x_px
    y = (top + np.arange(part.shape[0]) - circle.y_px)[:, None]
    distance = np.hypot(x, y)
    used = (distance > low) & (distance < high)
    if valid is not None:
        used &= valid[top : top + part.shape[0], left : left + part.shape[1]]
    r, azimuth = distance[used], np.arctan2(*np.broadcast_arrays(y, x))[used]
    rings = int(np.ceil((high - low) / RING_PX))
    sector = _sectors(azimuth)
    cell = sector * rings + np.minimum(((r - low) / RING_PX).astype(np.intp), rings - 1)
    count = np.bincount(cell, minlength=SECTORS * rings)
    near_edge = np.abs(low + (np.arange(rings) + 0.5) * RING_PX - circle.radius_px) < min(4.0, inside_px)
    whole = (count.reshape(SECTORS, rings)[:, near_edge] > 0).mean(axis=1) > 0.75
    kept = np.flatnonzero((count > 0) & np.repeat(whole, rings))
    sums = (np.bincount(cell, weights, SECTORS * rings)[kept] for weights in (r, part[used]))
    distance, value = (total / count[kept] for total in sums)
    middle = (kept // rings + 0.5) / SECTORS * 2 * np.pi - np.pi
    weight = np.sqrt(count[kept]) / max(noise, 1e-3 * float(np.ptp(value)) if len(value) else 1.0, 1e-9)
    return EdgeSamples(circle, middle, distance, value, weight, kept // rings)
