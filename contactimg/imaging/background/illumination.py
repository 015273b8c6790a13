"""Slowly varying illumination: a cubic polynomial fitted to the blocks of an image that are background.

With a reference the polynomial describes the ratio of the two backgrounds, without one the grey level itself.
Everything is fitted to block means, which are few and have little noise.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.imaging.background.alignment import Alignment
from contactimg.imaging.pixels.blocks import BLOCK, block_means, side_of
from contactimg.imaging.pixels.masks import Flags, Mask, Values
from contactimg.imaging.pixels.robust import AGREEMENT_SIGMA, CLIP_SIGMA, MAD_TO_STD, median, robust_std
from contactimg.imaging.profile.limits import FEW, LEAST_FRACTION, ROUNDS

Rows = NDArray[np.int64]

POLYNOMIAL_ORDER = 3  # total degree: vignetting is a quadratic, uneven lamps need a cubic
# Powers of u and v in each term of the polynomial.
TERMS = [(i, j) for j in range(POLYNOMIAL_ORDER + 1) for i in range(POLYNOMIAL_ORDER + 1 - j)]
ORDERS = np.sum(TERMS, axis=1)
# Robust standard deviations from the polynomial within which blocks are background, and neighbours flat.
BACKGROUND_CLIP_SIGMA = 3.5
# Blocks of 8 px that the fit uses, of smaller blocks those that cover the same area. Accuracy: 2 % of their
# scatter.
FIT_BLOCKS = 3000
DARKEST_FRACTION = 0.1  # of the level of a background: where it is darker, it is not divided by. By hand


@dataclass(frozen=True, eq=False)
class Illumination:
    """Polynomial of total degree 3 over an image, and the background blocks that it was fitted to.

    Parameters
    ----------
    coefficients : ndarray, shape (4, 4)
        ``coefficients[j, i]`` multiplies ``u**i v**j`` with ``u = 2 x/columns - 1`` and ``v = 2 y/rows - 1``.
    background : ndarray of bool, shape (block rows, block columns)
        Which blocks are background; their side follows from the shape (`side_of`).
    scatter : float
        Robust standard deviation of the background blocks about the polynomial.
    """

    coefficients: NDArray[np.float64]
    background: Flags
    scatter: float

    def row_polynomials(self, rows: Rows, shape: tuple[int, int]) -> tuple[Values, Values]:
        """Coefficients of the cubic in ``u`` for some rows, and ``u`` of each column."""
        along = _powers(2.0 * rows / shape[0] - 1.0) @ self.coefficients
        across = 2.0 * np.arange(shape[1]) / shape[1] - 1.0
        return along.astype(np.float32), across.astype(np.float32)

    def ratio_at_rows(
        self, rows: Rows, shape: tuple[int, int], columns: Rows | slice = slice(None)
    ) -> Values:
        """A ratio, far enough from 0 to divide by it, at all pixels of some rows (and columns)."""
        along, across = self.row_polynomials(rows, shape)
        ratio = np.empty((len(rows), len(across[columns])), np.float32)
        least = np.float32(max(DARKEST_FRACTION * float(self.coefficients[0, 0]), 1e-6))
        _evaluate(ratio, along, np.ascontiguousarray(across[columns]), least)
        return ratio

    def at_blocks(self, blocks: tuple[int, int], shape: tuple[int, int]) -> NDArray[np.float64]:
        """The polynomial at the centre of each block of an image of ``shape``."""
        v, u = _block_centres(blocks, shape)
        return _powers(v) @ self.coefficients @ _powers(u).T

    def subtract_from(self, image: NDArray, level: float = 0.0) -> Values:
        """The image minus the polynomial, and relative to it, in grey levels at a ``level`` that is not 0."""
        out, (rows, columns) = np.empty(image.shape, np.float32), image.shape
        light, across = self.row_polynomials(np.arange(rows), (rows, columns))
        _subtract(out, np.ascontiguousarray(image), light, across, np.float32(level))
        return out


def fit_illumination(
    blocks: NDArray, shape: tuple[int, int], *, level: float, scatter: float, least_scatter: float = 0.0,
    members: Flags | None = None,
) -> Illumination:  # fmt: skip
    """Fit a polynomial to the blocks that are background: least squares with clipping, iterated.

    Parameters
    ----------
    blocks : ndarray, shape (block rows, block columns)
        Block means of the quantity (ratio to the reference, or grey level); NaN = no data.
    shape : (int, int)
        Shape of the image in pixels.
    level, scatter : float
        Level of the background and scatter of its blocks to start from, infinite where it is not known; the
        polynomial and the scatter are then refined in turn.
    least_scatter : float
        Scatter below which blocks are equal: an image without noise has none of its own.
    members : ndarray of bool, optional
        Blocks that alone are fitted to; the background are all that agree with them.

    Returns
    -------
    Illumination
        Of lower order where too few blocks are background to determine a cubic.
    """
    part, basis = _basis(blocks.shape, shape)
    data = blocks.ravel()[part].astype(float) - level
    known = np.isfinite(data) if members is None else np.isfinite(data) & members.ravel()[part]
    if not known.all():
        data, basis = data[known], basis[:, known]
    deviation, coefficients = data, np.zeros(len(TERMS))
    keep = np.full(len(data), np.isfinite(scatter))  # where no scatter is known, a fit to all tells it first
    normal, right, summed = np.zeros((len(TERMS), len(TERMS))), np.zeros(len(TERMS)), np.zeros_like(keep)
    least = max(LEAST_FRACTION * abs(level), least_scatter, 1e-9)
    for _ in range(ROUNDS):
        # blocks at the rims of contacts would bias it to one side
        keep, previous = np.abs(deviation) < AGREEMENT_SIGMA * scatter, keep
        if not keep.any():
            break
        # the sums over the blocks of the step before, and those that have come or gone
        changed = np.flatnonzero(keep != summed)
        terms = basis[:, changed]
        added = np.where(keep[changed], terms, -terms)
        normal, right, summed = normal + added @ terms.T, right + added @ data[changed], keep
        coefficients = _solve(normal, right, int(np.count_nonzero(keep)))
        deviation = data - coefficients @ basis
        scatter = max(min(one_sided_scatter(deviation), scatter), least)
        if np.count_nonzero(keep != previous) < LEAST_FRACTION * len(data):
            break
    i, j = np.transpose(TERMS)
    grid = np.zeros((POLYNOMIAL_ORDER + 1, POLYNOMIAL_ORDER + 1))
    grid[j, i] = coefficients
    grid[0, 0] += level
    found = Illumination(grid, np.empty(0, np.bool_), scatter)
    near = np.abs(blocks - found.at_blocks(blocks.shape, shape)) < BACKGROUND_CLIP_SIGMA * scatter
    return replace(found, background=near)


def one_sided_scatter(deviation: NDArray) -> float:
    """Robust standard deviation from the narrower side, above or below: on it no contacts stand."""
    sides = -deviation[deviation < 0.0], deviation[deviation > 0.0]
    return MAD_TO_STD * min(median(side) if len(side) else 0.0 for side in sides)


def _powers(x: NDArray) -> NDArray:
    """The powers of each value, from 0 to `POLYNOMIAL_ORDER`, of its type."""
    return np.vander(x, POLYNOMIAL_ORDER + 1, increasing=True).astype(x.dtype, copy=False)


def _block_centres(blocks: tuple[int, int], shape: tuple[int, int]) -> list[NDArray]:
    """Normalised coordinates (v, u) of the rows and columns of blocks."""
    side = side_of(blocks, shape)
    return [((2 * np.arange(n) + 1) * side - 1) / size - 1 for n, size in zip(blocks, shape, strict=True)]


@lru_cache(maxsize=4)
def _basis(blocks: tuple[int, int], shape: tuple[int, int]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The blocks that enter the fit, and each term of the polynomial at their centres."""
    enough = FIT_BLOCKS * (BLOCK // side_of(blocks, shape)) ** 2
    every = max(int(np.sqrt(blocks[0] * blocks[1] / enough)), 1)
    rows, columns = (place.ravel() for place in jittered_grid(blocks, every))
    v, u = _block_centres(blocks, shape)
    return rows * blocks[1] + columns, np.stack([v[rows] ** j * u[columns] ** i for i, j in TERMS])


@lru_cache(maxsize=16)
def jittered_grid(shape: tuple[int, int], every: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of one element at random in each square of ``every`` elements.

    A regular grid could coincide with a lattice of contacts.
    """
    rng = np.random.default_rng(0)
    corners = np.meshgrid(*(np.arange(0, size, every) for size in shape), indexing="ij")
    rows, columns = (np.minimum(corner + rng.integers(0, every, corner.shape), size - 1)
                     for corner, size in zip(corners, shape, strict=True))  # fmt: skip
    return rows, columns


def _solve(normal: NDArray, right: NDArray, count: int) -> NDArray[np.float64]:
    """Regularised least squares with the terms that ``count`` blocks determine: by `FEW` each."""
    used = (ORDERS == 0) | (count >= FEW * (ORDERS + 1) * (ORDERS + 2) / 2)
    penalty = np.where(ORDERS[used] > 0, LEAST_FRACTION * count, 0.0)
    coefficients = np.zeros(len(TERMS))
    coefficients[used] = np.linalg.solve(normal[np.ix_(used, used)] + np.diag(penalty), right[used])
    return coefficients


@njit(cache=True, fastmath=True, forceinline=True)
def cubic(c0, c1, c2, c3, u):
    """Cubic polynomial by Horner's rule, for compiled loops over a row."""
    return c0 + u * (c1 + u * (c2 + u * c3))


@njit(cache=True)
def _evaluate(out, light, places, least):
    """Evaluate the polynomial at each pixel; ``least`` replaces lower values."""
    for y in range(len(out)):
        c0, c1, c2, c3 = light[y]
        row = out[y]
        for x in range(len(row)):
            value = cubic(c0, c1, c2, c3, places[x])
            row[x] = value if value > least else least


@njit(cache=True, error_model="numpy")
def _subtract(out, image, light, places, level):
    """Excess of an image over a polynomial, relative to it at a ``level`` that is not 0."""
    lowest, one = np.float32(DARKEST_FRACTION) * level, np.float32(1.0)
    for y in range(len(out)):
        c0, c1, c2, c3 = light[y]
        row, result = image[y], out[y]
        for x in range(len(row)):
            background = cubic(c0, c1, c2, c3, places[x])
            factor = level / max(background, lowest) if level else one
            result[x] = (np.float32(row[x]) - background) * factor


@dataclass(frozen=True, eq=False)
class DifferenceImage:
    """Frame minus background, corrected for uneven and changed illumination.

    Parameters
    ----------
    image : ndarray of float32, shape (rows, columns)
        Grey levels at the median level of the background; contacts stand out, the rest is noise about zero.
    level : float
        Median grey level of the background.
    brightness : ndarray of float32, shape (block rows, block columns)
        Brightness of the background of each block relative to ``level``.
    illumination : Illumination
        Of the background: ratio to the reference, or grey level without one; and which blocks are background.
    alignment : Alignment or None
        Of the frame against the reference; None without reference.
    ratio : bool
        Whether ``illumination`` is a ratio to the reference.
    valid : ndarray of uint8 or None
        0 where the frame or the registered reference has no pixel, or no light; None if nowhere.
    registration_failed : bool
        Whether the reference shows a texture that was not found in the frame.
    rounding : float
        Standard uncertainty of the mean of a block by compression (`rounding_of_blocks`), grey levels.
    """

    image: Values
    level: float
    brightness: Values
    illumination: Illumination
    alignment: Alignment | None
    ratio: bool = False
    valid: Mask = None
    registration_failed: bool = False
    rounding: float = 0.0

    @cached_property
    def blocks(self) -> Values:
        """Means of the image over its blocks, NaN where no pixel is seen."""
        return block_means(self.image, self.valid)

    @property
    def remark(self) -> str:
        """One sentence on the alignment with the reference; empty for a pure shift or without reference."""
        if self.registration_failed:
            return "the surface shown by the reference was not found in the frame: their shift is unknown"
        if self.alignment is None or (self.alignment.known and self.alignment.is_shift):
            return ""
        if not self.alignment.known:
            return "the surface shows nothing that determines the shift against the reference"
        degrees, scale = np.degrees(self.alignment.rotation), self.alignment.scale
        return f"rotated by {degrees:.3f} degrees and scaled by {scale:.5f} against the reference; corrected"


def plain_difference(image: Values) -> DifferenceImage:
    """A difference image in which nothing was registered or corrected: all of it counts as background."""
    blocks = np.zeros_like(block_means(image))
    illumination = Illumination(np.zeros((4, 4)), np.ones(blocks.shape, np.bool_), 0.0)
    return DifferenceImage(image, 0.0, np.ones_like(blocks), illumination, None)


def find_sign(blocks: Values, background: Flags) -> int:
    """1 if most of what stands out of a background at 0 is bright, or nothing does, else -1.

    A connected region counts as the square root of its light: one shadow is not many contacts. One at the
    border counts less, since light falls off there.

    Parameters
    ----------
    blocks : ndarray, shape (rows, columns)
        Block means of the difference image; NaN = no data.
    background : ndarray of bool
        Blocks that are background, from which the scatter is read; of another shape, or none: most are.

    Examples
    --------
    >>> blocks = np.array([[0.1, -0.1, 0.2, -0.2, 0.0, -9.0, -8.0, 0.1]])
    >>> find_sign(blocks, np.abs(blocks) < 1.0)
    -1
    """
    usual = np.isfinite(blocks)
    if not usual.any():
        return 1
    if background.shape == blocks.shape and (usual & background).any():
        usual &= background
    limit = CLIP_SIGMA * robust_std(blocks[usual])
    shown = []
    for light in (np.nan_to_num(blocks), -np.nan_to_num(blocks)):
        far = light > limit
        count, regions = cv2.connectedComponents(far.astype(np.uint8))
        weight = np.ones(count)
        # By hand: four dark corners of 500 px^2 against 25 contacts of 3 px.
        for side in (regions[0], regions[-1], regions[:, 0], regions[:, -1]):
            weight[side] = 0.3
        shown.append(weight @ np.sqrt(np.bincount(regions[far], light[far], minlength=count)))
    return -1 if shown[1] > shown[0] else 1
