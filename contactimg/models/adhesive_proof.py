"""Prove an adhesive solution: finite numbers, equilibrium, load, complementarity; name its stability."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from contactimg.models.adhesive_asperity_law import AdhesiveLaw
from contactimg.models.adhesive_path import AdhesivePath, AdhesiveState
from contactimg.models.asperity_laws import Caps
from contactimg.models.coupling import DenseCoupling, Kernel
from contactimg.models.load_spring import ContactConditions, LoadSpring
from contactimg.models.proof import MAX_RELATIVE_ERROR, check_finite, judge, relative_error
from contactimg.models.solution import InteractingSolution

Values = NDArray[np.float64]
Rows = NDArray[np.intp]

ROUNDING_FRACTION = 1e-11
"""Error of the sum of adhesive forces, relative to the sum of their magnitudes, that counts as rounding.
Theory: the Hertz part and the punch part of a force cancel, and the iteration stops at relative errors of
1e-11."""


@dataclass(frozen=True, eq=False)
class AdhesiveProof:
    """The checks of one adhesive solution.

    Parameters
    ----------
    path : AdhesivePath
        The problem as solved, with the corrections of full coupling.
    state : AdhesiveState
    law : AdhesiveLaw
        In SI units: ``w/E*`` in m, forces over ``E*`` in m^2.
    conditions : ContactConditions
    previous : InteractingSolution or None
        The solution it was followed from; None at first loading.
    """

    path: AdhesivePath
    state: AdhesiveState
    law: AdhesiveLaw
    conditions: ContactConditions
    previous: InteractingSolution | None

    def judge(self, solution: InteractingSolution) -> InteractingSolution:
        """The solution with status, branch and stability; an error if it is none."""
        check_finite(
            {"force": solution.force, "contact radius": solution.radius, "indentation": solution.indentation}
        )
        if self.state.contacts is not None:
            self.state.contacts.refuse_engulfed(self.state.contact_radius)
        rows, order = self.state.rows, self.path.problem.order
        radius, force = solution.radius[order[rows]], solution.force[order[rows]]
        size = self._penetration_size(solution)
        errors = {"sum of the forces": self._load_error(solution)}
        if rows.size:
            caps = self.path.problem.caps_in_metres(self.path.problem.caps[rows])
            law_force = self.law.force(radius, caps) * self.conditions.contact_modulus
            errors["forces at the contact radii"] = float(
                np.sum(np.abs(law_force - force)) / self._force_size(solution)
            )
            penetration = self.law.penetration(radius, caps)
            difference = np.abs(penetration - self._penetration(solution, force))
            errors["penetrations"] = float(np.max(difference)) / size
        return replace(
            solution,
            status=self._status(solution, errors, size),
            branch=self._branch(),
            stability_check=self._stability_check(),
        )

    def _penetration_size(self, solution: InteractingSolution) -> float:
        """Largest depth of the indenter below the apex of a contact, or the unit of height, m."""
        p = self.path.problem
        depths = np.abs(solution.indentation - p.depths[self.state.rows])
        return max(float(depths.max(initial=0.0)), p.depth)

    def _penetration(self, solution: InteractingSolution, force: Values) -> Values:
        """Penetrations of the contacts from the indentation and the displacement by the forces, m."""
        p, rows, contacts = self.path.problem, self.state.rows, self.state.contacts
        displacement = np.zeros(rows.size)
        if contacts is not None:
            displacement = contacts.matrix @ (force / p.force_unit)
        correction = (self.path.field_gap(rows) + displacement) * p.depth
        return solution.indentation - p.depths[rows] - correction

    def _force_size(self, solution: InteractingSolution) -> float:
        """Sum of the magnitudes of the forces and of their flat-punch parts, N."""
        punch = np.sqrt(8 * np.pi * self.law.adhesion * solution.radius**3) * self.conditions.contact_modulus
        return float(np.sum(np.abs(solution.force) + punch))

    def _load_error(self, solution: InteractingSolution) -> float:
        """Error of the sum of the forces relative to the load; relative to `_force_size` without load."""
        load = self.conditions.load
        if load is None:
            return 0.0
        if isinstance(load, LoadSpring):
            return load.imbalance(float(np.sum(solution.force)), solution.indentation)
        if load == 0:
            return abs(float(np.sum(solution.force))) / (self._force_size(solution) or 1.0)
        return relative_error(float(np.sum(solution.force)), load)

    def _status(self, solution: InteractingSolution, errors: dict[str, float], size: float) -> str:
        """Status from the errors and from the asperities without contact."""
        total = self._force_size(solution)
        load = self.conditions.force if self.conditions.spring is None else None
        away = abs(float(np.sum(solution.force)) - (load or 0.0))
        if load and errors["sum of the forces"] > MAX_RELATIVE_ERROR and away <= ROUNDING_FRACTION * total:
            errors["sum of the forces"] = 0.0
            judge(errors, self.path.tolerance)
            return (
                f"the load of {load:.6g} N is below the accuracy of the adhesive forces, {total:.3g} N: "
                f"they sum to the load within {away:.3g} N"
            )
        overlap = self._overlap()
        status = judge(errors, self.path.tolerance)
        if self.state.unsettled > MAX_RELATIVE_ERROR:
            return (
                "full coupling of the adhesive contacts did not settle: with the fields of the neighbours "
                f"the contact radii still change by {self.state.unsettled:.2g} of the largest"
            )
        if overlap.size and float(overlap.max()) > MAX_RELATIVE_ERROR * size:
            return (
                f"{overlap.size} asperities without contact overlap the indenter, by up to "
                f"{float(overlap.max()) * 1e6:.3g} um: their contacts broke on the way to this solution; "
                "approach it in smaller steps"
            )
        return status

    def _overlap(self) -> Values:
        """Overlaps of the asperities without contact, m: positive ones only."""
        p, state = self.path.problem, self.state
        penetration = state.penetration.copy()
        penetration[state.rows] = -np.inf
        pulling = state.force < 0
        if self.path.kernel is None or not pulling.any():
            return penetration[penetration > 0] * p.depth
        raised = np.flatnonzero((penetration <= 0) & (penetration > -1.0))
        # only contacts that pull raise the surface, and the bulge of a layer
        rise = self._inverse_distances(raised, state.rows[pulling]) @ -state.force[pulling] / np.pi
        rise += self.path.kernel.largest_rise() * float(np.sum(np.abs(state.force))) / np.pi
        raised = raised[penetration[raised] + rise > 0]
        if raised.size:
            kernel = self._inverse_distances(raised, state.rows)
            kernel -= self.path.kernel.deficit(1 / kernel)
            penetration[raised] -= kernel @ state.force / np.pi
        return penetration[penetration > 0] * p.depth

    def _inverse_distances(self, places: Rows, sources: Rows) -> Values:
        """``1/r`` between asperities."""
        p = self.path.problem
        squared = (p.x[places, None] - p.x[sources]) ** 2 + (p.y[places, None] - p.y[sources]) ** 2
        return 1 / np.sqrt(np.maximum(squared, np.finfo(float).eps ** 2))

    def _branch(self) -> str:
        """How the solution was reached."""
        if self.previous is None:
            return "first loading"
        load, previous = self.conditions.load, self.previous
        if isinstance(load, LoadSpring):
            now, then = load.displacement, previous.indentation + previous.load / load.stiffness
        elif load is None:
            now, then = self.state.indentation * self.path.problem.depth, previous.indentation
        else:
            now, then = load, previous.load
        if abs(now - then) <= MAX_RELATIVE_ERROR * abs(now):
            return "held"
        return "loading" if now > then else "unloading"

    def _stability_check(self) -> "StabilityCheck | None":
        """The check of the stability, for when it is asked for."""
        p, rows, state = self.path.problem, self.state.rows, self.state
        if self.path.kernel is None or not rows.size:
            return None
        return StabilityCheck(
            p.x[rows],
            p.y[rows],
            p.caps[rows],
            state.contact_radius,
            self.path.law,
            self.path.kernel,
            prescribed_load=p.load is not None,
            stiffness=p.stiffness,
        )


@dataclass(frozen=True, eq=False)
class StabilityCheck:
    """Stability of adhesive contacts, by the second variation of their energy; dimensionless.

    A contact alone is stable at fixed indentation where its penetration grows with its radius. Coupled
    contacts with the tangent stiffnesses ``k`` are stable while ``diag(1/k) + C`` has as many negative
    eigenvalues as ``diag(1/k)``. Under a prescribed load the sum of the forces must also grow with the
    indentation; with a load cell it may fall, more slowly than the force of the cell.
    """

    x: Values
    y: Values
    caps: Caps
    contact_radius: Values
    law: AdhesiveLaw
    kernel: Kernel
    prescribed_load: bool
    stiffness: float = 0.0

    def __call__(self) -> str:
        """``"stable"``, ``"stable only at fixed indentation"`` or ``"unstable"``."""
        force_slope, penetration_slope = self.law.slopes(self.contact_radius, self.caps)
        if np.any(penetration_slope < 0):
            return "unstable"
        compliance = penetration_slope / np.where(force_slope == 0, np.finfo(float).tiny, force_slope)
        matrix = DenseCoupling(self.x, self.y, self.kernel).matrix
        matrix[np.diag_indices_from(matrix)] += compliance
        factor, pivots, failed = lapack.dsytrf(matrix, lower=1)
        if failed:
            return "unstable"
        # eigenvalues by Sylvester's law of inertia: a pivot of order two has one of each sign
        single = pivots > 0
        negative = int(np.sum(np.diag(factor)[single] < 0)) + int(np.sum(~single)) // 2
        if negative != int(np.sum(compliance < 0)):
            return "unstable"
        if not self.prescribed_load:
            return "stable"
        rise, _ = lapack.dsytrs(factor, pivots, np.ones((self.x.size, 1)), lower=1)
        return "stable" if float(np.sum(rise)) + self.stiffness > 0 else "stable only at fixed indentation"
