"""Newton's method for many unilateral contacts, load and indentation solved together (dimensionless).

The unknowns are the forces ``q`` on the candidates and the indentation ``D``. The penetrations are
``delta = D - g - C q``; the equations are ``q = p(delta)`` and ``sum q = P``. Since ``p`` is continuously
differentiable and zero out of contact, the active set is simply ``{delta > 0}``, and every Newton direction
lowers the mismatch ``|p(delta) - q|``, which serves as merit function. The Newton system is symmetric:
``(W^{-1} + C) dq = W^{-1}(p - q) + dD`` on the active rows with the stiffnesses ``W = 2 a``, and ``dq = -q``
elsewhere.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.models.asperity_laws import AsperityLaw, Caps
from contactimg.models.coupling import Coupling, NewtonSystem, NotPositiveDefinite

Values = NDArray[np.float64]

STEP_FRACTIONS = 0.5 ** np.arange(13)
"""Fractions of a Newton step that the line search tries. Chosen by hand; sensitivity not measured."""

MAX_DOUBLINGS = 2100
"""Most doublings of a depth. Theory: floating-point numbers span 2098 powers of two."""

SOFTENINGS = (0.0, 0.1, 1.0, 10.0, 100.0)
"""Relative softenings of the contacts, tried in turn while the Newton matrix is indefinite or no step lowers
the mismatch. Chosen by hand; sensitivity not measured."""


EXACT = 1e-14
"""Last relative change of the penetration of independent contacts whose solution is wanted to rounding."""

START_ACCURACY = 1e-2
"""The same where they are only a start. Chosen by time: Newton's method leaves the square of it as error."""


@dataclass(frozen=True, eq=False)
class ContactSystem:
    """The candidates of a contact problem.

    Parameters
    ----------
    gap : ndarray
        ``g``: depth of each summit below the highest.
    caps : Caps
    law : AsperityLaw
    coupling : Coupling
    load : float or None
        ``P`` over ``E*``; None when the indentation is prescribed.
    """

    gap: Values
    caps: Caps
    law: AsperityLaw
    coupling: Coupling
    load: float | None

    def response(self, penetration: Values) -> tuple[Values, Values]:
        """Forces and contact radii at penetrations."""
        return self.law.respond(penetration, self.caps)


@dataclass(frozen=True, eq=False)
class Iterate:
    """A state of the iteration.

    Parameters
    ----------
    force : ndarray
        ``q``.
    indentation : float
        ``D``.
    displacement : ndarray
        ``C q``.
    carried, contact_radius : ndarray
        ``p`` and ``a`` at the penetrations of this state.
    residual : float
        Sum of ``|p - q|`` over the load.
    """

    force: Values
    indentation: float
    displacement: Values
    carried: Values
    contact_radius: Values
    residual: float

    def penetration(self, system: ContactSystem) -> Values:
        """``delta = D - g - C q``."""
        return self.indentation - system.gap - self.displacement

    @property
    def mismatch(self) -> float:
        """Euclidean norm of ``p - q``, the merit function."""
        return float(np.linalg.norm(self.carried - self.force))


def evaluate_iterate(
    system: ContactSystem, force: Values, indentation: float, displacement: Values
) -> Iterate:
    """Evaluate penetrations, forces and residual for given forces and indentation."""
    carried, contact_radius = system.response(indentation - system.gap - displacement)
    load = float(carried.sum()) if system.load is None else system.load
    difference = float(np.abs(carried - force).sum())
    residual = difference / load if load > 0 else float(difference > 0)
    return Iterate(force, indentation, displacement, carried, contact_radius, residual)


def solve_uncoupled(
    system: ContactSystem, offset: Values, load: float, *, guess: float = np.inf, accuracy: float = EXACT
) -> float:
    """Find the indentation at which independent contacts under the gaps ``g + offset`` bear a load.

    The load is a convex, increasing function of the indentation: Newton's method started above the root
    descends to it, and started below first steps above. ``guess`` is an indentation to start from,
    ``accuracy`` the last relative change of the penetration.
    """
    gap = system.gap + offset
    lowest = float(gap.min())
    # of that asperity alone
    depth = (0.75 * load / np.sqrt(system.caps.radius[int(np.argmin(gap))])) ** (2 / 3)
    if 0.01 * depth < guess - lowest < depth:
        depth = guess - lowest
    else:
        for _ in range(MAX_DOUBLINGS):
            if not _bearing(system, lowest + depth - gap)[0] < load:
                break
            depth *= 2
    for _ in range(100):
        total, stiffness = _bearing(system, lowest + depth - gap)
        if not stiffness > 0:
            break
        # Newton's method for the power 2/3 of the load, which is convex as well and nearly straight
        step = 1.5 * total * (1 - np.cbrt(load / total) ** 2) / stiffness
        depth = max(depth - step, 0.5 * depth)
        if abs(step) <= accuracy * depth:
            break
    return lowest + depth


