"""Full coupling: the neighbours' displacement field over the width of a contact.

Coupling ``hertz`` replaces the neighbours' point forces by Hertz's pressure. Coupling ``full`` also takes the
slope and the curvature of the displacement into account: the slope ``G`` shifts the contact sideways by ``s =
-R G``, to where the deformed surface and the cap are closest, and the curvature ``T`` (half the Laplacian)
changes the effective radius to ``1/(1/R + T)``. Displacements are then taken between the shifted contacts.
Below ``r/a`` of about 3 ``hertz`` alone is less accurate than point forces, because it removes only one of
several errors that partly cancel.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.models.asperity_laws import Caps
from contactimg.models.newton_iteration import ContactSystem, Iterate, evaluate_iterate

Values = NDArray[np.float64]

MAX_PREVIOUS_CORRECTIONS = 4
"""Previous corrections used by Anderson mixing. Chosen by hand: it affects the number of steps only."""

MIN_CURVATURE_FACTOR = 0.1
"""Least ``1 + R T``. Chosen by hand, to keep the radius positive on the way to a solution."""


@dataclass(frozen=True, eq=False)
class FieldCorrection:
    """Adds the field corrections at an iterate to a system of point forces.

    The corrections (excess displacement, slopes, curvature) depend on the forces and the forces on the
    corrections. The fixed point is approached with one Newton step between two updates, and the updates are
    extrapolated by Anderson mixing.

    Parameters
    ----------
    base : ContactSystem
        Point forces at the summits.
    x, y : ndarray
        The summits.
    full : bool
        Include shift and curvature, not only Hertz's pressure.
    """

    base: ContactSystem
    x: Values
    y: Values
    full: bool
    _history: list[tuple[Values, Values]] = field(default_factory=list)
    _tried: list[Values] = field(default_factory=list)

    def apply(self, system: ContactSystem, at: Iterate) -> tuple[ContactSystem, Iterate]:
        """The system corrected with the fields at an iterate, and that iterate evaluated in it."""
        fields = system.coupling.fields(at.force, at.contact_radius)
        if not self.full:
            refined = replace(self.base, gap=self.base.gap + self._extrapolated(fields.excess))
            return refined, evaluate_iterate(refined, at.force, at.indentation, at.displacement)
        computed = np.stack([fields.excess, fields.slope_x, fields.slope_y, fields.curvature])
        excess, slope_x, slope_y, curvature = self._extrapolated(computed.ravel()).reshape(computed.shape)
        radius = self.base.caps.radius
        shift_x, shift_y = -radius * slope_x, -radius * slope_y
        refined = replace(
            self.base,
            gap=self.base.gap + excess + (shift_x**2 + shift_y**2) / (2 * radius),
            caps=Caps(radius / np.maximum(1 + radius * curvature, MIN_CURVATURE_FACTOR)),
            coupling=system.coupling.at_positions(self.x + shift_x, self.y + shift_y),
        )
        displacement = refined.coupling.displacement(at.force)
        return refined, evaluate_iterate(refined, at.force, at.indentation, displacement)

    def _extrapolated(self, computed: Values) -> Values:
        """The next corrections to try; ``computed`` are those that follow from the last ones tried."""
        if self._tried:
            self._history.append((self._tried.pop(), computed))
            del self._history[: -MAX_PREVIOUS_CORRECTIONS - 1]
            computed = _anderson_mixing(self._history)
        self._tried.append(computed)
        return computed


def _anderson_mixing(history: list[tuple[Values, Values]]) -> Values:
    """The combination of the computed corrections whose error, computed minus tried, is least."""
    if len(history) < 2:
        return history[-1][1]
    computed = np.column_stack([after for _, after in history])
    errors = computed - np.column_stack([before for before, _ in history])
    weights = np.linalg.lstsq(np.diff(errors), errors[:, -1], rcond=1e-8)[0]
    return computed[:, -1] - np.diff(computed) @ weights
