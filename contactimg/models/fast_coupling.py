"""Elastic coupling without a stored matrix: cost nearly linear in the number of candidates.

Ewald's split: ``1/r = erfc(b r)/r + erf(b r)/r``. The first part is cut off at a radius and summed over the
pairs within it. The second is smooth: it is a Fourier series on a padded box, summed by non-uniform FFTs
(finufft), type 1 to the modes and type 2 back. The Fourier coefficients are those of the smooth kernel, faded
out beyond the largest distance to suppress periodic images.

The pairs of the first part are found in square cells as wide as the cutoff, and each is evaluated and stored
once.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import finufft
import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, next_fast_len
from scipy.linalg import cho_factor, cho_solve
from scipy.special import erf, erfc, erfcinv

from contactimg.compiled import njit
from contactimg.errors import InputError
from contactimg.models.coupling import (
    Coupling,
    DenseCoupling,
    Kernel,
    NewtonStep,
    NewtonSystem,
    conjugate_gradients,
)

Values = NDArray[np.float64]
Complex = NDArray[np.complexfloating]
Rows = NDArray[np.intp]

NEIGHBOURS_WITHIN_SHARPNESS = 8
"""Mean number of neighbours within ``1/b``. Chosen to balance the times of near sum and Fourier series."""

CUTOFF_PER_THICKNESS = 2.5
"""Longest cutoff over the layer's thickness: the modes then resolve the layer's deficit to 1e-12."""

FADE_CELLS = 24
"""Grid cells over which the kernel is faded out; an edge shaped like erf is then smooth to 1e-10."""

MOST_MODES = 8192
"""Modes each way that a small problem may take. Chosen: 5 GB."""

MOST_MODES_PER_ROOT = 8.0
"""Modes each way over the square root of the number of candidates that a large problem may take. Chosen:
evenly spread candidates take 5."""

MAX_CHOLESKY_CONTACTS = 2500
"""Most contacts for which a Newton system is solved by Cholesky. Chosen by hand; sensitivity not measured."""


SINGLE_ACCURACY = 1e-4
"""Accuracy from which on the transforms are computed in single precision. Measured: with a thousand modes
each way single precision adds an error of 1e-4, the phases being that inaccurate."""

RIM_FRACTION = 0.2
"""Wavenumbers along y below zero over those above. Chosen by accuracy: transforms err most at the rim of
their wavenumbers, where the modes around zero, the largest, would otherwise lie."""

SUM_ACCURACY = 0.05
"""Accuracy of the sums over that of the Newton system that is solved with them. Chosen by hand: it
affects the number of Newton steps only."""

CONTACTS_PER_CELL = 16.0
"""Mean number of contacts of a cell. Chosen by time."""

MOST_CELLS_PER_SIDE = 32
"""Most cells along a side: 1024 in all. Chosen by time: what finer cells hold is close to the identity."""

SINGLE_STORED = 1e-6
"""Accuracy from which on stored values may be in single precision. Theory: its rounding error is 6e-8."""


def square_cells(x: Values, y: Values, count: int) -> tuple[Rows, float]:
    """Number of the cell, of ``count`` along a side, that holds each place, row by row; width of a cell."""
    side = max(float(np.ptp(x)), float(np.ptp(y))) / count * (1 + 1e-12)
    row, column = (np.minimum(((v - v.min()) / side).astype(np.intp), count - 1) for v in (y, x))
    return row * count + column, side


class NearFieldSum:
    """Sums over the pairs closer than a cutoff.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
    cutoff : float
    sharpness : float
        ``b``.
    accuracy : float
        Relative accuracy of a sum; from `SINGLE_STORED` on the stored values are in single precision.
    """

    def __init__(
        self, x: Values, y: Values, *, cutoff: float, sharpness: float, accuracy: float = 1e-9
    ) -> None:
        self._stored: type = np.float32 if accuracy >= SINGLE_STORED else np.float64
        extent = max(float(np.ptp(x)), float(np.ptp(y)))
        self._cells = max(1, min(int(extent / cutoff), 2048))
        cell, _ = square_cells(x, y, self._cells)
        self._order = np.argsort(cell, kind="stable")
        self._bounds = np.searchsorted(cell[self._order], np.arange(self._cells**2 + 1))
        self._x, self._y = x[self._order], y[self._order]
        self._cutoff, self._sharpness = cutoff, sharpness

    def sum(self, force: Values) -> Values:
        """``sum_j erfc(b r_ij)/(pi r_ij) q_j`` over the near pairs."""
        result = np.empty_like(force)
        result[self._order] = _stored_sum(*self._pairs, force[self._order])
        return result

    @cached_property
    def _pairs(self) -> tuple[NDArray[np.intp], NDArray[np.int32], NDArray[np.floating]]:
        """The first pair of each point, the other points, and ``erfc(b r)/(pi r)``."""
        points = self._x, self._y, self._bounds, self._cells, self._cutoff**2, self._sharpness
        counts = np.zeros(self._x.size + 1, dtype=np.int64)
        _list_pairs(*points, counts, np.empty(0, dtype=np.int32), np.empty(0, dtype=self._stored))
        begins = np.cumsum(counts)
        others, values = np.empty(begins[-1], dtype=np.int32), np.empty(begins[-1], dtype=self._stored)
        _list_pairs(*points, begins, others, values)
        return begins, others, values


@njit(cache=True, error_model="numpy")
def _list_pairs(x, y, bounds, cells, cutoff2, sharpness, begins, others, values):  # type: ignore[no-untyped-def]  # noqa: PLR0917  # pragma: no cover
    """The pairs ``(i, j > i)`` and their values; where there is no room for them, the number of each ``i``.

    That number is left at ``i + 1`` of ``begins``.
    """
    count_only = others.size == 0
    for cell in range(cells * cells):
        row, column = cell // cells, cell % cells
        for i in range(bounds[cell], bounds[cell + 1]):
            at = 0 if count_only else begins[i]
            for near_row in range(row, min(row + 2, cells)):
                left = column if near_row == row else max(column - 1, 0)
                begin = bounds[near_row * cells + left]
                end = bounds[near_row * cells + min(column + 1, cells - 1) + 1]
                for j in range(max(begin, i + 1), end):
                    dx, dy = x[i] - x[j], y[i] - y[j]
                    r2 = dx * dx + dy * dy
                    if r2 < cutoff2:
                        if not count_only:
                            r = np.sqrt(r2)
                            others[at] = j
                            values[at] = math.erfc(sharpness * r) / (np.pi * r)
                        at += 1
            if count_only:
                begins[i + 1] = at


@njit(cache=True, fastmath={"reassoc", "contract"})
def _stored_sum(begins, others, values, q):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    result = np.zeros(q.size)
    for i in range(q.size):
        total = 0.0
        for k in range(begins[i], begins[i + 1]):
            j = others[k]
            total += values[k] * q[j]
            result[j] += values[k] * q[i]
        result[i] += total
    return result


@dataclass(frozen=True, eq=False)
class CellPreconditioner:
    """Solves a Newton system averaged over square cells exactly and leaves the rest of it as it is.

    The matrix ``I + S C S`` is the identity but for the displacement that many contacts share: its large
    eigenvalues, which grow with the extent of the pattern, belong to forces that vary slowly over it. A small
    dense problem on the cells holds these.

    Parameters
    ----------
    cell : ndarray, shape (n,)
        Number of the cell that each contact lies in.
    share : ndarray, shape (n,)
        Of each contact in its cell: the scales ``s`` over the root of the cell's sum of squares.
    factor : tuple
        Cholesky's, of the averaged system.
    """

    cell: Rows
    share: Values
    factor: tuple[Values, bool]

    @classmethod
    def of(cls, x: Values, y: Values, kernel: Kernel, scale: Values) -> "CellPreconditioner":
        """The preconditioner of contacts at ``x, y`` with the scales ``s = sqrt(2 a)``."""
        number = int(np.clip(np.sqrt(x.size / CONTACTS_PER_CELL), 2, MOST_CELLS_PER_SIDE))
        cell, side = square_cells(x, y, number)
        places = side * np.stack(np.divmod(np.arange(number**2), number)).astype(np.float64)
        size = np.sqrt(np.bincount(cell, scale**2, number**2))
        # a uniform pressure on a square of side h lowers its middle by 4 asinh(1)/(pi h) of the force
        own = (4 * np.arcsinh(1.0) / side - kernel.relief[0]) / np.pi
        matrix = size[:, None] * DenseCoupling(places[1], places[0], kernel, own=own).matrix * size
        matrix[np.diag_indices_from(matrix)] += 1.0
        return cls(cell, scale / size[cell], cho_factor(matrix, lower=True, overwrite_a=True))

    def __call__(self, side: Values) -> Values:
        """A vector multiplied by the preconditioner."""
        averaged = np.bincount(self.cell, self.share * side, self.factor[0].shape[0])
        change = cho_solve(self.factor, averaged, check_finite=False) - averaged
        return side + self.share * change[self.cell]


class FastCoupling(Coupling):
    """Pairs within a cutoff and non-uniform FFT for the far part.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        Candidates; no two may coincide.
    kernel : Kernel
    accuracy : float
        Relative accuracy of a sum.

    Raises
    ------
    InputError
        If the candidates are so unevenly spread, or the layer is so thin, that the grid of modes would not
        fit into memory.

    Notes
    -----
    Memory: that of two complex grids of ``(1.25 M)^2`` and two of ``M^2`` modes, with ``M`` about 5 times
    the square root of the number of candidates: some 2 kB a candidate.
    """

    def __init__(self, x: Values, y: Values, kernel: Kernel, accuracy: float = 1e-9) -> None:
        super().__init__(x, y, kernel)
        self._accuracy = accuracy
        single = accuracy >= SINGLE_ACCURACY
        self._real: type = np.float32 if single else np.float64
        self._complex: type = np.complex64 if single else np.complex128
        self._extent = max(float(np.ptp(x)), float(np.ptp(y)))
        area = max(float(np.ptp(x) * np.ptp(y)), 1e-3 * self._extent**2)
        reach = float(erfcinv(accuracy))
        balanced = reach * np.sqrt(NEIGHBOURS_WITHIN_SHARPNESS * area / (np.pi * x.size))
        cutoff = min(balanced, 0.3 * self._extent)
        if kernel.thinness:
            cutoff = min(cutoff, CUTOFF_PER_THICKNESS / kernel.thinness)
        self._sharpness = reach / cutoff
        # highest wavenumber 2 b erfcinv(eps) on a box of twice the extent and the fading rim
        half = int(np.ceil(2 * self._sharpness * reach / np.pi * self._extent)) + FADE_CELLS
        if 2 * half > max(MOST_MODES, MOST_MODES_PER_ROOT * np.sqrt(x.size)):
            raise InputError(
                f"the fast sums of {x.size} asperities would take a grid of {2 * half:,} x {2 * half:,} "
                'values: they lie on a line, or too far apart; use method "dense" or a smaller sample'
            )
        self._modes = 4 * next_fast_len(-(-half // 2), real=False)
        self._rim = 2 * int(RIM_FRACTION * self._modes / 4)
        self._cell = self._extent / (self._modes / 2 - FADE_CELLS)
        self._near = NearFieldSum(x, y, cutoff=cutoff, sharpness=self._sharpness, accuracy=accuracy)

    @cached_property
    def _multiplier(self) -> Values:
        """Fourier coefficients of the smooth part of the kernel, faded out beyond the extent.

        Those of wavenumbers along y that are not negative, and zeros for a rim of negative ones: the others
        follow, since forces are real.
        """
        d = self._cell * np.fft.fftfreq(self._modes, 1 / self._modes)
        middle, width = self._extent + 0.5 * FADE_CELLS * self._cell, FADE_CELLS * self._cell / 11
        fade = 0.5 * erfc((np.abs(d) - middle) / width)
        half = self._modes // 2 + 1  # an even function: half of it is all of it
        r = np.hypot(d[:half, None], d[None, :half])
        smooth = erf(self._sharpness * r)
        smooth /= np.where(r > 0, r, 1.0)
        smooth[0, 0] = self._sharpness * 2 / np.sqrt(np.pi)
        if self._kernel.thinness:
            smooth -= self._kernel.deficit(r)
        smooth *= fade[:half, None] / np.pi
        smooth *= fade[None, :half]
        quarter = dctn(smooth, type=1, overwrite_x=True)[:, :-1] / self._modes**2
        quarter[:, 1:] *= 2  # for the wavenumbers that are left out
        half_plane: Values = np.concatenate([quarter[:0:-1], quarter[:-1]]).astype(self._real)
        return np.pad(half_plane, ((0, 0), (self._rim, 0)))

    @cached_property
    def _plans(self) -> tuple[finufft.Plan, finufft.Plan]:
        """Transforms to the modes and back, with the points set."""
        turn = 2 * np.pi / (self._modes * self._cell)
        angles: list[Values] = [
            np.ascontiguousarray(turn * (v - 0.5 * (v.min() + v.max())), dtype=self._real)
            for v in (self._x, self._y)
        ]
        shape = self._modes, self._modes // 2 + self._rim
        how = {"eps": self._accuracy, "upsampfac": 1.25, "nthreads": 1, "dtype": self._complex}
        plans = finufft.Plan(1, shape, isign=-1, **how), finufft.Plan(2, shape, isign=1, **how)
        for plan in plans:
            plan.setpts(*angles)
        return plans

    @cached_property
    def _shift(self) -> Complex:
        """Phases that move the wavenumbers along y from around zero to zero and above."""
        y = self._y - 0.5 * (self._y.min() + self._y.max())
        turn = 2 * np.pi / (self._modes * self._cell)
        return np.exp(-1j * (self._modes // 4 - self._rim // 2) * turn * y).astype(self._complex)

    def displacement(self, force: Values) -> Values:
        """``C q`` at every candidate."""
        to_modes, from_modes = self._plans
        modes = to_modes.execute(self._shift * force.astype(self._real)) * self._multiplier
        far = (from_modes.execute(modes) * np.conj(self._shift)).real.astype(np.float64)
        # the smooth part's own value
        far -= (self._sharpness * 2 / np.pi**1.5 - self._kernel.relief[0] / np.pi) * force
        return far + self._near.sum(force)

    def solve_newton_system(self, active: Rows, system: NewtonSystem, tolerance: float) -> NewtonStep:
        """Solve for the contacts alone: with a stored matrix if they are few, else by conjugate gradients."""
        x, y, scale = self._x[active], self._y[active], system.scale
        if active.size <= MAX_CHOLESKY_CONTACTS:
            direct = DenseCoupling(x, y, self._kernel)
            return direct.solve_newton_system(np.arange(active.size), system, tolerance)
        # the sums need little more accuracy than the solution
        contacts = FastCoupling(x, y, self._kernel, max(self._accuracy, SUM_ACCURACY * tolerance))

        def apply(z: Values) -> Values:
            return z + scale * contacts.displacement(scale * z)

        precondition = CellPreconditioner.of(x, y, self._kernel, scale)
        return conjugate_gradients(apply, system, tolerance, precondition)[:2]

    def check_definite(self, active: Rows, scale: Values) -> None:
        """Refuse an indefinite matrix, of many contacts as far as the solution for one side shows it."""
        if active.size <= MAX_CHOLESKY_CONTACTS:
            direct = DenseCoupling(self._x[active], self._y[active], self._kernel)
            direct.check_definite(np.arange(active.size), scale)
        else:
            self.solve_newton_system(active, NewtonSystem(scale, scale), 1e-3)
