"""Elastic coupling without a stored matrix: cost nearly linear in the number of candidates.

Ewald's split: ``1/r = erfc(b r)/r + erf(b r)/r``. The first part is cut off at a radius and summed over the
pairs within it. The second is smooth: it is a Fourier series on a padded box, summed by non-uniform FFTs
(finufft), type 1 to the modes and type 2 back. The Fourier coefficients are those of the smooth kernel, faded
out beyond the largest distance to suppress periodic images.
"""

from dataclasses import replace
from functools import cached_property

import finufft
import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, next_fast_len
from scipy.special import erf, erfc, erfcinv

from contactimg.errors import InputError
from contactimg.models.cells import CellPreconditioner
from contactimg.models.conjugate_gradients import NewtonSystem, conjugate_gradients
from contactimg.models.coupling import DenseCoupling, Fields, Kernel, direct_sum
from contactimg.models.near_field_sum import NearFieldSum
from contactimg.models.work_limit import count_terms
from contactimg.timings import stage

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


MAX_DIRECT_SOURCES = 500
"""Most point forces that are summed one by one. Chosen by time: setting up a fast sum takes as long."""

SINGLE_ACCURACY = 1e-4
"""Accuracy from which on the transforms are computed in single precision. Measured: with a thousand modes
each way single precision adds an error of 1e-4, the phases being that inaccurate."""

RIM_FRACTION = 0.2
"""Wavenumbers along y below zero over those above. Chosen by accuracy: transforms err most at the rim of
their wavenumbers, where the modes around zero, the largest, would otherwise lie."""

SUM_ACCURACY = 0.05
"""Accuracy of the sums over that of the Newton system that is solved with them. Chosen by hand: it
affects the number of Newton steps only."""


