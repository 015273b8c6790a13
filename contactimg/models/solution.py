"""The record of a solved contact problem of single asperities, and its table of contacts."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.models.cap_shapes import CapShapes
from contactimg.models.proof import CONVERGED
from contactimg.models.validity import Validity, assess, contact_flags
from contactimg.tables import CONTACTS

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Outcome:
    """How a solution was reached: the fields of `InteractingSolution` beside its arrays."""

    indentation: float
    coupling: str
    thickness: float
    iterations: int
    residual: float
    status: str = CONVERGED
    branch: str = ""


@dataclass(frozen=True, eq=False)
class InteractingSolution:
    """Forces and contact radii of every asperity at one load.

    Parameters
    ----------
    force : ndarray, shape (n,), N
        One value an asperity, in the order of the table; zero out of contact.
    radius : ndarray, shape (n,), m
        Contact radii ``a``, of ellipses ``sqrt(a b)``; zero out of contact.
    x, y : ndarray, shape (n,), m
        Composite apexes: where a contact lies.
    composite_radius : ndarray, shape (n,), m
        The radius of curvature in the contact's law; of ellipsoidal caps the geometric mean of the two.
    height : ndarray, shape (n,), m
        Height of the summit above the plane it stands on.
    penetration : ndarray, shape (n,), m
        ``delta``: indentation of each asperity; where it is negative, the gap that remains; -inf for an
        asperity too far from contact to be solved for.
    indentation : float, m
        ``D`` from first touch.
    load : float, N
        Sum of the forces.
    coupling : str
        Level of elastic coupling.
    thickness : float, m
        Thickness of the layer; infinite for a half-space.
    status : str
        ``"converged"`` if the final numbers have passed every check of `contactimg.models.proof`; otherwise a
        sentence that says what does not hold.
    iterations : int
        Newton steps.
    residual : float
        Sum of ``|p - q|`` over the load, with ``q`` the forces and ``p`` those that follow from the
        penetrations.
    branch : str
        How an adhesive solution was reached: ``"first loading"``, ``"loading"``, ``"unloading"`` or
        ``"held"``, from the previous load or indentation to this one; empty without adhesion.
    stability_check : callable, optional
        Evaluates ``stability`` of coupled adhesive contacts.
    shapes : CapShapes or None
        Of caps that are not spheres of one modulus.
    """

    force: Values
    radius: Values
    x: Values
    y: Values
    composite_radius: Values
    height: Values
    penetration: Values
    indentation: float
    load: float
    coupling: str
    thickness: float
    status: str
    iterations: int
    residual: float
    branch: str = ""
    stability_check: Callable[[], str] | None = None
    shapes: CapShapes | None = None

    @cached_property
    def stability(self) -> str:
        """``"stable"`` under what is prescribed, ``"stable only at fixed indentation"`` or ``"unstable"``.

        Evaluated when first asked for. Without adhesion or without coupling the solver finds stable
        equilibria only.
        """
        return "stable" if self.stability_check is None else self.stability_check()

    @property
    def touching(self) -> NDArray[np.intp]:
        """Rows of the asperities in contact."""
        return np.flatnonzero(self.radius > 0)

    @property
    def area(self) -> float:
        """Real contact area ``A = sum pi a^2``, m^2."""
        return float(np.pi * np.sum(self.radius**2))

    @property
    def law_radius(self) -> Values:
        """Radii R (m) with which Hertz's ``4 E* a^3/(3 R)`` is the force, ``E*`` that of the scene."""
        return self.composite_radius if self.shapes is None else self.shapes.area_radius

    @property
    def _widths(self) -> tuple[Values, Values]:
        """Half the widths of the contacts, and the radii (m) that these are compared with for ``a/R``."""
        if self.shapes is None:
            return self.radius, self.composite_radius
        stretch = np.sqrt(self.shapes.axis_ratio)
        return self.radius / stretch, self.shapes.strain_radius / stretch

    @cached_property
    def validity(self) -> Validity:
        """How far the solution is from the limits of the model."""
        rows, (half_width, radius) = self.touching, self._widths
        return assess(
            self.x[rows],
            self.y[rows],
            half_width[rows],
            radius=radius[rows],
            base_gap=self.height[rows] - self.penetration[rows],
            thickness=self.thickness,
        )

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
        ratio, angle = np.ones(rows.size), np.full(rows.size, np.nan)
        if self.shapes is not None:
            ratio = self.shapes.axis_ratio[rows]
            angle = np.where(ratio < 1, self.shapes.azimuth[rows], np.nan)
        return CONTACTS.conform(
            pd.DataFrame(
                {
                    "frame": np.full(rows.size, frame, dtype=object),
                    "label": np.arange(1, rows.size + 1),
                    "x_m": x,
                    "y_m": y,
                    "radius_m": a,
                    "area_m2": np.pi * a**2,
                    "shape": np.where(ratio < 1, "ellipse", "disk"),
                    "semi_major_m": a / np.sqrt(ratio),
                    "semi_minor_m": a * np.sqrt(ratio),
                    "angle_rad": angle,
                    "holes": 0,
                    "asperity": rows,
                    "force_N": self.force[rows],
                    "flags": contact_flags(x, y, *(widths[rows] for widths in self._widths)),
                }
            )
        )
