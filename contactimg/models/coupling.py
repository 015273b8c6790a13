"""Elastic coupling: displacement of the surface at every candidate by the forces on all candidates.

Dimensionless (``E* = 1``): a force ``q`` displaces a half-space at a distance ``r`` by ``q/(pi r)`` and a
bonded layer of thickness ``t`` by ``q/pi [1/r - phi(r/t)/t]``. A coupling operator multiplies its matrix
``C`` by a vector of forces and solves the Newton system ``(I + S C S) z = b`` on the active rows, ``S`` the
diagonal matrix of ``s = sqrt(2 a)``. This matrix is close to the identity unless contacts nearly overlap:
conjugate gradients need few steps.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.linalg import lapack

from contactimg.compiled import njit
from contactimg.mechanics import layer

Values = NDArray[np.float64]
Rows = NDArray[np.intp]

NewtonStep = tuple[Values, float]
"""Changes of the scaled forces, and of the indentation."""


class NotPositiveDefinite(ArithmeticError):  # noqa: N818 - a state of the iteration, not a user error
    """The Newton matrix is indefinite because contacts overlap too far."""


@dataclass(frozen=True, eq=False)
class NewtonSystem:
    """The right-hand sides of the Newton system of some contacts, and its border.

    Parameters
    ----------
    scale : ndarray, shape (n,)
        ``s = sqrt(2 a)``.
    side : ndarray, shape (n,)
        ``b``.
    missing : float or None
        By how much the sum of the forces is to rise; None at prescribed indentation.
    """

    scale: Values
    side: Values
    missing: float | None = None

    def eliminate(self, from_side: Values, from_scale: Values) -> tuple[Values, float]:
        """The solution from those of ``A z = b`` and of ``A z = s``."""
        if self.missing is None:
            return from_side, 0.0
        rise = (self.missing - float(self.scale @ from_side)) / float(self.scale @ from_scale)
        return from_side + rise * from_scale, rise


def conjugate_gradients(
    apply: Callable[[Values], Values],
    system: NewtonSystem,
    tolerance: float,
    precondition: Callable[[Values], Values] = np.copy,
    most_steps: int = 200,
) -> tuple[Values, float, bool]:
    """Solve a Newton system with a positive definite matrix: ``z``, the rise, and whether it is solved.

    ``tolerance`` is that of the residual, relative to ``b`` and to what the rise adds to it. ``most_steps``
    are chosen: the matrix is close to the identity, so that fewer usually suffice.
    """
    scale, shared = system.scale, precondition(system.scale)
    share = 0.0 if system.missing is None else 1 / float(scale @ shared)

    def conditioned(residual: Values) -> tuple[Values, float]:
        change = precondition(residual)
        rise = -share * float(scale @ change)
        return change + rise * shared, rise

    rise = (system.missing or 0.0) * share
    solution = rise * shared
    residual = system.side + rise * scale - (apply(solution) if rise else 0.0)
    goal = tolerance**2 * float(system.side @ system.side + (rise * scale) @ (rise * scale))
    direction, direction_rise = change, change_rise = conditioned(residual)
    square = float(residual @ change)
    for _ in range(most_steps):
        remaining = residual + change_rise * scale
        if float(remaining @ remaining) <= goal:
            return solution, rise + change_rise, True
        image = apply(direction) - direction_rise * scale
        curvature = float(direction @ image)
        if curvature <= 0:
            raise NotPositiveDefinite
        step = square / curvature
        solution += step * direction
        rise += step * direction_rise
        residual -= step * image
        change, change_rise = conditioned(residual)
        before, square = square, float(residual @ change)
        direction = change + square / before * direction
        direction_rise = change_rise + square / before * direction_rise
    return solution, rise + change_rise, False


@dataclass(frozen=True, eq=False)
class Kernel:
    """Half-space or bonded layer.

    Parameters
    ----------
    thinness : float
        ``1/t``; zero for a half-space.
    value, slope : ndarray
        `contactimg.mechanics.layer.deficit_table`, empty for a half-space.
    between : bool
        Whether it acts between contacts only, because the law of a contact has what the support reflects of
        its own pressure; else the support acts on the contact itself as on the others.
    """

    thinness: float
    value: Values
    slope: Values
    between: bool = False

    @classmethod
    def of_thickness(cls, thickness: float, poisson_ratio: float = 0.5, *, between: bool = False) -> "Kernel":
        """The kernel of a layer; of a half-space if the thickness is infinite."""
        if np.isinf(thickness):
            return cls(0.0, np.zeros(0), np.zeros(0))
        return cls(1 / thickness, *layer.deficit_table(poisson_ratio), between)

    @property
    def relief(self) -> tuple[float, float]:
        """Deficit of the displacement by a unit of ``q/pi`` at its own place, and its Laplacian there."""
        if not (self.between and self.thinness):
            return 0.0, 0.0
        value, _, laplacian = layer_deficit(0.0, self.thinness, self.value, self.slope)
        return value, laplacian

    def displacement(self, x: Values, y: Values, sources: Values, force: Values) -> Values:
        """Displacement at places ``x, y`` by point forces at other places (2, n), summed pair by pair."""
        # squared distances are to be of the order of one
        unit = (float(np.ptp(sources)) if force.size else 0.0) or 1.0
        table = self.thinness * unit, self.value, self.slope
        return np.asarray(direct_sum(x / unit, y / unit, sources / unit, force / unit, *table))

    def largest_rise(self) -> float:
        """Largest rise of a layer by a unit of ``q/pi``, ``max(phi(s) - 1/s)/t``; 0 for a half-space."""
        if not self.thinness:
            return 0.0
        s = layer.STEP * np.arange(1, self.value.size)
        return self.thinness * max(float(np.max(self.value[1:] - 1 / s)), 0.0)

    def deficit(self, r: Values) -> Values:
        """``phi(r/t)/t`` of a layer."""
        knots = layer.STEP * np.arange(self.value.size)
        s = r * self.thinness
        inside = CubicHermiteSpline(knots, self.value, self.slope)(np.minimum(s, knots[-1]))
        return self.thinness * np.where(s < knots[-1], inside, 1 / np.maximum(s, knots[-1]))


class Fields(NamedTuple):
    """The neighbours' displacement field at each candidate, beyond the value for point forces.

    Parameters
    ----------
    excess : ndarray
        Displacement by Hertz's pressure of the neighbours less that by point forces.
    slope_x, slope_y : ndarray
        Slope of the displacement, with the extent of the neighbours' pressure.
    curvature : ndarray
        Half the Laplacian of the displacement: its curvature averaged over all directions; with that extent.
    quartic : ndarray
        The displacement averaged over a circle of radius ``rho`` about the candidate contains ``quartic
        rho^4``: 1/64 of the squared Laplacian.
    saddle_x, saddle_y : ndarray
        Half the difference of the displacement's principal curvatures, times the cosine and the sine of twice
        the direction of the larger one.
    cubic_x, cubic_y : ndarray
        1/8 of the gradient of the Laplacian: about the candidate the displacement contains ``rho^2`` times
        the scalar product with this vector.
    """

    excess: Values
    slope_x: Values
    slope_y: Values
    curvature: Values
    quartic: Values
    saddle_x: Values
    saddle_y: Values
    cubic_x: Values
    cubic_y: Values


MIN_ITERATIVE_CONTACTS = 64
"""Fewest contacts whose Newton system is solved by conjugate gradients. Chosen by hand: it affects the time
only; sensitivity not measured."""

MAX_DENSE_STEPS = 60
"""Most conjugate-gradient steps before a stored matrix is factorised instead. Measured: 300 contacts of the
pattern SA+ at 0.5 N need 15 to a residual of 1e-10."""


class Coupling:
    """Displacement of the surface at the candidates by the forces on them; of independent contacts none.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        Candidates; where they are coupled, no two may coincide.
    kernel : Kernel
    """

    def __init__(self, x: Values, y: Values, kernel: Kernel) -> None:
        self._x, self._y, self._kernel = x, y, kernel

    def displacement(self, force: Values) -> Values:
        """``C q``: displacement into the body at every candidate."""
        return np.zeros_like(force)

    def solve_newton_system(self, active: Rows, system: NewtonSystem, tolerance: float) -> NewtonStep:  # noqa: ARG002
        """Solve ``(I + S C S) z = b + s rho`` on the active rows: ``z`` and the rise ``rho``."""
        return system.eliminate(system.side, system.scale)

    def check_definite(self, active: Rows, scale: Values) -> None:
        """Raise `NotPositiveDefinite` if the matrix of that system is not positive definite."""

    def fields(self, force: Values, contact_radius: Values, saddle: Values | None = None) -> Fields:
        """The neighbours' fields at every candidate, summed pair by pair.

        ``saddle`` (2, n) is what the contacts lie in, which makes them elliptic; None for circles.
        """
        loaded, k = np.flatnonzero(force * contact_radius), self._kernel
        elliptic = np.zeros((2, force.size)) if saddle is None else saddle
        # Theory: a saddle t cos(2 phi) rho^2/2 over a circle of radius a changes the pressure such that, to
        # first order, the displacement at a distance is (8/15) a^5 t cos(2 phi)/(pi r^3) less, whatever the
        # profile
        long = 8 / 15 / np.pi * contact_radius**5 * elliptic
        table = k.thinness, k.value, k.slope
        fields = Fields(*_pair_fields(self._x, self._y, loaded, force, contact_radius, long, *table))
        bend = k.relief[1] * force / np.pi  # that of the contacts themselves, which is in their law
        excess, curvature = fields.excess + 0.1 * contact_radius**2 * bend, fields.curvature + 0.5 * bend
        return fields._replace(excess=excess, curvature=curvature)

    def at_positions(self, x: Values, y: Values) -> Self:
        """A coupling of the same kind between candidates at other places."""
        return type(self)(x, y, self._kernel)


class DenseCoupling(Coupling):
    """A stored matrix, up to some thousand candidates; its rows are computed when they are first needed.

    Most candidates never bear a force, and only the rows of those that do are read.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
    kernel : Kernel
    own : float or ndarray
        Displacement of a candidate by a unit force on itself, the diagonal.
    """

    def __init__(self, x: Values, y: Values, kernel: Kernel, *, own: float | Values = 0.0) -> None:
        super().__init__(x, y, kernel)
        self._own = np.broadcast_to(np.asarray(own) + kernel.relief[0] / np.pi, x.shape)
        self._matrix = np.empty((x.size, x.size))
        self._known = np.zeros(x.size, dtype=np.bool_)

    @property
    def matrix(self) -> Values:
        """The whole matrix ``C``."""
        return self._with_rows(np.arange(self._x.size))

    def _with_rows(self, rows: Rows) -> Values:
        """``C``, of which these rows have been computed."""
        k, missing = self._kernel, rows[~self._known[rows]]
        if missing.size:
            table = k.thinness, k.value, k.slope
            _fill_coupling_rows(self._matrix, missing, self._x, self._y, self._own, *table)
            self._known[missing] = True
        return self._matrix

    def displacement(self, force: Values) -> Values:
        """``C q``, over the candidates that carry a force."""
        loaded = np.flatnonzero(force)
        return _weighted_rows(self._with_rows(loaded), loaded, force)

    def solve_newton_system(self, active: Rows, system: NewtonSystem, tolerance: float) -> NewtonStep:
        """Solve by conjugate gradients; if they are slow or the contacts few, by Cholesky, to rounding."""
        matrix = _newton_matrix(self._with_rows(active), active, system.scale)
        if active.size >= MIN_ITERATIVE_CONTACTS:
            solution, rise, solved = conjugate_gradients(
                matrix.__matmul__, system, tolerance, most_steps=MAX_DENSE_STEPS
            )
            if solved:
                return solution, rise
        sides = np.column_stack([system.side, system.scale])
        solutions, _ = lapack.dpotrs(_cholesky_factor(matrix), sides, lower=1)
        return system.eliminate(*solutions.T)

    def check_definite(self, active: Rows, scale: Values) -> None:
        """Refuse a matrix that Cholesky's factorisation finds indefinite."""
        _cholesky_factor(_newton_matrix(self._with_rows(active), active, scale))


