"""Near field of the fast coupling: ``erfc(b r)/(pi r)`` summed over all pairs within a cutoff.

Candidates are sorted into square cells as wide as the cutoff, and each pair is evaluated once. ``erf(b r)/r``
is an even function of ``r``; a table over ``r^2`` gives it to 1e-12.
"""

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from contactimg.compiled import njit
from contactimg.models.coupling import (
    CUBIC,
    EXTENT_CURVATURE,
    EXTENT_SLOPE,
    QUARTIC,
    SADDLE,
    Fields,
    displacement_excess,
    elongation,
)

Values = NDArray[np.float64]

TABLE_SIZE = 4000
"""Intervals of the table. Chosen for an interpolation error of 1e-12."""

SINGLE_STORED = 1e-6
"""Accuracy from which on stored values may be in single precision. Theory: its rounding error is 6e-8."""


class NearFieldSum:
    """Sums over the pairs closer than a cutoff.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
    cutoff : float
    sharpness : float
        ``b``.
    kept : bool
        Store the pairs at the first sum, for more than one.
    accuracy : float
        Relative accuracy of a sum; from `SINGLE_STORED` on the stored values are in single precision.
    """

    def __init__(
        self,
        x: Values,
        y: Values,
        *,
        cutoff: float,
        sharpness: float,
        kept: bool = False,
        accuracy: float = 1e-9,
    ) -> None:
        self._kept = kept
        self._stored = np.float32 if accuracy >= SINGLE_STORED else np.float64
        extent = max(float(np.ptp(x)), float(np.ptp(y)))
        self._cells = max(1, min(int(extent / cutoff), 2048))
        size = extent / self._cells * (1 + 1e-12)
        row, column = (np.minimum(((v - v.min()) / size).astype(np.int64), self._cells - 1) for v in (y, x))
        cell = row * self._cells + column
        self._order = np.argsort(cell, kind="stable")
        self._bounds = np.searchsorted(cell[self._order], np.arange(self._cells**2 + 1))
        self._x, self._y = x[self._order], y[self._order]
        self._cutoff, self._sharpness = cutoff, sharpness
        self._table = _smooth_table(cutoff, sharpness)

    def sum(self, force: Values) -> Values:
        """``sum_j erfc(b r_ij)/(pi r_ij) q_j`` over the near pairs."""
        result = np.empty_like(force)
        if self._kept:
            result[self._order] = _stored_sum(*self._pairs, force[self._order])
        else:
            result[self._order] = _near_sum(*self._sorted, force[self._order])
        return result

    @property
    def _sorted(self) -> tuple[Values, Values, NDArray[np.intp], int, float, Values]:
        """The points in order of their cells, these, and the table."""
        return self._x, self._y, self._bounds, self._cells, self._cutoff**2, self._table

    @cached_property
    def _pairs(self) -> tuple[NDArray[np.intp], NDArray[np.int32], NDArray[np.floating]]:
        """Where the pairs of each point begin, the other points, and ``erfc(b r)/(pi r)``."""
        begins = np.cumsum(_count_pairs(*self._sorted[:-1]))
        others, values = np.empty(begins[-1], dtype=np.int32), np.empty(begins[-1], dtype=self._stored)
        _store_pairs(*self._sorted, begins, others, values)
        return begins, others, values

    def fields(self, force: Values, contact_radius: Values, saddle: Values | None = None) -> Fields:
        """Contribution of the near pairs to the fields."""
        sums = _near_fields(
            self._x,
            self._y,
            force[self._order],
            contact_radius[self._order],
            elongation(contact_radius, saddle)[:, self._order],
            self._bounds,
            self._cells,
            self._cutoff**2,
            self._sharpness,
        )
        parts = np.empty_like(sums)
        parts[:, self._order] = sums
        return Fields(*parts)


def _smooth_table(cutoff: float, sharpness: float) -> Values:
    """``erf(b r)/r`` and its derivative in ``r^2`` times the spacing, at evenly spaced ``r^2``."""
    square = np.linspace(0.0, cutoff**2, TABLE_SIZE + 1) * (1 + 1 / TABLE_SIZE)
    r = np.sqrt(square[1:])
    bell = 2 * sharpness / np.sqrt(np.pi) * np.exp(-((sharpness * r) ** 2))
    value = np.concatenate([[2 * sharpness / np.sqrt(np.pi)], erf(sharpness * r) / r])
    slope = np.concatenate(
        [[-2 * sharpness**3 / (3 * np.sqrt(np.pi))], (bell - erf(sharpness * r) / r) / (2 * r**2)]
    )
    # below b r = 0.05 the difference cancels: -(2 b^3/(3 sqrt pi)) (1 - 3/5 (b r)^2 + 3/14 (b r)^4)
    z = sharpness**2 * square
    series = slope[0] * (1 - 0.6 * z + 3 / 14 * z**2)
    slope = np.where(z < 2.5e-3, series, slope)
    return np.column_stack([value, slope * (square[1] - square[0])])


@njit(cache=True, error_model="numpy", inline="always")
def _rest(r2, per_square, table):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """``erfc(b r)/r``."""
    place = r2 * per_square
    k = int(place)
    f = place - k
    rise = table[k + 1, 0] - table[k, 0]
    bend = (table[k, 1] - rise) * (1 - f) + (rise - table[k + 1, 1]) * f
    return 1.0 / np.sqrt(r2) - (table[k, 0] + f * rise + f * (1 - f) * bend)


