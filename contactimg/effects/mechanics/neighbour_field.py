"""Effect of the displacement field of the neighbours over the width of a contact, from the closest pairs.

The terms of full coupling (`contactimg.models.full_coupling`) to first order at given forces. They decay with
the cube of the distance, so the nearest neighbours are enough.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.models.coupling import DenseCoupling, Kernel
from contactimg.models.full_coupling import CapCorrection, bounded_saddle
from contactimg.models.near_field_sum import NearFieldSum

Values = NDArray[np.float64]

MAX_ALL_PAIRS = 200
"""Number of contacts up to which all pairs are computed. Chosen by hand; sensitivity not measured."""

MEAN_NEIGHBOURS = 20
"""Mean number of neighbours used beyond that. Chosen by hand; sensitivity not measured."""


@dataclass(frozen=True, eq=False)
class FieldTerms:
    """What full coupling adds.

    Parameters
    ----------
    rise : ndarray, shape (n,)
        Of the gaps: ``excess + s^2/(2 R) + G s - sum_j G_ij s_j`` with the shifts ``s = -R G``, less what
        the ellipses gain.
    bends : ndarray, shape (n, 2)
        `Caps.bends`.
    squared : ndarray, shape (n,)
        Square of the relative change of the curvature, mean and saddle.
    """

    rise: Values
    bends: Values
    squared: Values


def field_terms(
    x: Values, y: Values, radius: Values, *, force: Values, contact_radius: Values, kernel: Kernel
) -> FieldTerms:
    """What full coupling adds to the gaps and to the profiles.

    Parameters
    ----------
    x, y, radius : ndarray, shape (n,)
        Positions and radii of curvature of the contacts, dimensionless.
    force, contact_radius : ndarray, shape (n,)
        Of the contacts coupled by point forces.
    kernel : Kernel
        Its contribution of the layer is used only where all pairs are computed.
    """
    if x.size <= MAX_ALL_PAIRS:
        fields = DenseCoupling(x, y, kernel).fields
    else:
        fields = NearFieldSum(x, y, cutoff=_cutoff(x, y), sharpness=0.0).fields
    circular = fields(force, contact_radius)
    own = fields(force, contact_radius, bounded_saddle(circular, radius))
    terms = CapCorrection.of(own, radius, contact_radius, aspect=0.0)
    sources = (
        fields(force * terms.shift_x, contact_radius).slope_x
        + fields(force * terms.shift_y, contact_radius).slope_y
    )
    squared = radius**2 * (own.curvature**2 + own.saddle_x**2 + own.saddle_y**2)
    return FieldTerms(terms.rise - sources, terms.bends, squared)


def _cutoff(x: Values, y: Values) -> float:
    """Distance within which a contact has `MEAN_NEIGHBOURS` neighbours on average."""
    area = float(np.ptp(x) * np.ptp(y))
    return min(
        float(np.sqrt(MEAN_NEIGHBOURS * area / (np.pi * x.size))), float(np.hypot(np.ptp(x), np.ptp(y)))
    )