def _bearing(system: ContactSystem, penetration: Values) -> tuple[float, float]:
    """Sum of forces and of stiffnesses of independent contacts."""
    touching = np.flatnonzero(penetration > 0)
    force, contact_radius = system.law.respond(penetration[touching], system.caps[touching])
    return float(force.sum()), 2 * float(contact_radius.sum())


def initial_iterate(system: ContactSystem, force: Values, indentation: float) -> Iterate:
    """First iterate from uncoupled forces, or from the forces of a solution at a similar load.

    At prescribed load the displacement by these forces is kept fixed and the indentation adjusted to bear the
    load. At prescribed indentation the forces are scaled until they agree with the penetrations in their
    sum. The start is the mean of these forces and those that follow from the resulting penetrations.
    """
    displacement, loaded = system.coupling.displacement(force), system.load
    if loaded is not None:
        guess = indentation + float(force @ displacement) / float(force.sum())
        indentation = solve_uncoupled(system, displacement, loaded, guess=guess, accuracy=START_ACCURACY)
    else:
        low, high, total = 0.0, 1.0, float(force.sum())
        for _ in range(30):
            factor = 0.5 * (low + high)
            carried, _ = _bearing(system, indentation - system.gap - factor * displacement)
            low, high = (factor, high) if carried > factor * total else (low, factor)
        force, displacement = 0.5 * (low + high) * force, 0.5 * (low + high) * displacement
    mixed = 0.5 * (force + system.response(indentation - system.gap - displacement)[0])
    if loaded is not None:
        mixed *= loaded / mixed.sum()
    displacement = system.coupling.displacement(mixed)
    if loaded is not None:
        indentation = solve_uncoupled(
            system, displacement, loaded, guess=indentation, accuracy=START_ACCURACY
        )
    return evaluate_iterate(system, mixed, indentation, displacement)


def take_step(system: ContactSystem, at: Iterate, tolerance: float) -> Iterate | None:
    """One Newton step, shortened until it lowers the mismatch; None if no step does.

    ``tolerance`` is the final residual wanted: the linear system is solved only as accurately as it requires.
    """
    if not at.contact_radius.any():
        return None
    for softening in SOFTENINGS:
        try:
            change, rise = _direction(system, at, softening, tolerance)
        except NotPositiveDefinite:
            continue
        response = system.coupling.displacement(change)
        for step in STEP_FRACTIONS:
            moved = at.force + step * change, at.indentation + step * rise, at.displacement + step * response
            trial = evaluate_iterate(system, *moved)
            if trial.mismatch < (1 - 1e-4 * step) * at.mismatch:
                return trial
    return None


def _direction(
    system: ContactSystem, at: Iterate, softening: float, tolerance: float
) -> tuple[Values, float]:
    """Newton's change of forces and of indentation, with contacts softened by ``1/(1 + softening)``."""
    active = np.flatnonzero(at.contact_radius > 0)
    change = -at.force
    scale = np.sqrt(2 * at.contact_radius[active] / (1 + softening))
    right = (at.carried - at.force)[active] / scale
    leaving = change.copy()
    leaving[active] = 0.0
    if leaving.any():
        right -= scale * system.coupling.displacement(leaving)[active]
    # the error of the linear solution may be as large as that of the linearisation, or as the residual
    # wanted; where that of the linearisation takes one more step in any case, the two share what is left
    wanted = 0.03 * tolerance / at.residual
    if at.residual**2 > tolerance:
        wanted = 0.3 * np.sqrt(tolerance / at.residual)
    accuracy = min(1e-2, max(1e-10, 0.1 * at.residual, wanted))
    missing = None
    if system.load is not None:
        missing = system.load - float(at.force.sum()) - float(leaving.sum())
    linear = NewtonSystem(scale, right, missing)
    solution, rise = system.coupling.solve_newton_system(active, linear, accuracy)
    change[active] = scale * solution
    return change, rise
