"""Adhesive contacts in a frozen displacement of the surface: the a-priori state with JKR's law.

At one load the contacts that adhesion adds change the smooth displacement of the surface little: it is
taken from the state without adhesion, and each contact answers for itself. Loading as in
`contactimg.models.adhesive`: contacts form where the surfaces touch, and those that form pull others in.
"""

import numpy as np
from numpy.typing import NDArray

from contactimg.effects.mechanics.state import Response
from contactimg.models.adhesive_asperity_law import AdhesiveLaw

Values = NDArray[np.float64]

MAX_ROUNDS = 50
"""Rounds of contacts that pull others in; the last ones add next to nothing."""

MAX_STEPS = 30

ACCURACY = 1e-6
"""Of the indentation, in units of adhesion's, ``(w^2 R)^(1/3)``."""


def adhesive_response(
    gap: Values, radius: Values, *, law: AdhesiveLaw, load: float, indentation: float
) -> Response:
    """Forces, radii and penetrations of independent adhesive contacts at a load.

    Parameters
    ----------
    gap : ndarray, shape (n,)
        Of the asperities, frozen displacement included; without dimension.
    radius : ndarray, shape (n,)
    law : AdhesiveLaw
    load : float
        Not negative.
    indentation : float
        Of the same contacts without adhesion: first touch of the lowest gap at least.
    """
    depth = max(indentation, float(gap.min()))
    touching = np.flatnonzero(gap <= depth)
    for _ in range(MAX_ROUNDS):
        depth, a = _bearing(gap[touching], radius[touching], law, load, depth)
        reached = np.flatnonzero(gap < depth)
        if reached.size <= touching.size:
            break
        touching = reached
    contact_radius, force = np.zeros_like(gap), np.zeros_like(gap)
    contact_radius[touching], force[touching] = a, law.force(a, radius[touching])
    return Response(force, contact_radius, depth - gap)


def _bearing(
    gap: Values, radius: Values, law: AdhesiveLaw, load: float, lowest: float
) -> tuple[float, Values]:
    """Indentation, not below the lowest, at which a set of contacts bears a load, and their radii."""
    depth, size = lowest, float(np.cbrt(law.adhesion**2 * radius.max()))
    for _ in range(MAX_STEPS):
        a = law.contact_radius(depth - gap, radius)
        stiffness, softness = law.slopes(a, radius)
        rise = (load - float(law.force(a, radius).sum())) / float(np.sum(stiffness / softness))
        if abs(rise) <= ACCURACY * size or (rise < 0 and depth == lowest):
            break
        depth = max(depth + rise, lowest)
    return depth, a
