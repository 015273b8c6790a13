"""Adhesive contacts on a surface whose displacement is held fixed.

The displacement by the neighbours is that of the state without adhesion; adhesion changes it little at a
given load. Each contact then follows the JKR law independently. As in `contactimg.models.adhesive`, contacts
form where the surfaces touch, and the contacts that form pull others into contact.
"""

import numpy as np
from numpy.typing import NDArray

from contactimg.effects.mechanics.approximate_state import Response
from contactimg.models.adhesive_asperity_law import AdhesiveLaw
from contactimg.models.asperity_laws import Caps

Values = NDArray[np.float64]

MAX_ROUNDS = 50
"""Largest number of rounds in which contacts pull others in. A safety limit, chosen by hand."""

MAX_NEWTON_STEPS = 30
"""Largest number of Newton steps for the indentation. A safety limit, chosen by hand."""

INDENTATION_ACCURACY = 1e-6
"""Accuracy of the indentation in units of ``(w^2 R)^(1/3)``, chosen far below the error of the estimates."""


def adhesive_response(
    gap: Values, caps: Caps, *, law: AdhesiveLaw, load: float, indentation: float
) -> Response:
    """Forces, radii and penetrations of independent adhesive contacts at a load.

    Parameters
    ----------
    gap : ndarray, shape (n,)
        Gaps of the asperities with the fixed displacement, dimensionless.
    caps : Caps
    law : AdhesiveLaw
    load : float
        Not negative.
    indentation : float
        Indentation of the same contacts without adhesion.
    """
    depth = max(indentation, float(gap.min()))
    touching = np.flatnonzero(gap <= depth)
    for _ in range(MAX_ROUNDS):
        depth, a = _balance_load(gap[touching], caps[touching], law, load, depth)
        reached = np.flatnonzero(gap < depth)
        if reached.size <= touching.size:
            break
        touching = reached
    contact_radius, force = np.zeros_like(gap), np.zeros_like(gap)
    contact_radius[touching], force[touching] = a, law.force(a, caps[touching])
    return Response(force, contact_radius, depth - gap, depth)


def _balance_load(
    gap: Values, caps: Caps, law: AdhesiveLaw, load: float, lowest: float
) -> tuple[float, Values]:
    """Indentation, at least ``lowest``, at which contacts carry the load, and the contact radii."""
    depth, size = lowest, float(np.cbrt(law.adhesion**2 * caps.radius.max()))
    for _ in range(MAX_NEWTON_STEPS):
        a = law.contact_radius(depth - gap, caps)
        stiffness, softness = law.slopes(a, caps)
        rise = (load - float(law.force(a, caps).sum())) / float(np.sum(stiffness / softness))
        if abs(rise) <= INDENTATION_ACCURACY * size or (rise < 0 and depth == lowest):
            break
        depth = max(depth + rise, lowest)
    return depth, a
