"""The same coupling without a matrix: cost near-linear in the number of candidates.

Ewald's split: ``1/r = erfc(b r)/r + erf(b r)/r``. The first part is cut off at a radius and stored as a
sparse matrix; the second is smooth, so a Fourier series on a padded box represents it and non-uniform FFTs
(finufft) sum it: type 1 to the modes, a multiplication, type 2 back. The multiplier is the discrete transform
of the smooth kernel itself, faded out beyond the largest distance, so that no periodic image is seen.
"""

import math
from collections.abc import Callable
from functools import cached_property

import finufft
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.fft import fft2, next_fast_len
from scipy.sparse import csr_array
from scipy.special import erf, erfc, erfcinv

from contactimg.models.coupling import Fields, Kernel, NotPositiveDefinite, displacement_excess

__all__ = ["FastCoupling"]

Values = NDArray[np.float64]
Rows = NDArray[np.intp]

NEIGHBOURS = 150
"""Mean number of neighbours in the near part: balances its memory against the size of the grid."""

CUTOFF_PER_THICKNESS = 2.5
"""Longest cutoff over the layer's thickness: the grid then resolves the layer's deficit to 1e-12."""

FADE_CELLS = 24
"""Grid cells over which the kernel is faded out; an erf-shaped edge is then smooth to 1e-10."""

MAX_KRYLOV = 400


