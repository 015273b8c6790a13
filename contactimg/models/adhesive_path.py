"""Follow a set of adhesive contacts to equilibrium: contacts break and form until none overlaps or pulls off.

For a given set, Newton's method finds the contact radii and the indentation; the Newton system is dense and
unsymmetric.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.errors import ConvergenceError, ModelRangeError
from contactimg.models.asperity_laws import AdhesiveLaw, Caps
from contactimg.models.coupling import QUARTIC, DenseCoupling, Kernel
from contactimg.models.full_coupling import CapCorrection, bounded_saddle, pressure_radius
from contactimg.models.scaled_problem import ScaledProblem
from contactimg.models.solution import InteractingSolution

Values = NDArray[np.float64]
Rows = NDArray[np.intp]

MAX_CONTACTS = 10_000
"""Most adhesive contacts. Chosen by memory: their matrices take some 2 GB."""

MAX_TOTAL_STEPS = 5000
"""Most Newton steps for all sets of contacts of one solution. Chosen by time: 300 contacts take about 20
s."""

LOAD_TOLERANCE = 1e-8
"""Relative error of the load to which the iteration continues after the tolerance is met. Chosen: a hundredth
of the error up to which a solution counts as converged."""

_MIN_STEP_FRACTION = 2.0**-30
"""Shortest fraction of a Newton step in the line search. Chosen by hand; sensitivity not measured."""

MAX_FIELD_UPDATES = 30
"""Most updates of the field corrections of full coupling. Chosen by hand; sensitivity not measured."""

FIELD_UPDATE_CHANGE = 1e-10
"""Change of the contact radii, relative to the largest, at which the field corrections have converged. Chosen
by hand, close to the tolerance of the radii."""


@dataclass(frozen=True, eq=False)
class AdhesiveState:
    """A set of contacts (rows from the highest down) with radii, forces and ``D``, and all penetrations."""

    rows: Rows
    contact_radius: Values
    force: Values
    penetration: Values
    indentation: float
    residual: float
    contacts: "AdhesiveContacts | None" = None
    unsettled: float = 0.0

    def scattered(self, size: int) -> tuple[Values, Values, Values]:
        """Force, contact radius and penetration of all asperities."""
        force, contact_radius = np.zeros(size), np.zeros(size)
        force[self.rows], contact_radius[self.rows] = self.force, self.contact_radius
        return force, contact_radius, self.penetration


@dataclass(frozen=True, eq=False)
class AdhesivePath:
    """One problem of a path; without a kernel the contacts are independent."""

    problem: ScaledProblem
    law: AdhesiveLaw
    kernel: Kernel | None
    tolerance: float
    max_iterations: int
    base: ScaledProblem | None = None

    def field_gap(self, rows: Rows) -> Values:
        """What full coupling adds to the gaps of contacts."""
        return self.problem.gap[rows] - (self.base or self.problem).gap[rows]

    def follow(self, previous: InteractingSolution, *, first: bool) -> tuple[AdhesiveState, int]:
        """Let contacts break and form until the set is in equilibrium.

        First loading starts with the highest asperity in contact at prescribed load, and with the asperities
        that the indenter reaches at prescribed indentation.
        """
        p = self.problem
        radius = previous.radius[p.order] / p.length
        reached = p.indentation >= 0 if p.load is None or p.stiffness else True
        if first and not radius.any() and reached:
            radius[0] = self.law.touch_radius(p.caps[:1])[0]
        return self._settle(radius, previous.indentation / p.depth, first=first)

    def refined(self, state: AdhesiveState, steps: int) -> tuple["AdhesivePath", AdhesiveState, int]:
        """Full coupling from the state with point forces: alternate field corrections and contacts.

        If they do not settle, the iteration that came closest, with what the radii still changed by.
        """
        path, closest, difference = self, (np.inf, self, state), np.inf
        for _ in range(MAX_FIELD_UPDATES):
            if not state.rows.size:
                return path, state, steps
            guess = np.zeros(self.problem.order.size)
            guess[state.rows] = state.contact_radius
            path = replace(self, problem=self._refine(path.problem, state, guess), base=self.problem)
            following, steps = path._settle(guess.copy(), state.indentation, first=False, steps=steps)
            _, radius, _ = following.scattered(guess.size)
            difference, state = float(np.abs(radius - guess).max() / guess.max()), following
            if difference <= FIELD_UPDATE_CHANGE:
                return path, state, steps
            if difference < closest[0]:
                closest = difference, path, state
        unsettled, path, state = closest
        return path, replace(state, unsettled=unsettled), steps

    def _refine(self, at: ScaledProblem, state: AdhesiveState, contact_radius: Values) -> ScaledProblem:
        """The problem with the neighbours' fields over the width of each contact, at a state.

        ``at`` holds the shifted summits. The terms are those of `contactimg.models.full_coupling` with JKR's
        pressure: Hertz's at the same contact radius minus that of a flat punch. What makes a contact elliptic
        is taken as without adhesion at the same contact radius.
        """
        p, aspect = self.problem, self.law.aspect
        near = np.flatnonzero((contact_radius > 0) | (state.indentation > p.gap))
        x, y, a, radius = at.x[near], at.y[near], contact_radius[near], p.radius[near]
        force, pull = state.scattered(p.gap.size)[0][near], np.sqrt(8 * np.pi * self.law.adhesion * a**3)
        kernel = self.kernel if self.kernel is not None else Kernel.of_thickness(np.inf)
        pairs = DenseCoupling(x, y, kernel)
        wide = pressure_radius(a, radius, aspect)
        fields = pairs.fields(force, wide, bounded_saddle(pairs.fields(force, wide), radius))
        moment = pull * a**2
        fields = replace(
            fields,
            excess=fields.excess - _punch_over_hertz(x, y, pull, a),
            curvature=fields.curvature - _punch_curvature(pairs, moment),
        )
        if kernel.thinness:
            fields.excess[:] += _layer_part(pairs, x, y, moment)
        terms = CapCorrection.of(fields, radius, a, aspect)
        gap, bends, place = p.gap.copy(), np.zeros((p.gap.size, 2)), np.stack([p.x, p.y])
        place[:, near] += np.stack([terms.shift_x, terms.shift_y])
        gap[near] += terms.shifted_rise
        bends[near] = terms.bends
        return replace(p, x=place[0], y=place[1], gap=gap, bends=bends)

    def _settle(
        self, guess: Values, depth: float, *, first: bool, steps: int = 0
    ) -> tuple[AdhesiveState, int]:
        """Newton for one set of contacts after the other, from guessed radii and indentation.

        ``steps`` were taken before for the same solution; they are in the number returned.
        """
        p, rows = self.problem, np.flatnonzero(guess)
        broken = np.zeros(guess.size, dtype=bool)
        while rows.size:
            if first:
                guess[rows] = np.maximum(guess[rows], self.law.touch_radius(p.caps[rows]))
            state, taken, weakest = self._equilibrium(rows, guess[rows], depth)
            steps += taken
            if steps > MAX_TOTAL_STEPS:
                raise ConvergenceError(
                    f"no contacts were found in equilibrium in {MAX_TOTAL_STEPS} Newton steps; approach "
                    "the load in smaller steps"
                )
            if state is None:
                broken[weakest] = True
                rows = rows[rows != weakest]
                continue
            forming = (state.penetration > 0) & ~broken
            forming[rows] = False
            if not forming.any():
                return state, steps
            guess, depth, first = np.zeros(guess.size), state.indentation, False
            guess[rows] = state.contact_radius
            guess[forming] = self.law.touch_radius(p.caps[forming])
            rows = np.flatnonzero(guess)
        return self._parted(), steps

    def _parted(self) -> AdhesiveState:
        """The state without contacts, after the last one has broken."""
        p = self.problem
        loaded = p.load is not None and not p.stiffness
        if p.load is not None and p.load > 0:
            raise ConvergenceError(
                f"no contacts were found in equilibrium under the load of {p.load * p.force_unit:.6g} N; "
                "approach it in smaller steps, or start at a higher load"
            )
        if loaded and p.load is not None and p.load < 0:
            raise ModelRangeError(
                "load must not be below pull-off: the contacts cannot bear a pull of "
                f"{-p.load * p.force_unit:.6g} N"
            )
        none, depth = np.zeros(0), 0.0 if loaded else p.indentation
        return AdhesiveState(np.zeros(0, dtype=np.intp), none, none, depth - p.gap, depth, 0.0)

    def _equilibrium(self, rows: Rows, a: Values, depth: float) -> tuple[AdhesiveState | None, int, int]:
        """Solve for one set of contacts; if it has no equilibrium, name the contact closest to its fold."""
        if rows.size > MAX_CONTACTS:
            raise ModelRangeError(
                f"{rows.size} adhesive contacts are too many for a dense matrix, at most {MAX_CONTACTS}; "
                "lower the load or take a part of the pattern"
            )
        contacts = AdhesiveContacts.of(self, rows)
        D = self.problem.indentation if self.problem.load is None else depth
        error, missing = contacts.errors(a, D)
        for steps in range(self.max_iterations + 1):
            residual = contacts.residual(error, missing, D)
            if residual <= self.tolerance and contacts.balanced(a, missing):
                return contacts.state(a, D, residual), steps, -1
            change, rise = contacts.direction(a, error, missing)
            step, merit = 1.0, float(error @ error + missing**2)
            while step > _MIN_STEP_FRACTION:
                trial = np.clip(a + step * change, contacts.fold, contacts.widest)
                trial_error, trial_missing = contacts.errors(trial, D + step * rise)
                if float(trial_error @ trial_error + trial_missing**2) < (1 - 1e-4 * step) * merit:
                    break
                step /= 2
            else:
                break
            error, missing = trial_error, trial_missing
            a, D = trial, D + step * rise
        if residual <= self.tolerance:
            return contacts.state(a, D, residual), steps, -1
        contacts.refuse_engulfed(a)
        return None, steps, int(rows[np.argmin(a / contacts.fold)])


@dataclass(frozen=True, eq=False)
class AdhesiveContacts:
    """Equations of a set of contacts in their radii: ``delta(a) + C p(a) + g - D = 0``, ``sum p = P``."""

    path: AdhesivePath
    rows: Rows
    caps: Caps
    gap: Values
    fold: Values
    widest: Values
    matrix: Values

    @classmethod
    def of(cls, path: AdhesivePath, rows: Rows) -> "AdhesiveContacts":
        """The equations of given rows; ``fold`` are the radii at which an isolated contact breaks."""
        p = path.problem
        caps = p.caps[rows]
        matrix = np.zeros((rows.size, rows.size))
        if path.kernel is not None:
            p.part(rows).refuse_duplicates()
            matrix = DenseCoupling(p.x[rows], p.y[rows], path.kernel).matrix
        fold, widest = path.law.fold(caps), path.law.widest(caps)
        return cls(path, rows, caps, p.gap[rows], fold, widest, matrix)

    def errors(self, a: Values, depth: float) -> tuple[Values, float]:
        """Errors of the penetrations and of the load."""
        penetration = self.path.law.penetration(a, self.caps)
        force, load = self.path.law.force(a, self.caps), self.path.problem.load
        missing = 0.0 if load is None else load - self.path.problem.stiffness * depth - float(force.sum())
        return penetration + self.matrix @ force + self.gap - depth, missing

    def residual(self, error: Values, missing: float, depth: float) -> float:
        """Largest relative error."""
        load = self.path.problem.load
        size = max(1.0, float(np.abs(depth - self.gap).max()))
        return max(float(np.abs(error).max()) / size, abs(missing) / max(1.0, abs(load or 0.0)))

    def refuse_engulfed(self, a: Values) -> None:
        """Refuse contacts that reach the centre of another one."""
        if not a.size or np.pi * float(self.matrix.max()) * float(a.max()) < 1:
            return
        reach = np.pi * self.matrix * np.maximum(a, a[:, None])
        i, j = np.unravel_index(int(np.argmax(reach)), reach.shape)
        if reach[i, j] >= 1:
            p = self.path.problem
            first, second = sorted(int(p.order[self.rows[k]]) for k in (i, j))
            apart = p.length / (np.pi * self.matrix[i, j])
            raise ModelRangeError(
                f"asperities: rows {first} and {second}, {apart * 1e6:.4g} um apart, are closer than the "
                f"contact radius of {max(a[i], a[j]) * p.length * 1e6:.4g} um; lower the load or merge them"
            )

    def balanced(self, a: Values, missing: float) -> bool:
        """Whether the forces sum to the load within `LOAD_TOLERANCE`, or within their rounding errors."""
        load = self.path.problem.load
        if not load or self.path.problem.stiffness or abs(missing) <= LOAD_TOLERANCE * abs(load):
            return True
        rounding = 8 * np.finfo(float).eps * float(np.sum(np.abs(self.path.law.force(a, self.caps))))
        return bool(abs(missing) <= rounding)

    def direction(self, a: Values, error: Values, missing: float) -> tuple[Values, float]:
        """Newton's change of radii and of the indentation."""
        stiffness, softness = self.path.law.slopes(a, self.caps)
        jacobian = self.matrix * stiffness
        # at the fold the softness vanishes; a lower bound keeps the matrix of an uncoupled row regular
        jacobian[np.diag_indices_from(jacobian)] += np.maximum(softness, 1e-9 * a / self.caps.radius)
        back, sink = np.linalg.solve(jacobian, np.column_stack([error, np.ones(a.size)])).T
        if self.path.problem.load is None:
            return -back, 0.0
        rise = float((missing + stiffness @ back) / (stiffness @ sink + self.path.problem.stiffness))
        return rise * sink - back, rise

    def state(self, a: Values, depth: float, residual: float) -> AdhesiveState:
        """The state with all penetrations: JKR's in contact, the overlap of the surfaces elsewhere."""
        p, law, force = self.path.problem, self.path.law, self.path.law.force(a, self.caps)
        penetration = depth - p.gap
        penetration[self.rows] = 0.0
        near = np.flatnonzero(penetration > 0)
        if self.path.kernel is not None:
            p.part(np.union1d(near, self.rows)).refuse_duplicates()
            sources = np.stack([p.x, p.y])[:, self.rows]
            penetration[near] -= self.path.kernel.displacement(p.x[near], p.y[near], sources, force)
        penetration[self.rows] = law.penetration(a, self.caps)
        return AdhesiveState(self.rows, a, force, penetration, depth, residual, self)