def _cholesky_factor(system: Values) -> Values:
    """The lower factor of a symmetric matrix, which is overwritten; `NotPositiveDefinite` if it has none."""
    # the upper triangle in C order is the lower one for LAPACK, whose factorisation is the faster
    factor, failed = lapack.dpotrf(system.T, lower=1, clean=0, overwrite_a=1)
    if failed:
        raise NotPositiveDefinite
    return factor


@njit(cache=True)
def layer_deficit(r, thinness, value, slope):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """``phi(r/t)/t``, its derivative and its Laplacian in ``r``, by cubic Hermite interpolation."""
    s = r * thinness
    place = s / layer.STEP
    k = int(place)
    if k + 1 >= value.size:
        return 1.0 / r, -1.0 / r**2, 1.0 / r**3
    f = place - k
    rise = value[k + 1] - value[k]
    left, right = slope[k] * layer.STEP - rise, rise - slope[k + 1] * layer.STEP
    bend = f * (1 - f) * (left * (1 - f) + right * f)
    first = (rise + (1 - 2 * f) * (left * (1 - f) + right * f) + f * (1 - f) * (right - left)) / layer.STEP
    second = (2 * (1 - 2 * f) * (right - left) - 2 * (left * (1 - f) + right * f)) / layer.STEP**2
    over = first / s if s > 0.5 * layer.STEP else second
    return (thinness * (value[k] + f * rise + bend), thinness**2 * first, thinness**3 * (second + over))


