"""Contacts of many caps on a half-space to about 1e-7: answers to hold the contact models against.

Independent of `contactimg.models`: no Hertz, no point forces, no expansion of the neighbours' field. Each
contact is the image of the unit disc under a polynomial ``f`` of a complex variable. On the disc the pressure
is ``sqrt(1 - rho^2)`` times a polynomial plus ``1/sqrt(1 - rho^2)`` times a harmonic polynomial. The latter
says how far the edge has to move: at the solution it vanishes for a smooth contact (Johnson, Contact
Mechanics, section 5.1), and with adhesion it is what the work of adhesion holds, a tension of ``sqrt(w E*/(pi
s))`` at a distance ``s`` from the edge (JKR). The displacement, ``1/(pi E*)`` times the integral of ``p/r``,
follows the gap at collocation points, in the sense of least squares. A second answer with polynomials of
higher degree shows the error.

Lengths are in any unit, forces over ``E*`` in that unit squared, places complex numbers.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.special import eval_jacobi, poch

from contactimg.compiled import njit

Gap = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""``gap(row, x, y)``: depth of cap ``row`` below the first touch, over the points ``x, y``."""

MAX_ITERATIONS = 60
"""Most iterations. A safety limit: six to fifteen suffice."""

FAR, MIDDLE, NEAR = (8, 20), (14, 48), (32, 160)
"""Radial and angular nodes of the quadrature over a contact, for the displacement at others: from three radii
on, from 1.6 on, nearer."""

OUTERMOST = 0.97
"""Largest radius of a collocation point on the unit disc: nearer to the edge the quadrature loses digits."""


