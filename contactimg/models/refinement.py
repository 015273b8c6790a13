"""What a point force at the summit leaves out: the neighbours' field over the width of a contact.

``hertz`` replaces the neighbours' point forces by Hertz's pressure. ``full`` adds what the slope and the
curvature of the displacement do to a contact: the slope ``G`` shifts the contact sideways by ``s = -R G``,
where the deformed surface and the cap come closest, and the curvature ``T`` (half the Laplacian) makes the
effective radius ``1/(1/R + T)``. Displacements are then those between shifted contacts. All three terms or
none: ``hertz`` alone is less accurate than point forces below ``r/a`` of about 3, because their errors cancel.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.models.newton import Iterate, System, measure

__all__ = ["Refinement"]

Values = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Refinement:
    """Turns a system of point forces into a refined one, around an iterate.

    Parameters
    ----------
    base : System
        Point forces at the summits.
    x, y : ndarray
        The summits.
    full : bool
        Shift and curvature too, not only Hertz's pressure.
    """

    base: System
    x: Values
    y: Values
    full: bool

    def apply(self, system: System, at: Iterate) -> tuple[System, Iterate]:
        """The system refined with the fields at the iterate, and the iterate measured in it."""
        _, contact_radius = system.response(at.penetration(system))
        fields = system.coupling.fields(at.force, contact_radius)
        offset, radius, coupling = fields.excess, self.base.radius, system.coupling
        if self.full:
            shift_x, shift_y = -radius * fields.slope_x, -radius * fields.slope_y
            offset = offset + (shift_x**2 + shift_y**2) / (2 * radius)
            radius = radius / np.maximum(1 + radius * fields.curvature, 0.1)
            coupling = coupling.moved(self.x + shift_x, self.y + shift_y)
        refined = replace(self.base, gap=self.base.gap + offset, radius=radius, coupling=coupling)
        displacement = coupling.displacement(at.force) if self.full else at.displacement
        return refined, measure(refined, at.force, at.indentation, displacement)