def _punch_over_hertz(x: Values, y: Values, pull: Values, a: Values) -> Values:
    """Displacement of a half-space by flat punches minus that by Hertz's pressure of the same forces."""
    loaded = np.flatnonzero(a)
    r = np.hypot(x[:, None] - x[loaded], y[:, None] - y[loaded])
    apart = r > 0
    ratio = a[loaded] / np.where(apart, r, np.inf)
    inner = np.clip(ratio, 1e-3, 1.0)
    punch = np.arcsin(inner) / inner
    hertz = 0.75 * ((2 * inner**2 - 1) * punch + np.sqrt(1 - inner**2)) / inner**2
    close = np.where(ratio > 1e-3, punch - hertz, ratio**2 / 15)
    inside = np.pi / 2 / np.maximum(ratio, 1.0) - 0.75 * np.pi * (1 - 0.5 / np.maximum(ratio, 1.0) ** 2) / (
        np.maximum(ratio, 1.0)
    )
    difference = np.where(ratio > 1, inside, close)
    return np.where(apart, difference / np.where(apart, r, 1.0), 0.0) @ pull[loaded] / np.pi


def _punch_curvature(pairs: DenseCoupling, moment: Values) -> Values:
    """Half the Laplacian of that difference, ``p a^2/(15 r^3)`` for each ``p a^2`` of ``moment``."""
    return pairs.fields(moment, (moment > 0).astype(np.float64)).quartic * 0.3 / QUARTIC


def _layer_part(pairs: DenseCoupling, x: Values, y: Values, moment: Values) -> Values:
    """Correction of that difference for a layer: 1/15 of ``sum p a^2`` times the Laplacian of the deficit."""
    half_space = DenseCoupling(x, y, Kernel.of_thickness(np.inf))
    weight = (moment > 0).astype(np.float64)
    return (half_space.fields(moment, weight).curvature - pairs.fields(moment, weight).curvature) * 2 / 15