@dataclass(frozen=True)
class DiscBasis:
    """Pressures on the unit disc and the quadrature of ``p/r`` at collocation points.

    Parameters
    ----------
    degree : int
        Of the polynomials.
    axial : int
        By how much the degree of the axisymmetric ones is higher: spheres far from paraboloids need it.
    angles, depths : int
        Quadrature nodes around and along each ray from a collocation point.
    """

    degree: int
    axial: int = 6
    angles: int = 96
    depths: int = 20

    @cached_property
    def harmonics(self) -> list[tuple[int, bool]]:
        """Order and kind (True: sine) of the angular functions."""
        return [(0, False)] + [(m, sine) for m in range(1, self.degree + 1) for sine in (False, True)]

    @cached_property
    def points(self) -> np.ndarray:
        """Collocation points (n,), complex."""
        radial, around = (self.degree + self.axial) // 2 + 4, 2 * self.degree + 5
        rho = OUTERMOST * np.sin(0.5 * np.pi * (np.arange(radial) + 0.5) / radial)
        turn = 2 * np.pi * np.arange(around) / around
        return (rho[:, None] * np.exp(1j * (turn + np.arange(radial)[:, None]))).ravel()

    @cached_property
    def rays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Nodes (n, q), their weights for ``1/r`` with ``sqrt(1 - rho^2)`` and with its inverse."""
        zeta = self.points[:, None, None]
        turn = np.exp(2j * np.pi * np.arange(self.angles) / self.angles)[None, :, None]
        t, weight = np.polynomial.legendre.leggauss(self.depths)
        t, weight = 0.5 * (t + 1), 0.5 * weight
        along = (zeta * np.conj(turn)).real
        half = np.sqrt(1 - np.abs(zeta) ** 2 + along**2)
        ahead, behind = half - along, half + along
        s = ahead * (1 - t**2)
        measure = 2 * ahead * t * weight * 2 * np.pi / self.angles
        root = t * np.sqrt(ahead * (s + behind))
        nodes = zeta + s * turn
        flat = (self.points.size, -1)
        return nodes.reshape(flat), (measure * root).reshape(flat), (measure / root).reshape(flat)

    def terms(self, m: int) -> int:
        """Number of radial functions of an angular order that multiply ``sqrt(1 - rho^2)``."""
        return (self.degree + (0 if m else self.axial) - 2 - m) // 2 + 1

    def smooth(self, zeta: np.ndarray) -> np.ndarray:
        """The polynomials (..., k) that multiply ``sqrt(1 - rho^2)``, up to the degree less two."""
        orders = range(self.degree - 1)
        columns = np.empty((sum(self.terms(m) * (1 + (m > 0)) for m in orders), *zeta.shape))
        number, squared, power = 0, 2 * np.abs(zeta) ** 2 - 1, np.ones_like(zeta)
        for m in orders:
            radial = [eval_jacobi(k, 0.5, m, squared) for k in range(self.terms(m))]
            for turning in (power.real, power.imag) if m else (power.real,):
                for part in radial:
                    np.multiply(turning, part, out=columns[number])
                    number += 1
            power = power * zeta
        return np.moveaxis(columns, 0, -1)

    def singular(self, zeta: np.ndarray) -> np.ndarray:
        """The harmonic polynomials (..., 2 degree + 1) that multiply ``1/sqrt(1 - rho^2)``."""
        columns, power = [np.ones(zeta.shape)], np.ones_like(zeta)
        for _ in range(self.degree):
            power = power * zeta
            columns += [power.real, power.imag]
        return np.moveaxis(np.array(columns), 0, -1)

    @cached_property
    def weighted(self) -> tuple[np.ndarray, np.ndarray]:
        """Both sets at the nodes of `rays`, with their weights: (n, q, k)."""
        nodes, root, inverse = self.rays
        smooth, singular = self.smooth(nodes), self.singular(nodes)
        smooth *= root[..., None]
        singular *= inverse[..., None]
        return smooth, singular

    @cached_property
    def circle(self) -> np.ndarray:
        """Displacement at the collocation points by both sets on a circle, exact less by quadrature.

        ``rho^m P_k(-1/2, m) e^(i m t)/sqrt(1 - rho^2)`` displaces in proportion to its own polynomial.
        """
        exact = np.hstack([self._exact(smooth=True), self._exact(smooth=False)])
        return exact - _displacement(self, np.ones(self.rays[0].shape))

    def _exact(self, *, smooth: bool) -> np.ndarray:
        columns, x = [], np.cos(np.pi * (np.arange(40) + 0.5) / 40)
        at = 2 * np.abs(self.points) ** 2 - 1
        for m, sine in self.harmonics[: 2 * (self.degree - 2) + 1] if smooth else self.harmonics:
            k = np.arange(self.terms(m) + 1)
            n = m + 2 * k
            factor = poch((n - m + 1) / 2, 0.5) * poch((n + m + 1) / 2, 0.5)
            family = eval_jacobi(k, -0.5, m, x[:, None])
            own = (
                0.5 * (1 - x)[:, None] * eval_jacobi(k[:-1], 0.5, m, x[:, None]) if smooth else family[:, :1]
            )
            parts = np.linalg.lstsq(family, own, rcond=None)[0]
            radial = eval_jacobi(k, -0.5, m, at[:, None]) / factor @ parts
            columns.append(_turning(self.points, m, sine)[:, None] * radial)
        return np.hstack(columns)

    def area_nodes(self, radial: int, around: int) -> tuple[np.ndarray, np.ndarray]:
        """Nodes of the disc and the weights of ``sqrt(1 - rho^2)`` and of its inverse."""
        z, weight = np.polynomial.legendre.leggauss(radial)
        z, weight = 0.5 * (z + 1), 0.5 * weight  # z = sqrt(1 - rho^2), rho drho = -z dz
        rho = np.sqrt(1 - z**2)
        turn = np.exp(2j * np.pi * np.arange(around) / around)
        nodes = (rho[:, None] * turn).ravel()
        cell = np.repeat(2 * np.pi / around * weight, around)
        return nodes, cell * np.repeat(z**2, around), cell


@lru_cache(maxsize=1)  # one of degree 10 holds 300 MB
def _last_basis(degree):
    """The basis of a degree, kept for the next problem."""
    return DiscBasis(degree)


def _turning(zeta, m, sine):
    power = zeta**m
    return power.imag if sine else power.real


@dataclass
class Contact:
    """One contact: its place, the polynomial of its shape, its pressure."""

    row: int
    shape: np.ndarray  # of f, complex: shape[0] + shape[1] zeta + shape[2] zeta^2 ...
    smooth: np.ndarray
    singular: np.ndarray
    moved: float = 1.0
    misfit: float = 1.0

    def place(self, zeta):
        return np.polynomial.polynomial.polyval(zeta, self.shape)

    def slope(self, zeta):
        return np.polynomial.polynomial.polyval(zeta, np.polynomial.polynomial.polyder(self.shape))

    @property
    def area(self) -> float:
        """Green: ``pi sum n |f_n|^2``."""
        return float(np.pi * np.sum(np.arange(self.shape.size) * np.abs(self.shape) ** 2))


@dataclass(frozen=True)
class CapProblem:
    """What is pressed.

    Parameters
    ----------
    gap : callable
    place : ndarray, shape (n,), complex
        Summits of the caps.
    load : float or None
        Over ``E*``; None if the indentation is prescribed.
    indentation : float
        Prescribed, or a guess.
    adhesion : float
        Work of adhesion over ``E*`` (JKR).
    """

    gap: Gap
    place: np.ndarray
    load: float | None
    indentation: float
    adhesion: float = 0.0


@dataclass(frozen=True)
class Answer:
    """Forces over ``E*`` and areas of all caps and the indentation.

    ``change`` is the last relative change of forces and edges, ``misfit`` the root mean square distance
    between displacement and gap over the range of the gap, in the worst contact.
    """

    force: np.ndarray
    area: np.ndarray
    indentation: float
    change: float
    misfit: float


def solve_caps(
    problem: CapProblem, force: np.ndarray, radius: np.ndarray, *, degree: int = 6, tolerance: float = 1e-9
) -> Answer:
    """Solve from rough forces and radii of all caps (zero: no contact)."""
    basis, depth, change = _last_basis(degree), problem.indentation, np.inf
    contacts = [
        _round(basis, row, problem.place[row], radius[row], force[row]) for row in np.flatnonzero(force)
    ]
    smallest = 1e-3 * float(np.median(radius[radius > 0]))
    for _ in range(MAX_ITERATIONS):
        contacts, depth, change = _improve(basis, problem, contacts, depth)
        if change < tolerance:
            rows, places = _missed(basis, problem, contacts, depth, 30 * smallest)
            if not rows.size:
                return _answer(basis, problem, contacts, depth, change)
            contacts += [
                _round(basis, row, place, smallest, 0.0) for row, place in zip(rows, places, strict=True)
            ]
    raise RuntimeError(f"not solved in {MAX_ITERATIONS} iterations: the last change is {change:.2g}")


def _round(basis, row, place, radius, force):
    """Hertz's contact as the start."""
    shape = np.zeros(basis.degree + 2, complex)
    shape[0], shape[1] = place, radius
    smooth = np.zeros(basis.smooth(np.zeros(1, complex)).shape[-1])
    smooth[0] = 1.5 * force / (np.pi * radius**2)
    return Contact(row, shape, smooth, np.zeros(2 * basis.degree + 1))