@njit(cache=True, error_model="numpy", inline="always")
def _inverse_root(square):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """``1/sqrt(square)`` to rounding, by two Newton steps from single precision: 1.5 times as fast in a loop.

    Squared distances between 1e-37 and 1e37, in units of a contact's size; beyond, that of the limit.
    """
    square = min(max(square, 1e-37), 1e37)
    root = np.float64(np.float32(1.0) / np.sqrt(np.float32(square)))
    root *= 1.5 - 0.5 * square * root * root
    return root * (1.5 - 0.5 * square * root * root)


@njit(cache=True, error_model="numpy")
def _fill_coupling_rows(matrix, rows, x, y, diagonal, thinness, value, slope):  # type: ignore[no-untyped-def]  # noqa: PLR0917  # pragma: no cover
    """``C_ij = 1/(pi r_ij)``, less the layer's deficit if there is one.

    Whole rows are computed although the matrix is symmetric: the plain loop over a row is vectorised, a
    mirrored store is not.
    """
    for i in rows:
        for j in range(x.size):
            dx, dy = x[i] - x[j], y[i] - y[j]
            matrix[i, j] = 1 / np.pi * _inverse_root(dx * dx + dy * dy)
        matrix[i, i] = 0.0
        if thinness > 0.0:
            for j in range(x.size):
                r = np.sqrt((x[i] - x[j]) ** 2 + (y[i] - y[j]) ** 2)
                matrix[i, j] -= layer_deficit(r, thinness, value, slope)[0] / np.pi
        matrix[i, i] += diagonal[i]


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def direct_sum(x, y, sources, strength, thinness, value, slope):  # type: ignore[no-untyped-def]  # noqa: PLR0917  # pragma: no cover
    """Displacement at places ``x, y`` by a few point forces at other places, pair by pair."""
    total = np.zeros(x.size)
    for i in range(x.size):
        for j in range(strength.size):
            dx, dy = x[i] - sources[0, j], y[i] - sources[1, j]
            total[i] += strength[j] * _inverse_root(dx * dx + dy * dy)
        if thinness > 0.0:
            for j in range(strength.size):
                r = np.sqrt((x[i] - sources[0, j]) ** 2 + (y[i] - sources[1, j]) ** 2)
                total[i] -= strength[j] * layer_deficit(r, thinness, value, slope)[0]
    return total / np.pi


