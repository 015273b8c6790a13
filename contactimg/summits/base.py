"""The surface that the asperities stand on, and the noise of the heights."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from contactimg.errors import InputError
from contactimg.pose.apex import SIGNIFICANT_STDS
from contactimg.pose.pairs import MAD_TO_STD

Values = NDArray[np.float64]
Form = Literal["none", "plane", "sphere"]

FORM_TERMS = {"none": 1, "plane": 3, "sphere": 4}
"""Form -> number of its terms, of 1, x, y and x^2 + y^2."""

TILES = 16
"""Tiles along each side from which the base is first guessed, so that a map needs as many rows and columns.
Chosen: 8 to 32 give the same base."""

ROUNDS = 12
"""Rounds of a fit, whose pixels are chosen anew in each. Chosen: 6 suffice on caps with noise, and those of a
base no longer change then."""

BASE_SHARE = 0.05
"""Share of the pixels that a base must hold. Chosen: among caps that leave less, heights refer to the mean
surface, and the result says so. The quantile of this share stands for the base of a tile at first."""


MOST_BINS = 20_000
"""Most bins of the histogram of heights. Chosen: caps of 10,000 times the noise leave the base a bin."""


@dataclass(frozen=True)
class HeightMap:
    """Heights on a grid of equal steps.

    Parameters
    ----------
    heights : ndarray, shape (rows, columns), m
        Positive away from the material; NaN where nothing was measured. Integers become floats, whose
        differences do not overflow.
    pixel_size : (float, float), m
        Distance between neighbouring columns, and between neighbouring rows.

    Raises
    ------
    InputError
        If the heights are no matrix of at least `TILES` rows and columns, none is finite, or a pixel
        size is not positive.
    """

    heights: Values
    pixel_size: tuple[float, float]

    def __post_init__(self) -> None:
        object.__setattr__(self, "heights", np.asarray(self.heights, dtype=np.float64))
        shape = self.heights.shape
        if len(shape) != 2 or min(shape) < TILES:
            least = f"at least {TILES} rows and columns"
            raise InputError(f"a height map must be a matrix of {least}, got the shape {shape}")
        if not np.isfinite(self.heights).any():
            raise InputError("the height map holds no finite height")
        if np.shape(self.pixel_size) != (2,) or not all(0 < size < np.inf for size in self.pixel_size):
            raise InputError(f"the pixel size must be two positive lengths, got {self.pixel_size!r} m")

    @property
    def x(self) -> Values:
        """Coordinates of the columns, m; 0 is the centre of the map."""
        count = self.heights.shape[1]
        return (np.arange(count) - (count - 1) / 2) * self.pixel_size[0]

    @property
    def y(self) -> Values:
        """Coordinates of the rows, m, downwards; 0 is the centre of the map."""
        count = self.heights.shape[0]
        return (np.arange(count) - (count - 1) / 2) * self.pixel_size[1]


@dataclass(frozen=True)
class Base:
    """The base of a map.

    Parameters
    ----------
    heights : ndarray, shape (rows, columns), m
        Height of the base below each pixel.
    std : float, m
        Standard uncertainty of these heights: how far the base, averaged over a tile, leaves the form.
    noise : float, m
        Standard deviation of the heights of single pixels about the base.
    seen : bool
        Whether there is a base; else heights refer to the mean surface.
    """

    heights: Values
    std: float
    noise: float
    seen: bool


def fit_base(surface: HeightMap, form: Form) -> Base:
    """Fit the form to the base between the asperities.

    Parameters
    ----------
    surface : HeightMap
    form : {"none", "plane", "sphere"}
        What is taken off the heights: their mode, a plane, or a plane and a sphere (to second order; the
        next order is r^4/(8 R^3), 1 nm at 1 mm from the apex of a sphere of 50 mm).

    Returns
    -------
    Base
    """
    heights = surface.heights
    terms = _terms(surface, form)
    finite = np.isfinite(heights)
    noise = pixel_noise(heights)
    coefficients = _first_guess(heights, terms)
    on_base = np.zeros_like(finite)
    for _ in range(ROUNDS):
        rest = heights - terms @ coefficients
        level, width = _lower_mode(rest[finite], noise)
        before, on_base = on_base, finite & (np.abs(rest - level) < SIGNIFICANT_STDS * width)
        if on_base.sum() <= 3 * terms.shape[-1] or np.array_equal(before, on_base):
            break
        coefficients = _least_squares(heights, terms, on_base)
    if on_base.sum() >= BASE_SHARE * finite.sum():
        rest = np.where(on_base, heights - terms @ coefficients, np.nan)
        scatter = float(np.nanstd(rest))
        # Theory: noise that an instrument blurs with 2 px (Gaussian) has 141 times what its fourth
        # differences show; a computed map has no noise, and a base of a thousandth of its range is flat.
        if scatter <= max(200.0 * noise, 1e-3 * float(np.ptp(heights[finite]))):
            return Base(terms @ coefficients, _waviness(rest), scatter, seen=True)
    mean = terms @ _least_squares(heights, terms, finite)
    return Base(mean, _waviness(heights - mean), noise, seen=False)


def pixel_noise(heights: Values) -> float:
    """Standard deviation of white noise in the heights, m, from differences that a smooth surface lacks.

    The second difference along a row, and of that along a column, leaves of a smooth surface only its fourth
    derivatives; of white noise it leaves 6 times the standard deviation.
    """
    fourth = np.diff(np.diff(heights, 2, axis=1), 2, axis=0)
    values = fourth[np.isfinite(fourth)]
    return MAD_TO_STD * float(np.median(np.abs(values))) / 6 if values.size else 0.0


def _terms(surface: HeightMap, form: Form) -> Values:
    """The functions of the position whose sum is the form, about 1 at the rim of the map; the last axis."""
    scale = max(abs(surface.x[0]), abs(surface.y[0]))
    x, y = surface.x[None, :] / scale, surface.y[:, None] / scale
    terms = (np.ones((1, 1)), x, y, x**2 + y**2)[: FORM_TERMS[form]]
    return np.stack([np.broadcast_to(term, surface.heights.shape) for term in terms], axis=-1)


def _least_squares(heights: Values, terms: Values, pixels: NDArray[np.bool_]) -> Values:
    chosen = terms[pixels]
    return np.asarray(np.linalg.lstsq(chosen.T @ chosen, heights[pixels] @ chosen)[0])


def _tiles(values: Values) -> Iterator[Values]:
    for band in np.array_split(values, TILES):
        yield from np.array_split(band, TILES, axis=1)


def _first_guess(heights: Values, terms: Values) -> Values:
    """Coefficients through a low quantile of each tile, tiles that stand out left out in turn."""
    tiles = zip(_tiles(terms), _tiles(heights), strict=True)
    known = [(part, tile) for part, tile in tiles if np.isfinite(tile).any()]
    design = np.array([part.mean(axis=(0, 1)) for part, _ in known])
    values = np.array([np.nanquantile(tile, BASE_SHARE) for _, tile in known])
    weights = np.ones_like(values)
    for _ in range(ROUNDS):  # least absolute deviations by reweighting
        coefficients = np.linalg.lstsq(design * weights[:, None], values * weights)[0]
        off = np.abs(values - design @ coefficients)
        weights = 1 / np.sqrt(np.maximum(off, np.median(off) / 10 + 1e-300))
        weights /= weights.max()
    return coefficients


def _lower_mode(values: Values, noise: float) -> tuple[float, float]:
    """The most frequent height, and the standard deviation of the heights below it.

    Asperities add to the heights above the mode only.
    """
    low, high = np.quantile(values, [0.001, 0.999])
    bin_width = max(noise / 2, (high - low) / MOST_BINS, 1e-300)
    count = min(max(int((high - low) / bin_width), 1), MOST_BINS)
    numbers, edges = np.histogram(values, bins=count, range=(low, max(high, low + bin_width)))
    peak = int(np.argmax(np.convolve(numbers, np.ones(5), mode="same")))
    near = values[np.abs(values - edges[peak]) < max(5 * bin_width, 2 * noise)]
    level = float(np.median(near)) if near.size else float(edges[peak])
    below = level - values[values < level]
    width = MAD_TO_STD * float(np.median(below)) if below.size else noise
    return level, max(width, noise, 1e-300)


def _waviness(rest: Values) -> float:
    """Standard deviation of the medians of tiles of the rest of the base, m, without that of white noise."""
    known = [tile[np.isfinite(tile)] for tile in _tiles(rest) if np.isfinite(tile).sum() >= 10]
    if not known:
        return 0.0
    variance = (MAD_TO_STD * np.median(np.abs([np.median(values) for values in known]))) ** 2
    expected = np.median([np.pi / 2 * values.var() / values.size for values in known])  # of a median
    return float(np.sqrt(max(variance - expected, expected / len(known))))
