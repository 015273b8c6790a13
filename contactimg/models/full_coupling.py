"""What a point force at the summit leaves out: the neighbours' field over the width of a contact.

``hertz`` replaces the neighbours' point forces by Hertz's pressure. ``full`` adds what the slope and the
curvature of the displacement do to a contact: the slope ``G`` shifts the contact sideways by ``s = -R G``,
where the deformed surface and the cap come closest, and the curvature ``T`` (half the Laplacian) makes the
effective radius ``1/(1/R + T)``. Displacements are then those between shifted contacts. All three terms or
none: ``hertz`` alone is less accurate than point forces below ``r/a`` of about 3, because their errors
cancel.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.models.newton_iteration import ContactSystem, Iterate, evaluate_iterate

Values = NDArray[np.float64]

MEMORY = 4
"""Earlier corrections from which the next one is extrapolated."""


@dataclass(frozen=True, eq=False)
class FieldCorrection:
    """Turns a system of point forces into a refined one, around an iterate.

    The corrections (excess displacement, slopes, curvature) follow from the forces and these from the
    corrections: a fixed point, approached by one Newton step between two updates and by extrapolation from
    the last few of them (Anderson's method).

    Parameters
    ----------
    base : ContactSystem
        Point forces at the summits.
    x, y : ndarray
        The summits.
    full : bool
        Shift and curvature too, not only Hertz's pressure.
    """

    base: ContactSystem
    x: Values
    y: Values
    full: bool
    _history: list[tuple[Values, Values]] = field(default_factory=list)
    _tried: list[Values] = field(default_factory=list)

    def apply(self, system: ContactSystem, at: Iterate) -> tuple[ContactSystem, Iterate]:
        """The system refined with the fields at the iterate, and the iterate measured in it."""
        fields = system.coupling.fields(at.force, at.contact_radius)
        if not self.full:
            refined = replace(self.base, gap=self.base.gap + self._extrapolated(fields.excess))
            return refined, evaluate_iterate(refined, at.force, at.indentation, at.displacement)
        found = np.stack([fields.excess, fields.slope_x, fields.slope_y, fields.curvature])
        excess, slope_x, slope_y, curvature = self._extrapolated(found.ravel()).reshape(found.shape)
        radius = self.base.radius
        shift_x, shift_y = -radius * slope_x, -radius * slope_y
        refined = replace(
            self.base,
            gap=self.base.gap + excess + (shift_x**2 + shift_y**2) / (2 * radius),
            radius=radius / np.maximum(1 + radius * curvature, 0.1),
            coupling=system.coupling.at_positions(self.x + shift_x, self.y + shift_y),
        )
        displacement = refined.coupling.displacement(at.force)
        return refined, evaluate_iterate(refined, at.force, at.indentation, displacement)

    def _extrapolated(self, found: Values) -> Values:
        """The next corrections to try, from those that the last ones tried led to."""
        if self._tried:
            self._history.append((self._tried.pop(), found))
            del self._history[: -MEMORY - 1]
            found = _least_error(self._history)
        self._tried.append(found)
        return found


def _least_error(history: list[tuple[Values, Values]]) -> Values:
    """The combination of what was found whose error, found minus tried, is least (Anderson's mixing)."""
    if len(history) < 2:
        return history[-1][1]
    found = np.column_stack([after for _, after in history])
    errors = found - np.column_stack([before for before, _ in history])
    weights = np.linalg.lstsq(np.diff(errors), errors[:, -1], rcond=1e-8)[0]
    return found[:, -1] - np.diff(found) @ weights
