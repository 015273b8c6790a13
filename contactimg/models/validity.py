"""How far a solution is from the limits of the contact models: flags on contacts and a summary.

The models assume small strain in each contact (``a/R``), contacts that do not overlap and an indenter
above the plane between the asperities. Beyond a certain overlap several solutions exist, which is an error.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from contactimg.models.base_gap import BaseGap
from contactimg.tables import Flag

Values = NDArray[np.float64]
Rows = NDArray[np.intp]
Pairs = tuple[Rows, Rows, Values]

HERTZ_LIMIT = 0.33
"""``a/R`` up to which Hertz's law describes elastomer spheres (Yashima et al., Experimental setups)."""


@dataclass(frozen=True)
class Validity:
    """Summary of a solution against the limits of its model; NaN without contacts.

    Parameters
    ----------
    n_contacts : int
    max_strain : float
        Largest ``a/R`` of a contact (composite radius); Hertz's law holds to about 0.33.
    n_beyond_hertz : int
        Contacts above that.
    n_overlapping : int
        Contacts closer to a neighbour than the sum of the two radii.
    planes : BaseGap
        Smallest gap between the lens and the plane between the caps.
    """

    n_contacts: int
    max_strain: float
    n_beyond_hertz: int
    n_overlapping: int
    planes: BaseGap

    @classmethod
    def of(
        cls, x: Values, y: Values, contact_radius: Values, *, radius: Values, planes: BaseGap
    ) -> "Validity":
        """The summary of a solution from arrays over its contacts, in m."""
        strain = contact_radius / radius
        largest = float(strain.max(initial=0.0)) if strain.size else np.nan
        beyond, merged = np.sum(strain > HERTZ_LIMIT), np.sum(overlapping(x, y, contact_radius))
        return cls(strain.size, largest, int(beyond), int(merged), planes)

    @property
    def base_gap(self) -> float:
        """Smallest gap between the lens and the plane between the caps, m; below zero the planes touch."""
        return self.planes.least

    @property
    def planes_touch(self) -> bool:
        """Whether the indenter reaches the plane between the asperities."""
        return self.base_gap < 0

    def messages(self) -> list[str]:
        """One sentence for each assumption that does not hold."""
        sentences = []
        if self.n_beyond_hertz:
            sentences.append(
                f"{self.n_beyond_hertz} of {self.n_contacts} contacts have a/R above {HERTZ_LIMIT} "
                f"(largest {self.max_strain:.2f}): beyond Hertz's law"
            )
        if self.n_overlapping:
            sentences.append(
                f"{self.n_overlapping} of {self.n_contacts} contacts overlap a neighbour: they would merge"
            )
        if self.planes_touch:
            sentences.append(self.planes.sentence)
        return sentences


def close_pairs(x: Values, y: Values, reach: Values) -> Pairs:
    """Pairs ``(i, j)`` not further apart than ``reach[i]``, ``reach[j] <= reach[i]``, and their distances.

    The larger of the two reaches counts; a pair of equal reaches comes once.
    """
    points = np.column_stack([x, y])
    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)  # faster to build, used once
    candidates = np.flatnonzero(reach > 0)
    neighbours = tree.query_ball_point(points[candidates], reach[candidates])
    i = np.repeat(candidates, [len(rows) for rows in neighbours])
    j = np.fromiter((row for rows in neighbours for row in rows), dtype=np.intp, count=i.size)
    keep = (reach[j] < reach[i]) | ((reach[j] == reach[i]) & (j < i))
    i, j = i[keep], j[keep]
    return i, j, np.hypot(x[i] - x[j], y[i] - y[j])


def unstable_pair(
    pairs: Pairs, contact_radius: Values, penetration: Values, force: Values
) -> tuple[int, int] | None:
    """Two candidates so close that the solution with point forces is not unique; None if there are none.

    Two contacts ``i, j`` are in unstable equilibrium where ``2 sqrt(a_i a_j) >= pi r``. If contact ``i``
    keeps candidate ``j`` out of contact, the opposite is a second solution when ``j``, pressed in by its
    penetration without ``i``, would displace the surface at ``i`` by at least the penetration of ``i``.
    Dimensionless (``E* = 1``); ``pairs`` are those no further apart than the diameter of the larger contact.
    """
    i, j, distance = pairs
    both = 4 * contact_radius[i] * contact_radius[j] >= (np.pi * distance) ** 2
    freed = np.maximum(penetration[j] + force[i] / (np.pi * distance), 0.0)
    # the force grows with the penetration at least as a paraboloid's of the neighbour's curvature
    swapped = 4 / 3 * np.sqrt(contact_radius[i] ** 2 / penetration[i]) * freed**1.5
    either = (contact_radius[j] == 0) & (swapped >= np.pi * distance * penetration[i])
    wrong = np.flatnonzero(both | either)
    return (int(i[wrong[0]]), int(j[wrong[0]])) if wrong.size else None


def overlapping(x: Values, y: Values, contact_radius: Values) -> NDArray[np.bool_]:
    """Which contacts are closer to another than the sum of the two radii."""
    i, j, distance = close_pairs(x, y, 2 * contact_radius)
    touch = contact_radius[i] + contact_radius[j] > distance
    result = np.zeros(contact_radius.size, dtype=bool)
    result[i[touch]] = result[j[touch]] = True
    return result


def nearest_neighbours(x: Values, y: Values) -> tuple[Values, Rows]:
    """Distance of each of two points or more to the nearest other one, and which that is."""
    points = np.column_stack([x, y])
    distance, nearest = cKDTree(points).query(points, k=2)
    return np.asarray(distance)[:, 1], np.asarray(nearest)[:, 1]


def contact_flags(x: Values, y: Values, contact_radius: Values, radius: Values) -> NDArray[np.int64]:
    """`Flag` values of contacts: ``BEYOND_HERTZ`` and ``OVERLAP``."""
    flags = np.where(contact_radius > HERTZ_LIMIT * radius, int(Flag.BEYOND_HERTZ), 0)
    return flags + np.where(overlapping(x, y, contact_radius), int(Flag.OVERLAP), 0)