def _improve(basis, problem, contacts, depth):
    """Solve each contact in the field of the others, then one Newton step of forces and indentation.

    The step takes the contacts for point forces on springs of stiffness ``2 a``: it affects the number of
    iterations, not the solution.
    """
    outside = _outside(basis, contacts)
    pairs = [
        (contact, _fit(basis, problem, contact, depth - field))
        for contact, field in zip(contacts, outside, strict=True)
    ]
    pairs = [(before, after) for before, after in pairs if after is not None]
    solved = [after for _, after in pairs]
    old = np.array([_force(basis, before) for before, _ in pairs])
    new = np.array([_force(basis, after) for after in solved])
    a = np.sqrt([contact.area / np.pi for contact in solved])
    place = np.array([contact.shape[0] for contact in solved])
    apart = np.abs(place[:, None] - place)
    np.fill_diagonal(apart, np.inf)
    matrix = np.eye(len(solved)) + (2 * a)[:, None] / (np.pi * apart)
    answer = np.linalg.solve(matrix, np.column_stack([new - old, 2 * a]))
    rise = 0.0
    if problem.load is not None:
        rise = (problem.load - old.sum() - answer[:, 0].sum()) / answer[:, 1].sum()
    step = answer @ [1.0, rise]
    for contact, times in zip(solved, np.clip((old + step) / new, 0.2, 5.0), strict=True):
        contact.smooth *= times
        contact.singular *= times
    moved = max(contact.moved for contact in solved)
    change = float(np.abs(step).sum() + np.abs(new - old).sum()) / float(new.sum())
    return solved, depth + rise, max(change, moved, float(len(solved) < len(contacts)))