@njit(cache=True, error_model="numpy")
def _near_sum(x, y, bounds, cells, cutoff2, table, q):  # type: ignore[no-untyped-def]  # noqa: PLR0917  # pragma: no cover
    """The sum over the loaded points, which are few where it is not repeated."""
    loaded = np.flatnonzero(q)
    first = np.searchsorted(loaded, bounds)
    result = np.zeros(x.size)
    per_square = (table.shape[0] - 1) / (cutoff2 * (1 + 1 / (table.shape[0] - 1)))
    for cell in range(cells * cells):
        row, column = cell // cells, cell % cells
        for i in range(bounds[cell], bounds[cell + 1]):
            total = 0.0
            for near_row in range(max(row - 1, 0), min(row + 2, cells)):
                begin = first[near_row * cells + max(column - 1, 0)]
                end = first[near_row * cells + min(column + 1, cells - 1) + 1]
                for j in loaded[begin:end]:
                    dx, dy = x[i] - x[j], y[i] - y[j]
                    r2 = dx * dx + dy * dy
                    if r2 < cutoff2 and i != j:
                        total += _rest(r2, per_square, table) * q[j]
            result[i] = total
    return result / np.pi


@njit(cache=True)
def _count_pairs(x, y, bounds, cells, cutoff2):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Number of pairs ``(i, j > i)``, that of ``i`` at ``i + 1``: a plain loop, so that it is vectorised."""
    counts = np.zeros(x.size + 1, dtype=np.int64)
    for cell in range(cells * cells):
        row, column = cell // cells, cell % cells
        for i in range(bounds[cell], bounds[cell + 1]):
            found = 0
            for near_row in range(row, min(row + 2, cells)):
                left = column if near_row == row else max(column - 1, 0)
                begin = bounds[near_row * cells + left]
                end = bounds[near_row * cells + min(column + 1, cells - 1) + 1]
                for j in range(max(begin, i + 1), end):
                    dx, dy = x[i] - x[j], y[i] - y[j]
                    found += dx * dx + dy * dy < cutoff2
            counts[i + 1] = found
    return counts


@njit(cache=True, error_model="numpy")
def _store_pairs(x, y, bounds, cells, cutoff2, table, begins, others, values):  # type: ignore[no-untyped-def]  # noqa: PLR0917  # pragma: no cover
    """The pairs and their values."""
    per_square = (table.shape[0] - 1) / (cutoff2 * (1 + 1 / (table.shape[0] - 1)))
    for cell in range(cells * cells):
        row, column = cell // cells, cell % cells
        for i in range(bounds[cell], bounds[cell + 1]):
            at = begins[i]
            for near_row in range(row, min(row + 2, cells)):
                left = column if near_row == row else max(column - 1, 0)
                begin = bounds[near_row * cells + left]
                end = bounds[near_row * cells + min(column + 1, cells - 1) + 1]
                for j in range(max(begin, i + 1), end):
                    dx, dy = x[i] - x[j], y[i] - y[j]
                    r2 = dx * dx + dy * dy
                    if r2 < cutoff2:
                        others[at] = j
                        values[at] = _rest(r2, per_square, table) / np.pi
                        at += 1


@njit(cache=True, fastmath={"reassoc", "contract"})
def _stored_sum(begins, others, values, q):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """The sum with stored pairs."""
    result = np.zeros(q.size)
    for i in range(q.size):
        total = 0.0
        for k in range(begins[i], begins[i + 1]):
            j = others[k]
            total += values[k] * q[j]
            result[j] += values[k] * q[i]
        result[i] += total
    return result


@njit(cache=True, error_model="numpy")
def _near_fields(x, y, force, contact_radius, long, bounds, cells, cutoff2, sharpness):  # type: ignore[no-untyped-def]  # noqa: PLR0917  # pragma: no cover
    """The fields at every candidate by the loaded ones within the cutoff.

    In full where the Fourier series has no part: the higher terms.
    """
    n = x.size
    result = np.zeros((9, n))
    for cell in range(cells * cells):
        row, column = cell // cells, cell % cells
        for i in range(bounds[cell], bounds[cell + 1]):
            for near_row in range(max(row - 1, 0), min(row + 2, cells)):
                begin = bounds[near_row * cells + max(column - 1, 0)]
                end = bounds[near_row * cells + min(column + 1, cells - 1) + 1]
                for j in range(begin, end):
                    dx, dy = x[i] - x[j], y[i] - y[j]
                    r2 = dx * dx + dy * dy
                    if i == j or r2 >= cutoff2 or force[j] == 0.0:
                        continue
                    r = np.sqrt(r2)
                    rest = math.erfc(sharpness * r) / r
                    bell = 2 * sharpness / np.sqrt(np.pi) * np.exp(-sharpness * sharpness * r2)
                    laplacian = (rest + bell) / r2 + 2 * sharpness * sharpness * bell
                    strength = force[j] / np.pi
                    slope = -strength * (rest + bell) / r2
                    smooth = 1.0 / (r2 * r) - laplacian
                    own = displacement_excess(contact_radius[j] / r) / r if contact_radius[j] > 0 else 0.0
                    result[0, i] += strength * (own - 0.1 * contact_radius[j] ** 2 * smooth)
                    fifth = strength / (r2 * r2 * r)
                    extent = contact_radius[j] ** 2 * fifth
                    slope -= EXTENT_SLOPE * extent
                    result[1, i] += slope * dx
                    result[2, i] += slope * dy
                    result[3, i] += 0.5 * strength * laplacian + EXTENT_CURVATURE * extent
                    result[4, i] += QUARTIC * fifth
                    along, across = dx * dx - dy * dy, 2.0 * dx * dy
                    result[0, i] -= (long[0, j] * along + long[1, j] * across) / (r2 * r2 * r)
                    result[5, i] += SADDLE * fifth * along
                    result[6, i] += SADDLE * fifth * across
                    result[7, i] -= CUBIC * fifth * dx
                    result[8, i] -= CUBIC * fifth * dy
    return result
