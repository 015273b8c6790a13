"""The record of a solved contact problem of single asperities, and its table of contacts."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.models.base_gap import BaseGap, GapField
from contactimg.models.composite_summits import CompositeSummits
from contactimg.models.conditions import ContactConditions
from contactimg.models.validity import Validity, contact_flags
from contactimg.tables import CONTACTS

Values = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class InteractingSolution:
    """Forces and contact radii of every asperity at one load.

    Parameters
    ----------
    force : ndarray, shape (n,), N
        One value an asperity, in the order of the table; zero out of contact.
    radius : ndarray, shape (n,), m
        Contact radii ``a``; zero out of contact.
    penetration : ndarray, shape (n,), m
        ``delta``: indentation of each asperity; where it is negative, the gap that remains; -inf for an
        asperity too far from contact to be solved for.
    indentation : float, m
        ``D`` from first touch.
    load : float, N
        Sum of the forces.
    coupling : str
        Level of elastic coupling.
    summits : CompositeSummits
        Asperities and lens combined.
    conditions : ContactConditions
        Lens, elastic body and what was prescribed.
    status : str
        ``"converged"`` if the final numbers have passed every check of `contactimg.models.convergence`;
        otherwise a sentence that says what does not hold.
    iterations : int
        Newton steps.
    residual : float
        Sum of ``|p - q|`` over the load, with ``q`` the forces and ``p`` those that follow from the
        penetrations.
    outside : ndarray, shape (3, k), m and N
        Positions and forces of what surrounds the table.
    """

    force: Values
    radius: Values
    penetration: Values
    indentation: float
    load: float
    coupling: str
    summits: CompositeSummits
    conditions: ContactConditions
    status: str
    iterations: int
    residual: float
    outside: Values = field(default_factory=lambda: np.zeros((3, 0)))

    @property
    def x(self) -> Values:
        """Composite apexes, m: where a contact lies."""
        return self.summits.apexes["x_m"]

    @property
    def y(self) -> Values:
        """Composite apexes, m: the other coordinate."""
        return self.summits.apexes["y_m"]

    @property
    def composite_radius(self) -> Values:
        """The radius of curvature (m) in the contact's law."""
        return self.summits.apexes["radius_m"]

    @property
    def height(self) -> Values:
        """Height of each summit above the plane it stands on, m."""
        return self.summits.height

    @cached_property
    def base_gap(self) -> BaseGap:
        """The smallest gap between the lens and the plane between the caps, and where it is.

        Without coupling the contacts are independent, and none displaces the plane beside it.
        """
        rows = self.touching
        pressing = self.force if self.coupling != "none" else np.zeros_like(self.force)
        own = np.stack([self.x[rows], self.y[rows], pressing[rows], self.radius[rows]])
        outside = np.pad(self.outside, ((0, 1), (0, 0)))
        contacts, discs = np.concatenate([own, outside], axis=1), self.summits.discs
        first_touch = float(self.summits.apexes["height_m"].max(initial=-np.inf))
        return GapField(self.conditions, self.indentation, first_touch, discs, rows, contacts).smallest()

    @property
    def touching(self) -> NDArray[np.intp]:
        """Rows of the asperities in contact."""
        return np.flatnonzero(self.radius > 0)

    @property
    def area(self) -> float:
        """Real contact area ``A = sum pi a^2``, m^2."""
        return float(np.pi * np.sum(self.radius**2))

    @cached_property
    def validity(self) -> Validity:
        """How far the solution is from the limits of the model."""
        rows = self.touching
        radius = self.composite_radius[rows]
        return Validity.of(self.x[rows], self.y[rows], self.radius[rows], radius=radius, planes=self.base_gap)

    def contacts(self, frame: str = "") -> pd.DataFrame:
        """The contacts as a table of the schema `CONTACTS`, in the order of the asperities.

        Parameters
        ----------
        frame : str
            Name of the load, for the column ``frame``.

        Returns
        -------
        DataFrame
            Centre, radius, area, force, row of the asperity, flags ``BEYOND_HERTZ`` and ``OVERLAP``.
        """
        rows = self.touching
        x, y, a = self.x[rows], self.y[rows], self.radius[rows]
        columns = {
            "frame": np.full(rows.size, frame, dtype=object),
            "label": np.arange(1, rows.size + 1),
            "x_m": x,
            "y_m": y,
            **dict.fromkeys(("radius_m", "semi_major_m", "semi_minor_m"), a),
            "area_m2": np.pi * a**2,
            "shape": "disk",
            "asperity": rows,
            "force_N": self.force[rows],
            "flags": contact_flags(x, y, a, self.composite_radius[rows]),
        }
        return CONTACTS.conform(pd.DataFrame(columns))