def _force(basis, contact):
    nodes, root, inverse = basis.area_nodes(16, 4 * basis.degree + 8)
    pressure = (
        basis.smooth(nodes) @ contact.smooth * root + basis.singular(nodes) @ contact.singular * inverse
    )
    return float(np.sum(pressure * np.abs(contact.slope(nodes)) ** 2))


def _outside(basis, contacts):
    """Displacement at the collocation points of each contact by all others (contacts, points)."""
    place = np.array([contact.shape[0] for contact in contacts])
    a = np.array([np.abs(contact.shape[1]) for contact in contacts])
    points = np.array([contact.place(basis.points) for contact in contacts])
    apart = (np.abs(place[:, None] - place) - a[:, None]) / a  # of the nearest point of i, in radii of j
    level = np.where(apart > 3, 0, np.where(apart > 1.6, 1, 2))
    np.fill_diagonal(level, -1)
    total = np.zeros(points.shape)
    for number, nodes in enumerate((FAR, MIDDLE, NEAR)):
        where, forces = _point_forces(basis, contacts, *nodes)
        _add_displacement(_parts(points), _parts(where), forces, level == number, total)
    return total


def _point_forces(basis, contacts, radial, around):
    """Quadrature of each contact's pressure as point forces (contacts, nodes)."""
    nodes, root, inverse = basis.area_nodes(radial, around)
    smooth, singular = basis.smooth(nodes) * root[:, None], basis.singular(nodes) * inverse[:, None]
    where = np.array([contact.place(nodes) for contact in contacts])
    stretch = np.array([np.abs(contact.slope(nodes)) ** 2 for contact in contacts])
    pressure = np.array([smooth @ c.smooth + singular @ c.singular for c in contacts])
    return where, pressure * stretch


def _parts(place):
    """Real and imaginary parts of places, as the first axis."""
    return np.stack([place.real, place.imag])


@njit(fastmath=True)
def _add_displacement(points, nodes, force, counted, total):
    """Add the displacement at the points of ``i`` by the point forces of ``j``, for the pairs counted."""
    for i in range(total.shape[0]):
        for j in range(force.shape[0]):
            if not counted[i, j]:
                continue
            for k in range(total.shape[1]):
                value = 0.0
                for n in range(force.shape[1]):
                    dx, dy = points[0, i, k] - nodes[0, j, n], points[1, i, k] - nodes[1, j, n]
                    value += force[j, n] / np.sqrt(dx * dx + dy * dy)
                total[i, k] += value / np.pi


def _own(basis, contact):
    """Displacement at the collocation points per unit of each pressure: smooth, then singular."""
    nodes, *_ = basis.rays
    stretch = _stretch(nodes, basis.points, contact.place(basis.points), contact.shape)
    return _displacement(basis, stretch) + contact.shape[1].real * basis.circle


@njit()
def _stretch(nodes, points, middle, shape):
    """``dA/r`` of the contact over the disc's at the nodes of the rays from each point, by Horner's rule.

    ``middle`` is where the shape puts the points.
    """
    stretch = np.empty(nodes.shape)
    place, slope = np.empty(nodes.shape[1], np.complex128), np.empty(nodes.shape[1], np.complex128)
    for i in range(points.size):
        place[:] = 0.0
        slope[:] = 0.0
        for n in range(shape.size - 1, -1, -1):
            for k in range(place.size):
                slope[k] = slope[k] * nodes[i, k] + place[k]
                place[k] = place[k] * nodes[i, k] + shape[n]
        for k in range(place.size):
            on_disc, apart = nodes[i, k] - points[i], place[k] - middle[i]
            longer = (on_disc.real**2 + on_disc.imag**2) / (apart.real**2 + apart.imag**2)
            stretch[i, k] = (slope[k].real ** 2 + slope[k].imag ** 2) * np.sqrt(longer)
    return stretch