@njit(cache=True)
def _weighted_rows(matrix, rows, weights):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Sum of some rows of a matrix with weights given for all."""
    total = np.zeros(matrix.shape[1])
    for row in rows:
        for j in range(total.size):
            total[j] += weights[row] * matrix[row, j]
    return total


@njit(cache=True)
def _newton_matrix(matrix, active, scale):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """``I + S C S`` on the active rows."""
    n = active.size
    system = np.empty((n, n))
    for i in range(n):
        row = active[i]
        for j in range(n):
            system[i, j] = scale[i] * matrix[row, active[j]] * scale[j]
        system[i, i] += 1.0
    return system


CLOSE_RATIO = 0.15
"""``a/r`` up to which `displacement_excess` is its series.

Theory: the next term, 429/174080 (a/r)^14, is 7e-15 of the displacement.
"""


@njit(cache=True, inline="always")
def _distant_excess(q2):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """`displacement_excess` of distant contacts, at the square of ``a/r``."""
    far = 35 / 4224 + q2 * (189 / 36608 + q2 * (231 / 66560))
    return q2 * (1 / 10 + q2 * (9 / 280 + q2 * (5 / 336 + q2 * far)))


@njit(cache=True)
def displacement_excess(ratio):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Displacement by Hertz's pressure over that by a point force, less one, at ``ratio = a/r``.

    The scalar of `contactimg.mechanics.hertz.displacement_factor`, continued inside the contact circle.
    """
    q2 = ratio * ratio
    if ratio < CLOSE_RATIO:
        return _distant_excess(q2)
    if ratio < 1.0:
        closed = (2 * q2 - 1) * np.arcsin(ratio) + ratio * np.sqrt(1 - q2)
        return 0.75 * closed / (ratio * q2) - 1.0
    return 0.75 * np.pi * (1.0 - 0.5 / q2) / ratio - 1.0


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def _distant_fields(dx, dy, strength, size2, long_x, long_y):  # type: ignore[no-untyped-def]  # noqa: PLR0917  # pragma: no cover
    """Fields of a half-space at one candidate; the excess of close contacts as if they were at `CLOSE_RATIO`.

    A plain loop without calls, so that it is vectorised; a contact at distance zero is the candidate itself.
    """
    excess, slope_x, slope_y, curvature, quartic = 0.0, 0.0, 0.0, 0.0, 0.0
    saddle_x, saddle_y, cubic_x, cubic_y = 0.0, 0.0, 0.0, 0.0
    for j in range(dx.size):
        r2 = dx[j] * dx[j] + dy[j] * dy[j]
        apart = 1.0 if r2 > 0.0 else 0.0
        inverse = 1.0 / np.sqrt(r2 if r2 > 0.0 else 1.0)
        weight = strength[j] * apart * inverse
        inverse2 = inverse * inverse
        q2 = size2[j] * inverse2
        distant = q2 if q2 < CLOSE_RATIO * CLOSE_RATIO else CLOSE_RATIO * CLOSE_RATIO
        along, across = (dx[j] * dx[j] - dy[j] * dy[j]) * inverse2, 2.0 * dx[j] * dy[j] * inverse2
        flattened = (long_x[j] * along + long_y[j] * across) * apart * inverse * inverse2
        excess += weight * _distant_excess(distant) - flattened
        weight *= inverse2
        # Hertz's pressure displaces by 1/r + a^2/(10 r^3): 0.3 (a/r)^2 more slope, and half the Laplacian of
        # the second term is 0.45 a^2/r^5; the squared Laplacian of 1/r is 9/r^5; its curvatures in the plane,
        # 2/r^3 and -1/r^3, differ by twice 1.5/r^3; an eighth of the gradient of their sum is -3/8 of 1/r^4
        slope = weight * (1.0 + 0.3 * q2)
        slope_x -= slope * dx[j]
        slope_y -= slope * dy[j]
        curvature += weight * (0.5 + 0.45 * q2)
        quartic += 9 / 64 * weight * inverse2
        saddle_x += 1.5 * weight * along
        saddle_y += 1.5 * weight * across
        cubic_x -= 3 / 8 * weight * inverse2 * dx[j]
        cubic_y -= 3 / 8 * weight * inverse2 * dy[j]
    return excess, slope_x, slope_y, curvature, quartic, saddle_x, saddle_y, cubic_x, cubic_y


