"""The rims of the contacts in a pooled background: radii and background from all frames together.

A contact multiplies the background by its light, so a frame divided by the light of its contacts shows the
background under them as well, as far as their radii are known: an error of a radius leaves a ring. Rings and
background follow together from least squares over all frames. With the views ``b_k = s + T_k d_k`` of the
background ``s``, templates ``T_k`` of the rims and corrections ``d_k`` of the radii, ``s`` is the mean
of the ``n`` corrected views, and ``T_k' T_k d_k - sum over l of T_k' T_l d_l / n = T_k' (b_k - mean of b)``.
The inverse of that matrix says how much the unknown background adds to the variance of a radius.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse, special
from scipy.sparse.linalg import cg
from scipy.spatial import cKDTree

# Constants without a stated origin were chosen by hand on rendered frames; their sensitivity is not measured.
REACH = 3.5
"""Blur widths on either side of a rim in which its template is not 0 (theory: 2e-3 of its height there)."""

PRIOR_STDS = 2.0
"""Standard uncertainties of a radius within which the correction is expected."""

SOLVED = 1e-4  # relative residual at which the corrections are solved: far below their uncertainty
SAME_CONTACT_PX = 1.0  # contacts of two frames are the same if their centres differ by less, plus ...
SAME_CONTACT_RADII = 0.5  # ... this fraction of the larger radius


@dataclass(frozen=True, eq=False)
class Rims:
    """The contacts of a frame in the coordinates of the anchor.

    Parameters
    ----------
    x, y, radius, radius_std : ndarray, shape (n,), px
    contrast : float
        Light of a contact relative to the background, negative for dark ones.
    blur : float, px
        Standard deviation of the profile's Gaussian, pixel included.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    radius: NDArray[np.float64]
    radius_std: NDArray[np.float64]
    contrast: float
    blur: float

    def templates(self, brightness: NDArray[np.float32], used: NDArray[np.bool_]) -> sparse.csc_array:
        """Change of the view per pixel of radius, a column a contact.

        Parameters
        ----------
        brightness : ndarray, shape (rows, columns)
            Of the background, smooth, grey levels.
        used : ndarray of bool, same shape
            Where the view is used.
        """
        contact, px, py = self._pixels(used.shape)
        r = np.hypot(px - self.x[contact], py - self.y[contact])
        a, s = self.radius[contact], self.blur
        near = (np.abs(r - a) < REACH * s) & used[py, px]
        contact, px, py, r, a = contact[near], px[near], py[near], r[near], a[near]
        slope = a / s**2 * np.exp(-((r - a) ** 2) / (2 * s**2)) * special.i0e(r * a / s**2)
        covered = special.ndtr((a - r) / s)
        value = brightness[py, px] * self.contrast * slope / (1.0 + self.contrast * covered)
        shape = (used.size, len(self.x))
        return sparse.csc_array((value.astype(np.float32), (py * used.shape[1] + px, contact)), shape)

    def _pixels(
        self, shape: tuple[int, ...]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Pixels of the square around each contact, and the contact of each."""
        half = np.ceil(self.radius + REACH * self.blur).astype(np.int64)
        side = 2 * half + 1
        contact = np.repeat(np.arange(len(self.x)), side**2)
        number = np.arange(len(contact)) - np.repeat(np.cumsum(side**2) - side**2, side**2)
        px = np.rint(self.x).astype(np.int64)[contact] - half[contact] + number % side[contact]
        py = np.rint(self.y).astype(np.int64)[contact] - half[contact] + number // side[contact]
        inside = (px >= 0) & (py >= 0) & (px < shape[1]) & (py < shape[0])
        return contact[inside], px[inside], py[inside]


@dataclass(frozen=True, eq=False)
class RimSums:
    """Sums that one view adds to the equations of the radii.

    Parameters
    ----------
    templates : sparse array, shape (pixels, n)
    products : ndarray, shape (n,)
        Of the templates with the view.
    prior : ndarray, shape (n,)
        Inverse variance of each correction beforehand, px^-2.
    """

    templates: sparse.csc_array
    products: NDArray[np.float64]
    prior: NDArray[np.float64]

    @classmethod
    def of(
        cls, rims: Rims, image: NDArray[np.float32], brightness: NDArray[np.float32], used: NDArray
    ) -> "RimSums":
        """The sums of a view; ``image`` minus ``brightness`` is multiplied with the templates of the rims."""
        templates = rims.templates(brightness, used)
        products = templates.T @ (image - brightness).ravel().astype(np.float64)
        return cls(templates, products, 1.0 / np.maximum(PRIOR_STDS * rims.radius_std, 1e-3) ** 2)

    def change(self, correction: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float32]:
        """The amount by which the view shows the rings that the corrections take out."""
        return (self.templates @ correction.astype(np.float32)).reshape(shape).astype(np.float32)


def correct_radii(
    views: list[RimSums],
    mean: NDArray[np.float32],
    count: NDArray[np.uint8],
    brightness: NDArray[np.float32],
    *,
    noise: float,
) -> list[NDArray[np.float64]]:
    """Corrections of the radii of each view from all views together, px.

    Parameters
    ----------
    views : list of RimSums
    mean : ndarray, shape (rows, columns)
        Mean of the views.
    count : ndarray, same shape
        Number of views in it.
    brightness : ndarray, same shape
        As given to `RimSums.of`.
    noise : float
        Standard deviation of a pixel of a view, grey levels.
    """
    sizes = [view.templates.shape[1] for view in views]
    if not sum(sizes):
        return [np.zeros(size) for size in sizes]
    templates = sparse.hstack([view.templates for view in views], format="csc").astype(np.float64)
    share = sparse.diags_array(1.0 / np.maximum(count.ravel(), 1).astype(np.float64))
    coupled = (templates.T @ (share @ templates)).tocsr()
    own = sparse.block_diag([view.templates.T @ view.templates for view in views], format="csr")
    prior = noise**2 * np.concatenate([view.prior for view in views])
    matrix = (own - coupled + sparse.diags_array(prior)).tocsr()
    right = np.concatenate([view.products for view in views]) - templates.T @ (mean - brightness).ravel()
    scale = sparse.diags_array(1.0 / np.maximum(matrix.diagonal(), 1e-12))
    solution, _ = cg(matrix, right, rtol=SOLVED, maxiter=500, M=scale)
    return np.split(solution, np.cumsum(sizes)[:-1])


@dataclass(frozen=True, eq=False)
class RimHistory:
    """The contacts of all views, to look up what the others show at a rim."""

    views: tuple[Rims, ...]

    @cached_property
    def _trees(self) -> list[cKDTree | None]:
        return [cKDTree(np.column_stack([view.x, view.y])) if len(view.x) else None for view in self.views]

    def excess_variance(
        self, rims: Rims, views_at_rim: NDArray[np.float64], *, but: int | None
    ) -> NDArray[np.float64]:
        """What the uncertainty of the background adds to the variance of each radius, relative to it.

        Parameters
        ----------
        rims : Rims
            Contacts of a frame.
        views_at_rim : ndarray, shape (n,)
            Number of other views at their rims.
        but : int or None
            Number of the view that is the frame itself, if it is one.

        Returns
        -------
        ndarray, shape (n,)
            ``1/n`` for ``n`` views without a rim there; 1 if all rims are the same and one view shows none.
        """
        others = [k for k in range(len(self.views)) if k != but]
        radius = np.full((len(rims.x), 1 + len(others)), np.nan)
        radius[:, 0] = rims.radius
        for column, k in enumerate(others, start=1):
            tree = self._trees[k]
            if tree is not None and len(rims.x):
                distance, nearest = tree.query(np.column_stack([rims.x, rims.y]))
                found = self.views[k].radius[nearest]
                same = distance < SAME_CONTACT_PX + SAME_CONTACT_RADII * np.maximum(found, rims.radius)
                radius[same, column] = found[same]
        return _excess(radius, rims.blur, views_at_rim)


def _excess(radius: NDArray, blur: float, views: NDArray) -> NDArray[np.float64]:
    """The excess from the radii of a contact in the frame (first column) and in the others; NaN where none.

    Examples
    --------
    >>> radius = np.array([[5.0, np.nan, np.nan], [5.0, 5.0, 5.0]])
    >>> _excess(radius, 1.4, np.array([4.0, 3.0])).round(2).tolist()
    [0.23, 0.93]

    Where rims of all views cover the pixels, little more than the prior is known of the radius:

    >>> _excess(np.full((1, 6), 5.0), 1.4, np.array([0.2])).round(1).tolist()
    [13.2]
    """
    mean = (radius[:, :, None] + radius[:, None, :]) / 2
    product = np.sqrt(np.maximum(radius[:, :, None] * radius[:, None, :], 1e-12))
    overlap = np.exp(-((radius[:, :, None] - radius[:, None, :]) ** 2) / (4 * blur**2)) * mean / product
    overlap = np.nan_to_num(np.minimum(overlap, 1.0), nan=0.0)
    identity = np.eye(radius.shape[1])
    overlap = np.maximum(overlap, identity)
    # pixels that few views use are masked in the others: as many views as rims, or the matrix is not positive
    number = np.maximum(np.maximum(views, 1e-3) + 1.0, overlap.sum(axis=2).max(axis=1))
    matrix = identity * (1.0 + 1.0 / (PRIOR_STDS**2 * 20.0)) - overlap / number[:, None, None]
    return np.linalg.inv(matrix)[:, 0, 0] - 1.0