def _displacement(basis, stretch):
    """``1/pi`` times the integral of ``p/r``; ``stretch`` is ``dA/r`` of the contact over the disc's."""
    return np.hstack([np.matmul(stretch[:, None], part)[:, 0] / np.pi for part in basis.weighted])


def _fit(basis, problem, contact, level):
    """Shape and pressure of a contact where the surface may rise to ``level`` at its collocation points.

    ``level`` is the indentation less the others' displacement.
    """
    matrix = _own(basis, contact)
    at = contact.place(basis.points)
    wanted = level - problem.gap(contact.row, at.real, at.imag)
    found = np.linalg.lstsq(matrix, wanted, rcond=None)[0]
    count = contact.smooth.size
    smooth, edge = found[:count], found[count:]
    turn = np.exp(2j * np.pi * np.arange(4 * basis.degree + 8) / (4 * basis.degree + 8))
    carried, singular = basis.smooth(turn) @ smooth, basis.singular(turn) @ edge
    held = -np.sqrt(2 * problem.adhesion / (np.pi * np.abs(contact.slope(turn))))
    mean = carried.mean() + 0.5 * held.mean()
    if mean <= 0:
        if singular.mean() <= 0:
            return None
        grow = np.full(turn.size, 0.5)
    else:
        grow = np.clip((singular - held) / np.maximum(carried + 0.5 * held, 0.1 * mean), -0.5, 0.5)
    moved = np.fft.fft(grow)[: basis.degree + 1] / turn.size * np.r_[1.0, np.full(basis.degree, 2.0)]
    shape = contact.shape.copy()
    a = shape[1].real
    # f grows by a e_m zeta^(m + 1) where the edge moves out by Re e_m zeta^m; m = 1 shifts the centre
    shape[1] += a * moved[0].real
    shape[0] += a * moved[1].conjugate()
    shape[3 : basis.degree + 2] += a * moved[2:]
    misfit = matrix @ found - wanted
    return Contact(
        contact.row,
        shape,
        smooth * (1 + moved[0].real),
        _modes(basis, held),
        float(np.abs(moved).sum()),
        float(np.sqrt(np.mean(misfit**2)) / np.ptp(wanted)),
    )


def _modes(basis, values):
    """Coefficients of the singular functions that take these values around the edge."""
    modes = np.fft.fft(values)[: basis.degree + 1] / values.size
    return np.r_[modes[0].real, 2 * np.column_stack([modes[1:].real, -modes[1:].imag]).ravel()]


def _missed(basis, problem, contacts, depth, step):
    """Rows out of contact where the surfaces would overlap, and where they would most.

    By the parabola through five points about the summit, ``step`` apart.
    """
    free = np.setdiff1d(np.arange(problem.place.size), [contact.row for contact in contacts])
    where, forces = _point_forces(basis, contacts, *MIDDLE)
    points = problem.place[free, None] + step * np.array([0, 1, -1, 1j, -1j])
    total, counted = np.zeros(points.shape), np.ones((free.size, len(contacts)), dtype=bool)
    _add_displacement(_parts(points), _parts(where), forces, counted, total)
    overlap = depth - total - problem.gap(free[:, None], points.real, points.imag)
    middle, right, left, up, down = overlap.T
    bend = (4 * middle - right - left - up - down) / (2 * step**2)
    slope = (right - left + 1j * (up - down)) / (2 * step)
    touching = middle + np.abs(slope) ** 2 / (2 * bend) > 0
    return free[touching], (problem.place[free] + slope / bend)[touching]


def _answer(basis, problem, contacts, depth, change):
    force, area = np.zeros(problem.place.size), np.zeros(problem.place.size)
    for contact in contacts:
        force[contact.row], area[contact.row] = _force(basis, contact), contact.area
    return Answer(force, area, float(depth), change, max(contact.misfit for contact in contacts))