class FastCoupling:
    """Sparse near part and non-uniform FFT for the far part.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        Candidates; no two may coincide.
    kernel : Kernel
    accuracy : float
        Relative accuracy of a sum.

    Notes
    -----
    Memory: about ``12 NEIGHBOURS`` bytes a candidate and ``16 * (2.5 M)^2`` bytes for the grids of ``M^2``
    modes, with ``M`` about 5 times the square root of the number of candidates.
    """

    def __init__(self, x: Values, y: Values, kernel: Kernel, accuracy: float = 1e-9) -> None:
        self._x, self._y, self._kernel, self._accuracy = x, y, kernel, accuracy
        self.extent = max(float(np.ptp(x)), float(np.ptp(y)))
        reach = float(erfcinv(accuracy))
        area = max(float(np.ptp(x) * np.ptp(y)), 1e-6 * self.extent**2)
        self.cutoff = min(np.sqrt(NEIGHBOURS * area / (np.pi * x.size)), 0.3 * self.extent)
        if kernel.thinness:
            self.cutoff = min(self.cutoff, CUTOFF_PER_THICKNESS / kernel.thinness)
        self.sharpness = reach / self.cutoff
        # highest wavenumber 2 b erfcinv(eps) on a box of twice the extent and the fading rim
        self.modes = 2 * next_fast_len(
            int(np.ceil(2 * self.sharpness * reach / np.pi * self.extent)) + FADE_CELLS, real=False
        )
        cell = self.extent / (self.modes / 2 - FADE_CELLS)
        self.period = self.modes * cell
        self._place(x, y)
        self.near = _near_matrix(x, y, self.cutoff, self.sharpness)
        self._self = -self.sharpness * 2 / np.sqrt(np.pi) / np.pi  # the smooth part's own value, taken out
        self._multiplier = self._transform(kernel)

    def _place(self, x: Values, y: Values) -> None:
        """Angles of the candidates in the periodic box."""
        turn = 2 * np.pi / self.period
        self._angles = (
            np.ascontiguousarray(turn * (x - 0.5 * (x.min() + x.max()))),
            np.ascontiguousarray(turn * (y - 0.5 * (y.min() + y.max()))),
        )

    def _transform(self, kernel: Kernel) -> Values:
        """Fourier coefficients of the smooth part of the kernel, faded out beyond the extent."""
        cell = self.period / self.modes
        d = cell * np.fft.fftfreq(self.modes, 1 / self.modes)
        middle, width = self.extent + 0.5 * FADE_CELLS * cell, FADE_CELLS * cell / 11
        fade = 0.5 * erfc((np.abs(d) - middle) / width)
        r = np.hypot(d[:, None], d[None, :])
        smooth = erf(self.sharpness * r) / np.where(r > 0, r, 1.0)
        smooth[0, 0] = self.sharpness * 2 / np.sqrt(np.pi)
        if kernel.thinness:
            smooth -= kernel.deficit(r)
        smooth *= fade[:, None] * fade[None, :] / np.pi
        return np.fft.fftshift(fft2(smooth).real) / self.modes**2

    @cached_property
    def _plans(self) -> tuple[finufft.Plan, finufft.Plan]:
        """Transforms to the modes and back, with the points set."""
        shape = (self.modes, self.modes)
        options = {"eps": self._accuracy, "upsampfac": 1.25, "nthreads": 1}
        plans = []
        for kind, sign in ((1, -1), (2, 1)):
            plan = finufft.Plan(kind, shape, isign=sign, **options)
            plan.setpts(*self._angles)
            plans.append(plan)
        return plans[0], plans[1]

    def displacement(self, force: Values) -> Values:
        """``C q`` at every candidate."""
        return self._complex_displacement(force.astype(np.complex128)).real

    def _complex_displacement(self, force: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Displacement by two sets of forces, real and imaginary part."""
        to_modes, back = self._plans
        modes = to_modes.execute(force)
        modes *= self._multiplier
        near = self.near @ np.column_stack([force.real, force.imag])
        return near[:, 0] + 1j * near[:, 1] + back.execute(modes) + self._self * force

    def newton(self, active: Rows, scale: Values, sides: Values, tolerance: float) -> Values:
        """By conjugate gradients, two columns in one complex sum; `NotPositiveDefinite` if so."""
        force = np.zeros(self.near.shape[0], dtype=np.complex128)

        def apply(z: Values) -> Values:
            # columns of one size, so that the rounding of one does not drown the other
            size = np.maximum(np.linalg.norm(z, axis=0), np.finfo(float).tiny)
            packed = z / size
            force[active] = scale * (packed[:, 0] + 1j * packed[:, 1])
            image = scale * self._complex_displacement(force)[active]
            return z + np.column_stack([image.real, image.imag]) * size

        return _conjugate_gradients(apply, sides, tolerance)

    def moved(self, x: Values, y: Values) -> "FastCoupling":
        """The same coupling between candidates at other places."""
        return FastCoupling(x, y, self._kernel, self._accuracy)

    def fields(self, force: Values, contact_radius: Values) -> Fields:
        """The neighbours' fields: pairs within the cutoff, Fourier series beyond."""
        to_modes, back = self._plans
        k = 2 * np.pi / self.period * np.arange(-self.modes // 2, self.modes // 2)
        widening = force * contact_radius**2 / 10
        modes = self._multiplier * to_modes.execute(force.astype(np.complex128))
        slope = back.execute(modes * (1j * k[:, None] - k[None, :]))
        modes = self._multiplier * to_modes.execute(0.5 * force + 1j * widening)
        bend = back.execute(modes * -(k[:, None] ** 2 + k[None, :] ** 2))
        own = -(self.sharpness**3) * 8 / (3 * np.pi**1.5)  # Laplacian of the smooth part at its centre
        near = _near_fields(
            self._x,
            self._y,
            self.near.indptr,
            self.near.indices,
            force,
            contact_radius,
            self.sharpness,
        )
        return Fields(
            excess=near[0] + bend.imag - own * widening,
            slope_x=near[1] + slope.real,
            slope_y=near[2] + slope.imag,
            curvature=near[3] + bend.real - own * 0.5 * force,
        )


def _conjugate_gradients(apply: Callable[[Values], Values], sides: Values, tolerance: float) -> Values:
    """Solve a symmetric positive definite system for two columns at once to a relative residual."""
    solution = np.zeros_like(sides)
    residual = sides.copy()
    direction = residual.copy()
    square = np.sum(residual**2, axis=0)
    goal = tolerance**2 * square
    for _ in range(MAX_KRYLOV):
        going = square > goal
        if not going.any():
            break
        image = apply(direction)
        curvature = np.sum(direction * image, axis=0)
        if np.any(curvature[going] <= 0):
            raise NotPositiveDefinite
        step = np.where(going, square / np.where(going, curvature, 1.0), 0.0)
        solution += step * direction
        residual -= step * image
        before, square = square, np.sum(residual**2, axis=0)
        direction = np.where(going, residual + square / np.where(going, before, 1.0) * direction, 0.0)
    return solution


def _near_matrix(x: Values, y: Values, cutoff: float, sharpness: float) -> csr_array:
    """``erfc(b r)/(pi r)`` between candidates closer than the cutoff."""
    starts, columns, distance = _neighbours(x, y, cutoff)
    values = erfc(sharpness * distance) / (np.pi * distance)
    return csr_array((values, columns, starts), shape=(x.size, x.size))


def _neighbours(x: Values, y: Values, cutoff: float) -> tuple[NDArray, NDArray, Values]:
    """Rows, columns and distances of all pairs closer than the cutoff, as a compressed sparse table."""
    cells = max(1, min(int(max(np.ptp(x), np.ptp(y)) / cutoff), 4096))
    size = max(np.ptp(x), np.ptp(y)) / cells * (1 + 1e-12)
    column = np.minimum(((x - x.min()) / size).astype(np.int64), cells - 1)
    row = np.minimum(((y - y.min()) / size).astype(np.int64), cells - 1)
    cell = row * cells + column
    order = np.argsort(cell, kind="stable")
    bounds = np.searchsorted(cell[order], np.arange(cells * cells + 1))
    return _pairs_within(x, y, cutoff, cells, cell, order, bounds)


@njit(cache=True)
def _pairs_within(x, y, cutoff, cells, cell, order, bounds):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Count the neighbours, then list them."""
    n = x.size
    starts = np.zeros(n + 1, dtype=np.int64)
    columns = np.empty(0, dtype=np.int32)
    distance = np.empty(0)
    for listing in range(2):
        if listing:
            starts[1:] = np.cumsum(starts[1:])
            columns = np.empty(starts[n], dtype=np.int32)
            distance = np.empty(starts[n])
        for i in range(n):
            place = starts[i]
            row, column = cell[i] // cells, cell[i] % cells
            for near_row in range(max(row - 1, 0), min(row + 2, cells)):
                first = near_row * cells + max(column - 1, 0)
                last = near_row * cells + min(column + 1, cells - 1)
                for place_in_order in range(bounds[first], bounds[last + 1]):
                    j = order[place_in_order]
                    dx, dy = x[i] - x[j], y[i] - y[j]
                    r2 = dx * dx + dy * dy
                    if r2 < cutoff * cutoff and i != j:
                        if listing:
                            columns[place] = j
                            distance[place] = np.sqrt(r2)
                            place += 1
                        else:
                            starts[i + 1] += 1
    return starts, columns, distance


@njit(cache=True)
def _near_fields(x, y, starts, columns, force, contact_radius, sharpness):  # type: ignore[no-untyped-def]  # pragma: no cover
    """What the pairs within the cutoff add to the Fourier series of slope, curvature and excess."""
    n = x.size
    excess, slope_x, slope_y, curvature = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    for i in range(n):
        for place in range(starts[i], starts[i + 1]):
            j = columns[place]
            if force[j] == 0.0:
                continue
            dx, dy = x[i] - x[j], y[i] - y[j]
            r2 = dx * dx + dy * dy
            r = np.sqrt(r2)
            rest = math.erfc(sharpness * r)
            bell = 2 * sharpness / np.sqrt(np.pi) * np.exp(-sharpness * sharpness * r2)
            first = -(rest / r + bell) / r
            laplacian = (rest / r + bell) / r2 + 2 * sharpness * sharpness * bell
            strength = force[j] / np.pi
            slope_x[i] += strength * first * dx / r
            slope_y[i] += strength * first * dy / r
            curvature[i] += 0.5 * strength * laplacian
            smooth = 1.0 / (r2 * r) - laplacian
            own = displacement_excess(contact_radius[j] / r) / r if contact_radius[j] > 0 else 0.0
            excess[i] += strength * (own - 0.1 * contact_radius[j] ** 2 * smooth)
    return excess, slope_x, slope_y, curvature