class FastCoupling:
    """Pairs within a cutoff and non-uniform FFT for the far part.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        Candidates; no two may coincide.
    kernel : Kernel
    accuracy : float
        Relative accuracy of a sum.
    kept : bool
        Store the near pairs, for more than one sum.

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

    @stage("coupling sums")
    def __init__(
        self, x: Values, y: Values, kernel: Kernel, accuracy: float = 1e-9, *, kept: bool = True
    ) -> None:
        self._x, self._y, self._kernel, self._accuracy = x, y, kernel, accuracy
        single = accuracy >= SINGLE_ACCURACY
        self._real: type = np.float32 if single else np.float64
        self._complex: type = np.complex64 if single else np.complex128
        self._extent = max(float(np.ptp(x)), float(np.ptp(y)))
        area = max(float(np.ptp(x) * np.ptp(y)), 1e-3 * self._extent**2)
        reach = float(erfcinv(accuracy))
        cutoff = min(
            reach * np.sqrt(NEIGHBOURS_WITHIN_SHARPNESS * area / (np.pi * x.size)), 0.3 * self._extent
        )
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
        self._near = NearFieldSum(
            x, y, cutoff=cutoff, sharpness=self._sharpness, kept=kept, accuracy=accuracy
        )

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
        plans = []
        for kind, sign in ((1, -1), (2, 1)):
            plan = finufft.Plan(
                kind,
                (self._modes, self._modes // 2 + self._rim),
                isign=sign,
                eps=self._accuracy,
                upsampfac=1.25,
                nthreads=1,
                dtype=self._complex,
            )
            plan.setpts(*angles)
            plans.append(plan)
        return plans[0], plans[1]

    @cached_property
    def _shift(self) -> Complex:
        """Phases that move the wavenumbers along y from around zero to zero and above."""
        y = self._y - 0.5 * (self._y.min() + self._y.max())
        turn = 2 * np.pi / (self._modes * self._cell)
        return np.exp(-1j * (self._modes // 4 - self._rim // 2) * turn * y).astype(self._complex)

    def _to_modes(self, force: Values) -> Complex:
        """Fourier coefficients of the smooth displacement by forces."""
        modes: Complex = self._plans[0].execute(self._shift * force.astype(self._real))
        modes *= self._multiplier
        return modes

    def _from_modes(self, modes: Complex) -> Values:
        """The function of Fourier coefficients at the candidates."""
        values: Complex = self._plans[1].execute(modes)
        values *= np.conj(self._shift)
        return values.real.astype(np.float64)

    @stage("coupling sums")
    def displacement(self, force: Values) -> Values:
        """``C q`` at every candidate."""
        count_terms(0.5 * force.size)
        far = self._from_modes(self._to_modes(force))
        # the smooth part's own value
        far -= (self._sharpness * 2 / np.pi**1.5 - self._kernel.relief[0] / np.pi) * force
        return far + self._near.sum(force)

    def displacement_at(self, rows: Rows, force: Values) -> Values:
        """``C q`` at some candidates, of which none is loaded, summed over those and the loaded ones."""
        loaded = np.flatnonzero(force)
        if loaded.size <= MAX_DIRECT_SOURCES:
            k, x, y = self._kernel, self._x, self._y
            sources = np.stack([x[loaded], y[loaded]])
            return direct_sum(x[rows], y[rows], sources, force[loaded], k.thinness, k.value, k.slope)
        involved = np.union1d(rows, loaded)
        part = FastCoupling(self._x[involved], self._y[involved], self._kernel, self._accuracy, kept=False)
        return part.displacement(force[involved])[np.searchsorted(involved, rows)]

    def solve_newton_system(
        self, active: Rows, system: NewtonSystem, tolerance: float
    ) -> tuple[Values, float]:
        """On the contacts alone: by Cholesky if they are few, else by conjugate gradients."""
        x, y, scale = self._x[active], self._y[active], system.scale
        if active.size <= MAX_CHOLESKY_CONTACTS:
            direct = DenseCoupling(x, y, self._kernel)
            return direct.solve_newton_system(np.arange(active.size), system, tolerance)
        # the sums need little more accuracy than the solution
        contacts = FastCoupling(x, y, self._kernel, max(self._accuracy, SUM_ACCURACY * tolerance))

        def apply(z: Values) -> Values:
            return z + scale * contacts.displacement(scale * z)

        return conjugate_gradients(apply, system, tolerance, CellPreconditioner.of(x, y, self._kernel, scale))

    def check_definite(self, active: Rows, scale: Values) -> None:
        """As far as the solution for one side shows it, beyond the contacts that Cholesky can take."""
        if active.size <= MAX_CHOLESKY_CONTACTS:
            direct = DenseCoupling(self._x[active], self._y[active], self._kernel)
            direct.check_definite(np.arange(active.size), scale)
        else:
            self.solve_newton_system(active, NewtonSystem(scale, scale), 1e-3)

    def at_positions(self, x: Values, y: Values) -> "FastCoupling":
        """The same coupling between candidates at other places."""
        return FastCoupling(x, y, self._kernel, self._accuracy)

    @stage("coupling sums")
    def fields(self, force: Values, contact_radius: Values, saddle: Values | None = None) -> Fields:
        """The neighbours' fields: pairs within the cutoff plus the Fourier series.

        Saddle, cubic and quartic terms and those of the neighbours' extent come from those pairs alone.
        """
        count_terms(2 * force.size)
        turn = 2 * np.pi / (self._modes * self._cell)
        k_x = turn * np.arange(-self._modes // 2, self._modes // 2)[:, None]
        k_y = turn * np.arange(-self._rim, self._modes // 2)
        widening = force * contact_radius**2 / 10
        modes = self._to_modes(force)
        slope_x, slope_y = (self._from_modes(1j * k * modes) for k in (k_x, k_y))
        curvature = self._from_modes(-0.5 * (k_x**2 + k_y**2) * modes)
        excess = self._from_modes(-(k_x**2 + k_y**2) * self._to_modes(widening))
        own = -8 / 3 * self._sharpness**3 / np.pi**1.5  # Laplacian of the smooth part at its centre
        near = self._near.fields(force, contact_radius, saddle)
        found = replace(
            near,
            excess=near.excess + excess - own * widening,
            slope_x=near.slope_x + slope_x,
            slope_y=near.slope_y + slope_y,
            curvature=near.curvature + curvature - own * 0.5 * force,
        )
        return self._kernel.relieved(found, force, contact_radius)
