"""Where the background is, and how its brightness differs from the reference's: a slow polynomial field.

Everything here works on block averages of the frame, so that it costs next to nothing and sees little noise.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from contactimg.imaging.pixels.blocks import BLOCK, side_of

ORDER = 3
TERMS = [(i, j) for j in range(ORDER + 1) for i in range(ORDER + 1 - j)]  # powers of x and y
CLIP = 3.5  # blocks further than this many robust standard deviations from the field are not background
FIT_CLIP = 2.0  # the same for the fit, in which the rims of contacts would count on one side only
ENOUGH_BLOCKS = 3000  # blocks that determine the field; of smaller ones as much area
LEAST_RATIO = 0.05  # of the ratio in the middle: where the field extrapolates to less, it is that
MINIMUM_SPREAD = 1e-3  # of the level: an exactly constant image has no spread of its own


@dataclass(frozen=True, eq=False)
class Illumination:
    """A polynomial of total degree 3 over the image and the blocks it was fitted to.

    Parameters
    ----------
    coefficients : ndarray, shape (4, 4)
        ``coefficients[j, i]`` multiplies ``u**i v**j`` with ``u = 2 x/columns - 1`` and ``v = 2 y/rows - 1``.
    background : ndarray of bool, shape (block rows, block columns)
        Blocks taken as background; their side follows from the shape (`side_of`).
    spread : float
        Robust standard deviation of one background block about the field.
    """

    coefficients: NDArray[np.float64]
    background: NDArray[np.bool_]
    spread: float

    def row_polynomials(
        self, shape: tuple[int, int], rows: NDArray[np.int64] | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Coefficients of the cubic in ``u`` of each row (all, or those given), and ``u`` of each column."""
        which = np.arange(shape[0]) if rows is None else rows
        v = 2.0 * which / shape[0] - 1.0
        along = (v[:, None] ** np.arange(ORDER + 1)) @ self.coefficients
        across = 2.0 * np.arange(shape[1]) / shape[1] - 1.0
        return along.astype(np.float32), across.astype(np.float32)

    def rows(
        self,
        rows: NDArray[np.int64],
        shape: tuple[int, int],
        columns: NDArray[np.int64] | slice = slice(None),
    ) -> NDArray[np.float32]:
        """The field at every pixel of some rows (and columns) of an image of ``shape``."""
        along, across = self.row_polynomials(shape, rows)
        across = across[columns]
        out = np.zeros((len(rows), len(across)), np.float32)
        _add_rows(out, out, along, across, np.float32(1.0))
        return out

    def ratio_rows(
        self,
        rows: NDArray[np.int64],
        shape: tuple[int, int],
        columns: NDArray[np.int64] | slice = slice(None),
    ) -> NDArray[np.float32]:
        """The field of a ratio, bounded such that it can be divided by."""
        ratio = self.rows(rows, shape, columns)
        return np.maximum(ratio, np.float32(max(LEAST_RATIO * self.coefficients[0, 0], 1e-6)), out=ratio)

    def at(self, x: NDArray, y: NDArray, shape: tuple[int, int]) -> NDArray[np.float64]:
        """The field at points (px) of an image of ``shape``."""
        u, v = 2.0 * np.asarray(x) / shape[1] - 1.0, 2.0 * np.asarray(y) / shape[0] - 1.0
        return np.asarray(np.polynomial.polynomial.polyval2d(v, u, self.coefficients))

    def at_blocks(self, blocks: tuple[int, int], shape: tuple[int, int]) -> NDArray[np.float64]:
        """The field at the centre of each block of an image of ``shape``."""
        return _at_blocks(self.coefficients, blocks, shape)

    def subtract_from(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """The image minus the field."""
        out = np.empty_like(image)
        _add_rows(out, image, *self.row_polynomials(image.shape), np.float32(-1.0))
        return out


def fit_illumination(blocks: NDArray, shape: tuple[int, int], *, start: float, spread: float) -> Illumination:
    """Fit a slow field to the blocks that are background.

    Parameters
    ----------
    blocks : ndarray, shape (block rows, block columns)
        Block means of the quantity (ratio to the reference, or grey level); NaN = no data.
    shape : (int, int)
        Shape of the image in pixels.
    start, spread : float
        Level of the background and its scatter to start from; the field and its scatter are then refined in
        turn.

    Returns
    -------
    Illumination
        A field of lower order where too few blocks are background to determine the full one.
    """
    part, basis = _basis(blocks.shape, shape)
    data = blocks.ravel()[part].astype(float)
    finite = np.isfinite(data)
    data = np.where(finite, data - start, 0.0)
    deviation = data
    coefficients = np.zeros(len(TERMS))
    keep = finite
    for _ in range(6):
        keep, before = finite & (np.abs(deviation) < FIT_CLIP * spread), keep
        orders = _orders_supported(int(np.count_nonzero(keep)))
        if orders == 0:
            break
        coefficients = _solve(basis, data, keep, orders)
        deviation = data - coefficients @ basis
        spread = max(min(_clean_scatter(deviation[finite]), spread), MINIMUM_SPREAD * abs(start), 1e-9)
        if np.count_nonzero(keep != before) < 1e-3 * len(data):
            break
    grid = np.zeros((ORDER + 1, ORDER + 1))
    for k, (i, j) in enumerate(TERMS):
        grid[j, i] = coefficients[k]
    grid[0, 0] += start
    offset = np.abs(blocks - _at_blocks(grid, blocks.shape, shape))
    return Illumination(grid, offset < CLIP * spread, spread)  # false where there is no data


def _clean_scatter(deviation: NDArray) -> float:
    """Robust standard deviation from the side of the field on which no contacts stand."""
    ordered = np.sort(deviation)
    below, above = np.searchsorted(ordered, 0.0), np.searchsorted(ordered, 0.0, side="right")
    sides = (-ordered[:below], ordered[above:])
    return 1.4826 * min(float(side[len(side) // 2]) if len(side) else 0.0 for side in sides)


def _block_centres(blocks: tuple[int, int], shape: tuple[int, int]) -> tuple[NDArray, NDArray]:
    """Normalised coordinates (u, v) of the columns and rows of blocks."""
    side = side_of(blocks, shape)
    u = ((2 * np.arange(blocks[1]) + 1) * side - 1) / shape[1] - 1
    v = ((2 * np.arange(blocks[0]) + 1) * side - 1) / shape[0] - 1
    return u, v


def _at_blocks(coefficients: NDArray, blocks: tuple[int, int], shape: tuple[int, int]) -> NDArray[np.float64]:
    """The polynomial at the centre of each block."""
    u, v = _block_centres(blocks, shape)
    powers = np.arange(ORDER + 1)
    return np.asarray((v[:, None] ** powers) @ coefficients @ (u[:, None] ** powers).T)


@lru_cache(maxsize=4)
def _basis(blocks: tuple[int, int], shape: tuple[int, int]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Which blocks determine a field, and each term of the polynomial at their centres."""
    enough = ENOUGH_BLOCKS * (BLOCK // side_of(blocks, shape)) ** 2
    every = max(int(np.sqrt(blocks[0] * blocks[1] / enough)), 1)
    rows, columns = (place.ravel() for place in _scattered(blocks, every))
    u, v = _block_centres(blocks, shape)
    return rows * blocks[1] + columns, np.stack([v[rows] ** j * u[columns] ** i for i, j in TERMS])


def _scattered(shape: tuple[int, int], every: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of one element in each square of so many, at random: lattices are regular."""
    rng = np.random.default_rng(0)
    corners = np.meshgrid(*(np.arange(0, size, every) for size in shape), indexing="ij")
    rows, columns = (np.minimum(corner + rng.integers(0, every, corner.shape), size - 1)
                     for corner, size in zip(corners, shape, strict=True))  # fmt: skip
    return rows, columns


def _solve(basis: NDArray, data: NDArray, keep: NDArray[np.bool_], orders: int) -> NDArray[np.float64]:
    """Least squares over the kept blocks with the terms of the lowest ``orders`` orders."""
    used = np.array([i + j < orders for i, j in TERMS])
    power, common = _normal_equations(basis, data, keep)
    # a weak pull towards the constant keeps corners without background from running away
    ridge = 1e-3 * np.count_nonzero(keep) * np.diag([0.0] + [1.0] * (int(used.sum()) - 1))
    coefficients = np.zeros(len(TERMS))
    coefficients[used] = np.linalg.solve(power[np.ix_(used, used)] + ridge, common[used])
    return coefficients


@njit(cache=True)
def _normal_equations(basis, data, keep):
    """Products of the terms with each other and with the data, summed over the kept blocks."""
    terms = basis.shape[0]
    power, common = np.zeros((terms, terms)), np.zeros(terms)
    weight = keep.astype(np.float64)
    for i in range(terms):
        kept = basis[i] * weight
        for j in range(i + 1):
            power[i, j] = power[j, i] = _product(kept, basis[j])
        common[i] = _product(kept, data)
    return power, common


@njit(cache=True, fastmath=True, forceinline=True)
def _product(one, other):
    """Scalar product, in vector instructions."""
    total = 0.0
    for k in range(len(one)):
        total += one[k] * other[k]
    return total


def _orders_supported(count: int) -> int:
    """Number of polynomial orders (constant = 1) that so many blocks determine: ten for each coefficient."""
    return int(
        sum(count >= 10 * (order + 1) * (order + 2) // 2 for order in range(1, ORDER + 1)) + (count > 0)
    )


@njit(cache=True, fastmath=True, forceinline=True)
def _add_rows(out, image, along, across, sign):
    """``image + sign x`` polynomial, row by row."""
    for y in range(len(out)):
        _add_row(out[y], image[y], along[y], across, sign)


@njit(cache=True, fastmath=True, forceinline=True)
def _add_row(out, image, along, across, sign):
    """One row; contiguous vectors and single precision, so that it compiles to vector instructions."""
    c0, c1, c2, c3 = along
    for x in range(len(out)):
        u = across[x]
        out[x] = image[x] + sign * (c0 + u * (c1 + u * (c2 + u * c3)))


def background_mode(
    blocks: NDArray, *, background_is: str, scatter: float | None = None
) -> tuple[float, float]:
    """Most likely level of the background among block means, and the scatter of a block.

    Parameters
    ----------
    blocks : ndarray
        Block means; NaN = no data.
    background_is : {"lowest", "highest", "nearest_one", "most_common"}
        Which of several well-populated levels is the background: the lowest (bright contacts), the highest
        (dark contacts), the one closest to 1 (ratio to a reference) or the most common.
    scatter : float or None
        Of one block of background, if it is known; None: from the differences of neighbours.

    Returns
    -------
    level, spread : float
    """
    values = blocks[np.isfinite(blocks)]
    if not len(values):
        return 1.0, MINIMUM_SPREAD
    low, high = float(values.min()), float(values.max())
    least = max(MINIMUM_SPREAD * max(abs(low), abs(high)), 1e-9)
    spread = max(neighbour_scatter(blocks) if scatter is None else scatter, least)
    bins = int(np.clip((high - low) / spread, 1, 2000)) + 4
    edges = np.linspace(low - 2 * spread, high + 2 * spread, bins + 1)
    places = ((values - edges[0]) * (bins / (edges[-1] - edges[0]))).astype(np.int64)
    counts = np.bincount(np.minimum(places, bins - 1), minlength=bins)
    smooth = np.convolve(counts, [1, 4, 6, 4, 1], mode="same") / 16.0
    left, right = np.r_[0.0, smooth[:-1]], np.r_[smooth[1:], 0.0]
    populated = smooth >= max(0.05 * smooth.max(), 1e-9)
    peaks = np.flatnonzero((smooth > left) & (smooth >= right) & populated)
    centres = (edges[:-1] + edges[1:]) / 2
    choice = {
        "lowest": 0,
        "highest": -1,
        "nearest_one": int(np.argmin(np.abs(centres[peaks] - 1.0))),
        "most_common": int(np.argmax(smooth[peaks])),
    }[background_is]
    level, width = float(centres[peaks[choice]]), float(edges[1] - edges[0])
    sample = values[_scattered((1, len(values)), max(len(values) // ENOUGH_BLOCKS, 1))[1][0]]
    return level, 2.0 * max(min(spread, _clean_scatter(sample - level)), width, least)


def neighbour_scatter(blocks: NDArray) -> float:
    """Scatter of one block from the differences of neighbours; half of them may straddle rims of contacts."""
    rows = _scattered((1, len(blocks)), max(blocks.size // ENOUGH_BLOCKS, 1))[1][0]
    difference = np.diff(blocks[rows], axis=1).ravel()
    difference = difference[np.isfinite(difference)]
    if not len(difference):
        return 0.0
    # a quarter of normal deviates lie within 0.3186 standard deviations
    return float(np.percentile(np.abs(difference), 25) / 0.3186 / np.sqrt(2))
