"""What all contacts of a frame have in common belongs to the camera, not to the contacts.

Two things: an elongation with the same ratio and angle everywhere (pixels that are not square, an oblique
view), and a misfit of the edge that looks the same about every contact (coma, astigmatism, interlaced lines).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from contactimg.imaging.fit.ellipse import E1, E2, RADIUS, FittedEllipse, X, Y

FEWEST_CONTACTS = 10
"""Contacts that show what a frame has in common. Chosen: its median is then known to 0.4 of the scatter."""
LEAST_COMMON_SHARE = 0.75
"""Share of the contacts that must agree with a common elongation. Chosen."""
AGREEMENT_SIGMA = 3.0
"""Deviation up to which a contact agrees. False-alarm rate: 1e-2 for two normal components."""
AGREEMENT_FRACTION = 0.1
"""The same, in units of the common ellipticity: a camera distorts a little unevenly. Chosen."""
RADIAL_BINS, ANGULAR_BINS = 8, 12
"""Cells about a rim: 0.9 blur widths by 30 degrees. Chosen: finer than any low-order aberration."""
BAND_BLUR_WIDTHS = 3.6
"""Half the width of the band they cover. Theory: 2e-4 of an edge is left there."""
OWN_MISFIT_FRACTION = 0.35
"""Share of its misfit that the common one must leave for a contact to have its own. Chosen, as for covers."""

NEIGHBOURS = 24
"""Nearest contacts that show what a place of the field has in common. Chosen: their median is known to a
quarter of their scatter."""


@dataclass(frozen=True)
class Distortion:
    """A common elongation.

    Parameters
    ----------
    e1, e2 : float
        Its ellipticity.
    agreeing : ndarray of bool
        Which of the ellipses have it.
    """

    e1: float
    e2: float
    agreeing: NDArray[np.bool_]

    @property
    def ratio(self) -> float:
        """Of the half-axes."""
        return float(np.exp(2.0 * np.hypot(self.e1, self.e2)))

    @property
    def angle(self) -> float:
        """Of the longer one, from +x towards +y, rad."""
        return float(0.5 * np.arctan2(self.e2, self.e1))


def find_distortion(ellipses: Sequence[FittedEllipse], radii: NDArray[np.float64]) -> Distortion | None:
    """The elongation that the contacts of a frame share; None if they do not.

    Parameters
    ----------
    ellipses : sequence of FittedEllipse
        Those whose ellipticity is significant.
    radii : ndarray, px
        Of all contacts of the frame.

    Notes
    -----
    Contacts under shear are elongated in the same direction as well, but in different ratios: most ellipses
    must agree within their errors, and they must be most of the contacts that are large enough to show it.
    """
    if len(ellipses) < FEWEST_CONTACTS:
        return None
    e = np.array([ellipse.parameters[[E1, E2]] for ellipse in ellipses])
    variance = np.array([np.trace(part.total_covariance[E1 : E2 + 1, E1 : E2 + 1]) / 2 for part in ellipses])
    middle = np.median(e, axis=0)
    tolerance = np.hypot(AGREEMENT_SIGMA * np.sqrt(variance), AGREEMENT_FRACTION * np.hypot(*middle))
    agreeing = np.hypot(*(e - middle).T) < tolerance
    own = np.array([ellipse.parameters[RADIUS] for ellipse in ellipses])
    large = np.count_nonzero(radii >= np.median(own))
    if np.count_nonzero(agreeing) < LEAST_COMMON_SHARE * len(e) or len(e) < LEAST_COMMON_SHARE * large:
        return None
    mean = np.average(e[agreeing], axis=0, weights=1.0 / variance[agreeing])
    return Distortion(float(mean[0]), float(mean[1]), np.asarray(agreeing))


def edge_cells(
    residual: NDArray[np.float64], ellipse: FittedEllipse, blur: float, corner: tuple[int, int]
) -> NDArray[np.float64]:
    """Mean of a residual in cells about the rim, over radius and angle.

    Parameters
    ----------
    residual : ndarray, shape (rows, columns)
        NaN where a pixel does not count.
    ellipse : FittedEllipse
    blur : float, px
    corner : (int, int)
        Column and row of the first pixel.

    Returns
    -------
    ndarray, shape (2, RADIAL_BINS * ANGULAR_BINS)
        Means, and numbers of pixels.
    """
    rows, columns = residual.shape
    x = np.arange(columns) + corner[0] - ellipse.parameters[X]
    y = (np.arange(rows) + corner[1] - ellipse.parameters[Y])[:, None]
    major, minor = ellipse.half_axes
    cosine, sine = np.cos(ellipse.angle), np.sin(ellipse.angle)
    q = np.hypot((cosine * x + sine * y) / major, (cosine * y - sine * x) / minor)
    u = (q - 1.0) * np.hypot(x, y) / np.maximum(q, 1e-9) / blur
    used = (np.abs(u) < BAND_BLUR_WIDTHS) & np.isfinite(residual)
    ring = ((u[used] / BAND_BLUR_WIDTHS + 1.0) / 2.0 * RADIAL_BINS).astype(int)
    turn = np.broadcast_to(np.arctan2(y, x), residual.shape)[used]
    sector = ((turn / (2.0 * np.pi) + 0.5) * ANGULAR_BINS).astype(int) % ANGULAR_BINS
    cell, size = ring * ANGULAR_BINS + sector, RADIAL_BINS * ANGULAR_BINS
    count = np.bincount(cell, minlength=size).astype(float)
    total = np.bincount(cell, weights=residual[used], minlength=size)
    return np.stack([total / np.maximum(count, 1.0), count])


def has_own_misfit(cells: Sequence[NDArray[np.float64]], places: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which contacts misfit in a way that is common neither to all nor to those around them.

    Parameters
    ----------
    cells : sequence of ndarray, shape (2, k)
        Residuals over the contrast about each contact (`edge_cells`).
    places : ndarray, shape (n, 2), px
        Their centres: aberrations of a lens vary over the field.

    Returns
    -------
    ndarray of bool
        True for all if they are few.
    """
    if len(cells) < FEWEST_CONTACTS:
        return np.ones(len(cells), np.bool_)
    means, counts = np.array([part[0] for part in cells]), np.array([part[1] for part in cells])
    seen = np.where(counts > 0, means, np.nan)
    known = np.isfinite(seen).sum(axis=0) >= FEWEST_CONTACTS
    common = np.where(known, np.nanmedian(np.where(known, seen, 0.0), axis=0), 0.0)
    before, after = (np.sum(counts * part**2, axis=1) for part in (means, means - common))
    own = np.asarray(after > OWN_MISFIT_FRACTION * before)
    if len(cells) > NEIGHBOURS and own.any():
        around = np.asarray(cKDTree(places).query(places[own], k=NEIGHBOURS + 1)[1])
        rest = means[own] - np.median(means[around[:, 1:]], axis=1)
        own[own] = np.sum(counts[own] * rest**2, axis=1) > OWN_MISFIT_FRACTION * before[own]
    return own