@njit(cache=True)
def _pair_fields(x, y, loaded, force, contact_radius, long, thinness, value, slope):  # type: ignore[no-untyped-def]  # noqa: PLR0917  # pragma: no cover
    """The fields of `Fields` at every candidate by the loaded ones."""
    n = x.size
    fields = np.zeros((9, n))
    x_loaded, y_loaded, radius = x[loaded], y[loaded], contact_radius[loaded]
    strength, size2 = force[loaded] / np.pi, radius * radius
    long_x, long_y = long[0][loaded], long[1][loaded]
    for i in range(n):
        dx, dy = x[i] - x_loaded, y[i] - y_loaded
        sums = _distant_fields(dx, dy, strength, size2, long_x, long_y)
        for k in range(9):
            fields[k, i] = sums[k]
        for j in range(loaded.size):
            r2 = dx[j] * dx[j] + dy[j] * dy[j]
            if size2[j] >= CLOSE_RATIO * CLOSE_RATIO * r2 and r2 > 0.0:
                r = np.sqrt(r2)
                counted = _distant_excess(CLOSE_RATIO * CLOSE_RATIO)
                fields[0, i] += strength[j] * (displacement_excess(radius[j] / r) - counted) / r
            if thinness > 0.0:
                r = np.sqrt(r2)
                _, first, laplacian = layer_deficit(r, thinness, value, slope)
                fields[0, i] -= strength[j] * 0.1 * size2[j] * laplacian
                fields[3, i] -= 0.5 * strength[j] * laplacian
                if r > 0.0:
                    fields[1, i] -= strength[j] * first * dx[j] / r
                    fields[2, i] -= strength[j] * first * dy[j] / r
                    saddle = strength[j] * (0.5 * laplacian - first / r) / r2
                    fields[5, i] -= saddle * (dx[j] * dx[j] - dy[j] * dy[j])
                    fields[6, i] -= saddle * 2.0 * dx[j] * dy[j]
    return fields
