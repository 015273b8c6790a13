"""Effect of the displacement field of the neighbours over the width of a contact, from the closest pairs.

The terms of full coupling (`contactimg.models.full_coupling`) to first order at given forces: the Hertz
pressure instead of point forces, the slope that shifts a contact, and the curvature that changes its radius
of curvature. They decay with the cube of the distance, so the nearest neighbours are enough.
"""

import numpy as np
from numpy.typing import NDArray

from contactimg.models.coupling import DenseCoupling, Kernel
from contactimg.models.near_field_sum import NearFieldSum

Values = NDArray[np.float64]

MAX_ALL_PAIRS = 200
"""Number of contacts up to which all pairs are computed. Chosen by hand; sensitivity not measured."""

MEAN_NEIGHBOURS = 20
"""Mean number of neighbours used beyond that. Chosen by hand; sensitivity not measured."""


def field_terms(
    x: Values, y: Values, radius: Values, *, force: Values, contact_radius: Values, kernel: Kernel
) -> tuple[Values, Values]:
    """The change of the gaps and the factor on the curvatures by full coupling.

    Parameters
    ----------
    x, y, radius : ndarray, shape (n,)
        Positions and radii of curvature of the contacts, dimensionless.
    force, contact_radius : ndarray, shape (n,)
        Of the contacts coupled by point forces.
    kernel : Kernel
        Its contribution of the layer is used only where all pairs are computed.

    Returns
    -------
    lowering, bending : ndarray
        ``excess + s^2/(2 R) + G s - sum_j G_ij s_j`` with the shifts ``s = -R G``, and ``1 + R T``.
    """
    if x.size <= MAX_ALL_PAIRS:
        fields = DenseCoupling(x, y, kernel).fields
    else:
        fields = NearFieldSum(x, y, cutoff=_cutoff(x, y), sharpness=0.0).fields
    own = fields(force, contact_radius)
    shift_x, shift_y = -radius * own.slope_x, -radius * own.slope_y
    sources = (
        fields(force * shift_x, contact_radius).slope_x + fields(force * shift_y, contact_radius).slope_y
    )
    # s = -R G: the gap at the shifted summit rises by s^2/(2 R) and the field there falls by s^2/R
    lowering = own.excess - (shift_x**2 + shift_y**2) / (2 * radius) - sources
    return lowering, np.maximum(1 + radius * own.curvature, 0.1)


def _cutoff(x: Values, y: Values) -> float:
    """Distance within which a contact has `MEAN_NEIGHBOURS` neighbours on average."""
    area = float(np.ptp(x) * np.ptp(y))
    return min(
        float(np.sqrt(MEAN_NEIGHBOURS * area / (np.pi * x.size))), float(np.hypot(np.ptp(x), np.ptp(y)))
    )
